//! Calibrated skins: pokes at known positions make a measured Jacobian, on which images are made, and a locator, which
//! places single touches with an honest sigma. With few pokes the locator leans on the physics, with many on the pokes.

mod self_calibrated;

use std::path::Path;

use dermis_tomo::inverse::{Hyperparameter, LinearProblem, MeasuredJacobian};
use dermis_touch::locator::{
    Examples, LeaveOneOut, Locator, LocatorOptions, LocatorScratch, SignatureMap, SuggestedPoke,
};
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::imager::Imager;
use crate::prepare::Prepared;
use crate::reference::{Reference, check_frames};
use crate::touches::Placement;

/// Version of the calibration file.
const VERSION: u32 = 1;
/// Correlation lengths tried for the measured Jacobian, relative to half the shorter side.
const LENGTHS: [f64; 4] = [0.15, 0.25, 0.4, 0.6];
/// Positions of the locator's map lie at most this far apart, relative to half the shorter side.
const MAP_SPACING: f64 = 0.04;
/// Above this novelty a frame is doubted to be a single touch, and several contacts of the image stand against it.
const MOST_NOVELTY: f64 = 3.0;

/// What a poke's load was measured as.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LoadQuantity {
    /// Depth of indentation, metres.
    DepthM,
    /// Force, newtons.
    ForceN,
}

/// Pokes at known positions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pokes {
    /// Where, metres.
    pub positions_m: Vec<[f64; 2]>,
    /// How hard, if it was measured.
    pub loads: Option<(LoadQuantity, Vec<f64>)>,
}

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

/// What an operator for a reference consists of, with or without calibration.
#[derive(Debug)]
pub struct CalibratedImager {
    /// Difference data to images.
    pub imager: Imager,
    /// The reference that the difference data are to be made with.
    pub reference: Reference,
    /// Places single touches, if the skin is calibrated.
    pub placement: Option<PlacementFinder>,
}

/// Finds the place of the single touch of a frame.
#[derive(Clone, Debug)]
pub enum PlacementFinder {
    /// A locator learnt from pokes.
    Learnt(Box<LearntFinder>),
    /// The matched filter of a skin calibrated without labels.
    Matched(Box<self_calibrated::MatchedFinder>),
}

/// A locator with its memory.
#[derive(Clone, Debug)]
pub struct LearntFinder {
    locator: Locator,
    scratch: LocatorScratch,
    /// Root mean square of the noise-weighted frame below which there is no touch.
    smallest_amplitude: f64,
}

impl PlacementFinder {
    /// Where the single touch of a frame is, `None` where the frame is too weak.
    ///
    /// # Errors
    /// A frame of another length, or without enough channels.
    pub fn place(&mut self, difference: &[f64]) -> Result<Option<Placement>, Error> {
        match self {
            PlacementFinder::Learnt(finder) => finder.place(difference),
            PlacementFinder::Matched(finder) => finder.place(difference),
        }
    }
}

impl LearntFinder {
    fn place(&mut self, difference: &[f64]) -> Result<Option<Placement>, Error> {
        let located = self.locator.predict_into(difference, &mut self.scratch)?;
        if located.amplitude < self.smallest_amplitude {
            return Ok(None);
        }
        Ok(Some(Placement {
            doubtful: located.novelty > MOST_NOVELTY,
            position_m: [located.x_m, located.y_m],
            covariance_m2: [
                [located.sigma_x_m.powi(2), located.covariance_xy_m2],
                [located.covariance_xy_m2, located.sigma_y_m.powi(2)],
            ],
        }))
    }
}

impl Prepared {
    /// Fits a calibration to pokes. `baselines` has one frame for all pokes or one for each; frames in the protocol's
    /// order.
    ///
    /// # Errors
    /// Counts that disagree, positions off the skin, or pokes from which nothing can be learnt.
    pub fn calibrate(&self, baselines: &[Vec<f64>], frames: &[Vec<f64>], pokes: &Pokes) -> Result<Calibration, Error> {
        check_frames("poke", frames, self.channels())?;
        self.check_pokes(frames.len(), pokes)?;
        let reference = self.reference(baselines)?;
        let paired = baselines.len() == frames.len() && frames.len() > 1;
        let differences: Vec<Vec<f64>> = frames
            .iter()
            .enumerate()
            .map(|(index, frame)| reference.difference(frame, paired.then(|| baselines[index].as_slice())))
            .collect();
        let mut examples = Examples::new(self.channels(), differences.concat(), pokes.positions_m.clone())?
            .with_channel_noise(reference.noise.clone())?;
        if let Some((_, loads)) = &pokes.loads {
            examples = examples.with_loads(loads.clone())?;
        }
        let positions = self.map_positions();
        let physics = SignatureMap::new(self.channels(), positions.clone(), self.signatures(&positions))?;
        let locator = Locator::fit(&examples, &physics, &LocatorOptions::default())?;
        Ok(Calibration {
            version: VERSION,
            skin: self.skin.name.clone(),
            channels: self.channels(),
            load: pokes.loads.as_ref().map(|(quantity, _)| *quantity),
            frames: differences,
            positions_m: pokes.positions_m.clone(),
            loads: pokes.loads.as_ref().map(|(_, loads)| loads.clone()),
            locator,
        })
    }

