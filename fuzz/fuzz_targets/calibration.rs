//! Calibrations by pokes, and of forces.
#![no_main]

use std::path::Path;
use std::sync::LazyLock;

use dermis_live::calibration::Calibration;
use dermis_live::forces::parse_forces;
use dermis_skin::Skin;
use libfuzzer_sys::fuzz_target;

static SKIN: LazyLock<Skin> = LazyLock::new(|| Skin::open("healing-square").expect("a built-in skin"));

fuzz_target!(|data: &[u8]| {
    let file = Path::new("fuzzed.json");
    let _ = Calibration::parse(data, file);
    let _ = parse_forces(data, file, &SKIN);
});
