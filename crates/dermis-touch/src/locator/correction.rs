//! How far a skin's model puts touches from where they are, and how strong it shows them, learnt from pokes: each a
//! constant and a smooth field over the skin. Both coordinates of the shift, and the logarithm of the amplitude, are
//! regressed on the place that the model gives, with the covariance r (k(p, p') + 1) relative to the scatter, k the
//! Matern 5/2 correlation; places scatter as the model says of each, in proportion. r and the length of k are those
//! that predict left-out pokes best, and r = 0 (places stay as they are, one gain for all) stands unless another is
//! clearly better. Rasmussen & Williams (2006), section 5.4.2, for leaving one poke out without refitting.

use faer::linalg::solvers::DenseSolveCore;
use faer::{Mat, Side};
use serde::{Deserialize, Serialize};

use super::copies::matern52;
use super::data::{LeaveOneOut, LeftOut, MIN_EXAMPLES};
use super::error::{LocatorError, check_finite, check_first, check_length, check_positions};
use super::posterior::quantile;
use crate::typical::median;

/// Lengths tried, relative to half the shorter side of the skin.
const LENGTHS: [f64; 4] = [0.3, 0.6, 1.2, 3.0];
/// Variances of the field tried, relative to that of the scatter.
const STRENGTHS: [f64; 5] = [0.3, 1.0, 3.0, 10.0, 30.0];
/// A field is believed where it makes left-out errors (root mean square) smaller than this part of those without.
const WORTH_IT: f64 = 0.97;
/// The model has mistaken a poke for another one beyond this distance, relative to half the shorter side.
const MISTAKEN: f64 = 0.5;
/// A place scatters at least and at most so many times the median variance.
const SCATTER: (f64, f64) = (0.25, 100.0);
/// The part of coordinates that lies within one standard deviation.
const WITHIN_ONE_SIGMA: f64 = 0.683;
/// Quantities that the left-out pokes chose: length, strength, sigma.
const CHOSEN: f64 = 3.0;

/// A poke as the skin's model sees it, and as it was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenPoke {
    /// Where the model puts it, metres.
    pub seen_m: [f64; 2],
    /// Variance of each coordinate of that according to the model, m^2, above zero; 1 where nobody knows.
    pub variance_m2: f64,
    /// How strong the model shows it, above zero.
    pub amplitude: f64,
    /// Where it was, metres.
    pub truth_m: [f64; 2],
    /// How hard it was relative to a typical poke, above zero; 1 where nobody knows.
    pub load_share: f64,
}

/// What a skin's model makes of a poke.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PokeSight {
    /// The one touch that it is.
    Single(SeenPoke),
    /// Several touches: this is the strongest.
    Several(SeenPoke),
    /// No touch at this place, metres.
    Nothing([f64; 2]),
}

impl PokeSight {
    /// The poke, where the model sees one touch.
    pub fn single(&self) -> Option<&SeenPoke> {
        match self {
            Self::Single(poke) => Some(poke),
            Self::Several(_) | Self::Nothing(_) => None,
        }
    }
}

/// Moves the places that a model gives to where pokes say they are, and scales amplitudes to those of a typical poke.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "StoredCorrection", into = "StoredCorrection")]
pub struct PlaceCorrection {
    stored: StoredCorrection,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredCorrection {
    /// Places of the pokes as the model has them, metres.
    places_m: Vec<[f64; 2]>,
    /// Length of the field of shifts, metres.
    shift_length_m: f64,
    /// What each poke adds to the shift at its own place, metres; all zero where places stay as they are.
    shifts_m: Vec<[f64; 2]>,
    /// Standard deviation of each coordinate afterwards, metres.
    sigma_m: f64,
    /// Logarithm of the amplitude that the model shows of a typical poke.
    log_amplitude: f64,
    /// Length of the field about it, metres, and what each poke adds to it.
    amplitude_length_m: f64,
    log_amplitudes: Vec<f64>,
    left_out: LeaveOneOut,
}

impl PlaceCorrection {
    /// Of pokes on a skin of which half the shorter side is `half_width_m`, metres.
    ///
    /// # Errors
    /// Fewer than [`MIN_EXAMPLES`] pokes that the model did not mistake, or values that are not finite and, but for
    /// places, above zero.
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
        // A mistaken poke is as wrong as the model has it, whatever the others say.
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

    /// Where a touch is that the model puts at `place_m`, metres.
    pub fn corrected(&self, place_m: [f64; 2]) -> [f64; 2] {
        let mut corrected = place_m;
        for (poke_m, shift_m) in self.stored.places_m.iter().zip(&self.stored.shifts_m) {
            let share = share(place_m, *poke_m, self.stored.shift_length_m);
            corrected.iter_mut().zip(shift_m).for_each(|(c, shift)| *c += share * shift);
        }
        corrected
    }

    /// The amplitude that the model shows of a typical poke where it puts it at `place_m`, metres.
    pub fn typical_amplitude(&self, place_m: [f64; 2]) -> f64 {
        let StoredCorrection { places_m, log_amplitudes, amplitude_length_m, log_amplitude, .. } = &self.stored;
        field_at(places_m, log_amplitudes, *amplitude_length_m, *log_amplitude, place_m).exp()
    }

    /// Standard deviation of each coordinate of a corrected place, metres: what left-out pokes were off by.
    pub fn sigma_m(&self) -> f64 {
        self.stored.sigma_m
    }

    /// How well each poke is placed by the model and the shifts of the others.
    pub fn leave_one_out(&self) -> &LeaveOneOut {
        &self.stored.left_out
    }

