//! The matched filter that places touches of a skin calibrated without labels.

use dermis_tomo::inverse::SelfCalibration;
use dermis_touch::{PlaceHypotheses, PlaceModes};

use crate::Error;
use crate::reference::Reference;
use crate::stages::placement::Placement;

/// Below this correlation with the best place's signature, a frame is doubted to be a single touch.
const LEAST_SCORE: f64 = 0.5;

/// The matched filter and what it needs to read difference data.
#[derive(Clone, Debug)]
pub struct MatchedFinder {
    calibration: SelfCalibration,
    relative: Vec<f64>,
    noise: Vec<f64>,
    smallest_amplitude: f64,
    variance_m2: f64,
    scores: Vec<f64>,
    probabilities: Vec<f64>,
    hypotheses: PlaceHypotheses,
}

impl MatchedFinder {
    /// Frames whose root mean square in units of the noise is below `smallest_amplitude` show no touch. Without a
    /// reference yet: [`MatchedFinder::adapt`]. Places at least `separation_m` apart may be two explanations of a frame.
    pub(super) fn new(
        calibration: SelfCalibration,
        smallest_amplitude: f64,
        variance_m2: f64,
        separation_m: f64,
    ) -> Self {
        let hypotheses = PlaceHypotheses::new(PlaceModes::new(calibration.places_m(), separation_m));
        Self {
            calibration,
            relative: Vec::new(),
            noise: Vec::new(),
            smallest_amplitude,
            variance_m2,
            scores: Vec::new(),
            probabilities: Vec::new(),
            hypotheses,
        }
    }

    /// The next frame has nothing to do with this one.
    pub(super) fn forget(&mut self) {
        self.hypotheses.forget();
    }

    /// Reads differences from this baseline from now on: the reference with the scales of the calibration, in whose
    /// units its noise is as well.
    pub(crate) fn adapt(&mut self, mut reference: Reference) -> Reference {
        for (channel, data_scale) in self.calibration.data_scale().iter().enumerate() {
            let scale = 1.0 / (reference.baseline[channel] * data_scale);
            let old = reference.scale[channel].abs();
            let scale = if scale.is_finite() { scale } else { 0.0 };
            reference.noise[channel] *= if old > 0.0 { scale.abs() / old } else { 0.0 };
            reference.scale[channel] = scale;
        }
        self.noise.clone_from(&reference.noise);
        reference
    }

    pub(super) fn place(&mut self, time_ns: u64, difference: &[f64]) -> Result<Option<Placement>, Error> {
        // Root mean square of the frame in units of its noise: is there a touch at all?
        let in_noise = difference.iter().zip(&self.noise).filter(|(d, noise)| d.is_finite() && **noise > 0.0);
        let (count, sum) = in_noise.fold((0, 0.0), |(n, sum), (d, noise)| (n + 1, sum + (d / noise).powi(2)));
        if count == 0 || (sum / f64::from(count)).sqrt() < self.smallest_amplitude {
            self.forget();
            return Ok(None);
        }
        self.relative.clear();
        self.relative.extend(difference.iter().zip(self.calibration.data_scale()).map(|(d, scale)| d * scale));
        let Some(touch) = self.calibration.locate_with_scores(&self.relative, &mut self.scores)? else {
            return Ok(None);
        };
        self.calibration.probabilities(&self.scores, &mut self.probabilities);
        let told = self.hypotheses.follow(time_ns, &self.probabilities);
        let elsewhere = told.filter(|told| !self.hypotheses.are_one(told.leading.position_m, touch.position_m));
        Ok(Some(Placement {
            position_m: elsewhere.map_or(touch.position_m, |told| told.leading.position_m),
            covariance_m2: [[self.variance_m2, 0.0], [0.0, self.variance_m2]],
            amplitude: None,
            load: None,
            doubtful: touch.score < LEAST_SCORE,
            other_place: told.and_then(|told| told.other),
        }))
    }
}
