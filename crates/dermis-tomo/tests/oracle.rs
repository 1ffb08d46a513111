//! Voltages, Jacobians and images against EIDORS values (`../shared/oracle/eit`). Tolerances are the oracle's own:
//! an independent dense implementation reproduced the voltages to 4e-13, Jacobians to 5e-13 and images to 3e-9.

use std::path::{Path, PathBuf};

use dermis_tomo::eit::{ForwardModel, Protocol};
use dermis_tomo::inverse::{ImageBasis, LinearProblem, Prior, Weighting};
use dermis_tomo::mesh::{CellKind, Contact, Electrode, ElectrodedMesh, Mesh};
use serde_json::Value;

fn cases() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/oracle/eit");
    let Ok(entries) = std::fs::read_dir(&root) else {
        println!("skipped: the EIDORS reference values are not at ../shared/oracle/eit");
        return Vec::new();
    };
    let mut cases: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).filter(|p| p.is_dir()).collect();
    cases.sort();
    cases
}

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

fn stored_jacobian(case: &Path, name: &str) -> Vec<f64> {
    let file = std::fs::read_dir(case).unwrap().flatten().map(|e| e.path()).find(|path| {
        let file = path.file_name().unwrap().to_string_lossy().into_owned();
        file.starts_with(&format!("J_{name}_")) && file.ends_with(".f64")
    });
    let bytes = std::fs::read(file.unwrap()).unwrap();
    bytes.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect()
}

#[test]
fn voltages_potentials_and_jacobians_equal_eidors() {
    for path in cases() {
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
    for path in cases() {
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
