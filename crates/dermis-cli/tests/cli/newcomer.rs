//! A newcomer's first hour: frames in files, an order that differs from the skin's, exports, a new skin.

use std::fs;

use serde_json::Value;

use super::{Desk, text};

/// A desk with rest.csv, frames of the untouched twin, and press.csv, ten frames of each of three presses.
fn sampled(skin: &str) -> Desk {
    let desk = Desk::with(&[]);
    sample(&desk, skin);
    desk
}

fn sample(desk: &Desk, skin: &str) {
    let files = ["--baseline", "rest.csv", "--frames", "press.csv"];
    desk.done(&[&["twin", "sample", skin, "--presses", "random:3", "--repeats", "10"], &files[..]].concat());
}

fn touched(lines: &str) -> usize {
    let lines = lines.lines().map(|line| serde_json::from_str::<Value>(line).expect("a line"));
    lines.filter(|line| line["touches"].as_array().is_some_and(|list| !list.is_empty())).count()
}

#[test]
fn a_file_of_touched_frames_runs_with_its_own_baseline_and_reports_its_end() {
    let desk = sampled("healing-square");
    let run = ["run", "healing-square", "--source", "press.csv", "--speed", "0", "--headless"];
    for baseline in ["rest.csv", "rest.csv#0..8"] {
        let output = desk.run(&[&run[..], &["--baseline", baseline]].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        assert!(text(&output.stderr).contains("press.csv has ended after 30 frames"), "{}", text(&output.stderr));
        assert!(touched(&text(&output.stdout)) >= 25, "{baseline}: {} of 30 frames", touched(&text(&output.stdout)));
    }
    let output = desk.run(&run);
    assert_eq!(output.status.code(), Some(0));
    assert!(
        text(&output.stderr).contains("hint: the first 32 frames of press.csv are assumed to show the untouched skin")
    );
    let refused = desk.refused(&[&run[..], &["--baseline", "none.csv"]].concat(), 2);
    assert!(refused.contains("none.csv"), "{refused}");
}

#[test]
fn a_wrong_order_fails_with_the_line_to_write() {
    let text_of = dermis_skin::builtin_text("healing-square").expect("a built-in skin");
    let rotating =
        text_of.replacen("measure = \"pseudo-polar\"\n", "measure = \"pseudo-polar\"\norder = \"rotating\"\n", 1);
    assert_ne!(rotating, text_of);
    let desk = Desk::with(&[("rotating.toml", &rotating)]);
    sample(&desk, "rotating.toml");
    let files = ["--baseline", "rest.csv", "--frames", "press.csv", "--touches", "t.csv"];
    let output = desk.run(&[&["reconstruct", "healing-square"], &files[..]].concat());
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("\norder = \"rotating\"\n"), "{}", text(&output.stdout));
    desk.done(&[&["reconstruct", "rotating.toml"], &files[..]].concat());
    // The command that searches for orders reports the same, as text and as JSON.
    let said = desk.done(&["order", "healing-square", "--baseline", "rest.csv"]);
    assert!(said.contains("drive = \"pseudo-polar\"\nmeasure = \"pseudo-polar\"\norder = \"rotating\"\n"), "{said}");
    let json: Value =
        serde_json::from_str(&desk.done(&["order", "--skin", "healing-square", "--baseline", "rest.csv", "--json"]))
            .expect("JSON");
    assert_eq!((&json["readings"], &json["is_clear"]), (&Value::from(208), &Value::from(true)));
    assert_eq!(json["candidates"][0]["order"], "rotating");
}

