//! Corrections learned from pokes, for the errors of a skin's model in the position and amplitude of touches. Each is a
//! constant plus a smooth field over the skin. Both coordinates of the shift, and the logarithm of the amplitude, are
//! regressed on the position given by the model, with covariance r (k(p, p') + 1) relative to the scatter, where k is
//! the Matern 5/2 correlation. Each position scatters in proportion to the variance that the model states for it. r
//! and the length of k are those that predict left-out pokes best. r = 0 (positions unchanged, one gain for all) is
//! kept unless another value is clearly better. Rasmussen & Williams (2006), section 5.4.2, for leaving one poke out
//! without refitting.

use faer::linalg::solvers::DenseSolveCore;
use faer::{Mat, Side};
use serde::{Deserialize, Serialize};

use super::data::{LeaveOneOut, LeftOut, MIN_EXAMPLES};
use super::error::{LocatorError, check_finite, check_first, check_length, check_positions};
use super::pair_correlations::matern52;
use super::posterior::quantile;
use crate::statistics::median;

/// Lengths tried, relative to half the shorter side of the skin.
const LENGTHS: [f64; 4] = [0.3, 0.6, 1.2, 3.0];
/// Variances of the field tried, relative to the variance of the scatter.
const STRENGTHS: [f64; 5] = [0.3, 1.0, 3.0, 10.0, 30.0];
/// Use a field only if it reduces the RMS left-out error below this share of the error without it.
const WORTH_IT: f64 = 0.97;
/// Beyond this distance, relative to half the shorter side, the model has mistaken a poke for another.
const MISTAKEN: f64 = 0.5;
/// Bounds on the scatter of a position, in multiples of the median variance.
const SCATTER: (f64, f64) = (0.25, 100.0);
/// Share of coordinates within one standard deviation.
const WITHIN_ONE_SIGMA: f64 = 0.683;
/// Number of quantities chosen by left-out pokes: length, strength, sigma.
const CHOSEN: f64 = 3.0;

/// A poke as the skin's model sees it, and its true position and load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenPoke {
    /// Position given by the model, metres.
    pub seen_m: [f64; 2],
    /// Variance of each coordinate of `seen_m` according to the model, m^2, above zero; 1 if unknown.
    pub variance_m2: f64,
    /// Amplitude given by the model, above zero.
    pub amplitude: f64,
    /// True position, metres.
    pub truth_m: [f64; 2],
    /// Load relative to a typical poke, above zero; 1 if unknown.
    pub load_share: f64,
}

/// How a skin's model sees a poke.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PokeSight {
    /// As a single touch, which is correct.
    Single(SeenPoke),
    /// As several touches; this is the strongest.
    Several(SeenPoke),
    /// Not at all; the poke was at this position, metres.
    Nothing([f64; 2]),
}

impl PokeSight {
    /// The poke, if the model sees a single touch.
    pub fn single(&self) -> Option<&SeenPoke> {
        match self {
            Self::Single(poke) => Some(poke),
            Self::Several(_) | Self::Nothing(_) => None,
        }
    }
}

