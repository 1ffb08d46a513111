//! The matched filter that locates touches on a skin calibrated without labels.

use dermis_tomo::inverse::{MatchedPair, PairSearch, SelfCalibration};
use dermis_touch::{PlaceHypotheses, PlaceModes};

use crate::Error;
use crate::reference::Reference;
use crate::stages::placement::{FurtherTouch, MOST_FURTHER, Placement};

/// Below this correlation with the best position's signature, a frame may not be a single touch.
const LEAST_SCORE: f64 = 0.5;

/// Test a frame for two touches if its best single position leaves more than this share of the usual residual.
const LEAST_LEFT: f64 = 0.7;
/// Accept two touches if they leave at most `LEFT_BY_TWO` times the residual of the best single position, and the
/// weaker press is at least `LEAST_ALIKE` times as strong. Single presses leave 0.70 or more of it on the measured
/// gel (475 frames), and at least 0.66 on its twin if the weaker of two presses is this strong (240). Two presses
/// leave 0.1 to 0.5, and up to 0.7 if the channels were weighted using frames of two presses alone.
const LEFT_BY_TWO: f64 = 0.6;
const LEAST_ALIKE: f64 = 0.4;
/// Minimum distance of two touches, in multiples of the distance between two explanations of a frame: a press wider
/// than the templates looks like two adjacent presses.
pub(super) const TOUCHES_APART: f64 = 1.5;

/// A coordinate's sigma has two parts: `OF_GRAIN` times the standard deviation of positions spread evenly over a grid
/// cell, and `SIZES` touch sizes times the share of the frame's energy that its touches leave. The twin and the
/// measured gel leave 5 and 31 % of a press, and locate it to 1.2 and 4.7 mm (68 % of errors).
const OF_GRAIN: f64 = 0.8;
const SIZES: f64 = 1.5;

/// Error model of positions.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlaceError {
    /// Side of the grid's cells, metres.
    pub cell_m: f64,
    /// Standard deviation of the Gaussian that represents a touch, metres.
    pub size_m: f64,
}

impl PlaceError {
    /// Covariance of touches that leave this share of a frame's weighted energy unexplained.
    fn covariance_m2(&self, left: f64) -> [[f64; 2]; 2] {
        let grain_m2 = OF_GRAIN.powi(2) * self.cell_m.powi(2) / 12.0;
        let variance_m2 = grain_m2 + (SIZES * left.clamp(0.0, 1.0) * self.size_m).powi(2);
        [[variance_m2, 0.0], [0.0, variance_m2]]
    }
}

/// True if two touches are accepted, given the shares of a frame's energy that the best position and the best two
/// positions leave, and the strength of the weaker press relative to the stronger.
pub(super) fn are_two(left_by_one: f64, left_by_two: f64, alike: f64) -> bool {
    left_by_two <= LEFT_BY_TWO * left_by_one && alike >= LEAST_ALIKE
}

/// The matched filter and the parameters for reading difference data.
#[derive(Clone, Debug)]
pub struct MatchedFinder {
    calibration: SelfCalibration,
    relative: Vec<f64>,
    noise: Vec<f64>,
    smallest_amplitude: f64,
    error: PlaceError,
    scores: Vec<f64>,
    probabilities: Vec<f64>,
    hypotheses: PlaceHypotheses,
    pairs: PairSearch,
}

impl MatchedFinder {
    /// Frames with an RMS below `smallest_amplitude`, in units of the noise, show no touch. Positions at least
    /// `separation_m` apart may be two explanations of a frame. Call [`MatchedFinder::adapt`] to set the reference.
    pub(super) fn new(
        calibration: SelfCalibration,
        smallest_amplitude: f64,
        error: PlaceError,
        separation_m: f64,
    ) -> Self {
        let pairs = calibration.pair_search(TOUCHES_APART * separation_m);
        let hypotheses = PlaceHypotheses::new(PlaceModes::new(calibration.places_m(), separation_m));
        Self {
            calibration,
            relative: Vec::new(),
            noise: Vec::new(),
            smallest_amplitude,
            error,
            scores: Vec::new(),
            probabilities: Vec::new(),
            hypotheses,
            pairs,
        }
    }

    /// Forgets the current press: the next frame is unrelated.
    pub(super) fn forget(&mut self) {
        self.hypotheses.forget();
    }

