//! The calibration file: its contents and how it is read back.

use dermis_touch::locator::{FusedLocator, Locator, PlaceCorrection};
use serde::{Deserialize, Serialize};

use super::super::place_locator::PlaceLocator;
use super::super::pokes::LoadQuantity;
use super::strength::TouchStrength;
use super::{Calibration, PokeReview};

/// Versions of the calibration file: a locator with one expert, with two, and with two plus a correction of the
/// model's positions.
const VERSION_SINGLE: u32 = 1;
const VERSION_FUSED: u32 = 2;
const VERSION_BY_MODEL: u32 = 3;

/// The stored form of a [`Calibration`]. It has exactly one of `locator` (version 1) and `fused`, and `by_model` in
/// version 3.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StoredCalibration {
    version: u32,
    skin: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    skin_sha256: Option<String>,
    channels: usize,
    load: Option<LoadQuantity>,
    #[serde(deserialize_with = "frames_with_gaps")]
    frames: Vec<Vec<f64>>,
    positions_m: Vec<[f64; 2]>,
    loads: Option<Vec<f64>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    locator: Option<Box<Locator>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    fused: Option<Box<FusedLocator>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    by_model: Option<PlaceCorrection>,
    #[serde(default)]
    pokes: Option<usize>,
    #[serde(default)]
    strength: TouchStrength,
    #[serde(default)]
    review: PokeReview,
}

impl TryFrom<StoredCalibration> for Calibration {
    type Error = String;

    fn try_from(stored: StoredCalibration) -> Result<Self, String> {
        let version = stored.version;
        let expected = |what: &str| Err(format!("version {version}: expected {what} and nothing else of the three"));
        let locator = match (version, stored.fused, stored.locator, &stored.by_model) {
            (VERSION_FUSED, Some(fused), None, None) | (VERSION_BY_MODEL, Some(fused), None, Some(_)) => {
                PlaceLocator::Fused(fused)
            }
            (VERSION_SINGLE, None, Some(locator), None) => PlaceLocator::Single(locator),
            (VERSION_SINGLE, ..) => return expected("\"locator\""),
            (VERSION_FUSED, ..) => return expected("\"fused\""),
            (VERSION_BY_MODEL, ..) => return expected("\"fused\" and \"by_model\""),
            _ => return Err(format!("version: {version}, expected {VERSION_SINGLE} to {VERSION_BY_MODEL}")),
        };
        let count = stored.frames.len();
        let ragged = stored.frames.iter().any(|frame| frame.len() != stored.channels);
        let loads_fit = stored.loads.as_ref().is_none_or(|loads| loads.len() == count);
        if ragged || stored.positions_m.len() != count || !loads_fit {
            return Err("frames, positions and loads differ in number, or frames in length".into());
        }
        if locator.channels() != stored.channels {
            return Err(format!("locator: {} channels, expected {}", locator.channels(), stored.channels));
        }
        Ok(Self {
            skin: stored.skin,
            skin_sha256: stored.skin_sha256,
            channels: stored.channels,
            load: stored.load,
            frames: stored.frames,
            positions_m: stored.positions_m,
            loads: stored.loads,
            locator,
            by_model: stored.by_model,
            pokes: stored.pokes.unwrap_or(count),
            strength: stored.strength,
            review: stored.review,
        })
    }
}

impl From<Calibration> for StoredCalibration {
    fn from(calibration: Calibration) -> Self {
        let (version, locator, fused) = match calibration.locator {
            PlaceLocator::Single(locator) => (VERSION_SINGLE, Some(locator), None),
            PlaceLocator::Fused(fused) if calibration.by_model.is_some() => (VERSION_BY_MODEL, None, Some(fused)),
            PlaceLocator::Fused(fused) => (VERSION_FUSED, None, Some(fused)),
        };
        Self {
            version,
            skin: calibration.skin,
            skin_sha256: calibration.skin_sha256,
            channels: calibration.channels,
            load: calibration.load,
            frames: calibration.frames,
            positions_m: calibration.positions_m,
            loads: calibration.loads,
            locator,
            fused,
            by_model: calibration.by_model,
            pokes: Some(calibration.pokes),
            strength: calibration.strength,
            review: calibration.review,
        }
    }
}

/// Frames as stored in JSON: missing values are `null`.
fn frames_with_gaps<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Vec<Vec<f64>>, D::Error> {
    let rows = Vec::<Vec<Option<f64>>>::deserialize(from)?;
    Ok(rows.into_iter().map(|row| row.into_iter().map(|value| value.unwrap_or(f64::NAN)).collect()).collect())
}