/// Corrects the positions given by a model, and gives the amplitude of a typical poke for scaling.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "StoredCorrection", into = "StoredCorrection")]
pub struct PlaceCorrection {
    stored: StoredCorrection,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredCorrection {
    /// Positions of the pokes as given by the model, metres.
    places_m: Vec<[f64; 2]>,
    /// Length of the field of shifts, metres.
    shift_length_m: f64,
    /// Contribution of each poke to the shift at its own position, metres; all zero if positions are not corrected.
    shifts_m: Vec<[f64; 2]>,
    /// Standard deviation of each coordinate after correction, metres.
    sigma_m: f64,
    /// Logarithm of the model's amplitude for a typical poke.
    log_amplitude: f64,
    /// Length of the amplitude field, metres, and each poke's contribution to it.
    amplitude_length_m: f64,
    log_amplitudes: Vec<f64>,
    left_out: LeaveOneOut,
}

impl PlaceCorrection {
    /// Fits a correction to pokes on a skin whose shorter side is twice `half_width_m`, metres.
    ///
    /// # Errors
    /// Fewer than [`MIN_EXAMPLES`] pokes that the model did not mistake, or values that are not finite or, except for
    /// positions, not above zero.
    pub fn fit(pokes: &[SeenPoke], half_width_m: f64) -> Result<Self, LocatorError> {
        let seen: Vec<[f64; 2]> = pokes.iter().map(|poke| poke.seen_m).collect();
        let truth_m: Vec<[f64; 2]> = pokes.iter().map(|poke| poke.truth_m).collect();
        check_positions("seen_m", &seen)?;
        check_positions("truth_m", &truth_m)?;
        let above_zero = |field, values: &mut dyn Iterator<Item = f64>| {
            check_first(field, values, |v| v.is_finite() && v > 0.0, "a finite number above zero")
        };
        above_zero("amplitude", &mut pokes.iter().map(|poke| poke.amplitude))?;
        above_zero("variance_m2", &mut pokes.iter().map(|poke| poke.variance_m2))?;
        above_zero("load_share", &mut pokes.iter().map(|poke| poke.load_share))?;
        above_zero("half_width_m", &mut std::iter::once(half_width_m))?;
        let shift = |poke: &SeenPoke| [0, 1].map(|axis| poke.truth_m[axis] - poke.seen_m[axis]);
        let is_near = |i: &usize| {
            let [x, y] = shift(&pokes[*i]);
            x.hypot(y) <= MISTAKEN * half_width_m
        };
        let near: Vec<usize> = (0..pokes.len()).filter(is_near).collect();
        if near.len() < MIN_EXAMPLES {
            let expected = "at least 5 that the model puts near their places";
            return Err(LocatorError::Count { field: "pokes", got: near.len(), expected });
        }
        let places_m: Vec<[f64; 2]> = near.iter().map(|&i| seen[i]).collect();
        let shifts: Vec<[f64; 2]> = near.iter().map(|&i| shift(&pokes[i])).collect();
        let variances: Vec<f64> = near.iter().map(|&i| pokes[i].variance_m2).collect();
        let usual = median(&variances);
        let scatter: Vec<f64> = variances.iter().map(|v| (v / usual).clamp(SCATTER.0, SCATTER.1)).collect();
        let shifts = Field::best(&places_m, &shifts, &scatter, half_width_m)?;
        let amplitudes: Vec<f64> = near.iter().map(|&i| pokes[i].amplitude / pokes[i].load_share).collect();
        let amplitudes = TypicalAmplitude::fit(&places_m, &amplitudes, half_width_m)?;
        let coordinates: Vec<f64> = shifts.errors.iter().flatten().map(|error| error.abs()).collect();
        let allowance = 1.0 + CHOSEN / near.len() as f64;
        let sigma_m = allowance * quantile(&coordinates, WITHIN_ONE_SIGMA);
        // A mistaken poke keeps the model's error: the correction does not apply to it.
        let mut errors: Vec<[f64; 2]> = pokes.iter().map(shift).collect();
        near.iter().zip(&shifts.errors).for_each(|(&i, error)| errors[i] = *error);
        Ok(Self {
            stored: StoredCorrection {
                left_out: report(truth_m.iter().zip(&errors).map(|(&t, &e)| example(t, e, sigma_m)).collect()),
                places_m,
                shift_length_m: shifts.length_m,
                shifts_m: shifts.weights,
                sigma_m,
                log_amplitude: amplitudes.log_amplitude,
                amplitude_length_m: amplitudes.length_m,
                log_amplitudes: amplitudes.log_amplitudes,
            },
        })
    }

    /// A model that needs no shifts: only its amplitudes are scaled. `left_out` are pokes that it had not learned from.
    ///
    /// # Errors
    /// As [`PlaceCorrection::fit`].
    pub fn without_shifts(pokes: &[SeenPoke], left_out: Vec<LeftOut>, half_width_m: f64) -> Result<Self, LocatorError> {
        let fitted = Self::fit(pokes, half_width_m)?;
        let shifts_m = vec![[0.0; 2]; fitted.stored.shifts_m.len()];
        Ok(Self { stored: StoredCorrection { shifts_m, sigma_m: 0.0, left_out: report(left_out), ..fitted.stored } })
    }

