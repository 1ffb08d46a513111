//! Force calibrations as files.

use std::path::Path;

use dermis_touch::force::ForceCalibration;

use crate::Error;

/// Writes a force calibration as JSON, atomically.
///
/// # Errors
/// The file cannot be written.
pub fn save_forces(calibration: &ForceCalibration, path: &Path) -> Result<(), Error> {
    dermis_device::write_atomic(path, |out| Ok(serde_json::to_writer_pretty(out, calibration)?))?;
    Ok(())
}

/// Reads a force calibration for a skin.
///
/// # Errors
/// No such file, not a force calibration, one of another skin, or numbers that make no sense.
pub fn load_forces(path: &Path, skin: &str) -> Result<ForceCalibration, Error> {
    parse_forces(&dermis_device::instruments::read_bytes(path)?, path, skin)
}

/// Reads a force calibration for a skin from its text; `path` is for messages.
///
/// # Errors
/// As [`load_forces`].
pub fn parse_forces(text: &[u8], path: &Path, skin: &str) -> Result<ForceCalibration, Error> {
    let content = |field: String, reason: String| Error::Content { file: path.to_path_buf(), field, reason };
    let calibration: ForceCalibration = serde_json::from_slice(text)
        .map_err(|error| content(format!("line {}, column {}", error.line(), error.column()), error.to_string()))?;
    calibration.check(skin).map_err(|error| content("force calibration".into(), error.to_string()))?;
    Ok(calibration)
}
