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
    /// reference yet: [`MatchedFinder::adapt`]. Places at least `separation_m` apart may be two explanations of a
    /// frame.
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

#[cfg(test)]
mod tests {
    use super::super::self_calibrated::{RIM_SIZES, places_off_the_rim};
    use super::*;
    use crate::prepare::Prepared;
    use dermis_skin::{Skin, builtin_text};
    use dermis_tomo::inverse::{CalibrationOptions, TouchTemplates};

    /// The gel skin with an ideal voltmeter, all of whose pairs are of opposite electrodes. Half a turn only exchanges
    /// the electrodes of every pair, which changes the sign of current and voltage both: a press reads as one at the
    /// point opposite.
    fn ambiguous() -> Prepared {
        let text = builtin_text("hydrogel-disc").unwrap();
        let lines = text.lines().filter(|line| !line.starts_with("circuit")).map(|line| match line.split(' ').next() {
            Some("drive") => "drive = \"opposite\"",
            Some("measure") => "measure = \"opposite\"",
            _ => line,
        });
        Prepared::new(Skin::parse(&lines.collect::<Vec<_>>().join("\n"), "test").unwrap()).unwrap()
    }

    /// A hash of two numbers, -1 to 1.
    fn uniform(a: usize, b: usize) -> f64 {
        let hash = ((a << 16 | b) as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        ((hash ^ hash >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40) as f64 / f64::from(1 << 23) - 1.0
    }

    fn distance_mm(a: [f64; 2], b: [f64; 2]) -> f64 {
        1e3 * (a[0] - b[0]).hypot(a[1] - b[1])
    }

    #[test]
    fn a_press_that_reads_as_one_opposite_is_told_at_both_places_and_does_not_jump() {
        let prepared = ambiguous();
        // All angles, from the middle to three quarters of the radius.
        let places: Vec<[f64; 2]> = (0..60)
            .map(|n| {
                let (r, angle) = (0.064 * ((f64::from(n) + 0.5) / 60.0).sqrt(), 2.399_963 * f64::from(n));
                [r * angle.cos(), r * angle.sin()]
            })
            .collect();
        let (signatures, channels) = (prepared.signatures(&places), prepared.channels());
        let largest = prepared.voltages.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
        // Readings of a press in relative changes, with noise of a fifth of its size; channels at zero have none.
        let press = |place: usize, frame: usize| -> Vec<f64> {
            let signature = &signatures[place * channels..(place + 1) * channels];
            let size = (signature.iter().map(|v| v * v).sum::<f64>() / channels as f64).sqrt();
            let change = |c: usize| 0.1 * (signature[c] + 0.35 * size * uniform(frame, c)) / prepared.voltages[c];
            (0..channels)
                .map(|c| if prepared.voltages[c].abs() > 1e-3 * largest { change(c) } else { f64::NAN })
                .collect()
        };
        let frames: Vec<Vec<f64>> = (0..places.len()).map(|n| press(n, n)).collect();
        let size = prepared.skin.touch.relative_size * prepared.half_width_m();
        let at = places_off_the_rim(&prepared, RIM_SIZES * size);
        let pixels = prepared.map.inside_centres_m();
        let templates = TouchTemplates::blurred(prepared.jacobian.as_mat(), &pixels, &at, size).unwrap();
        let calibration =
            SelfCalibration::fit(&templates, &prepared.voltages, &frames, CalibrationOptions::default()).unwrap();
        let mut finder = MatchedFinder::new(calibration, 1.0, 1.6e-5, prepared.places_apart_m());
        let reference = Reference::from_baseline(&prepared, &prepared.voltages, None).unwrap();
        let reference = finder.adapt(reference);
        let mut place = |time_ns: u64, changes: &[f64]| {
            let read: Vec<f64> = changes.iter().zip(&reference.baseline).map(|(d, rest)| rest * (1.0 + d)).collect();
            finder.place(time_ns, &reference.difference(&read, None)).unwrap().unwrap()
        };
        let off = |at: [f64; 2], place: [f64; 2]| distance_mm(at, place).min(distance_mm(at, place.map(|v| -v)));
        let mut told = 0;
        for (number, truth) in places.iter().enumerate().filter(|(_, at)| at[0].hypot(at[1]) > 0.035) {
            // A minute apart: no press follows another.
            let found = place(60_000_000_000 * number as u64, &frames[number]);
            let other = found.other_place.unwrap_or_else(|| panic!("no other place for {truth:?}: {found:?}"));
            assert!(
                off(found.position_m, *truth) < 10.0 && off(other.position_m, *truth) < 15.0,
                "{truth:?}: {found:?}"
            );
            assert!(distance_mm(other.position_m, found.position_m) > 45.0, "{truth:?}: {found:?}");
            // The meshes are not symmetric, so that neither is exactly a half.
            assert!((0.3..=0.65).contains(&other.probability), "{truth:?}: {found:?}");
            told += 1;
        }
        assert!(told > 30, "{told}");
        // One press that lasts, each frame with noise of its own that turns the balance.
        let mut before: Option<[f64; 2]> = None;
        for frame in 0..100 {
            let found = place(10_000_000_000_000 + 20_000_000 * frame as u64, &press(50, 100 + frame));
            let step_mm = before.replace(found.position_m).map_or(0.0, |at| distance_mm(at, found.position_m));
            assert!(step_mm < 20.0, "frame {frame} jumps by {step_mm} mm");
            assert!(found.other_place.is_some(), "frame {frame}: {found:?}");
        }
    }
}
