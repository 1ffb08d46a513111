//! Finds metal and plastic objects near the electrodes given in the folder names.

use std::path::Path;

use dermis_lab::evidence::pyeidors::{files, found, objects, target};

use super::measured;

fn check(folder: &Path, file: &Path) {
    let (expected, outcome) = (objects(folder).unwrap(), target(file).unwrap());
    let found = found(&outcome);
    let name = file.file_name().unwrap().to_string_lossy();
    println!(
        "pyeidors {name}: expected {expected:?}, found {found:.2?}, order {:.4}",
        outcome.report.order.correlation
    );
    assert_eq!(found.len(), expected.len(), "{name}");
    for object in expected {
        let is_near = |other: &dermis_lab::evidence::pyeidors::Object| {
            other.sign == object.sign && other.pitches_from(object.electrode).abs() <= 0.5
        };
        assert!(found.iter().any(is_near), "{name}: nothing like {object:?} within half a pitch: {found:.2?}");
    }
    assert!(outcome.report.order.correlation > 0.98 && outcome.report.order.better.is_none());
}

// Measured: within 0.31 pitches for every object in every file, without ghost touches.
#[test]
fn metal_and_plastic_lie_at_their_electrodes() {
    let Some(directory) = measured("pyeidors-tank", "") else { return };
    let files = files(&directory).unwrap();
    files.iter().for_each(|(folder, file)| check(folder, file));
    assert_eq!(files.len(), 6);
}

#[test]
fn other_names_of_folders_are_refused() {
    for name in ["electrode01", "electrode17_metal", "electrodeNaN_metal", "cup_metal", "electrode01_wood", ""] {
        assert!(objects(Path::new(name)).is_err(), "{name}");
    }
    assert_eq!(objects(Path::new("x/electrode01_metal_electrode05_plastic")).unwrap().len(), 2);
}
