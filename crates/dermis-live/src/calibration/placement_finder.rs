//! What places the single touch of a frame in a calibrated skin.

use dermis_touch::locator::{PlaceCorrection, TypicalAmplitude};
use dermis_touch::{LoadQuantity, PlaceHypotheses, PlaceHypothesis, PlaceModes, TouchLoad};

use super::matched::MatchedFinder;
use super::place_locator::{PlaceLocator, PlaceScratch};
use super::poke_calibration::Calibration;
use crate::Error;
use crate::reference::Reference;
use crate::stages::placement::Placement;

/// Above this novelty a frame is doubted to be a single touch, and several contacts of the image stand against it.
const MOST_NOVELTY: f64 = 3.0;

/// Finds the place of the single touch of a frame.
#[derive(Clone, Debug)]
pub enum PlacementFinder {
    /// A locator learnt from pokes.
    Learnt(Box<LearntFinder>),
    /// The matched filter of a skin calibrated without labels.
    Matched(Box<MatchedFinder>),
}

/// A locator with its memory.
#[derive(Clone, Debug)]
pub struct LearntFinder {
    locator: PlaceLocator,
    scratch: PlaceScratch,
    /// Where the model places touches: what corrects it.
    correction: Option<PlaceCorrection>,
    /// What amplitudes are divided by, where this places touches.
    typical: Option<TypicalAmplitude>,
    /// What the pokes' loads were measured as.
    load: Option<LoadQuantity>,
    /// Root mean square of the noise-weighted frame below which there is no touch.
    smallest_amplitude: f64,
    hypotheses: PlaceHypotheses,
}

impl PlacementFinder {
    /// Where the single touch of a frame is, `None` where the frame is too weak. Two places that explain it about
    /// equally well are followed over the frames of a press; `time_ns` is that of the frame.
    ///
    /// # Errors
    /// A frame of another length, or without enough channels.
    pub fn place(&mut self, time_ns: u64, difference: &[f64]) -> Result<Option<Placement>, Error> {
        match self {
            PlacementFinder::Learnt(finder) => finder.place(time_ns, difference),
            PlacementFinder::Matched(finder) => finder.place(time_ns, difference),
        }
    }

    /// The next frame has nothing to do with this one.
    pub fn forget(&mut self) {
        match self {
            PlacementFinder::Learnt(finder) => finder.hypotheses.forget(),
            PlacementFinder::Matched(finder) => finder.forget(),
        }
    }

    /// The reference of a new baseline, in the units that frames are read in from now on: those of a skin that has
    /// calibrated itself, else as it is.
    pub(crate) fn adapt(&mut self, reference: Reference) -> Reference {
        match self {
            PlacementFinder::Learnt(_) => reference,
            PlacementFinder::Matched(finder) => finder.adapt(reference),
        }
    }

    /// What corrects the places of the model, where that places touches: what is placed here then only tells loads.
    pub fn correction(&self) -> Option<&PlaceCorrection> {
        match self {
            PlacementFinder::Learnt(finder) => finder.correction.as_ref(),
            PlacementFinder::Matched(_) => None,
        }
    }
}

impl LearntFinder {
    /// Frames whose noise-weighted root mean square is below `smallest_amplitude` show no touch. Places at least
    /// `separation_m` apart may be two explanations of a frame.
    ///
    /// # Errors
    /// As [`Calibration::typical_amplitude`].
    pub(super) fn new(
        calibration: &Calibration,
        smallest_amplitude: f64,
        half_width_m: f64,
        separation_m: f64,
    ) -> Result<Self, Error> {
        let locator = calibration.locator().clone();
        let hypotheses = PlaceHypotheses::new(PlaceModes::new(locator.places_m(), separation_m));
        let correction = calibration.correction().cloned();
        let typical = match correction {
            Some(_) => None,
            None => calibration.typical_amplitude(half_width_m)?,
        };
        let load = calibration.load_quantity();
        Ok(Self { scratch: locator.scratch(), correction, typical, load, locator, smallest_amplitude, hypotheses })
    }

    fn place(&mut self, time_ns: u64, difference: &[f64]) -> Result<Option<Placement>, Error> {
        if difference.iter().all(|v| !v.is_finite() || *v == 0.0) {
            self.hypotheses.forget();
            return Ok(None);
        }
        let located = self.locator.locate(difference, &mut self.scratch)?;
        if located.amplitude < self.smallest_amplitude {
            self.hypotheses.forget();
            return Ok(None);
        }
        let load = self.load.zip(located.load);
        let mut position_m = [located.x_m, located.y_m];
        let mut covariance_m2 = [
            [located.sigma_x_m.powi(2), located.covariance_xy_m2],
            [located.covariance_xy_m2, located.sigma_y_m.powi(2)],
        ];
        let probabilities = self.scratch.posterior();
        let told = self.hypotheses.follow(time_ns, probabilities);
        let apart = |at: [f64; 2]| !self.hypotheses.are_one(at, position_m);
        let told = told.filter(|told| told.other.is_some() || apart(told.leading.position_m));
        let mut other_place = None;
        if let Some(told) = told {
            // The mean over both places is neither of them.
            let whole = variances(self.locator.places_m(), probabilities);
            let scale = [0, 1].map(|axis| (covariance_m2[axis][axis] / whole[axis]).sqrt());
            let calibrated = |mode: PlaceHypothesis| {
                let covariance = |a: usize, b: usize| mode.covariance_m2[a][b] * scale[a] * scale[b];
                [[covariance(0, 0), covariance(0, 1)], [covariance(1, 0), covariance(1, 1)]]
            };
            other_place = told.other.map(|mode| PlaceHypothesis { covariance_m2: calibrated(mode), ..mode });
            (position_m, covariance_m2) = (told.leading.position_m, calibrated(told.leading));
        }
        Ok(Some(Placement {
            amplitude: self.typical.as_ref().map(|typical| located.amplitude / typical.at(position_m)),
            load: load.map(|(quantity, load)| TouchLoad { quantity, value: load.value, sigma: load.sigma }),
            doubtful: located.novelty > MOST_NOVELTY,
            position_m,
            covariance_m2,
            other_place,
        }))
    }
}

/// Variances of x and y over places of these probabilities, m^2.
fn variances(places_m: &[[f64; 2]], probabilities: &[f64]) -> [f64; 2] {
    let sum = |of: &dyn Fn([f64; 2]) -> f64| places_m.iter().zip(probabilities).map(|(at, p)| p * of(*at)).sum::<f64>();
    [0, 1].map(|axis| {
        let mean = sum(&|at| at[axis]);
        sum(&|at| (at[axis] - mean).powi(2)).max(f64::MIN_POSITIVE)
    })
}
