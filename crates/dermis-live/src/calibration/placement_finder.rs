//! Locates the touches of a frame on a calibrated skin.

use dermis_tomo::mesh::{Point, distance};
use dermis_touch::locator::{
    FusedLocator, FusedScratch, Located, Part, PlaceCorrection, Superposition, SuperpositionScratch, TypicalAmplitude,
};
use dermis_touch::{LoadQuantity, TouchLoad};

use super::matched::MatchedFinder;
use super::poke_calibration::{Calibration, SmallestAmplitude};
use crate::Error;
use crate::reference::Reference;
use crate::stages::placement::{FurtherTouch, MOST_FURTHER, Placement};

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
    locator: FusedLocator,
    scratch: FusedScratch,
    /// Explains frames by several touches.
    superposition: Option<(Superposition, SuperpositionScratch)>,
    /// Memory for the touches of a frame, and for a frame with one of them.
    parts: Vec<Part>,
    frame: Vec<f64>,
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
        let superposition = calibration.superposition()?.map(|found| (found, SuperpositionScratch::default()));
        Ok(Self {
            scratch: locator.scratch(),
            superposition,
            parts: Vec::new(),
            frame: Vec::new(),
            correction,
            typical,
            load,
            locator,
            smallest_amplitude,
            half_width_m,
        })
    }

    /// Uses the mean of the locator's posterior even if that has several modes: with a posterior learned from few
    /// pokes, a single mode is the worse guess.
    fn place(&mut self, difference: &[f64]) -> Result<Option<Placement>, Error> {
        if difference.iter().all(|v| !v.is_finite() || *v == 0.0) {
            return Ok(None);
        }
        let located = self.locator.predict_into(difference, &mut self.scratch)?;
        let sigma_m = located.sigma_x_m.max(located.sigma_y_m);
        if !self.smallest_amplitude.is_touch(located.amplitude, sigma_m) {
            return Ok(None);
        }
        self.parts.clear();
        if let Some((superposition, scratch)) = &mut self.superposition {
            self.parts.extend_from_slice(superposition.explain(difference, scratch)?);
            if self.parts.is_empty() {
                return Ok(None);
            }
        }
        if self.parts.len() < 2 {
            return Ok(Some(self.placement(&located)));
        }
        let first = self.place_part(difference, 0)?;
        let mut further = [None; MOST_FURTHER];
        for (number, place) in (1..self.parts.len()).zip(&mut further) {
            let found = self.place_part(difference, number)?;
            let share = match (found.amplitude, first.amplitude) {
                (Some(amplitude), Some(strongest)) => amplitude / strongest,
                _ => self.parts[number].share / self.parts[0].share,
            };
            *place = Some(FurtherTouch {
                position_m: found.position_m,
                covariance_m2: found.covariance_m2,
                share,
                load: found.load,
            });
        }
        Ok(Some(Placement { further, doubtful: false, ..first }))
    }

    /// Locates one of the touches of a frame, with the others removed.
    fn place_part(&mut self, difference: &[f64], number: usize) -> Result<Placement, Error> {
        if let Some((superposition, scratch)) = &mut self.superposition {
            superposition.without_others(difference, &self.parts, number, scratch, &mut self.frame);
        }
        let located = self.locator.predict_into(&self.frame, &mut self.scratch)?;
        let mut placement = self.placement(&located);
        let part = self.parts[number];
        // What the sum leaves of the other touches may outweigh this one.
        let distance_m = |place_m: Point| distance([located.x_m, located.y_m], place_m);
        let is_elsewhere = self.parts.iter().any(|other| distance_m(other.position_m) < distance_m(part.position_m));
        let is_rather_here = match &mut self.superposition {
            Some((superposition, scratch)) => {
                superposition.is_rather_at(&part, placement.position_m, &self.frame, scratch)?
            }
            None => false,
        };
        if is_elsewhere || is_rather_here {
            placement.position_m = part.position_m;
        }
        Ok(placement)
    }

    fn placement(&self, located: &Located) -> Placement {
        let sigma_m = located.sigma_x_m.max(located.sigma_y_m);
        let load = self.load.zip(located.load);
        let position_m = [located.x_m, located.y_m];
        Placement {
            amplitude: self.typical.as_ref().map(|typical| located.amplitude / typical.at(position_m)),
            load: load.map(|(quantity, load)| TouchLoad { quantity, value: load.value, sigma: load.sigma }),
            doubtful: self.superposition.is_none() && located.novelty > MOST_NOVELTY,
            vague: sigma_m > VAGUE * self.half_width_m,
            position_m,
            covariance_m2: [
                [located.sigma_x_m.powi(2), located.covariance_xy_m2],
                [located.covariance_xy_m2, located.sigma_y_m.powi(2)],
            ],
            other_place: None,
            further: [None; MOST_FURTHER],
        }
    }
}
