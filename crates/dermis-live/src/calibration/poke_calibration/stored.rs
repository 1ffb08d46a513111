//! The calibration file: its contents and how it is read back.

use dermis_tomo::mesh::Point;
use dermis_touch::locator::{FusedLocator, PlaceCorrection};
use serde::{Deserialize, Serialize};

use super::super::pokes::LoadQuantity;
use super::frames::frames_with_gaps;
use super::groups::PokeGroup;
use super::strength::TouchStrength;
use super::{AsBuilt, Calibration, PokeReview};

/// Version of the calibration file.
const VERSION: u32 = 4;

/// The stored form of a [`Calibration`].
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
    positions_m: Vec<Point>,
    loads: Option<Vec<f64>>,
    fused: Box<FusedLocator>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    by_model: Option<PlaceCorrection>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    as_built: Option<AsBuilt>,
    /// Pokes with several touches, which only teach how touches add up.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    groups: Vec<PokeGroup>,
    pokes: usize,
    strength: TouchStrength,
    review: PokeReview,
}

impl TryFrom<StoredCalibration> for Calibration {
    type Error = String;

    fn try_from(stored: StoredCalibration) -> Result<Self, String> {
        if stored.version != VERSION {
            return Err(format!("version: {}, expected {VERSION}: calibrate again", stored.version));
        }
        let count = stored.frames.len();
        let groups = stored.groups.iter().map(|group| &group.frame);
        let ragged = stored.frames.iter().chain(groups).any(|frame| frame.len() != stored.channels);
        let loads_fit = stored.loads.as_ref().is_none_or(|loads| loads.len() == count);
        if ragged || stored.positions_m.len() != count || !loads_fit {
            return Err("frames, positions and loads differ in number, or frames in length".into());
        }
        if stored.fused.channels() != stored.channels {
            return Err(format!("fused: {} channels, expected {}", stored.fused.channels(), stored.channels));
        }
        let is_place = |place: &Point| place.iter().all(|v| v.is_finite());
        if stored.groups.iter().any(|group| group.touches_m.is_empty() || !group.touches_m.iter().all(is_place)) {
            return Err("groups: a group without finite positions".into());
        }
        Ok(Self {
            skin: stored.skin,
            skin_sha256: stored.skin_sha256,
            channels: stored.channels,
            load: stored.load,
            frames: stored.frames,
            positions_m: stored.positions_m,
            loads: stored.loads,
            locator: stored.fused,
            by_model: stored.by_model,
            as_built: stored.as_built,
            groups: stored.groups,
            pokes: stored.pokes,
            strength: stored.strength,
            review: stored.review,
        })
    }
}

impl From<Calibration> for StoredCalibration {
    fn from(calibration: Calibration) -> Self {
        Self {
            version: VERSION,
            skin: calibration.skin,
            skin_sha256: calibration.skin_sha256,
            channels: calibration.channels,
            load: calibration.load,
            frames: calibration.frames,
            positions_m: calibration.positions_m,
            loads: calibration.loads,
            fused: calibration.locator,
            by_model: calibration.by_model,
            as_built: calibration.as_built,
            groups: calibration.groups,
            pokes: calibration.pokes,
            strength: calibration.strength,
            review: calibration.review,
        }
    }
}
