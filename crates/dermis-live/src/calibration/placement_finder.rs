//! Locates the single touch of a frame on a calibrated skin.

use dermis_touch::locator::{PlaceCorrection, TypicalAmplitude};
use dermis_touch::{LoadQuantity, TouchLoad};

use super::matched::MatchedFinder;
use super::place_locator::{PlaceLocator, PlaceScratch};
use super::poke_calibration::{Calibration, SmallestAmplitude};
use crate::Error;
use crate::reference::Reference;
use crate::stages::placement::Placement;

/// Above this novelty a frame may not be a single touch, and several contacts in the image count against it.
const MOST_NOVELTY: f64 = 3.0;
/// Above this standard deviation, relative to half the shorter side, the position of a touch is unknown.
const VAGUE: f64 = 0.5;

/// Locates the single touch of a frame.
#[derive(Clone, Debug)]
pub enum PlacementFinder {
    /// A locator learned from pokes.
    Learnt(Box<LearntFinder>),
    /// The matched filter of a skin calibrated without labels.
    Matched(Box<MatchedFinder>),
}

/// A locator with its memory.
#[derive(Clone, Debug)]
pub struct LearntFinder {
    locator: PlaceLocator,
    scratch: PlaceScratch,
    /// Corrects the model's positions, if the model locates touches.
    correction: Option<PlaceCorrection>,
    /// Divisor for amplitudes.
    typical: Option<TypicalAmplitude>,
    /// Quantity in which the pokes' loads were measured.
    load: Option<LoadQuantity>,
    /// RMS values of the noise-weighted frame below which there is no touch.
    smallest_amplitude: SmallestAmplitude,
    half_width_m: f64,
}

impl PlacementFinder {
    /// Locates the single touch of a frame; `None` if the frame is too weak. The matched filter follows two positions
    /// that explain it about equally well over the frames of a press. `time_ns` is the frame's time.
    ///
    /// # Errors
    /// A frame of the wrong length, or without enough channels.
    pub fn place(&mut self, time_ns: u64, difference: &[f64]) -> Result<Option<Placement>, Error> {
        match self {
            PlacementFinder::Learnt(finder) => finder.place(difference),
            PlacementFinder::Matched(finder) => finder.place(time_ns, difference),
        }
    }

    /// Forgets the current press: the next frame is unrelated.
    pub fn forget(&mut self) {
        if let PlacementFinder::Matched(finder) = self {
            finder.forget();
        }
    }

    /// Adapts the reference of a new baseline to the units in which frames are read from now on. Only a skin that
    /// calibrated itself needs this; otherwise the reference is unchanged.
    pub(crate) fn adapt(&mut self, reference: Reference) -> Reference {
        match self {
            PlacementFinder::Learnt(_) => reference,
            PlacementFinder::Matched(finder) => finder.adapt(reference),
        }
    }

    /// The correction of the model's positions, if the model locates touches. This finder then only estimates loads,
    /// and locates touches that the model does not see.
    pub fn correction(&self) -> Option<&PlaceCorrection> {
        match self {
            PlacementFinder::Learnt(finder) => finder.correction.as_ref(),
            PlacementFinder::Matched(_) => None,
        }
    }
}

impl LearntFinder {
    /// Locates touches in frames whose noise-weighted RMS is at least `smallest_amplitude`.
    ///
    /// # Errors
    /// As [`Calibration::typical_amplitude`].
    pub(super) fn new(
        calibration: &Calibration,
        smallest_amplitude: SmallestAmplitude,
        half_width_m: f64,
    ) -> Result<Self, Error> {
        let locator = calibration.locator().clone();
        let correction = calibration.correction().cloned();
        let typical = calibration.typical_amplitude(half_width_m)?;
        let load = calibration.load_quantity();
        Ok(Self { scratch: locator.scratch(), correction, typical, load, locator, smallest_amplitude, half_width_m })
    }

    /// Uses the mean of the locator's posterior even if that has several modes: with a posterior learned from few
    /// pokes, a single mode is the worse guess.
    fn place(&mut self, difference: &[f64]) -> Result<Option<Placement>, Error> {
        if difference.iter().all(|v| !v.is_finite() || *v == 0.0) {
            return Ok(None);
        }
        let located = self.locator.locate(difference, &mut self.scratch)?;
        let sigma_m = located.sigma_x_m.max(located.sigma_y_m);
        if !self.smallest_amplitude.is_touch(located.amplitude, sigma_m) {
            return Ok(None);
        }
        let load = self.load.zip(located.load);
        let position_m = [located.x_m, located.y_m];
        Ok(Some(Placement {
            amplitude: self.typical.as_ref().map(|typical| located.amplitude / typical.at(position_m)),
            load: load.map(|(quantity, load)| TouchLoad { quantity, value: load.value, sigma: load.sigma }),
            doubtful: located.novelty > MOST_NOVELTY,
            vague: sigma_m > VAGUE * self.half_width_m,
            position_m,
            covariance_m2: [
                [located.sigma_x_m.powi(2), located.covariance_xy_m2],
                [located.covariance_xy_m2, located.sigma_y_m.powi(2)],
            ],
            other_place: None,
            second: None,
        }))
    }
}