#[test]
fn every_export_of_frames_is_read_like_the_recording() {
    let desk = Desk::with(&[]);
    desk.done(&["record", "healing-square", "--speed", "0", "--frames", "120", "--out", "a.mcap"]);
    desk.done(&["export", "a.mcap", "--out", "a.csv"]);
    desk.done(&["export", "a.mcap", "--format", "npy", "--out", "a.npy"]);
    let mut tables = Vec::new();
    for file in ["a.mcap", "a.csv", "a.npy"] {
        let (baseline, frames) = (format!("{file}#0..32"), format!("{file}#32.."));
        let words =
            ["reconstruct", "healing-square", "--baseline", &baseline, "--frames", &frames, "--touches", "t.csv"];
        let said = desk.done(&words);
        assert!(said.contains("frames: 88\n"), "{file}: {said}");
        desk.done(&["snr", "--frames", &baseline]);
        let table = fs::read_to_string(desk.path("t.csv")).expect("a table");
        // An array has no times, so tracks differ; the positions are the same.
        let places = |line: &str| {
            let cells: Vec<f64> = line.split(',').take(4).map(|cell| cell.parse().expect("a number")).collect();
            [cells[0], cells[2], cells[3]]
        };
        tables.push(table.lines().skip(1).map(places).collect::<Vec<_>>());
    }
    assert!(tables[0].len() > 20, "{} rows", tables[0].len());
    for (other, what) in tables[1..].iter().zip(["the CSV", "the array"]) {
        assert_eq!(other.len(), tables[0].len(), "{what} gives as many touches as the recording");
        // Equal except for rounding, since sums may be taken in another order.
        let off = other
            .iter()
            .zip(&tables[0])
            .flat_map(|(a, b)| (0..3).map(move |k| (a[k] - b[k]).abs()))
            .fold(0.0, f64::max);
        assert!(off < 1e-9, "{what} gives other touches: {off} mm off");
    }
}

#[test]
fn a_recording_in_place_of_a_skin_is_answered_with_the_right_option() {
    let desk = Desk::with(&[]);
    desk.done(&["record", "healing-square", "--speed", "0", "--frames", "3", "--out", "x.mcap"]);
    let said = desk.refused(&["run", "x.mcap", "--headless"], 2);
    assert!(said.contains("dermis run --source x.mcap"), "{said}");
    let said = desk.refused(&["run", "serial:/dev/ttyACM0", "--headless"], 2);
    assert!(said.contains("--source serial:/dev/ttyACM0"), "{said}");
    let said = desk.refused(&["run", "no-such-skin", "--headless"], 2);
    assert!(said.contains("hint: `dermis skins list`") && said.contains("dermis new"), "{said}");
}

#[test]
fn a_new_skin_may_go_into_a_folder_that_does_not_exist() {
    let desk = Desk::with(&[]);
    let begin =
        ["new", "mine", "--outline", "square:60", "--electrodes", "8", "--layer", "gel", "--instrument", "none"];
    desk.done(&[&begin[..], &["--out", "skins/first"]].concat());
    assert!(desk.path("skins/first/mine.toml").is_file() && desk.path("skins/first/mine.svg").is_file());
}

#[test]
fn skins_side_by_side_get_one_instrument_and_a_verdict_that_no_noise_turns() {
    let desk = Desk::with(&[]);
    for count in ["8", "16", "32"] {
        let name = format!("s{count}");
        desk.done(&[
            "new",
            &name,
            "--outline",
            "square:100",
            "--electrodes",
            count,
            "--layer",
            "gel",
            "--instrument",
            "none",
        ]);
    }
    let compare =
        |more: &[&str]| desk.done(&[&["design", "s8.toml", "s16.toml", "s32.toml", "--map", "8"], more].concat());
    let verdict = |said: &str| said.lines().last().expect("a line").split(" at ").next().expect("words").to_owned();
    let said = compare(&[]);
    assert!(said.contains("one instrument for all: ") && said.contains(" per reading of s8 "), "{said}");
    assert!(verdict(&said).contains("places touches best") || verdict(&said).contains("equally well"), "{said}");
    let best = |said: &str| said.lines().last().expect("a line").split_whitespace().next().expect("a name").to_owned();
    for noise in ["0.1", "10"] {
        assert_eq!(best(&compare(&["--noise-uv", noise])), best(&said), "{noise} uV");
    }
    let json: Value = serde_json::from_str(&compare(&["--json"])).expect("JSON");
    assert_eq!(json["skins"].as_array().map(Vec::len), Some(3));
    assert!(json["verdict"].as_str().is_some_and(|text| said.contains(text)), "{json}");
    // A search also accepts a signal-to-noise ratio, and prints patterns in the syntax of skin files.
    let words = ["design", "s8.toml", "--map", "4", "--improve", "drive", "--winner", "w.toml", "--snr-db", "60"];
    let said = desk.done(&words);
    assert!(said.contains("measure = \"adjacent\"") && !said.contains("Skip("), "{said}");
}