    /// Switches to differences from this baseline. Returns the reference with the scales of the calibration, and with
    /// noise in the same units.
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
        // RMS of the frame in units of its noise, to decide whether there is a touch at all.
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
        let placed = Placement {
            position_m: touch.position_m,
            covariance_m2: self.error.covariance_m2(1.0 - touch.score * touch.score),
            amplitude: None,
            load: None,
            doubtful: touch.score < LEAST_SCORE,
            vague: false,
            other_place: None,
            further: [None; MOST_FURTHER],
        };
        if let Some(MatchedPair { positions_m, amplitudes, left }) = self.pair(touch.score)? {
            self.forget();
            let [position_m, other_m] = positions_m;
            // Residual energy relative to the weaker touch alone.
            let of_weaker = left * (1.0 + (amplitudes[0] / amplitudes[1]).powi(2));
            let covariance_m2 = self.error.covariance_m2(of_weaker);
            let share = amplitudes[1] / amplitudes[0];
            let mut further = placed.further;
            further[0] = Some(FurtherTouch { position_m: other_m, covariance_m2, share, load: None });
            return Ok(Some(Placement { position_m, covariance_m2, further, doubtful: false, ..placed }));
        }
        self.calibration.probabilities(&self.scores, &mut self.probabilities);
        let told = self.hypotheses.follow(time_ns, &self.probabilities);
        let elsewhere = told.filter(|told| !self.hypotheses.are_one(told.leading.position_m, touch.position_m));
        Ok(Some(Placement {
            position_m: elsewhere.map_or(touch.position_m, |told| told.leading.position_m),
            covariance_m2: elsewhere.map_or(placed.covariance_m2, |told| {
                let spread = told.leading.covariance_m2;
                [0, 1].map(|a| [0, 1].map(|b| placed.covariance_m2[a][b] + spread[a][b]))
            }),
            other_place: told.and_then(|told| told.other),
            ..placed
        }))
    }

    /// The two touches of the current frame, if accepted. `score` is that of its best single position.
    fn pair(&self, score: f64) -> Result<Option<MatchedPair>, Error> {
        let [left, typical] = [score, self.calibration.score()].map(|score| 1.0 - score * score);
        if left <= LEAST_LEFT * typical {
            return Ok(None);
        }
        let pair = self.calibration.locate_pair(&self.relative, &self.pairs)?;
        let is_believed = |pair: &MatchedPair| are_two(left, pair.left, pair.amplitudes[1] / pair.amplitudes[0]);
        Ok(pair.filter(is_believed))
    }
}

#[cfg(test)]
mod tests {
    use super::super::self_calibrated::{RIM_SIZES, places_off_the_rim};
    use super::*;
    use crate::prepare::Prepared;
    use dermis_skin::{Skin, builtin_text};
    use dermis_tomo::inverse::{CalibrationOptions, TouchTemplates};
    use dermis_tomo::mesh::{Point, distance};

    /// The gel skin with an ideal voltmeter, all of whose pairs are of opposite electrodes. Half a turn merely swaps
    /// the electrodes of every pair, which flips the sign of both current and voltage. A press then reads like one at
    /// the opposite point.
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

    fn distance_mm(a: Point, b: Point) -> f64 {
        1e3 * distance(a, b)
    }

    /// A skin that has calibrated itself by presses all over it.
    struct Desk {
        prepared: Prepared,
        places: Vec<Point>,
        signatures: Vec<f64>,
        reference: Reference,
        finder: MatchedFinder,
    }

    impl Desk {
        fn new(prepared: Prepared) -> Self {
            // All angles, from the centre to three quarters of the radius.
            let places: Vec<Point> = (0..60)
                .map(|n| {
                    let (r, angle) = (0.064 * ((f64::from(n) + 0.5) / 60.0).sqrt(), 2.399_963 * f64::from(n));
                    [r * angle.cos(), r * angle.sin()]
                })
                .collect();
            let signatures = prepared.signatures(&places);
            let frames: Vec<Vec<f64>> = (0..places.len()).map(|n| changes(&prepared, &signatures, &[n], n)).collect();
            let size = prepared.skin.touch.relative_size * prepared.half_width_m();
            let at = places_off_the_rim(&prepared, RIM_SIZES * size);
            let pixels = prepared.map.inside_centres_m();
            let templates = TouchTemplates::blurred(prepared.jacobian.as_mat(), &pixels, &at, size).unwrap();
            let calibration =
                SelfCalibration::fit(&templates, &prepared.voltages, &frames, CalibrationOptions::default()).unwrap();
            let error = PlaceError { cell_m: prepared.map.grid().pixel_m, size_m: size };
            let mut finder = MatchedFinder::new(calibration, 1.0, error, prepared.places_apart_m());
            let reference = Reference::from_baseline(&prepared, &prepared.voltages, None).unwrap();
            let reference = finder.adapt(reference);
            Self { prepared, places, signatures, reference, finder }
        }

