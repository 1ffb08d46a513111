//! Compares voltages, Jacobians, images and the Laplace prior with EIDORS values (`tests/data/oracle/eit`). The
//! tolerances come with the values: an independent dense implementation reproduced the voltages to 4e-13, Jacobians
//! to 5e-13 and images to 3e-9.

use std::collections::BTreeMap;

use dermis_testdata::{eit_cases, stored_jacobian};
use dermis_tomo::eit::{ForwardModel, Protocol};
use dermis_tomo::inverse::{ImageBasis, LinearProblem, Prior, PriorMatrix, Weighting};
use dermis_tomo::mesh::{CellKind, Contact, Electrode, ElectrodedMesh, Mesh};
use serde_json::Value;

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

fn rows(value: &Value) -> Vec<Vec<f64>> {
    value.as_array().unwrap().iter().map(numbers).collect()
}

fn indices(value: &Value) -> Vec<u32> {
    numbers(value).into_iter().map(|v| v as u32).collect()
}

fn model(case: &Value) -> ForwardModel {
    let kind = if case["dim"] == 2 { CellKind::Triangle } else { CellKind::Tetrahedron };
    let nodes = rows(&case["nodes"]).iter().map(|n| [n[0], n[1], n.get(2).copied().unwrap_or(0.0)]).collect();
    let elements = case["elems"].as_array().unwrap().iter().flat_map(indices).collect();
    let electrode = |e: &Value| {
        let contact = if e["type"] == "CEM" {
            Contact::Faces(e["faces"].as_array().unwrap().iter().map(indices).collect())
        } else {
            Contact::Point(e["node"].as_u64().unwrap() as u32)
        };
        Electrode { contact, contact_impedance: e["z_contact"].as_f64().unwrap_or(0.0) }
    };
    let electrodes = case["electrodes"].as_array().unwrap().iter().map(electrode).collect();
    let body = ElectrodedMesh::new(Mesh::new(kind, nodes, elements).unwrap(), electrodes).unwrap();
    let of: Vec<usize> = indices(&case["meas_stim"]).into_iter().map(|s| s as usize).collect();
    ForwardModel::new(body, Protocol::from_rows(&rows(&case["stim"]), &rows(&case["meas"]), &of).unwrap()).unwrap()
}

fn relative(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let difference: f64 = found.iter().zip(expected).map(|(a, b)| (a - b) * (a - b)).sum();
    (difference / expected.iter().map(|v| v * v).sum::<f64>()).sqrt()
}

#[test]
fn voltages_potentials_and_jacobians_equal_eidors() {
    for path in eit_cases() {
        let case: Value = serde_json::from_slice(&std::fs::read(path.join("case.json")).unwrap()).unwrap();
        let model = model(&case);
        for name in ["hom", "incl", "wave"] {
            let solution = model.solve(&numbers(&case[format!("sigma_{name}")])).unwrap();
            let error = relative(&solution.voltages(), &numbers(&case[format!("v_{name}")]));
            assert!(error < 1e-10, "{path:?} {name}: voltages off by {error:e}");
            for (stimulation, expected) in rows(&case[format!("U_{name}")]).iter().enumerate() {
                let error = relative(&solution.electrode_potentials(stimulation), expected);
                assert!(error < 1e-9, "{path:?} {name}: potentials of stimulation {stimulation} off by {error:e}");
            }
            if name != "incl" {
                let error = relative(&solution.jacobian().values, &stored_jacobian(&path, name));
                assert!(error < 1e-9, "{path:?} {name}: Jacobian off by {error:e}");
            }
        }
    }
}

#[test]
fn one_step_images_equal_eidors() {
    for path in eit_cases() {
        let case: Value = serde_json::from_slice(&std::fs::read(path.join("case.json")).unwrap()).unwrap();
        let model = model(&case);
        let solution = model.solve(&numbers(&case["sigma_hom"])).unwrap();
        let (v_hom, v_incl) = (numbers(&case["v_hom"]), numbers(&case["v_incl"]));
        let jacobian = solution.jacobian();
        let basis = ImageBasis::of_elements(&model.body().mesh);
        for recon in case["recon"].as_array().unwrap() {
            let normalised = recon["normalize_measurements"] == 1;
            let mut j = jacobian.clone();
            let mut weighting = Weighting::Identity;
            let mut dv: Vec<f64> = v_incl.iter().zip(&v_hom).map(|(a, b)| a - b).collect();
            if normalised {
                for channel in 0..j.rows {
                    let columns = j.columns;
                    j.values[channel * columns..(channel + 1) * columns].iter_mut().for_each(|v| *v /= v_hom[channel]);
                }
                dv.iter_mut().zip(&v_hom).for_each(|(d, v)| *d /= v);
                let unit = model.solve(&vec![1.0; j.columns]).unwrap().voltages();
                weighting = Weighting::Diagonal(unit.iter().map(|v| v * v).collect());
            }
            let prior = match recon["prior"].as_str().unwrap() {
                "prior_noser" => Prior::Noser { exponent: 0.5 },
                "prior_laplace" => Prior::Laplace,
                _ => Prior::Identity,
            };
            let matrix = prior.matrix(j.as_mat(), &weighting, &basis).unwrap();
            let problem = LinearProblem::new(j.as_mat(), weighting, matrix).unwrap();
            let image = problem.operator(recon["hyperparameter"].as_f64().unwrap()).unwrap().apply(&dv).unwrap();
            let error = relative(&image, &numbers(&recon["x"]));
            assert!(error < 1e-6, "{path:?} {} {}: image off by {error:e}", recon["prior"], recon["hyperparameter"]);
        }
    }
}

#[test]
fn the_laplace_prior_equals_eidors() {
    for path in eit_cases() {
        let case: Value = serde_json::from_slice(&std::fs::read(path.join("case.json")).unwrap()).unwrap();
        let model = model(&case);
        let basis = ImageBasis::of_elements(&model.body().mesh);
        let jacobian = model.solve(&numbers(&case["sigma_hom"])).unwrap().jacobian();
        let matrix = Prior::Laplace.matrix(jacobian.as_mat(), &Weighting::Identity, &basis).unwrap();
        let PriorMatrix::Sparse { entries, .. } = matrix else { panic!("Laplace is sparse") };
        let mut found: BTreeMap<(u32, u32), f64> = BTreeMap::new();
        for (row, column, value) in entries {
            *found.entry((row, column)).or_default() += value;
        }
        let text = std::fs::read_to_string(path.join("laplace_prior_ijv.csv")).unwrap();
        let entry = |line: &str| {
            let cells: Vec<f64> = line.split(',').map(|cell| cell.trim().parse().unwrap()).collect();
            ((cells[0] as u32, cells[1] as u32), cells[2])
        };
        // Ours holds only the lower triangle. All entries are small integers, so they match exactly.
        let expected: BTreeMap<(u32, u32), f64> = text.lines().map(entry).filter(|((i, j), _)| i >= j).collect();
        assert_eq!(found, expected, "{path:?}");
    }
}
