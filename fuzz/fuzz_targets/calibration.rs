//! Calibrations by pokes, and of forces.
#![no_main]

use std::path::Path;

use dermis_live::calibration::Calibration;
use dermis_live::forces::parse_forces;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let file = Path::new("fuzzed.json");
    let _ = Calibration::parse(data, file);
    let _ = parse_forces(data, file, "healing-square");
});