    /// True if positions are shifted. Otherwise the model's own standard deviations hold.
    pub fn shifts(&self) -> bool {
        self.stored.sigma_m > 0.0
    }

    /// Corrected position of a touch that the model puts at `place_m`, metres.
    pub fn corrected(&self, place_m: [f64; 2]) -> [f64; 2] {
        let mut corrected = place_m;
        for (poke_m, shift_m) in self.stored.places_m.iter().zip(&self.stored.shifts_m) {
            let share = share(place_m, *poke_m, self.stored.shift_length_m);
            corrected.iter_mut().zip(shift_m).for_each(|(c, shift)| *c += share * shift);
        }
        corrected
    }

    /// Amplitude that the model gives a typical poke placed at `place_m`, metres.
    pub fn typical_amplitude(&self, place_m: [f64; 2]) -> f64 {
        let StoredCorrection { places_m, log_amplitudes, amplitude_length_m, log_amplitude, .. } = &self.stored;
        field_at(places_m, log_amplitudes, *amplitude_length_m, *log_amplitude, place_m).exp()
    }

    /// Standard deviation of each coordinate of a corrected position, metres, from the errors of left-out pokes.
    pub fn sigma_m(&self) -> f64 {
        self.stored.sigma_m
    }

    /// Errors of each poke when located by the model and the shifts of the others.
    pub fn leave_one_out(&self) -> &LeaveOneOut {
        &self.stored.left_out
    }

    /// Adds another locator's results on the same pokes (other than positions), and the pokes that the model does not
    /// see as one touch.
    #[must_use]
    pub fn beside(mut self, other: &LeaveOneOut, unseen: &[PokeSight]) -> Self {
        let examples = &mut self.stored.left_out.examples;
        for sight in unseen {
            examples.extend(match sight {
                // As wrong as its strongest touch.
                PokeSight::Several(poke) => {
                    Some(example(poke.truth_m, [0, 1].map(|k| poke.truth_m[k] - poke.seen_m[k]), self.stored.sigma_m))
                }
                // The other locator places it.
                PokeSight::Nothing(truth_m) => other.examples.iter().find(|e| e.position_m == *truth_m).copied(),
                PokeSight::Single(_) => None,
            });
        }
        self.stored.left_out = LeaveOneOut {
            physics_cosine: other.physics_cosine,
            load_error: other.load_error,
            ..report(std::mem::take(examples))
        };
        self
    }
}

/// Amplitude of a typical poke over the skin, as seen by a model or a locator. Dividing amplitudes by it expresses
/// them in pokes.
#[derive(Clone, Debug, PartialEq)]
pub struct TypicalAmplitude {
    /// Positions of the pokes, metres.
    places_m: Vec<[f64; 2]>,
    /// Logarithm of the median amplitude.
    log_amplitude: f64,
    /// Length of the amplitude field, metres, and each poke's contribution to it.
    length_m: f64,
    log_amplitudes: Vec<f64>,
}

impl TypicalAmplitude {
    /// Fits the field to pokes at some positions, metres, with their observed amplitudes. If loads are known, divide
    /// each amplitude by the poke's load relative to a typical one. The shorter side of the skin is twice
    /// `half_width_m`.
    ///
    /// # Errors
    /// No pokes, different numbers of positions and amplitudes, amplitudes that are not finite and above zero.
    pub fn fit(places_m: &[[f64; 2]], amplitudes: &[f64], half_width_m: f64) -> Result<Self, LocatorError> {
        check_length("amplitudes", places_m.len(), amplitudes.len())?;
        check_positions("places_m", places_m)?;
        let is_amplitude = |v: f64| v.is_finite() && v > 0.0;
        check_first("amplitude", amplitudes.iter().copied(), is_amplitude, "a finite number above zero")?;
        if amplitudes.is_empty() {
            return Err(LocatorError::Count { field: "pokes", got: 0, expected: "at least one" });
        }
        let logs: Vec<f64> = amplitudes.iter().map(|amplitude| amplitude.ln()).collect();
        let log_amplitude = median(&logs);
        let logs: Vec<[f64; 1]> = logs.iter().map(|log| [log - log_amplitude]).collect();
        let field = Field::best(places_m, &logs, &vec![1.0; logs.len()], half_width_m)?;
        let log_amplitudes = field.weights.iter().map(|[weight]| *weight).collect();
        Ok(Self { places_m: places_m.to_vec(), log_amplitude, length_m: field.length_m, log_amplitudes })
    }

