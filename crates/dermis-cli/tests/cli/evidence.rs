//! `dermis evidence` on sets made by a twin's model, on damaged or missing sets, and on the real ones.

use std::fs;
use std::path::Path;

use serde_json::Value;

use super::{Desk, text};

/// Writes `data/golfball` and `data/five-skins/plain` in the layout of the measured sets, made by models.
pub(crate) fn synthetic_sets(desk: &Desk) {
    let prepare = |name: &str| {
        let skin = dermis_skin::Skin::open(name).expect("a built-in skin");
        dermis_live::prepare::Prepared::new(skin).expect("a skin that meshes")
    };
    let tank = prepare("golfball-tank");
    let with_balls = |balls: &[[f64; 2]]| -> Vec<f64> {
        let signatures = tank.signatures(balls);
        let sum = |channel: usize| signatures.iter().skip(channel).step_by(tank.channels()).sum::<f64>();
        tank.voltages.iter().enumerate().map(|(channel, v)| (v + 0.3 * sum(channel)).abs()).collect()
    };
    let frames = [vec![], vec![[0.0, 0.0]], vec![[0.0, 0.07]], vec![[0.0, 0.07], [-0.07, 0.0]]];
    let frames = frames.map(|balls| with_balls(&balls));
    let row = |channel: usize| frames.each_ref().map(|frame| frame[channel].to_string()).join(",") + "\n";
    let rows: String = (0..tank.channels()).map(row).collect();
    put(&desk.path("data/golfball/phantom_A.csv"), &format!("ref,setup2,setup3,setup4\n{rows}"));

    let gel = prepare("hydrogel-disc");
    let places: Vec<[f64; 2]> =
        (1..=66).map(|k| [0.618_034, 0.754_878].map(|step| 0.08 * ((f64::from(k) * step).fract() - 0.5))).collect();
    let signatures = gel.signatures(&places);
    let frames: String = signatures
        .chunks_exact(gel.channels())
        .map(|frame| frame.iter().map(|v| format!("{:.9e}", 1e5 * v)).collect::<Vec<_>>().join(",") + "\n")
        .collect();
    put(&desk.path("data/five-skins/plain/differences.csv"), &frames);
    let rows: String = places.iter().map(|[x, y]| format!("{x},{y},0.005\n")).collect();
    put(&desk.path("data/five-skins/plain/positions.csv"), &format!("x_m,y_m,depth_m\n{rows}"));
}

fn put(path: &Path, text: &str) {
    fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
    fs::write(path, text).expect("a file");
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).expect("JSON")
}

/// The figure with this name in a row of a set.
fn figure(set: &Value, row: usize, name: &str) -> f64 {
    let figures = set["findings"][row]["here"].as_array().expect("figures");
    let found = figures.iter().find(|figure| figure["name"] == name);
    found.and_then(|figure| figure["value"].as_f64()).unwrap_or_else(|| panic!("no {name} in {figures:?}"))
}

#[test]
fn evidence_measures_present_sets_and_lists_missing_ones() {
    let desk = Desk::with(&[]);
    synthetic_sets(&desk);
    let words = ["evidence", "--data", "data", "--only", "ktc,golfball,five-skins", "--quick", "--json"];
    let found = json(&desk.done(&words));
    let [skins, tank, balls] = found["sets"].as_array().expect("sets").as_slice() else { panic!("{found}") };
    assert_eq!([&skins["state"], &tank["state"], &balls["state"]], ["incomplete", "missing", "measured"], "{found}");
    assert_eq!(skins["looked_at"][0], "data/five-skins/circles/differences.csv");
    assert_eq!(tank["looked_at"][0], "data/ktc/truth_train1.csv");
    assert!(figure(balls, 0, "ball at (0, 70)") < 10.0, "{balls}");
    assert!(figure(skins, 0, "median") < 5.0, "{skins}");
    assert_eq!(balls["command"], "dermis evidence --data DIR --only golfball --quick");
    assert!(balls["findings"][0]["seconds"].as_f64().is_some_and(|seconds| seconds > 0.0));
}

