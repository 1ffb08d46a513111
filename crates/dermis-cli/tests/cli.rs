//! The command as a user's script sees it: exit codes, messages, files. Reference values are worked out by hand, or
//! come from EIDORS (`tests/data/oracle/eit`).

#[path = "cli/evidence.rs"]
mod evidence;
#[path = "cli/newcomer.rs"]
mod newcomer;
#[path = "cli/pokes.rs"]
mod pokes;
#[path = "cli/skins.rs"]
mod skins;
#[path = "cli/solve.rs"]
mod solve;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use dermis_device::instruments::npy;
use serde_json::Value;
use tempfile::TempDir;

/// The unit square as four triangles around its centre, with electrodes along its left and right sides and 1 A from
/// left to right. The potential is linear, so all values are known: with conductivity s and contact impedance z, v =
/// 1/s + 2 z and dv/ds = -1/(4 s^2) for each element.
const SQUARE: &str = r#"{
    "dim": 2, "n_nodes": 5, "n_elems": 4, "n_elec": 2, "n_meas": 1, "made_by": "hand",
    "nodes": [[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]],
    "elems": [[0, 1, 4], [2, 1, 4], [2, 3, 4], [0, 3, 4]],
    "electrodes": [
        {"type": "CEM", "z_contact": 0.1, "faces": [[0, 3]]},
        {"type": "CEM", "z_contact": 0.1, "faces": [[1, 2]]}
    ],
    "stim": [[1, -1]], "meas": [[1, -1]], "meas_stim": [0],
    "sigma_hom": [2, 2, 2, 2], "sigma_incl": [2.5, 2.5, 2.5, 2.5], "sigma_broken": [2, 0, 2, 2]
}
"#;

const SKIN: &str = r#"
name = "test"
modality = "eit"

[frontend]
shape = { disc = { diameter_mm = 100.0 } }
layer = { kind = "sheet", thickness_mm = 2.0, conductivity_s_per_m = 1.0 }
electrodes = { pads = [
    { circle = { centre_mm = [-20.0, 0.0], diameter_mm = 10.0 } },
    { circle = { centre_mm = [20.0, 0.0], diameter_mm = 10.0 } },
    { circle = { centre_mm = [0.0, 20.0], diameter_mm = 10.0 } },
    { point = { at_mm = [0.0, -20.0] } },
] }
contact_impedance_ohm_m2 = 1e-4

[backend]
current_ma = 1.0
drive = "adjacent"
measure = "adjacent"
driven = "keep"

[imaging]
elements = 300
"#;

/// A directory to run the command in.
struct Desk(TempDir);

