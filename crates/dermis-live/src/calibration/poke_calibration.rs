//! A calibration by pokes at known positions: a measured Jacobian, on which images are made, and a locator, which places
//! single touches with an honest sigma. With few pokes the locator leans on the physics, with many on the pokes.

use std::path::Path;

use dermis_tomo::inverse::MeasuredJacobian;
use dermis_touch::locator::{Examples, LeaveOneOut, Locator, LocatorOptions, SignatureMap, SuggestedPoke};
use serde::{Deserialize, Serialize};

use super::pokes::{LoadQuantity, Pokes};
use crate::Error;
use crate::prepare::Prepared;
use crate::reference::{Reference, check_frames};

/// Version of the calibration file.
const VERSION: u32 = 1;
/// Correlation lengths tried for the measured Jacobian, relative to half the shorter side.
const LENGTHS: [f64; 4] = [0.15, 0.25, 0.4, 0.6];
/// Positions of the locator's map lie at most this far apart, relative to half the shorter side.
const MAP_SPACING: f64 = 0.04;
/// A calibration, as it stands in its file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    version: u32,
    skin: String,
    channels: usize,
    load: Option<LoadQuantity>,
    /// Difference data of each poke, model volts, divided by nothing.
    frames: Vec<Vec<f64>>,
    positions_m: Vec<[f64; 2]>,
    loads: Option<Vec<f64>>,
    locator: Locator,
}

impl Calibration {
    /// Fits a calibration to pokes. `baselines` has one frame for all pokes or one for each; frames in the protocol's
    /// order.
    ///
    /// # Errors
    /// Counts that disagree, positions off the skin, or pokes from which nothing can be learnt.
    pub fn fit(prepared: &Prepared, baselines: &[Vec<f64>], frames: &[Vec<f64>], pokes: &Pokes) -> Result<Self, Error> {
        check_frames("poke", frames, prepared.channels())?;
        check_pokes(prepared, frames.len(), pokes)?;
        let reference = Reference::of(prepared, baselines)?;
        let paired = baselines.len() == frames.len() && frames.len() > 1;
        let differences: Vec<Vec<f64>> = frames
            .iter()
            .enumerate()
            .map(|(index, frame)| reference.difference(frame, paired.then(|| baselines[index].as_slice())))
            .collect();
        let mut examples = Examples::new(prepared.channels(), differences.concat(), pokes.positions_m.clone())?
            .with_channel_noise(reference.noise.clone())?;
        if let Some((_, loads)) = &pokes.loads {
            examples = examples.with_loads(loads.clone())?;
        }
        let positions = map_positions(prepared);
        let physics = SignatureMap::new(prepared.channels(), positions.clone(), prepared.signatures(&positions))?;
        let locator = Locator::fit(&examples, &physics, &LocatorOptions::default())?;
        Ok(Self {
            version: VERSION,
            skin: prepared.skin.name.clone(),
            channels: prepared.channels(),
            load: pokes.loads.as_ref().map(|(quantity, _)| *quantity),
            frames: differences,
            positions_m: pokes.positions_m.clone(),
            loads: pokes.loads.as_ref().map(|(_, loads)| loads.clone()),
            locator,
        })
    }

    /// How well each poke is located by the others.
    pub fn leave_one_out(&self) -> &LeaveOneOut {
        self.locator.leave_one_out()
    }

    /// Amplitude of the weakest poke, in units of the noise that the calibration saw. Where baselines lie far apart in time
    /// that noise holds drift, and a threshold in its units alone would pass over light touches.
    pub(super) fn weakest_amplitude(&self) -> Result<f64, Error> {
        let mut scratch = self.locator.scratch();
        let mut weakest = f64::INFINITY;
        for frame in &self.frames {
            weakest = weakest.min(self.locator.predict_into(frame, &mut scratch)?.amplitude);
        }
        Ok(weakest)
    }

    /// What places single touches.
    pub(super) fn locator(&self) -> &Locator {
        &self.locator
    }

    /// Number of pokes.
    pub fn pokes(&self) -> usize {
        self.positions_m.len()
    }

    /// Where more pokes would help most.
    ///
    /// # Errors
    /// A count of zero.
    pub fn suggest_pokes(&self, count: usize) -> Result<Vec<SuggestedPoke>, Error> {
        Ok(self.locator.suggest_pokes(count)?)
    }

