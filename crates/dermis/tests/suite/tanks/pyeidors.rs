//! Metal and plastic near electrodes that the folders' names give.

use super::{Outcome, chosen, measured, run};

/// Electrode number (1 to 17, fractional) at which a touch lies: electrodes count counter-clockwise from the top.
fn electrode(x_mm: f64, y_mm: f64) -> f64 {
    (y_mm.atan2(x_mm).to_degrees() - 90.0).rem_euclid(360.0) / 22.5 + 1.0
}

/// `electrode05_plastic` parts of a folder's name: number and sign of the change of conductivity.
fn objects(folder: &str) -> Vec<(f64, f64)> {
    let words: Vec<&str> = folder.split('_').collect();
    let object = |pair: &[&str]| {
        let number = pair[0].trim_start_matches("electrode").parse().unwrap();
        (number, if pair[1] == "metal" { 1.0 } else { -1.0 })
    };
    words.chunks(2).map(object).collect()
}

fn check(name: &str, folder: &str, outcome: &Outcome) {
    let expected = objects(folder);
    let found: Vec<(f64, f64)> = outcome
        .touches
        .iter()
        .map(|row| {
            // The skin is a disc of 200 mm; the sign is the image's.
            let value = outcome.images.at(0, row.x_mm / 100.0, row.y_mm / 100.0);
            (electrode(row.x_mm, row.y_mm), value.signum())
        })
        .collect();
    println!(
        "pyeidors {name}: expected {expected:?}, found {found:.2?}, order {:.4}",
        outcome.report.order.correlation
    );
    assert_eq!(found.len(), expected.len(), "{name}");
    for (number, sign) in expected {
        let distance = |e: f64| (e - number + 8.0).rem_euclid(16.0) - 8.0;
        let near = found.iter().any(|&(e, s)| s == sign && distance(e).abs() <= 0.5);
        assert!(near, "{name}: nothing of sign {sign} within half a pitch of electrode {number}: {found:.2?}");
    }
    assert!(outcome.report.order.correlation > 0.98 && outcome.report.order.better.is_none());
}

// Measured: within 0.31 of a pitch for every object of every file, no ghost among the touches.
#[test]
fn metal_and_plastic_lie_at_their_electrodes() {
    let Some(directory) = measured("pyeidors-tank", "") else { return };
    let mut files = 0;
    for folder in std::fs::read_dir(directory).unwrap().flatten() {
        for file in std::fs::read_dir(folder.path()).unwrap().flatten().map(|entry| entry.path()) {
            let outcome = run("pyeidors-tank", chosen(&file, "reference"), chosen(&file, "target"));
            let name = file.file_name().unwrap().to_string_lossy().into_owned();
            check(&name, &folder.file_name().to_string_lossy(), &outcome);
            files += 1;
        }
    }
    assert_eq!(files, 6);
}
