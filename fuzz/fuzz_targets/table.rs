//! Files of frames in every format: CSV, columns, NPY, Sciospec, MATLAB, lists of golf ball and pyeidors. The first
//! byte selects the format.
#![no_main]

use std::path::Path;

use dermis_device::{Format, decode};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Some((which, content)) = data.split_first() else { return };
    let file = Path::new("fuzzed.bin");
    let _ = Format::detect(file, content);
    let format = Format::ALL[usize::from(*which) % Format::ALL.len()];
    if let Ok(table) = decode(format, content, file) {
        assert_eq!(table.frames() * table.channels(), table.values().len());
        assert!(!table.values().iter().any(|value| value.is_infinite()));
    }
});