impl Desk {
    fn with(files: &[(&str, &str)]) -> Self {
        let desk = Self(tempfile::tempdir().expect("a directory"));
        files.iter().for_each(|(name, text)| fs::write(desk.path(name), text).expect("a file"));
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn run(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_dermis"));
        command.args(arguments).current_dir(self.0.path()).env_remove("DERMIS_LOG");
        command.output().expect("the command starts")
    }

    /// Runs a command that must succeed, and returns its standard output.
    fn done(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", text(&output.stderr));
        text(&output.stdout)
    }

    /// Runs a command that must be refused with this code and leave no file behind, and returns its message.
    fn refused(&self, arguments: &[&str], code: i32) -> String {
        let before = self.names();
        let output = self.run(arguments);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
        // Only the lines on how the files were understood may precede the error.
        let before_error: Vec<&str> = message.lines().take_while(|line| !line.starts_with("error: ")).collect();
        let is_understood = |line: &&str| line.contains(": ") && line.contains("frame");
        assert!(message.contains("error: ") && before_error.iter().all(is_understood), "{arguments:?}: {message}");
        assert_eq!(text(&output.stdout), "", "{arguments:?}");
        assert_eq!(self.names(), before, "{arguments:?} left files behind");
        message
    }

    fn names(&self) -> Vec<String> {
        let entries = fs::read_dir(self.0.path()).expect("a directory");
        let mut names: Vec<String> =
            entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    fn array(&self, name: &str) -> npy::Array {
        npy::read(&self.path(name)).expect("an array")
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn bad_usage_is_refused() {
    let desk = Desk::with(&[("case.json", SQUARE), ("skin.toml", SKIN), ("frames.csv", "1,2\n3,4\n")]);
    let table: [(&[&str], &str); 14] = [
        (&[], "Usage: dermis"),
        (&["paint"], "unrecognized subcommand 'paint'"),
        (&["solve", "case.json"], "required arguments were not provided"),
        (&["solve", "case.json", "--sigma", "hom"], "required arguments were not provided"),
        (&["solve", "case.json", "--voltages", "v.npy"], "--sigma"),
        (&["solve", "case.json", "--difference", "hom:incl", "--image", "x.npy"], "--prior"),
        (&["solve", "case.json", "--difference", "hom", "--image", "x.npy"], "two conductivities as in hom:incl"),
        (&["solve", "case.json", "--hyperparameter", "-1"], "expected a positive number"),
        (&["solve", "case.json", "--hyperparameter=nan"], "expected a positive number"),
        (
            &["solve", "case.json", "--sigma", "hom", "--voltages", "a.npy", "--jacobian", "a.npy"],
            "--jacobian a.npy: is also --voltages",
        ),
        (&["solve", "case.json", "--sigma", "hom", "--voltages", "case.json"], "is also the case"),
        (&["skins", "draw", "skin.toml", "--out", "skin.gif"], "expected a name that ends in .svg, .png or .pdf"),
        (&["skins", "draw", "skin.toml", "--out", "a.png", "--width-px", "9"], "9 is not in 200..=8000"),
        (&["snr", "--frames", "frames.csv", "--format", "docx"], "expected one of csv, lines"),
    ];
    for (arguments, expected) in table {
        let before = desk.names();
        let output = desk.run(arguments);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
        assert!(message.contains(expected), "{arguments:?}: {message}");
        assert_eq!(desk.names(), before, "{arguments:?}");
    }
    assert_eq!(fs::read_to_string(desk.path("case.json")).expect("a file"), SQUARE);
}

#[test]
fn a_failed_write_leaves_no_file() {
    let desk = Desk::with(&[("case.json", SQUARE)]);
    let message = desk.refused(&["solve", "case.json", "--sigma", "hom", "--voltages", "no/such/v.npy"], 2);
    assert!(message.contains("no/such/v.npy"), "{message}");
    if Path::new("/dev/full").exists() {
        let message = desk.refused(&["solve", "case.json", "--sigma", "hom", "--voltages", "/dev/full"], 1);
        assert!(message.contains("/dev/full: cannot write"), "{message}");
    }
}

#[test]
fn ratios_are_given_under_each_definition() {
    let desk = Desk::with(&[("frames.csv", "9,-9,5\n11,-11,5\n9,-9,5\n11,-11,5\n")]);
    let json: Value = serde_json::from_str(&desk.done(&["snr", "--frames", "frames.csv", "--json"])).expect("JSON");
    assert_eq!((&json["frames"], &json["reading"]), (&Value::from(4), &Value::from("value")));
    // Mean 10, sum of squared deviations 4, std = sqrt(4/3) (divided by n - 1), sum of squares 404.
    let ratio = 10.0 / (4.0_f64 / 3.0).sqrt();
    let expected = [10.0 * ratio.log10(), 10.0 * 101.0_f64.log10(), 20.0 * ratio.log10()];
    let names = ["ionic-as-printed", "healing-energy", "amplitude"];
    for ((average, name), expected) in json["definitions"].as_array().expect("a list").iter().zip(names).zip(expected) {
        assert_eq!(average["definition"], name);
        assert!((average["mean_db"].as_f64().expect("a number") - expected).abs() < 1e-12, "{average}");
        assert_eq!((&average["channels"], &average["left_out"]), (&Value::from(2), &Value::from(1)));
    }
    assert_eq!(json["channels"][2]["amplitude_db"], Value::Null, "a channel without noise has no finite ratio");

    let table = desk.done(&["snr", "--frames", "frames.csv"]);
    assert!(table.contains("18.75 dB = 20 log10(mean V / std V)"), "{table}");
    assert!(table.contains("9.38 dB = 10 log10(mean V / std V)"), "{table}");
    assert!(table.contains("20.04 dB = 10 log10(sum V^2 / sum (V - mean V)^2)"), "{table}");
    assert!(table.contains("1 channels without a finite ratio left out"), "{table}");
}

#[test]
fn frames_that_cannot_be_used_are_refused() {
    let files =
        [("one.csv", "1,2,3\n"), ("ragged.csv", "1,2,3\n4,5\n"), ("word.csv", "1,2\n3,x\n"), ("inf.csv", "1,inf\n")];
    let desk = Desk::with(&files);
    let table = [
        ("one.csv", "expected at least 2, got 1"),
        ("ragged.csv", "ragged.csv:2: expected 3 values as in the other rows, found 2"),
        ("word.csv", "word.csv:2: column 2"),
        ("inf.csv", "inf.csv:1: column 2: expected a finite number or nan"),
        ("none.csv", "none.csv: cannot read"),
        ("one.csv#5", "no single frame '5'"),
    ];
    for (frames, expected) in table {
        let message = desk.refused(&["snr", "--frames", frames], 2);
        assert!(message.contains(expected), "{frames}: {message}");
    }
}

#[test]
fn results_go_to_stdout_and_log_lines_to_stderr() {
    let desk = Desk::with(&[("case.json", SQUARE)]);
    let arguments = ["solve", "case.json", "--sigma", "hom", "--voltages", "v.npy"];
    let quiet = desk.run(&arguments);
    let verbose = desk.run(&[&arguments[..], &["--verbose"]].concat());
    assert_eq!(text(&quiet.stderr), "");
    assert_eq!(quiet.stdout, verbose.stdout);
    assert!(text(&verbose.stderr).contains("elements=4"), "{}", text(&verbose.stderr));
}

#[test]
fn a_replay_leaves_table_figures_data_and_report() {
    let desk = Desk::with(&[]);
    let printed = desk.done(&["reproduce", "i", "i3", "--out", "replay"]);
    assert!(printed.contains("64 mN at 0 mm"), "{printed}");
    for file in ["table.csv", "smallest.svg", "smallest.pdf", "smallest.png", "smallest.npy", "../report.html"] {
        assert!(desk.path("replay/I3").join(file).is_file(), "{file}");
    }
    let table: [(&[&str], &str); 3] = [
        (&["reproduce", "Z"], "paper Z: expected one of E, H, I, P"),
        (&["reproduce", "I", "I99"], "experiment I99: expected one of I1, I2"),
        (&["reproduce"], "<PAPER|EXPERIMENT>"),
    ];
    for (words, expected) in table {
        let message = desk.refused(words, 2);
        assert!(message.contains(expected), "{words:?}: {message}");
    }
}

#[test]
fn the_examples_of_every_help_run() {
    let frames: String = (0..6).map(|k| format!("{},{}\n", 100 + k % 2, 50 - k % 3)).collect();
    let desk = Desk::with(&[("case.json", SQUARE), ("frames.csv", &frames), ("my-skin.toml", SKIN)]);
    measured_files(&desk);
    desk.done(&["body", "demo", "arm"]);
    evidence::synthetic_sets(&desk);
    let mut ran = 0;
    for command in documented_commands(&desk) {
        let words: Vec<&str> = command.iter().map(String::as_str).chain(["--help"]).collect();
        // Long examples go on in the next line.
        let help = desk.done(&words).replace("\\\n", "");
        let examples: Vec<&str> = help.lines().filter_map(|line| line.strip_prefix("  dermis ")).collect();
        assert!(!examples.is_empty(), "the help of {command:?} has no example:\n{help}");
        for example in examples {
            let words: Vec<&str> = example.split_whitespace().map(|word| word.trim_matches('\'')).collect();
            desk.done(&words);
            ran += 1;
        }
    }
    assert!(ran >= 9, "{ran} examples ran");
}

/// Rows of numbers as a CSV file.
fn write_rows(desk: &Desk, name: &str, rows: &[Vec<f64>]) {
    let line = |row: &Vec<f64>| row.iter().map(f64::to_string).collect::<Vec<_>>().join(",") + "\n";
    std::fs::write(desk.path(name), rows.iter().map(line).collect::<String>()).expect("a file");
}

/// The files named in the examples of `reconstruct` and `calibrate`: frames of two skins, from their models.
fn measured_files(desk: &Desk) {
    let prepare = |name: &str| {
        let skin = dermis_skin::Skin::open(name).expect("a built-in skin");
        dermis_live::prepare::Prepared::new(skin).expect("a skin that meshes")
    };
    let touched = |prepared: &dermis_live::prepare::Prepared, at: [f64; 2], share: f64| -> Vec<f64> {
        let signature = prepared.signatures(&[at]);
        prepared.voltages.iter().zip(signature).map(|(v, s)| v + share * s).collect()
    };
    let square = prepare("healing-square");
    write_rows(desk, "rest.csv", std::slice::from_ref(&square.voltages));
    let presses = [[0.0, 0.0], [0.02, 0.01], [-0.02, 0.0]].map(|at| touched(&square, at, 0.3));
    write_rows(desk, "press.csv", &presses);
    // The remains of a recorder that never finished.
    let layout = dermis_device::Layout::Channels { count: 1 };
    let head = dermis_record::RecordingHead::new("name = \"a\"\n", layout, "test");
    drop(dermis_record::Recorder::create(&desk.path("broken.mcap"), &head).expect("a recording"));
    let gel = prepare("hydrogel-disc");
    let magnitudes = |frame: Vec<f64>| frame.iter().map(|v| v.abs()).collect::<Vec<_>>();
    let places: Vec<[f64; 2]> =
        (0..16).map(|k| [0.03 * f64::from(k % 4) - 0.045, 0.03 * f64::from(k / 4) - 0.045]).collect();
    write_rows(desk, "before.csv", &[magnitudes(gel.voltages.clone())]);
    let pressed: Vec<Vec<f64>> = places.iter().map(|at| magnitudes(touched(&gel, *at, 0.1))).collect();
    write_rows(desk, "pressed.csv", &pressed);
    let at_rest = magnitudes(gel.voltages.clone());
    let difference = |frame: &Vec<f64>| frame.iter().zip(&at_rest).map(|(f, b)| f - b).collect::<Vec<f64>>();
    let touched_at = |k: u32| [0.01 * f64::from(k % 5) - 0.02, 0.012 * f64::from(k / 5) - 0.03];
    let touches: Vec<Vec<f64>> = (0..25).map(|k| magnitudes(touched(&gel, touched_at(k), 0.1))).collect();
    write_rows(desk, "touches.csv", &touches);
    write_rows(desk, "baselines.csv", std::slice::from_ref(&at_rest));
    write_rows(desk, "differences.csv", &pressed.iter().map(difference).collect::<Vec<_>>());
    let positions: String = places.iter().map(|[x, y]| format!("{x},{y},0.01\n")).collect();
    std::fs::write(desk.path("positions.csv"), format!("x_m,y_m,depth_m\n{positions}")).expect("a file");
}

#[test]
fn frames_that_do_not_fit_the_skin_leave_no_file() {
    let desk = Desk::with(&[("short.csv", "1,2,3\n"), ("few.csv", "x_m,y_m\n0,0\n"), ("off.csv", &off_the_skin())]);
    measured_files(&desk);
    let positions = std::fs::read_to_string(desk.path("positions.csv")).expect("a file");
    let scaled = |factor: f64| -> String {
        let row = |line: &str| {
            let cells: Vec<String> =
                line.split(',').map(|cell| (factor * cell.parse::<f64>().expect("a number")).to_string()).collect();
            cells.join(",")
        };
        let rows: Vec<String> = positions.lines().skip(1).map(row).collect();
        format!("x_m,y_m,depth_m\n{}\n", rows.join("\n"))
    };
    std::fs::write(desk.path("mm.csv"), scaled(1e3)).expect("a file");
    std::fs::write(desk.path("close.csv"), scaled(1e-3)).expect("a file");
    let reconstruct = ["reconstruct", "healing-square", "--touches", "t.csv", "--images", "i.npy"];
    let calibrate = ["calibrate", "hydrogel-disc", "--baseline", "before.csv", "--frames", "pressed.csv"];
    let differences = ["calibrate", "hydrogel-disc", "--differences", "--frames", "differences.csv"];
    let table: [(Vec<&str>, &str); 12] = [
        ([&differences[..], &["--positions", "mm.csv", "--out", "c.json"]].concat(), "if they are millimetres"),
        ([&differences[..], &["--positions", "close.csv", "--out", "c.json"]].concat(), "are they metres?"),
        ([&differences[..], &["--positions", "positions.csv"]].concat(), "--out is needed"),
        ([&differences[..], &["--out", "c.json"]].concat(), "--positions is needed"),
        (
            ["calibrate", "hydrogel-disc", "--frames", "pressed.csv", "--positions", "positions.csv"]
                .into_iter()
                .chain(["--out", "c.json"])
                .collect(),
            "--baseline is needed",
        ),
        ([&calibrate[..], &["--write-skin", "found.toml"]].concat(), "at least 20, of touches"),
        (
            [&reconstruct[..], &["--baseline", "rest.csv", "--frames", "short.csv"]].concat(),
            "expected 208 channels, got 3",
        ),
        (
            [&reconstruct[..], &["--baseline", "short.csv", "--frames", "press.csv"]].concat(),
            "expected 208 channels, got 3",
        ),
        ([&reconstruct[..], &["--baseline", "rest.csv", "--frames", "none.csv"]].concat(), "none.csv"),
        ([&calibrate[..], &["--positions", "few.csv", "--out", "c.json"]].concat(), "expected 16, one a frame, got 1"),
        ([&calibrate[..], &["--positions", "off.csv", "--out", "c.json"]].concat(), "position of poke 3"),
        (
            [&reconstruct[..], &["--baseline", "rest.csv", "--frames", "press.csv", "--calibration", "short.csv"]]
                .concat(),
            "short.csv",
        ),
    ];
    for (words, expected) in table {
        let message = desk.refused(&words, 2);
        assert!(message.contains(expected), "{words:?}: {message}");
    }
}

/// Sixteen positions; the fourth is two metres off.
fn off_the_skin() -> String {
    let row = |k: i32| if k == 3 { "2,0\n".to_string() } else { format!("{},0\n", 0.001 * f64::from(k)) };
    format!("x_m,y_m\n{}", (0..16).map(row).collect::<String>())
}

/// Every command and subcommand that needs no hardware and ends by itself.
fn documented_commands(desk: &Desk) -> Vec<Vec<String>> {
    let commands = |words: &[&str]| -> Vec<String> {
        let help = desk.done(&[words, &["--help"]].concat());
        let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
        // A line that is indented further continues a description.
        listed
            .filter_map(|line| line.strip_prefix("  ").filter(|line| !line.starts_with(' ')))
            .filter_map(|line| line.split_whitespace().next())
            .filter(|name| *name != "help")
            .map(str::to_owned)
            .collect()
    };
    let mut all = Vec::new();
    for name in commands(&[]).into_iter().filter(|name| name != "run") {
        all.extend(commands(&[&name]).into_iter().map(|inner| vec![name.clone(), inner]));
        all.push(vec![name]);
    }
    all
}

#[test]
fn the_doctor_s_code_tells_whether_something_is_wrong() {
    let sound = dermis_skin::builtin_text("healing-square").expect("a built-in skin");
    let faults = "[twin]\nfaults = [{ stuck_channels = [{ channel = 30, value_mv = 4.0 }] }]\n";
    let desk = Desk::with(&[("broken.toml", &sound.replacen("[twin]\n", faults, 1))]);
    let output = desk.run(&["doctor", "--skin", "broken.toml", "--frames", "64", "--json"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let checks: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let bad: Vec<&Value> = checks.as_array().expect("a list").iter().filter(|check| check["answer"] == "bad").collect();
    assert_eq!(bad.len(), 1, "{bad:?}");
    assert!(bad[0]["found"].as_str().is_some_and(|found| found.starts_with("channel 30 ")), "{bad:?}");
    // Nothing listens on port 1 of this machine.
    let output = desk.run(&["doctor", "--source", "tcp:127.0.0.1:1", "--wait-s", "0.5"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stdout).contains("BAD  connection"), "{}", text(&output.stdout));
    assert_eq!(desk.run(&["doctor", "--frames", "3"]).status.code(), Some(2));
}