    /// With what another locator found out about the same pokes beside places, and with what becomes of those that the
    /// model does not see as one touch.
    #[must_use]
    pub fn beside(mut self, other: &LeaveOneOut, unseen: &[PokeSight]) -> Self {
        let examples = &mut self.stored.left_out.examples;
        for sight in unseen {
            examples.extend(match sight {
                // As wrong as the strongest of them.
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

/// How strong something (a model, a locator) shows a typical poke, over the skin: what its amplitudes are to be divided
/// by, so that they count in pokes.
#[derive(Clone, Debug, PartialEq)]
pub struct TypicalAmplitude {
    /// Places of the pokes, metres.
    places_m: Vec<[f64; 2]>,
    /// Logarithm of the median amplitude.
    log_amplitude: f64,
    /// Length of the field about it, metres, and what each poke adds to it.
    length_m: f64,
    log_amplitudes: Vec<f64>,
}

impl TypicalAmplitude {
    /// Of pokes at places, metres, with the amplitudes that they were shown with, each divided by the poke's load
    /// relative to a typical one where loads are known, on a skin of which half the shorter side is `half_width_m`.
    ///
    /// # Errors
    /// No pokes, numbers of places and amplitudes that differ, amplitudes that are not finite and above zero.
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

    /// At a place, metres.
    pub fn at(&self, place_m: [f64; 2]) -> f64 {
        field_at(&self.places_m, &self.log_amplitudes, self.length_m, self.log_amplitude, place_m).exp()
    }
}

/// A field at a place: its constant, and what each poke adds.
fn field_at(pokes_m: &[[f64; 2]], added: &[f64], length_m: f64, constant: f64, place_m: [f64; 2]) -> f64 {
    let add = |(poke_m, added): (&[f64; 2], &f64)| added * share(place_m, *poke_m, length_m);
    constant + pokes_m.iter().zip(added).map(add).sum::<f64>()
}

/// What a poke's weight counts at another place.
fn share(a: [f64; 2], b: [f64; 2], length_m: f64) -> f64 {
    1.0 + matern52(a, b, length_m)
}

/// A field of K quantities fitted to pokes.
struct Field<const K: usize> {
    length_m: f64,
    weights: Vec<[f64; K]>,
    /// What is left at each poke when it was left out.
    errors: Vec<[f64; K]>,
}

impl<const K: usize> Field<K> {
    /// The one that predicts left-out pokes best; none at all unless another is clearly better. `scatter`: variance of
    /// each target, relative to that of a usual one.
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

    /// Root mean square of the errors, each relative to its scatter.
    fn rms(&self, scatter: &[f64]) -> f64 {
        let weighted = |(errors, s): (&[f64; K], &f64)| errors.iter().map(|error| error * error).sum::<f64>() / s;
        let sum: f64 = self.errors.iter().zip(scatter).map(weighted).sum();
        (sum / (K * self.errors.len()) as f64).sqrt()
    }
}

/// A poke at `truth_m` that was placed wrong by -`error_m`.
fn example(truth_m: [f64; 2], error_m: [f64; 2], sigma_m: f64) -> LeftOut {
    LeftOut {
        position_m: truth_m,
        located_m: [0, 1].map(|axis| truth_m[axis] - error_m[axis]),
        sigma_m: [sigma_m; 2],
        error_m: error_m[0].hypot(error_m[1]),
        novelty: 1.0,
    }
}

/// What left-out pokes tell together.
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

    /// Places on a 7 x 7 grid of 60 mm, and a repeatable scatter of about 0.1 mm.
    fn grid() -> Vec<[f64; 2]> {
        (0..49_usize).map(|i| [-0.03 + 0.01 * (i % 7) as f64, -0.03 + 0.01 * (i / 7) as f64]).collect()
    }

    fn scatter(i: usize) -> [f64; 2] {
        [1, 2].map(|k| 1e-4 * (((i * 37 + k * 101) % 17) as f64 / 8.5 - 1.0))
    }

    /// A stretch, a turn and an offset, as a skin has whose drawing is not what was built.
    fn truth(p: [f64; 2]) -> [f64; 2] {
        [1.04 * p[0] - 0.02 * p[1] + 0.001, 0.02 * p[0] + 0.98 * p[1] - 0.0005]
    }

    /// Pokes seen on the grid and made by `truth` of that, with the scatter.
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
        // Between the pokes, and against the true map rather than the scattered pokes.
        let between = [0.0137, -0.0214];
        let (found, wanted) = (correction.corrected(between), truth(between));
        let off = |found: [f64; 2]| (found[0] - wanted[0]).hypot(found[1] - wanted[1]);
        // Uncorrected it is 1 mm off; the scatter of one poke is 0.08 mm.
        assert!(off(between) > 0.8e-3 && off(found) < 1e-4, "{} m", off(found));
        assert!((0.5e-4..2e-4).contains(&correction.sigma_m()), "{}", correction.sigma_m());
        let again: PlaceCorrection = serde_json::from_str(&serde_json::to_string(&correction).unwrap()).unwrap();
        // The text holds the last digit or the one before.
        assert!((0..2).all(|axis| (again.corrected(between)[axis] - found[axis]).abs() < 1e-12));
    }

    #[test]
    fn places_that_are_right_already_stay_as_they_are() {
        let correction = PlaceCorrection::fit(&pokes(|p| p), 0.035).unwrap();
        let moved = |p: [f64; 2]| {
            let to = correction.corrected(p);
            (to[0] - p[0]).hypot(to[1] - p[1])
        };
        assert!(grid().into_iter().all(|p| moved(p) < 0.5e-4));
    }

    #[test]
    fn amplitudes_are_those_of_a_typical_poke_whatever_the_load_and_the_place() {
        let mut pokes = pokes(|p| p);
        // A skin twice as sensitive at its right end as at its left one, poked with loads that differ.
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
        // A third of the pokes 8 mm off: trusted like the others, they pull places by 2.7 mm.
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