    /// Typical amplitude at a position, metres.
    pub fn at(&self, place_m: [f64; 2]) -> f64 {
        field_at(&self.places_m, &self.log_amplitudes, self.length_m, self.log_amplitude, place_m).exp()
    }
}

/// Value of a field at a position: its constant plus the contribution of each poke.
fn field_at(pokes_m: &[[f64; 2]], added: &[f64], length_m: f64, constant: f64, place_m: [f64; 2]) -> f64 {
    let add = |(poke_m, added): (&[f64; 2], &f64)| added * share(place_m, *poke_m, length_m);
    constant + pokes_m.iter().zip(added).map(add).sum::<f64>()
}

/// Factor on a poke's weight at another position.
fn share(a: [f64; 2], b: [f64; 2], length_m: f64) -> f64 {
    1.0 + matern52(a, b, length_m)
}

/// A field of K quantities fitted to pokes.
struct Field<const K: usize> {
    length_m: f64,
    weights: Vec<[f64; K]>,
    /// Error at each poke when it is left out.
    errors: Vec<[f64; K]>,
}

impl<const K: usize> Field<K> {
    /// The field that predicts left-out pokes best, or the zero field unless another is clearly better. `scatter` is
    /// the variance of each target relative to the usual one.
    fn best(
        places: &[[f64; 2]],
        targets: &[[f64; K]],
        scatter: &[f64],
        half_width_m: f64,
    ) -> Result<Self, LocatorError> {
        let mut best = Self { length_m: half_width_m, weights: vec![[0.0; K]; places.len()], errors: targets.to_vec() };
        let mut bar = WORTH_IT * best.rms(scatter);
        for length_m in LENGTHS.map(|share| share * half_width_m) {
            for strength in STRENGTHS {
                let field = Self::fit(places, targets, scatter, length_m, strength)?;
                if field.rms(scatter) < bar {
                    bar = field.rms(scatter);
                    best = field;
                }
            }
        }
        Ok(best)
    }

    fn fit(
        places: &[[f64; 2]],
        targets: &[[f64; K]],
        scatter: &[f64],
        length_m: f64,
        strength: f64,
    ) -> Result<Self, LocatorError> {
        let n = places.len();
        let own = |i: usize, j: usize| if i == j { scatter[i] } else { 0.0 };
        let covariance = Mat::from_fn(n, n, |i, j| strength * share(places[i], places[j], length_m) + own(i, j));
        let singular = |_| LocatorError::Singular { what: "covariance of the shifts" };
        let inverse = covariance.llt(Side::Lower).map_err(singular)?.inverse();
        let solved = &inverse * Mat::from_fn(n, K, |i, k| targets[i][k]);
        Ok(Self {
            length_m,
            weights: (0..n).map(|i| std::array::from_fn(|k| strength * solved[(i, k)])).collect(),
            errors: (0..n).map(|i| std::array::from_fn(|k| solved[(i, k)] / inverse[(i, i)])).collect(),
        })
    }

    /// RMS of the errors, each relative to its scatter.
    fn rms(&self, scatter: &[f64]) -> f64 {
        let weighted = |(errors, s): (&[f64; K], &f64)| errors.iter().map(|error| error * error).sum::<f64>() / s;
        let sum: f64 = self.errors.iter().zip(scatter).map(weighted).sum();
        (sum / (K * self.errors.len()) as f64).sqrt()
    }
}

/// A poke at `truth_m` whose located position is off by -`error_m`.
fn example(truth_m: [f64; 2], error_m: [f64; 2], sigma_m: f64) -> LeftOut {
    LeftOut {
        position_m: truth_m,
        located_m: [0, 1].map(|axis| truth_m[axis] - error_m[axis]),
        sigma_m: [sigma_m; 2],
        error_m: error_m[0].hypot(error_m[1]),
        novelty: 1.0,
    }
}

/// Summary of the left-out pokes.
fn report(examples: Vec<LeftOut>) -> LeaveOneOut {
    let errors: Vec<f64> = examples.iter().map(|example| example.error_m).collect();
    let is_within = |axis: usize, e: &LeftOut| (e.located_m[axis] - e.position_m[axis]).abs() <= e.sigma_m[axis];
    let within = |axis: usize| examples.iter().filter(|e| is_within(axis, e)).count() as f64 / examples.len() as f64;
    LeaveOneOut {
        median_error_m: quantile(&errors, 0.5),
        p90_error_m: quantile(&errors, 0.9),
        coverage: [within(0), within(1)],
        physics_cosine: 0.0,
        load_error: None,
        examples,
    }
}

impl TryFrom<StoredCorrection> for PlaceCorrection {
    type Error = LocatorError;