    /// The Jacobian that the pokes measured, per unit load (or per poke), on the skin's image grid.
    ///
    /// # Errors
    /// Fewer than three complete pokes.
    pub fn measured_jacobian(&self, prepared: &Prepared) -> Result<MeasuredJacobian, Error> {
        let typical = self.loads.as_ref().map(|loads| loads.iter().sum::<f64>() / loads.len() as f64);
        let complete = |index: &usize| self.frames[*index].iter().all(|v| v.is_finite());
        let chosen: Vec<usize> = (0..self.frames.len()).filter(complete).collect();
        // Loads relative to their mean, so that a typical poke has amplitude 1 with or without loads.
        let share = |index: usize| match (&self.loads, typical) {
            (Some(loads), Some(typical)) => loads[index] / typical,
            _ => 1.0,
        };
        let frames: Vec<Vec<f64>> =
            chosen.iter().map(|&i| self.frames[i].iter().map(|v| v / share(i)).collect()).collect();
        let positions: Vec<[f64; 2]> = chosen.iter().map(|&i| self.positions_m[i]).collect();
        let lengths = LENGTHS.map(|share| share * prepared.half_width_m());
        Ok(MeasuredJacobian::interpolate(&frames, &positions, &prepared.map.inside_centres_m(), &lengths)?)
    }

    /// Is this a calibration of this skin?
    ///
    /// # Errors
    /// Another skin's name or number of channels.
    pub fn check(&self, prepared: &Prepared) -> Result<(), Error> {
        if self.skin != prepared.skin.name || self.channels != prepared.channels() {
            return Err(Error::Frames {
                what: "calibration".into(),
                expected: format!("one of skin {} with {} channels", prepared.skin.name, prepared.channels()),
                got: format!("one of skin {} with {} channels", self.skin, self.channels),
            });
        }
        Ok(())
    }

    /// Writes the calibration as JSON, atomically.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), Error> {
        dermis_device::write_atomic(path, |out| Ok(serde_json::to_writer(out, self)?))?;
        Ok(())
    }

    /// Reads a calibration.
    ///
    /// # Errors
    /// No such file, not a calibration, one of another version, or one whose parts do not fit each other.
    pub fn load(path: &Path) -> Result<Self, Error> {
        Self::parse(&dermis_device::instruments::read_bytes(path)?, path)
    }

    /// Reads a calibration from its text; `path` is for messages.
    ///
    /// # Errors
    /// As [`Calibration::load`].
    pub fn parse(text: &[u8], path: &Path) -> Result<Self, Error> {
        let content = |field: String, reason: String| Error::Content { file: path.to_path_buf(), field, reason };
        let calibration: Self = serde_json::from_slice(text)
            .map_err(|error| content(format!("line {}, column {}", error.line(), error.column()), error.to_string()))?;
        if calibration.version != VERSION {
            let reason = format!("{}, expected {VERSION}", calibration.version);
            return Err(content("version".into(), reason));
        }
        let count = calibration.frames.len();
        let ragged = calibration.frames.iter().any(|frame| frame.len() != calibration.channels);
        let loads_fit = calibration.loads.as_ref().is_none_or(|loads| loads.len() == count);
        if ragged || calibration.positions_m.len() != count || !loads_fit {
            let reason = "frames, positions and loads differ in number, or frames in length".to_string();
            return Err(content("frames".into(), reason));
        }
        if calibration.locator.channels() != calibration.channels {
            let reason = format!("{} channels, expected {}", calibration.locator.channels(), calibration.channels);
            return Err(content("locator".into(), reason));
        }
        Ok(calibration)
    }
}

fn check_pokes(prepared: &Prepared, frames: usize, pokes: &Pokes) -> Result<(), Error> {
    if pokes.positions_m.len() != frames {
        return Err(Error::Frames {
            what: "positions of pokes".into(),
            expected: format!("{frames}, one a frame"),
            got: pokes.positions_m.len().to_string(),
        });
    }
    let (low, high) = prepared.body.outline.bounds_m();
    let off = |p: &&[f64; 2]| (0..2).any(|axis| !(low[axis]..=high[axis]).contains(&p[axis]));
    if let Some(index) = pokes.positions_m.iter().position(|p| off(&p)) {
        let [x, y] = pokes.positions_m[index];
        return Err(Error::Frames {
            what: format!("position of poke {index}"),
            expected: format!("metres, within {low:?} to {high:?}"),
            got: format!("({x}, {y})"),
        });
    }
    Ok(())
}

/// Positions for the locator's map: centres of blocks of pixels.
fn map_positions(prepared: &Prepared) -> Vec<[f64; 2]> {
    let grid = prepared.map.grid();
    let step = ((MAP_SPACING * prepared.half_width_m() / grid.pixel_m).round() as usize).max(1);
    prepared
        .map
        .inside_pixels()
        .iter()
        .map(|&pixel| pixel as usize)
        .filter(|pixel| (pixel % grid.columns) % step == step / 2 && (pixel / grid.columns) % step == step / 2)
        .map(|pixel| grid.centre_m(pixel))
        .collect()
}
