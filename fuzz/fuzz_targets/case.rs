//! Cases of the forward solver, and meshes of Gmsh.
#![no_main]

use std::path::Path;

use dermis_lab::case::Case;
use dermis_tomo::mesh::{ElectrodeGroups, read_msh};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let _ = Case::parse(data, Path::new("fuzzed.json"));
    let _ = read_msh(data, &ElectrodeGroups::Prefix("electrode".into()), &[0.01]);
});