        /// Result of the finder for presses at these positions, read with noise number `noise`.
        fn place(&mut self, time_ns: u64, presses: &[usize], noise: usize) -> Placement {
            let changes = changes(&self.prepared, &self.signatures, presses, noise);
            let read: Vec<f64> =
                changes.iter().zip(&self.reference.baseline).map(|(d, rest)| rest * (1.0 + d)).collect();
            self.finder.place(time_ns, &self.reference.difference(&read, None)).unwrap().unwrap()
        }
    }

    /// Readings of presses as relative changes, with noise of a fifth of their size. Channels that read zero at rest
    /// are NaN.
    fn changes(prepared: &Prepared, signatures: &[f64], presses: &[usize], noise: usize) -> Vec<f64> {
        let channels = prepared.channels();
        let largest = prepared.voltages.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
        let both = |c: usize| presses.iter().map(|place| signatures[place * channels + c]).sum::<f64>();
        let size = ((0..channels).map(|c| both(c).powi(2)).sum::<f64>() / channels as f64).sqrt();
        let change = |c: usize| 0.1 * (both(c) + 0.35 * size * uniform(noise, c)) / prepared.voltages[c];
        (0..channels).map(|c| if prepared.voltages[c].abs() > 1e-3 * largest { change(c) } else { f64::NAN }).collect()
    }

    #[test]
    fn an_ambiguous_press_is_reported_at_both_places_and_does_not_jump() {
        let mut desk = Desk::new(ambiguous());
        let off = |at: Point, place: Point| distance_mm(at, place).min(distance_mm(at, place.map(|v| -v)));
        let mut told = 0;
        for (number, truth) in desk.places.clone().iter().enumerate().filter(|(_, at)| at[0].hypot(at[1]) > 0.035) {
            // A minute apart, so that presses are unrelated.
            let found = desk.place(60_000_000_000 * number as u64, &[number], number);
            let other = found.other_place.unwrap_or_else(|| panic!("no other place for {truth:?}: {found:?}"));
            assert!(
                off(found.position_m, *truth) < 10.0 && off(other.position_m, *truth) < 15.0,
                "{truth:?}: {found:?}"
            );
            assert!(distance_mm(other.position_m, found.position_m) > 45.0, "{truth:?}: {found:?}");
            // The meshes are not symmetric, so neither probability is exactly a half.
            assert!((0.3..=0.65).contains(&other.probability), "{truth:?}: {found:?}");
            told += 1;
        }
        assert!(told > 30, "{told}");
        // One lasting press, with noise in each frame that tips the balance.
        let mut before: Option<[f64; 2]> = None;
        for frame in 0..100 {
            let found = desk.place(10_000_000_000_000 + 20_000_000 * frame as u64, &[50], 100 + frame);
            let step_mm = before.replace(found.position_m).map_or(0.0, |at| distance_mm(at, found.position_m));
            assert!(step_mm < 20.0, "frame {frame} jumps by {step_mm} mm");
            assert!(found.other_place.is_some(), "frame {frame}: {found:?}");
        }
    }

    #[test]
    fn two_presses_are_two_and_one_is_one() {
        let mut desk = Desk::new(Prepared::new(Skin::open("hydrogel-disc").unwrap()).unwrap());
        let singles: Vec<Placement> = (0..60).map(|n| desk.place(60_000_000_000 * n as u64, &[n], 1000 + n)).collect();
        assert!(singles.iter().all(|found| found.further[0].is_none()), "{singles:?}");
        let (mut pairs, mut both) = (0, 0);
        for (a, b) in (0..60).flat_map(|a| (0..a).map(move |b| (a, b))) {
            let truth = [desk.places[a], desk.places[b]];
            let apart_mm = distance_mm(truth[0], truth[1]);
            if !(43.0..60.0).contains(&apart_mm) {
                continue;
            }
            let found = desk.place(60_000_000_000 * (100 + pairs), &[a, b], 2000 + 60 * a + b);
            pairs += 1;
            let Some(second) = found.further[0] else { continue };
            let near = |[p, q]: [[f64; 2]; 2]| distance_mm(p, truth[0]).max(distance_mm(q, truth[1])) < 15.0;
            let (p, q) = (found.position_m, second.position_m);
            both += u64::from(near([p, q]) || near([q, p]));
            assert!((LEAST_ALIKE..=1.0).contains(&second.share), "{second:?}");
        }
        println!("{both} of {pairs} pairs");
        assert!(pairs > 200 && both * 10 >= pairs * 9, "{both} of {pairs}");
    }
}