    fn check_pokes(&self, frames: usize, pokes: &Pokes) -> Result<(), Error> {
        if pokes.positions_m.len() != frames {
            return Err(Error::Frames {
                what: "positions of pokes".into(),
                expected: format!("{frames}, one a frame"),
                got: pokes.positions_m.len().to_string(),
            });
        }
        let (low, high) = self.body.outline.bounds_m();
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
    fn map_positions(&self) -> Vec<[f64; 2]> {
        let grid = self.map.grid();
        let step = ((MAP_SPACING * self.half_width_m() / grid.pixel_m).round() as usize).max(1);
        self.map
            .inside_pixels()
            .iter()
            .map(|&pixel| pixel as usize)
            .filter(|pixel| (pixel % grid.columns) % step == step / 2 && (pixel / grid.columns) % step == step / 2)
            .map(|pixel| grid.centre_m(pixel))
            .collect()
    }

    /// The imager for a reference: on the measured Jacobian where there is a calibration, else on the model's.
    ///
    /// # Errors
    /// As [`Prepared::imager`]; a calibration of another skin.
    pub fn calibrated_imager(
        &self,
        calibration: Option<&Calibration>,
        reference: Reference,
        data: &[Vec<f64>],
    ) -> Result<CalibratedImager, Error> {
        let Some(calibration) = calibration else {
            if let Some(calibrated) = self.self_calibrated(&reference, data)? {
                return Ok(calibrated);
            }
            let imager = self.imager(&reference, data)?;
            return Ok(CalibratedImager { imager, reference, placement: None });
        };
        calibration.check(self)?;
        let measured = calibration.measured_jacobian(self)?;
        let weighting = self.weighting(&reference)?;
        let prior = self.prior().matrix(measured.jacobian.as_mat(), &weighting, &self.basis)?;
        let problem = LinearProblem::new(measured.jacobian.as_mat(), weighting, prior)?;
        let lambda = problem.choose(&Hyperparameter::Relative(0.1), data)?;
        let imager = self.imager_from(problem, lambda, &reference.noise, 1.0)?;
        let placement = PlacementFinder::Learnt(Box::new(LearntFinder {
            scratch: calibration.locator.scratch(),
            locator: calibration.locator.clone(),
            smallest_amplitude: self.skin.touch.hold_sigma.min(0.5 * calibration.weakest_amplitude()?),
        }));
        Ok(CalibratedImager { imager, reference, placement: Some(placement) })
    }
}

impl Calibration {
    /// How well each poke is located by the others.
    pub fn leave_one_out(&self) -> &LeaveOneOut {
        self.locator.leave_one_out()
    }

    /// Amplitude of the weakest poke, in units of the noise that the calibration saw. Where baselines lie far apart in time
    /// that noise holds drift, and a threshold in its units alone would pass over light touches.
    fn weakest_amplitude(&self) -> Result<f64, Error> {
        let mut scratch = self.locator.scratch();
        let mut weakest = f64::INFINITY;
        for frame in &self.frames {
            weakest = weakest.min(self.locator.predict_into(frame, &mut scratch)?.amplitude);
        }
        Ok(weakest)
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

/// Reads a table of pokes: columns x_m, y_m and, if there is a third, depth_m or force_n (by header; without one, metres
/// of depth).
///
/// # Errors
/// A file that is no table of numbers, other columns, or values that are missing.
pub fn read_pokes(path: &Path) -> Result<Pokes, Error> {
    let table = dermis_device::instruments::csv::read_numbers(path)?;
    let content = |field: String, reason: String| Error::Content { file: path.to_path_buf(), field, reason };
    let column = |name: &str, otherwise: usize| match &table.header {
        Some(_) => table.column_index(name),
        None => (otherwise < table.columns).then_some(otherwise),
    };
    let (Some(x), Some(y)) = (column("x_m", 0), column("y_m", 1)) else {
        return Err(content("columns".into(), "expected x_m, y_m and optionally depth_m or force_n".into()));
    };
    let load = column("force_n", usize::MAX)
        .map(|index| (LoadQuantity::ForceN, index))
        .or_else(|| column("depth_m", 2).map(|index| (LoadQuantity::DepthM, index)));
    let mut pokes = Pokes::default();
    let mut loads = Vec::new();
    for row in 0..table.rows() {
        let values = table.row(row).unwrap_or_default();
        let value = |index: usize| values.get(index).copied().unwrap_or(f64::NAN);
        let position = [value(x), value(y)];
        if position.iter().any(|v| !v.is_finite()) {
            return Err(content(format!("row {row}"), format!("position {position:?} is not finite")));
        }
        pokes.positions_m.push(position);
        loads.extend(load.map(|(_, index)| value(index)));
    }
    if let Some((quantity, _)) = load {
        if let Some(row) = loads.iter().position(|l| !(l.is_finite() && *l > 0.0)) {
            return Err(content(format!("row {row}"), format!("load {} is not a positive number", loads[row])));
        }
        pokes.loads = Some((quantity, loads));
    }
    Ok(pokes)
}
