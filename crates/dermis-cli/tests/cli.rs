//! The command as a user's script sees it: exit codes, messages, files. Reference values are worked out by hand, or
//! come from EIDORS (`tests/data/oracle/eit`).

#[path = "cli/earlier.rs"]
mod earlier;
#[path = "cli/evidence.rs"]
mod evidence;
#[path = "cli/newcomer.rs"]
mod newcomer;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use dermis_device::instruments::npy;
use serde_json::Value;
use tempfile::TempDir;

/// The unit square as four triangles round its middle, electrodes along its left and right sides, 1 A from left to
/// right: the potential is linear, so that all values are known. With conductivity s and contact impedance z, v = 1/s +
/// 2 z and dv/ds = -1/(4 s^2) for each element.
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

    /// Runs a command that must succeed; its standard output.
    fn done(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", text(&output.stderr));
        text(&output.stdout)
    }

    /// Runs a command that must be refused with this code and leave no file behind; its message.
    fn refused(&self, arguments: &[&str], code: i32) -> String {
        let before = self.names();
        let output = self.run(arguments);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
        assert!(message.starts_with("error: "), "{arguments:?}: {message}");
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

fn relative(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let difference: f64 = found.iter().zip(expected).map(|(a, b)| (a - b) * (a - b)).sum();
    (difference / expected.iter().map(|v| v * v).sum::<f64>()).sqrt()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().expect("a list").iter().map(|v| v.as_f64().expect("a number")).collect()
}

#[test]
fn voltages_and_jacobian_of_a_square_are_those_worked_out_by_hand() {
    let desk = Desk::with(&[("case.json", SQUARE)]);
    let out = desk.done(&["solve", "case.json", "--sigma", "hom", "--voltages", "v.npy", "--jacobian", "j.npy"]);
    assert_eq!(out, "voltages: 1 values to v.npy\nJacobian: 1 x 4 values to j.npy\n");
    let (v, j) = (desk.array("v.npy"), desk.array("j.npy"));
    assert_eq!((v.shape, j.shape), (vec![1], vec![1, 4]));
    assert!((v.values[0] - 0.7).abs() < 1e-14, "{:?}", v.values);
    assert!(relative(&j.values, &[-0.0625; 4]) < 1e-13, "{:?}", j.values);
    assert_eq!(desk.names(), ["case.json", "j.npy", "v.npy"]);
}

#[test]
fn conductivities_come_from_the_case_or_from_a_file() {
    let desk = Desk::with(&[("case.json", SQUARE), ("column.txt", "4\n4\n4\n4\n")]);
    npy::write_f64(&desk.path("sigma.npy"), &[4], &[5.0; 4]).expect("a file");
    for (choice, expected) in [("incl", 0.6), ("column.txt", 0.45), ("sigma.npy", 0.4)] {
        desk.done(&["solve", "case.json", "--sigma", choice, "--voltages", "v.npy"]);
        let found = desk.array("v.npy").values[0];
        assert!((found - expected).abs() < 1e-14, "{choice}: {found}");
    }
}

#[test]
fn difference_images_of_a_square_are_those_worked_out_by_hand() {
    let desk = Desk::with(&[("case.json", SQUARE)]);
    let image = |prior: &str, more: &[&str]| {
        let fixed = ["solve", "case.json", "--difference", "hom:incl", "--hyperparameter", "0.5", "--image", "x.npy"];
        desk.done(&[&fixed, &["--prior", prior][..], more].concat());
        desk.array("x.npy").values
    };
    // dv = 0.6 - 0.7; with J = (j, j, j, j) and R = r I, x = j w dv / (4 j^2 w + lambda^2 r).
    let one_step = |j: f64, w: f64, dv: f64, r: f64| j * w * dv / (4.0 * j * j * w + 0.25 * r);
    let (j, dv) = (-0.0625, -0.1);
    assert!(relative(&image("identity", &[]), &[one_step(j, 1.0, dv, 1.0); 4]) < 1e-12);
    assert!(relative(&image("noser", &[]), &[one_step(j, 1.0, dv, 0.0625); 4]) < 1e-12);
    // The Laplace prior does not weigh constants, so that the one measurement is met exactly.
    assert!(relative(&image("laplace", &[]), &[dv / (4.0 * j); 4]) < 1e-12);
    // Normalised: both over v0 = 0.7, W = (voltage of unit conductivity)^2 = 1.2^2.
    let expected = one_step(j / 0.7, 1.44, dv / 0.7, 1.0);
    for flag in ["--normalised", "--normalized"] {
        assert!(relative(&image("identity", &[flag]), &[expected; 4]) < 1e-12);
    }
}

#[test]
fn point_electrodes_need_no_contact_impedance() {
    let point = |corner: usize| format!(r#"{{"type": "PEM", "node": {corner}}}"#);
    let left = r#"{"type": "CEM", "z_contact": 0.1, "faces": [[0, 3]]}"#;
    let right = r#"{"type": "CEM", "z_contact": 0.1, "faces": [[1, 2]]}"#;
    let case = SQUARE.replace(left, &point(0)).replace(right, &point(2));
    let desk = Desk::with(&[("case.json", &case)]);
    desk.done(&["solve", "case.json", "--sigma", "hom", "--voltages", "v.npy"]);
    // By symmetry nodes 1, 3 and the middle lie half-way. Right angles lie opposite the sides of the square, so only
    // the spokes conduct, with cot(45 deg) s = 2 S each: corner - middle - corner is 1/2 + 1/2 ohm.
    assert!((desk.array("v.npy").values[0] - 1.0).abs() < 1e-14);
}

#[test]
fn eidors_values_are_reproduced() {
    let desk = Desk::with(&[]);
    for folder in dermis_testdata::eit_cases() {
        let file = folder.join("case.json");
        let case: Value = serde_json::from_slice(&fs::read(&file).expect("a case")).expect("JSON");
        let file = file.to_string_lossy();
        for sigma in ["hom", "incl", "wave"] {
            desk.done(&["solve", &file, "--sigma", sigma, "--voltages", "v.npy", "--jacobian", "j.npy"]);
            let error = relative(&desk.array("v.npy").values, &numbers(&case[format!("v_{sigma}")]));
            assert!(error < 1e-10, "{file} {sigma}: voltages off by {error:e}");
            if sigma != "incl" {
                let error = relative(&desk.array("j.npy").values, &dermis_testdata::stored_jacobian(&folder, sigma));
                assert!(error < 1e-9, "{file} {sigma}: Jacobian off by {error:e}");
            }
        }
        for recon in case["recon"].as_array().expect("a list") {
            let prior = recon["prior"].as_str().expect("a name").trim_start_matches("prior_").to_string();
            let lambda = recon["hyperparameter"].to_string();
            let mut arguments = vec!["solve", &file, "--difference", "hom:incl", "--prior", &prior];
            arguments.extend(["--hyperparameter", &lambda, "--image", "x.npy"]);
            if recon["normalize_measurements"] == 1 {
                arguments.push("--normalised");
            }
            desk.done(&arguments);
            let error = relative(&desk.array("x.npy").values, &numbers(&recon["x"]));
            assert!(error < 1e-6, "{arguments:?}: image off by {error:e}");
        }
    }
}

#[test]
fn bad_cases_are_refused_with_place_value_and_expectation() {
    let table: [(&str, &str, &[&str]); 20] = [
        ("\"n_nodes\": 5", "\"n_nodes\": 6", &["n_nodes", "is 6", "expected 5"]),
        ("\"n_meas\": 1", "\"n_meas\": 2", &["n_meas", "is 2", "expected 1"]),
        ("[1, 1],", "[1, NaN],", &["line 3", "is NaN", "expected a finite number"]),
        ("[1, 1],", "[1, Infinity],", &["line 3", "expected a finite number"]),
        ("[1, 1],", "[1, 1e999],", &["line 3", "number out of range"]),
        ("[1, 1],", "[1],", &["nodes[2]", "expected 2 or 3 coordinates"]),
        ("[2, 3, 4]", "[2, 7, 4]", &["elems[2][1]", "is 7", "one of 5 nodes"]),
        ("[2, 3, 4]", "[2, 3, -4]", &["elems[2][2]", "is -4"]),
        ("[2, 3, 4]", "[2, 3, 3]", &["elems", "element 2 is degenerate"]),
        ("[2, 3, 4]", "[0, 1, 2]", &["elems", "fold over each other"]),
        ("[[0, 3]]", "[[0, 2]]", &["electrodes", "electrode 0", "face [0, 2] is no face of the mesh"]),
        ("[[0, 3]]", "[[2, 1]]", &["electrodes", "electrode 1", "overlaps electrode 0"]),
        ("[[0, 3]]", "[]", &["electrode 0", "touches no part of the mesh"]),
        (
            "\"CEM\", \"z_contact\": 0.1",
            "\"CEM\", \"z_contact\": -1",
            &["electrodes[0].z_contact", "is -1", "positive"],
        ),
        ("\"CEM\", \"z_contact\": 0.1", "\"PEM\", \"node\": 5", &["electrodes[0].node", "is 5", "one of 5 nodes"]),
        ("\"stim\": [[1, -1]]", "\"stim\": [[1, -1, 0]]", &["stim[0]", "holds 3 values", "expected 2 currents"]),
        ("\"stim\": [[1, -1]]", "\"stim\": [[1, -0.5]]", &["stim[0]", "adds to 5e-1 A", "add to 0"]),
        ("\"meas_stim\": [0]", "\"meas_stim\": [3]", &["meas_stim[0]", "is 3", "one of 1 stimulations"]),
        ("[2, 2, 2, 2]", "[2, 2, 2]", &["sigma_hom", "holds 3 values", "expected 4 conductivities"]),
        ("[2, 2, 2, 2]", "[2, 2, \"2\", 2]", &["sigma_hom[2]", "is \"2\"", "expected a finite number"]),
    ];
    for (from, to, fragments) in table {
        assert!(SQUARE.contains(from), "{from}");
        let desk = Desk::with(&[("case.json", &SQUARE.replacen(from, to, 1))]);
        let arguments = ["solve", "case.json", "--sigma", "hom", "--voltages", "v.npy", "--jacobian", "j.npy"];
        let message = desk.refused(&arguments, 2);
        for fragment in [&["case.json"], fragments].concat() {
            assert!(message.contains(fragment), "{to}: no {fragment:?} in {message}");
        }
    }
}

#[test]
fn files_that_are_no_cases_are_refused() {
    let truncated = &SQUARE[..SQUARE.len() / 2];
    let files = [("case.json", SQUARE), ("truncated.json", truncated), ("list.json", "[]"), ("empty.json", "")];
    let desk = Desk::with(&[files.as_slice(), &[("skin.toml", SKIN), ("short.csv", "1\n2\n")]].concat());
    let table = [
        ("missing.json", "hom", "missing.json: cannot read"),
        ("truncated.json", "hom", "the file ends inside its JSON; it is truncated"),
        ("empty.json", "hom", "the file ends inside its JSON"),
        ("list.json", "hom", "expected an object with nodes, elems"),
        ("skin.toml", "hom", "expected JSON"),
        (".", "hom", "cannot read"),
        ("case.json", "broken", "sigma_broken[1]: is 0; expected a positive conductivity"),
        ("case.json", "none", "sigma_none: is neither in the case (it has broken, hom, incl) nor is there a file"),
        ("case.json", "short.csv", "short.csv: conductivity: has shape [2, 1]; expected 4 conductivities"),
        ("case.json", "case.json", "case.json:1: column 1: expected a number"),
    ];
    for (case, sigma, expected) in table {
        let message = desk.refused(&["solve", case, "--sigma", sigma, "--voltages", "v.npy"], 2);
        assert!(message.contains(expected), "{case} {sigma}: {message}");
    }
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
            "--jacobian a.npy: is --voltages as well",
        ),
        (&["solve", "case.json", "--sigma", "hom", "--voltages", "case.json"], "is the case as well"),
        (&["skins", "draw", "skin.toml", "--out", "skin.gif"], "expected a name that ends in .svg, .png or .pdf"),
        (&["skins", "draw", "skin.toml", "--out", "a.png", "--width-px", "9"], "9 is not in 200..=8000"),
        (&["snr", "--frames", "frames.csv", "--format", "xlsx"], "expected one of csv, columns"),
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
fn what_cannot_be_written_is_a_failure_without_remains() {
    let desk = Desk::with(&[("case.json", SQUARE)]);
    let message = desk.refused(&["solve", "case.json", "--sigma", "hom", "--voltages", "no/such/v.npy"], 2);
    assert!(message.contains("no/such/v.npy"), "{message}");
    if Path::new("/dev/full").exists() {
        let message = desk.refused(&["solve", "case.json", "--sigma", "hom", "--voltages", "/dev/full"], 1);
        assert!(message.contains("/dev/full: cannot write"), "{message}");
    }
}

#[test]
fn bad_skin_files_are_refused_with_their_place() {
    let table: [(&str, &str, &[&str]); 9] = [
        ("name = \"test\"", "name = \"test\"\ncolour = \"red\"", &["colour", "unknown field", "3 |"]),
        ("current_ma = 1.0", "current_a = 1.0", &["current_a", "unknown field"]),
        ("current_ma = 1.0", "current_ma = nan", &["backend.current_ma", "NaN", "1e-9 to 1e6"]),
        ("elements = 300", "elements = 3", &["imaging.elements", "= 3", "50 to 500000"]),
        ("[20.0, 0.0]", "[70.0, 0.0]", &["mesh of test", "electrode 1"]),
        ("[20.0, 0.0]", "[-15.0, 0.0]", &["mesh of test", "electrode"]),
        ("diameter_mm = 100.0", "diameter_mm = -1.0", &["frontend.shape.disc.diameter_mm", "-1", "1 to 10000"]),
        ("drive = \"adjacent\"", "drive = \"sideways\"", &["sideways", "adjacent"]),
        ("elements = 300\n", "elements = [", &["test.toml", "line 23", "unclosed array"]),
    ];
    for (from, to, fragments) in table {
        assert!(SKIN.contains(from), "{from}");
        let desk = Desk::with(&[("test.toml", &SKIN.replacen(from, to, 1))]);
        let message = desk.refused(&["skins", "draw", "test.toml", "--out", "skin.svg"], 2);
        for fragment in fragments {
            assert!(message.contains(fragment), "{to}: no {fragment:?} in {message}");
        }
    }
    let message = Desk::with(&[]).refused(&["skins", "show", "nothing"], 2);
    assert!(message.contains("\"nothing\"") && message.contains("healing-square"), "{message}");
}

#[test]
fn skins_are_listed_shown_and_drawn() {
    let desk = Desk::with(&[("skin.toml", SKIN)]);
    let list = desk.done(&["skins", "list"]);
    for name in list.lines().map(|line| line.split_whitespace().next().expect("a name")) {
        let shown = desk.done(&["skins", "show", name]);
        let (first, _) = shown.split_once('\n').expect("lines");
        assert!(first.starts_with("# ") && (first.contains(" electrodes, ") || first.contains(" coils, ")), "{shown}");
        fs::write(desk.path("shown.toml"), &shown).expect("a file");
        assert_eq!(desk.done(&["skins", "show", "shown.toml"]), shown, "{name} does not survive being shown");
    }
    assert!(list.contains("healing-square"), "{list}");

    let out = desk.done(&["skins", "draw", "skin.toml", "--out", "skin.svg"]);
    assert!(out.starts_with("1000 x ") && out.ends_with("pixels to skin.svg\n"), "{out}");
    let svg = fs::read_to_string(desk.path("skin.svg")).expect("a picture");
    assert!(svg.starts_with("<svg ") && svg.ends_with("</svg>\n"));
    for (class, count) in [("mesh", 1), ("outline", 1), ("electrodes", 1), ("number", 4), ("scale-bar", 1), ("axes", 1)]
    {
        assert_eq!(svg.matches(&format!("class=\"{class}\"")).count(), count, "{class}");
    }
    desk.done(&["skins", "draw", "skin.toml", "--out", "bare.svg", "--no-mesh"]);
    assert!(!fs::read_to_string(desk.path("bare.svg")).expect("a picture").contains("class=\"mesh\""));

    desk.done(&["skins", "draw", "skin.toml", "--out", "skin.PNG", "--width-px", "320"]);
    let png = fs::read(desk.path("skin.PNG")).expect("a picture");
    assert!(png.starts_with(b"\x89PNG\r\n\x1a\n"));
    assert_eq!(u32::from_be_bytes(png[16..20].try_into().expect("4 bytes")), 320, "width in the header");
}

#[test]
fn ratios_are_given_under_each_definition() {
    let desk = Desk::with(&[("frames.csv", "9,-9,5\n11,-11,5\n9,-9,5\n11,-11,5\n")]);
    let json: Value = serde_json::from_str(&desk.done(&["snr", "--frames", "frames.csv", "--json"])).expect("JSON");
    assert_eq!((&json["frames"], &json["reading"]), (&Value::from(4), &Value::from("value")));
    // Mean 10, squared deviations 4 in all, std = sqrt(4/3) (divided by n - 1), sum of squares 404.
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
        [("one.csv", "1,2,3\n"), ("ragged.csv", "1,2\n3\n"), ("word.csv", "1,2\n3,x\n"), ("inf.csv", "1,inf\n")];
    let desk = Desk::with(&files);
    let table = [
        ("one.csv", "expected at least 2, got 1"),
        ("ragged.csv", "ragged.csv:2: expected 2 values as in the first row, found 1"),
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
    let earlier = SKIN.replace("kind = \"sheet\"", "kind = \"gel\"");
    let desk = Desk::with(&[("case.json", SQUARE), ("frames.csv", &frames), ("my-skin.toml", &earlier)]);
    measured_files(&desk);
    evidence::synthetic_sets(&desk);
    let mut ran = 0;
    for command in documented_commands(&desk) {
        let words: Vec<&str> = command.iter().map(String::as_str).chain(["--help"]).collect();
        let help = desk.done(&words);
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

/// What the examples of `reconstruct` and `calibrate` name: frames of two skins as their models have them.
fn measured_files(desk: &Desk) {
    let prepare = |name: &str| {
        let skin = dermis::skin::Skin::open(name).expect("a built-in skin");
        dermis::live::prepare::Prepared::new(skin).expect("a skin that meshes")
    };
    let touched = |prepared: &dermis::live::prepare::Prepared, at: [f64; 2], share: f64| -> Vec<f64> {
        let signature = prepared.signatures(&[at]);
        prepared.voltages.iter().zip(signature).map(|(v, s)| v + share * s).collect()
    };
    let square = prepare("healing-square");
    write_rows(desk, "rest.csv", std::slice::from_ref(&square.voltages));
    let presses = [[0.0, 0.0], [0.02, 0.01], [-0.02, 0.0]].map(|at| touched(&square, at, 0.3));
    write_rows(desk, "press.csv", &presses);
    // What a recorder leaves that never came to its end.
    let layout = dermis_device::Layout::Channels { count: 1 };
    let head = dermis::record::RecordingHead::new("name = \"a\"\n", layout, "test");
    drop(dermis::record::Recorder::create(&desk.path("broken.mcap"), &head).expect("a recording"));
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
fn frames_that_do_not_fit_the_skin_leave_nothing_behind() {
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

/// Sixteen positions, the fourth of them two metres off.
fn off_the_skin() -> String {
    let row = |k: i32| if k == 3 { "2,0\n".to_string() } else { format!("{},0\n", 0.001 * f64::from(k)) };
    format!("x_m,y_m\n{}", (0..16).map(row).collect::<String>())
}

/// Every command and subcommand that needs no hardware and ends by itself.
fn documented_commands(desk: &Desk) -> Vec<Vec<String>> {
    let commands = |words: &[&str]| -> Vec<String> {
        let help = desk.done(&[words, &["--help"]].concat());
        let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
        listed
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
    let sound = dermis::skin::builtin_text("healing-square").expect("a built-in skin");
    let faults = "[twin]\nfaults = [{ stuck_channels = [{ channel = 30, value_mv = 4.0 }] }]\n";
    let desk = Desk::with(&[("broken.toml", &sound.replacen("[twin]\n", faults, 1))]);
    let output = desk.run(&["doctor", "--skin", "broken.toml", "--frames", "64", "--json"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let checks: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let bad: Vec<&Value> = checks.as_array().expect("a list").iter().filter(|check| check["answer"] == "bad").collect();
    assert_eq!(bad.len(), 1, "{bad:?}");
    assert!(bad[0]["found"].as_str().is_some_and(|found| found.starts_with("channel 30 ")), "{bad:?}");
    // Nobody listens at port 1 of this machine.
    let output = desk.run(&["doctor", "--source", "tcp:127.0.0.1:1", "--wait-s", "0.5"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stdout).contains("BAD  connection"), "{}", text(&output.stdout));
    assert_eq!(desk.run(&["doctor", "--frames", "3"]).status.code(), Some(2));
}