#[test]
fn evidence_fills_the_tables_of_a_page_and_leaves_its_prose() {
    let page = "# Mine\n\nBefore.\n\n<!-- evidence:begin -->\nold\n<!-- evidence:end -->\n\nAfter.\n";
    let desk = Desk::with(&[("page.md", page), ("prose.md", "# Nothing to fill\n")]);
    synthetic_sets(&desk);
    let words = ["evidence", "--data", "data", "--only", "golfball,team7", "--quick", "--out"];
    desk.done(&[&words[..], &["page.md"]].concat());
    let filled = fs::read_to_string(desk.path("page.md")).expect("a page");
    assert!(filled.starts_with("# Mine\n\nBefore.\n\n<!-- evidence:begin -->\n"), "{filled}");
    assert!(filled.ends_with("<!-- evidence:end -->\n\nAfter.\n") && !filled.contains("old"), "{filled}");
    assert!(filled.contains("### `golfball`: ") && filled.contains("ball at (0, 0)"), "{filled}");
    assert!(filled.contains("Missing: `DIR/team7/team7_Bz_gauss_50hz.csv` does not exist."), "{filled}");
    for name in ["new.md", "new.html", "new.json"] {
        desk.done(&[&words[..], &[name]].concat());
        assert!(fs::read_to_string(desk.path(name)).expect("a file").contains("golfball"), "{name}");
    }
    for (name, expected) in [
        ("prose.md", "<!-- evidence:begin -->"),
        ("page.txt", "expected a name that ends in .md, .html or .json"),
        ("nowhere/page.md", "its folder does not exist"),
    ] {
        let message = desk.refused(&[&words[..], &[name]].concat(), 2);
        assert!(message.contains(expected), "{name}: {message}");
    }
    assert_eq!(fs::read_to_string(desk.path("prose.md")).expect("a page"), "# Nothing to fill\n");
}

#[test]
fn a_damaged_set_is_reported_and_the_others_still_run() {
    let desk = Desk::with(&[]);
    synthetic_sets(&desk);
    put(&desk.path("data/team7/team7_Bz_gauss_50hz.csv"), "x_mm,a,b,c,d\n0,1,2,3,4\n");
    put(&desk.path("data/pyeidors-tank/electrode01_jelly/a.csv"), "1,2,3,4\n");
    put(&desk.path("data/hydrogel-damage/monitored.csv"), "\u{1}PNG\u{0}\n");
    let sets = "golfball,team7,pyeidors-tank,hydrogel-damage";
    let output = desk.run(&["evidence", "--data", "data", "--only", sets, "--quick", "--json"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    for file in ["team7_Bz_gauss_50hz.csv", "electrode01_jelly", "monitored.csv"] {
        assert!(text(&output.stderr).contains(file), "{file}: {}", text(&output.stderr));
    }
    let found = json(&text(&output.stdout));
    let states: Vec<&str> =
        found["sets"].as_array().expect("sets").iter().filter_map(|set| set["state"].as_str()).collect();
    assert_eq!(states, ["failed", "measured", "failed", "failed"]);
}

#[test]
fn evidence_without_sets_or_with_unknown_sets_is_refused() {
    let desk = Desk::with(&[("file", "")]);
    fs::create_dir(desk.path("empty")).expect("a folder");
    let output = desk.run(&["evidence", "--data", "empty"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("0 of 8 sets"), "{}", text(&output.stdout));
    for (words, expected) in [
        (&["--data", "empty", "--only", "gel"][..], "--only gel: expected one or more of hydrogel, five-skins"),
        (&["--data", "file"], "--data file: expected a folder"),
        (&["--data", "none"], "--data none: expected a folder"),
        (&[], "--data"),
    ] {
        let message = desk.refused(&[&["evidence"], words].concat(), 2);
        assert!(message.contains(expected), "{words:?}: {message}");
    }
    assert_eq!(desk.done(&["evidence", "--list"]).lines().count(), 8);
}

/// The quick run on measured sets that takes a few minutes at most.
#[test]
fn evidence_holds_on_measured_sets() {
    let Some(folder) = dermis_testdata::set("golfball") else { return };
    for name in ["hydrogel", "sciospec", "pyeidors-tank", "team7"] {
        if dermis_testdata::set(name).is_none() {
            return;
        }
    }
    let desk = Desk::with(&[]);
    let data = folder.parent().expect("the folder of all sets").display().to_string();
    let sets = "hydrogel,golfball,pyeidors-tank,sciospec,team7";
    let found = json(&desk.done(&["evidence", "--data", &data, "--only", sets, "--quick", "--json"]));
    let set = |name: &str| {
        let sets = found["sets"].as_array().expect("sets");
        sets.iter().find(|set| set["set"] == name).unwrap_or_else(|| panic!("no {name} in {found}"))
    };
    println!("{found:#}");
    assert!(figure(set("hydrogel"), 0, "median") < 7.0);
    // After 50 and 400 pokes.
    assert!(figure(set("hydrogel"), 1, "median") < 5.0 && figure(set("hydrogel"), 2, "median") < 2.0);
    assert!(figure(set("golfball"), 0, "ball at (0, 0)") < 10.0);
    assert_eq!(figure(set("pyeidors-tank"), 0, "right sign within half a pitch"), 18.0);
    assert!((58.0..=62.0).contains(&figure(set("sciospec"), 0, "first seen in frame")));
    assert!(figure(set("team7"), 0, "rms at phase 0") < 2.2);
}
