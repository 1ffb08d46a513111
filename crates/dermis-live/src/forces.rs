//! Force calibrations as files: the calibration with the fingerprint of its skin.

use std::path::Path;

use dermis_skin::Skin;
use dermis_touch::force::ForceCalibration;
use serde::Deserialize;
use serde_json::Value;

use crate::Error;
use crate::same_skin::{check_print, frames_sha256};

/// Key of the fingerprint in the file.
const PRINT: &str = "skin_sha256";

/// Writes a force calibration of a skin as JSON, atomically.
///
/// # Errors
/// The file cannot be written.
pub fn save_forces(calibration: &ForceCalibration, skin: &Skin, path: &Path) -> Result<(), Error> {
    dermis_device::write_atomic(path, |out| {
        let mut stored = serde_json::to_value(calibration)?;
        stored[PRINT] = Value::String(frames_sha256(skin));
        Ok(serde_json::to_writer_pretty(out, &stored)?)
    })?;
    Ok(())
}

/// Reads a force calibration for a skin.
///
/// # Errors
/// No such file, not a force calibration, a calibration of another skin, or invalid numbers.
pub fn load_forces(path: &Path, skin: &Skin) -> Result<ForceCalibration, Error> {
    parse_forces(&dermis_device::instruments::read_bytes(path)?, path, skin)
}

/// Reads a force calibration for a skin from its text; `path` is for messages.
///
/// # Errors
/// As [`load_forces`].
pub fn parse_forces(text: &[u8], path: &Path, skin: &Skin) -> Result<ForceCalibration, Error> {
    let (calibration, print) = read(text, path)?;
    let what = format!("{}: force calibration", path.display());
    check_print(&what, (&calibration.scope.skin, print.as_deref()), skin)?;
    check(calibration, path, &skin.name)
}

/// Reads a force calibration for a skin regardless of its fingerprint; its name must be the skin's.
///
/// # Errors
/// As [`load_forces`].
pub fn parse_forces_as(text: &[u8], path: &Path, skin: &Skin) -> Result<ForceCalibration, Error> {
    check(read(text, path)?.0, path, &skin.name)
}

fn check(calibration: ForceCalibration, path: &Path, skin: &str) -> Result<ForceCalibration, Error> {
    let content = |field: String, reason: String| Error::Content { file: path.to_path_buf(), field, reason };
    calibration.check(skin).map_err(|error| content("force calibration".into(), error.to_string()))?;
    Ok(calibration)
}

/// The calibration, and the fingerprint if the file has one.
fn read(text: &[u8], path: &Path) -> Result<(ForceCalibration, Option<String>), Error> {
    #[derive(Deserialize)]
    struct Print {
        #[serde(default)]
        skin_sha256: Option<String>,
    }
    let place = |error: serde_json::Error| Error::Content {
        file: path.to_path_buf(),
        field: format!("line {}, column {}", error.line(), error.column()),
        reason: error.to_string(),
    };
    let Print { skin_sha256 } = serde_json::from_slice(text).map_err(place)?;
    if skin_sha256.is_none() {
        return Ok((serde_json::from_slice(text).map_err(place)?, None));
    }
    let mut stored: Value = serde_json::from_slice(text).map_err(place)?;
    stored.as_object_mut().map(|stored| stored.remove(PRINT));
    let content = |error: serde_json::Error| Error::Content {
        file: path.to_path_buf(),
        field: "force calibration".into(),
        reason: error.to_string(),
    };
    Ok((serde_json::from_value(stored).map_err(content)?, skin_sha256))
}

/// Source of the forces that touches report.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ForceSource {
    /// A force calibration.
    Calibration,
    /// A calibration with pokes of known force.
    Pokes,
    /// The law of the layer in the skin file.
    Law,
}

impl ForceSource {
    /// The source in one word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Calibration => "calibration",
            Self::Pokes => "pokes",
            Self::Law => "law",
        }
    }
}