#[test]
fn a_new_skin_file_is_written_and_never_replaced() {
    let desk = Desk::with(&[("corners.csv", "x_mm,y_mm\n-50,-40\n50,-40\n60,40\n-60,40\n")]);
    let begin = ["new", "mine", "--outline", "polygon:corners.csv", "--electrodes", "12", "--layer", "foam"];
    let said = desk.done(&[&begin[..], &["--instrument", "tcp:10.0.0.5:4000"]].concat());
    assert!(
        said.contains("12 electrodes, 108 channels")
            && said.contains("dermis run mine.toml --source tcp:10.0.0.5:4000")
    );
    let file = fs::read_to_string(desk.path("mine.toml")).expect("a skin file");
    assert!(file.lines().filter(|line| line.starts_with('#')).count() > 10, "{file}");
    assert!(fs::read_to_string(desk.path("mine.svg")).expect("a drawing").starts_with("<svg "));
    desk.done(&["skins", "show", "mine.toml"]);
    for again in ["mine.toml", "mine.svg"] {
        let said = desk.refused(&begin, 2);
        assert!(said.contains("already exists"), "{again}: {said}");
        fs::remove_file(desk.path("mine.toml")).ok();
    }
    fs::remove_file(desk.path("mine.svg")).expect("a file");
    let table: [(&[&str], &str); 4] = [
        (&["new", "../mine"], "letters, digits"),
        (&["new", "m", "--outline", "square:-3"], "outline \"square:-3\""),
        (&["new", "m", "--outline", "polygon:none.csv"], "none.csv"),
        (&["new", "m", "--instrument", "file.csv"], "expected none, serial:PORT or tcp:HOST:PORT"),
    ];
    for (words, expected) in table {
        let said = desk.refused(words, 2);
        assert!(said.contains(expected), "{words:?}: {said}");
    }
    // Without a terminal, defaults replace the missing answers.
    assert!(desk.done(&["new", "usual"]).contains("16 electrodes, 208 channels"));
}

#[test]
fn earlier_spellings_are_understood_with_a_hint() {
    let desk = sampled("healing-square");
    let output = desk.run(&[
        "segment",
        "--skin",
        "healing-square",
        "--reference",
        "rest.csv",
        "--frames",
        "press.csv#0",
        "--out",
        "l.npy",
        "--size",
        "16",
    ]);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(
        said.contains("--skin healing-square is now written as the first word")
            && said.contains("--reference is now --baseline"),
        "{said}"
    );
    let said = desk.refused(&["segment", "--baseline", "rest.csv", "--frames", "press.csv", "--out", "l2.npy"], 2);
    assert!(said.contains("SKIN is missing"), "{said}");
}

#[test]
fn shells_and_manual_pages_know_every_command() {
    let desk = Desk::with(&[]);
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = desk.done(&["completions", shell]);
        assert!(script.contains("reconstruct") && script.contains("calibration"), "{shell}");
    }
    desk.done(&["completions", "man", "--out", "man"]);
    let page = fs::read_to_string(desk.path("man/dermis-reconstruct.1")).expect("a page");
    assert!(page.contains("baseline"), "{page}");
    assert!(desk.path("man/dermis-skins-draw.1").is_file());
    assert!(desk.refused(&["completions", "man"], 2).contains("--out FOLDER"));
}

#[test]
fn tables_are_also_printed_as_json() {
    let desk = Desk::with(&[]);
    let json = |words: &[&str]| -> Value { serde_json::from_str(&desk.done(words)).expect("JSON") };
    assert!(json(&["skins", "list", "--json"]).as_array().is_some_and(|list| list.len() > 10));
    assert!(json(&["reproduce", "--list", "--json"]).as_array().is_some_and(|list| list.len() >= 4));
}