    fn try_from(stored: StoredCorrection) -> Result<Self, LocatorError> {
        let count = stored.places_m.len();
        check_length("shifts_m", count, stored.shifts_m.len())?;
        check_length("log_amplitudes", count, stored.log_amplitudes.len())?;
        check_positions("places_m", &stored.places_m)?;
        check_positions("shifts_m", &stored.shifts_m)?;
        check_finite("log_amplitudes", &stored.log_amplitudes)?;
        check_finite("log_amplitude", &[stored.log_amplitude])?;
        let lengths = [stored.shift_length_m, stored.amplitude_length_m];
        let above_zero = |v: f64| v.is_finite() && v > 0.0;
        check_first("length_m", lengths.into_iter(), above_zero, "a finite number above zero")?;
        let sigma = std::iter::once(stored.sigma_m);
        check_first("sigma_m", sigma, |v| v.is_finite() && v >= 0.0, "a finite number, zero or above")?;
        Ok(Self { stored })
    }
}

impl From<PlaceCorrection> for StoredCorrection {
    fn from(correction: PlaceCorrection) -> Self {
        correction.stored
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::distance;

    /// Positions on a 7 x 7 grid of 60 mm, and a repeatable scatter of about 0.1 mm.
    fn grid() -> Vec<[f64; 2]> {
        (0..49_usize).map(|i| [-0.03 + 0.01 * (i % 7) as f64, -0.03 + 0.01 * (i / 7) as f64]).collect()
    }

    fn scatter(i: usize) -> [f64; 2] {
        [1, 2].map(|k| 1e-4 * (((i * 37 + k * 101) % 17) as f64 / 8.5 - 1.0))
    }

    /// A stretch, a rotation and an offset, as on a skin that was not built exactly as drawn.
    fn truth(p: [f64; 2]) -> [f64; 2] {
        [1.04 * p[0] - 0.02 * p[1] + 0.001, 0.02 * p[0] + 0.98 * p[1] - 0.0005]
    }

    /// Pokes seen on the grid and made at `truth` of that, with the scatter.
    fn pokes(truth: impl Fn([f64; 2]) -> [f64; 2]) -> Vec<SeenPoke> {
        let poke = |(i, seen_m): (usize, [f64; 2])| SeenPoke {
            seen_m,
            variance_m2: 1.0,
            amplitude: 1.0,
            truth_m: [0, 1].map(|axis| truth(seen_m)[axis] + scatter(i)[axis]),
            load_share: 1.0,
        };
        grid().into_iter().enumerate().map(poke).collect()
    }

    #[test]
    fn a_stretch_a_turn_and_an_offset_are_learnt() {
        let correction = PlaceCorrection::fit(&pokes(truth), 0.035).unwrap();
        // Evaluated between the pokes, and against the true map rather than the scattered pokes.
        let between = [0.0137, -0.0214];
        let (found, wanted) = (correction.corrected(between), truth(between));
        // Uncorrected, it is 1 mm off; the scatter of one poke is 0.08 mm.
        let error_m = distance(found, wanted);
        assert!(distance(between, wanted) > 0.8e-3 && error_m < 1e-4, "{error_m} m");
        assert!((0.5e-4..2e-4).contains(&correction.sigma_m()), "{}", correction.sigma_m());
        let again: PlaceCorrection = serde_json::from_str(&serde_json::to_string(&correction).unwrap()).unwrap();
        // The text preserves all but the last digit.
        assert!((0..2).all(|axis| (again.corrected(between)[axis] - found[axis]).abs() < 1e-12));
    }

    #[test]
    fn places_that_are_right_already_stay_as_they_are() {
        let correction = PlaceCorrection::fit(&pokes(|p| p), 0.035).unwrap();
        assert!(grid().into_iter().all(|p| distance(correction.corrected(p), p) < 0.5e-4));
    }

    #[test]
    fn amplitudes_are_relative_to_a_typical_poke_at_any_load_and_place() {
        let mut pokes = pokes(|p| p);
        // A skin twice as sensitive at its right end as at its left one, poked with different loads.
        let sensitivity = |p: [f64; 2]| 3.0 * (p[0] / 0.06 * std::f64::consts::LN_2).exp();
        for (i, poke) in pokes.iter_mut().enumerate() {
            poke.load_share = 1.0 + 0.5 * (i % 3) as f64;
            poke.amplitude = sensitivity(poke.seen_m) * poke.load_share;
        }
        let correction = PlaceCorrection::fit(&pokes, 0.035).unwrap();
        for place in [[0.0, 0.0], [-0.022, 0.013], [0.024, -0.017]] {
            let ratio = correction.typical_amplitude(place) / sensitivity(place);
            assert!((ratio - 1.0).abs() < 0.02, "{place:?}: {ratio}");
        }
    }

    #[test]
    fn a_mistaken_poke_moves_nothing_and_is_counted() {
        let mut pokes = pokes(|p| p);
        pokes.iter_mut().for_each(|poke| poke.truth_m = poke.seen_m);
        pokes[10].truth_m = [0.03, 0.03];
        let correction = PlaceCorrection::fit(&pokes, 0.035).unwrap();
        assert_eq!(correction.corrected([0.01, 0.0]), [0.01, 0.0]);
        let worst = correction.leave_one_out().examples.iter().map(|e| e.error_m).fold(0.0, f64::max);
        assert!(worst > 0.03);
        assert!(PlaceCorrection::fit(&pokes[..4], 0.035).is_err());
        pokes[3].amplitude = f64::NAN;
        assert!(PlaceCorrection::fit(&pokes, 0.035).unwrap_err().to_string().contains("amplitude, index 3"));
    }

    #[test]
    fn places_that_the_model_doubts_count_less() {
        let shifted = |p: [f64; 2]| [p[0] + 1e-3, p[1]];
        let mut pokes = pokes(shifted);
        for poke in pokes.iter_mut().step_by(3) {
            poke.truth_m[0] += 8e-3;
            poke.variance_m2 = 64.0;
        }
        let off =
            |pokes: &[SeenPoke]| (PlaceCorrection::fit(pokes, 0.035).unwrap().corrected([0.0; 2])[0] - 1e-3).abs();
        let with_doubts = off(&pokes);
        pokes.iter_mut().for_each(|poke| poke.variance_m2 = 1.0);
        // A third of the pokes are 8 mm off. Weighted like the others they pull positions by 2.7 mm.
        assert!(with_doubts < 2e-4 && off(&pokes) > 1e-3, "{with_doubts} m");
    }

    #[test]
    fn pokes_that_the_model_does_not_see_are_as_far_off_as_the_other_locator_has_them() {
        let seen = pokes(|p| p);
        let [blind, crowded] = [[0.031, 0.031], [0.032, -0.032]];
        let other = report(vec![example(blind, [0.004, 0.0], 0.005), example(crowded, [0.001, 0.0], 0.001)]);
        let split = SeenPoke { seen_m: [0.032, -0.022], truth_m: crowded, ..seen[0] };
        let sights = [PokeSight::Single(seen[0]), PokeSight::Nothing(blind), PokeSight::Several(split)];
        let correction = PlaceCorrection::fit(&seen, 0.035).unwrap();
        let alone = correction.leave_one_out().examples.len();
        let all = correction.beside(&other, &sights).leave_one_out().clone();
        let errors: Vec<f64> = all.examples[alone..].iter().map(|e| (e.error_m * 1e6).round()).collect();
        assert_eq!(errors, [4000.0, 10_000.0]);
        assert!(all.coverage[0] <= 1.0 && all.median_error_m < 2e-4);
    }
}
