//! `dermis solve`: values worked out by hand and from EIDORS, conductivities from cases and files, and cases that are
//! refused.

use std::fs;

use dermis_device::instruments::npy;
use serde_json::Value;

use super::{Desk, SKIN, SQUARE};

fn relative(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let difference: f64 = found.iter().zip(expected).map(|(a, b)| (a - b) * (a - b)).sum();
    (difference / expected.iter().map(|v| v * v).sum::<f64>()).sqrt()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().expect("a list").iter().map(|v| v.as_f64().expect("a number")).collect()
}

#[test]
fn voltages_and_jacobian_of_a_square_agree_with_hand_calculation() {
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
fn difference_images_of_a_square_agree_with_hand_calculation() {
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
    // The Laplace prior doesn't penalise constants, so the single measurement is fitted exactly.
    assert!(relative(&image("laplace", &[]), &[dv / (4.0 * j); 4]) < 1e-12);
    // Normalised: both divided by v0 = 0.7, and W = (voltage at unit conductivity)^2 = 1.2^2.
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
    // By symmetry nodes 1, 3 and the centre are at half the voltage. The right angles are opposite the sides of the
    // square, so only the spokes conduct, with cot(45 deg) s = 2 S each: corner - centre - corner is 1/2 + 1/2 ohm.
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
        ("[[0, 3]]", "[[0, 2]]", &["electrodes", "electrode 0", "face [0, 2] is not a face of the mesh"]),
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
        ("case.json", "case.json", "case.json: expected a text table of numbers, found JSON text"),
    ];
    for (case, sigma, expected) in table {
        let message = desk.refused(&["solve", case, "--sigma", sigma, "--voltages", "v.npy"], 2);
        assert!(message.contains(expected), "{case} {sigma}: {message}");
    }
}
