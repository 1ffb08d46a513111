//! Turns log-likelihoods over the map's positions into a position and its uncertainty. Left-out examples choose the
//! two numbers that calibrate the uncertainty: the temperature b of p(x) ~ exp(b L(x)) and a factor on sigma.

use faer::Mat;
use rayon::prelude::*;

use super::rows::tempered_sums;

/// Number of temperatures tried, and their range from nearly flat to sharper than the likelihood, even in the
/// logarithm.
const TEMPERATURES: usize = 20;
const COLDEST: f64 = 2.0;
const HOTTEST: f64 = 0.003;
/// Ignore log weights below this.
const NEGLIGIBLE: f64 = -40.0;
/// Look for negligible positions again after this many temperatures.
const THINNED_EVERY: usize = 3;
/// Share of errors within one standard deviation of a Gaussian.
pub(super) const ONE_SIGMA: f64 = 0.6827;
/// Share of the errors that should be within `TAIL_SIGMAS` standard deviations, if errors have longer tails than a
/// Gaussian's: 98.8 % are within 2.5 of it. At most the share `MOST_WITHIN` is then within one.
const TAIL_SIGMAS: f64 = 2.5;
const TAIL_SHARE: f64 = 0.96;
const MOST_WITHIN: f64 = 0.74;
/// Extrapolations tried: half the largest, a quarter, and so on.
const EXTRAPOLATIONS: i32 = 10;
/// Lower bound on the factor, relative to that without extrapolation.
const LEAST_FACTOR: f64 = 0.3;
/// Gain in total log score that a choice must bring. This is the penalty of Akaike's criterion for one parameter, so
/// that few examples do not choose by chance.
pub(super) const SELECTION_MARGIN: f64 = 1.0;
/// Number of quantities chosen by the examples that leaving one out does not undo: length, noise, shrinkage, common
/// gain, temperature, both terms of sigma. Left-out errors are too small by about this number over the number of
/// examples.
pub(super) const CHOSEN_QUANTITIES: f64 = 7.0;

/// Mean and covariance of a posterior over positions.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moments {
    /// Mean position, metres.
    pub mean_m: [f64; 2],
    /// Variances of x and y and their covariance, square metres, before calibration.
    pub covariance_m2: [f64; 3],
    /// Index of the most probable position.
    pub peak: usize,
    /// Logarithm of the mean untempered likelihood over the positions.
    pub log_evidence: f64,
}

/// Turns log-likelihoods into a tempered posterior. `weights` receives the probabilities.
pub(super) fn moments(
    positions: &[[f64; 2]],
    log_likelihood: &[f64],
    temperature: f64,
    spacing_m: f64,
    weights: &mut [f64],
) -> Moments {
    let mut peak = 0;
    for (p, value) in log_likelihood.iter().enumerate() {
        if *value > log_likelihood[peak] {
            peak = p;
        }
    }
    let top = log_likelihood[peak];
    let (mut total, mut evidence) = (0.0, 0.0);
    let (mut sx, mut sy, mut sxx, mut syy, mut sxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let origin = positions[peak];
    for p in 0..positions.len() {
        let below = log_likelihood[p] - top;
        let w = if temperature * below > NEGLIGIBLE { (temperature * below).exp() } else { 0.0 };
        weights[p] = w;
        if below > NEGLIGIBLE {
            evidence += below.exp();
        }
        let (x, y) = (positions[p][0] - origin[0], positions[p][1] - origin[1]);
        total += w;
        sx += w * x;
        sy += w * y;
        sxx += w * x * x;
        syy += w * y * y;
        sxy += w * x * y;
    }
    weights.iter_mut().for_each(|w| *w /= total);
    let (mx, my) = (sx / total, sy / total);
    let grain = spacing_m * spacing_m / 12.0;
    Moments {
        mean_m: [origin[0] + mx, origin[1] + my],
        covariance_m2: [
            (sxx / total - mx * mx).max(0.0) + grain,
            (syy / total - my * my).max(0.0) + grain,
            sxy / total - mx * my,
        ],
        peak,
        log_evidence: top + (evidence / positions.len() as f64).ln(),
    }
}

/// A temperature and its predictive score.
#[derive(Debug, Clone, Copy)]
pub(super) struct Calibration {
    /// Exponent of the likelihood.
    pub temperature: f64,
    /// Mean log predictive density of an example's position (Student t, 4 degrees of freedom, constants omitted).
    pub score: f64,
}

/// Chooses the temperature whose calibrated posterior predicts the left-out positions best. Column i of `left_out` is
/// the log-likelihood of example i over the map.
pub(super) fn calibrate(
    positions: &[[f64; 2]],
    left_out: &Mat<f64>,
    truth: &[[f64; 2]],
    spacing_m: f64,
) -> Calibration {
    let temperature = |step: usize| {
        let share = step as f64 / (TEMPERATURES - 1) as f64;
        HOTTEST * (COLDEST / HOTTEST).powf(share)
    };
    let locate = |likely: &mut Likely, i: usize| {
        let origin = likely.fill(positions, left_out.col_as_slice(i));
        let mut at = |step: usize| {
            if step.is_multiple_of(THINNED_EVERY) {
                likely.forget_below((NEGLIGIBLE / temperature(step)) as f32);
            }
            let (mean_m, variances_m2) = likely.spread(temperature(step), spacing_m);
            [0, 1].map(|axis| (origin[axis] + mean_m[axis] - truth[i][axis], variances_m2[axis].sqrt()))
        };
        (0..TEMPERATURES).map(&mut at).collect::<Vec<_>>()
    };
    // For each example and temperature, errors and posterior standard deviations of x and y.
    let errors: Vec<Vec<[(f64, f64); 2]>> =
        (0..truth.len()).into_par_iter().map_init(Likely::default, locate).collect();
    let mut best = Calibration { temperature: 1.0, score: f64::NEG_INFINITY };
    for step in 0..TEMPERATURES {
        let errors: Vec<(f64, f64)> = errors.iter().flat_map(|example| example[step]).collect();
        let ratios: Vec<f64> = errors.iter().map(|e| (e.0 / e.1).abs()).collect();
        let factor = quantile(&ratios, ONE_SIGMA).max(1e-3);
        let score = errors.iter().map(|e| log_student(e.0, e.1 * factor)).sum::<f64>() / truth.len() as f64;
        if score > best.score {
            best = Calibration { temperature: temperature(step), score };
        }
    }
    best
}

/// The positions that are not negligible, with the logarithms of their likelihoods.
#[derive(Default)]
struct Likely {
    /// Difference of the logarithm from the largest, zero or above.
    below: Vec<f32>,
    /// Coordinates relative to the most likely position, metres.
    x_m: Vec<f32>,
    y_m: Vec<f32>,
}

impl Likely {
    /// Takes all positions. Returns the most likely one.
    fn fill(&mut self, positions: &[[f64; 2]], log_likelihood: &[f64]) -> [f64; 2] {
        let better = |best: usize, p: usize| if log_likelihood[p] > log_likelihood[best] { p } else { best };
        let peak = (0..positions.len()).fold(0, better);
        let (origin, top) = (positions[peak], log_likelihood[peak]);
        self.below.clear();
        self.below.extend(log_likelihood.iter().map(|value| (top - value) as f32));
        for (axis, coordinates) in [&mut self.x_m, &mut self.y_m].into_iter().enumerate() {
            coordinates.clear();
            coordinates.extend(positions.iter().map(|at| (at[axis] - origin[axis]) as f32));
        }
        origin
    }

    /// Drops positions whose log-likelihood relative to the peak is below `least`, which is negative.
    fn forget_below(&mut self, least: f32) {
        let mut kept = 0;
        for i in 0..self.below.len() {
            (self.below[kept], self.x_m[kept], self.y_m[kept]) = (self.below[i], self.x_m[i], self.y_m[i]);
            kept += usize::from(self.below[i] < -least);
        }
        self.below.truncate(kept);
        self.x_m.truncate(kept);
        self.y_m.truncate(kept);
    }

    /// Mean, relative to the most likely position, and variances along x and y of the tempered posterior.
    fn spread(&self, temperature: f64, spacing_m: f64) -> ([f64; 2], [f64; 2]) {
        let sums = tempered_sums(&self.below, &self.x_m, &self.y_m, temperature as f32);
        let mean = sums.firsts.map(|sum| sum / sums.total);
        let grain = spacing_m * spacing_m / 12.0;
        let variance = |axis: usize| (sums.seconds[axis] / sums.total - mean[axis] * mean[axis]).max(0.0) + grain;
        (mean, [variance(0), variance(1)])
    }
}

/// One example as located by others: its error, the posterior's variances before calibration, and the share of the
/// map's prior variance left at its located position.
#[derive(Debug, Clone, Copy)]
pub(super) struct Trial {
    pub error_m: [f64; 2],
    pub variance_m2: [f64; 2],
    pub unexplained: f64,
    /// Weight among the examples: below 1 for an earlier session's.
    pub weight: f64,
}

/// Number of trials, those of an earlier session by their weight.
fn weight(trials: &[Trial]) -> f64 {
    trials.iter().map(|trial| trial.weight).sum()
}

/// Computes sigma from the posterior: sigma^2 = (factor s)^2 + (extrapolation u)^2, with s the posterior's standard
/// deviation and u the unexplained share of the map's variance. Far from any example the map itself may be displaced.
#[derive(Debug, Clone, Copy)]
pub(super) struct Spread {
    pub factor: f64,
    pub extrapolation_m: f64,
}

impl Spread {
    /// Variance of one coordinate.
    pub(super) fn variance_m2(self, posterior_m2: f64, unexplained: f64) -> f64 {
        posterior_m2 * self.factor.powi(2) + (self.extrapolation_m * unexplained).powi(2)
    }

    /// Fits both terms. `far` holds examples located from other parts of the skin, and `near` examples located from all
    /// the others. `far` bounds the extrapolation: 68 % of its errors are within one sigma. Below that bound, the
    /// extrapolation that predicts `near` best is used, since a frame from an unknown part of the skin often resembles
    /// touches where the map is well known. The factor is raised for the number of quantities the examples `chose`.
    pub(super) fn fit(near: &[Trial], far: &[Trial], chose: f64) -> Self {
        let alone = Self::factor_for(near, 0.0);
        let needed = |t: &Trial, axis: usize| {
            let rest = t.error_m[axis].powi(2) - t.variance_m2[axis] * alone * alone;
            rest.max(0.0).sqrt() / t.unexplained.max(1e-3)
        };
        let ratios: Vec<f64> = far.iter().flat_map(|t| [needed(t, 0), needed(t, 1)]).collect();
        let most_m = if ratios.is_empty() { 0.0 } else { quantile(&ratios, ONE_SIGMA) };
        let with = |extrapolation_m: f64| Self { factor: Self::factor_for(near, extrapolation_m), extrapolation_m };
        let mut best = with(most_m);
        let mut reached = best.score(near);
        for halvings in (1..=EXTRAPOLATIONS).filter(|_| most_m > 0.0) {
            let candidate = with(most_m * 0.5_f64.powi(halvings));
            let score = candidate.score(near);
            if score > reached + SELECTION_MARGIN {
                (best, reached) = (candidate, score);
            }
        }
        Self { factor: best.factor * (1.0 + chose / weight(near)), ..best }
    }

    /// The factor from `near` for a given extrapolation, raised for the number of quantities that the examples `chose`.
    pub(super) fn factor_with(near: &[Trial], extrapolation_m: f64, chose: f64) -> f64 {
        Self::factor_for(near, extrapolation_m) * (1.0 + chose / weight(near))
    }

    /// Log density of the true positions, without constants.
    fn score(self, trials: &[Trial]) -> f64 {
        let density = |t: &Trial, axis: usize| {
            log_student(t.error_m[axis], self.variance_m2(t.variance_m2[axis], t.unexplained).sqrt())
        };
        trials.iter().map(|t| t.weight * (density(t, 0) + density(t, 1))).sum()
    }

    /// The factor that puts 68 % of the errors within one sigma, for a given extrapolation. It is raised until 96 % are
    /// within 2.5 sigma, or 74 % within one. At least `LEAST_FACTOR` times that without extrapolation.
    fn factor_for(near: &[Trial], extrapolation_m: f64) -> f64 {
        let alone = if extrapolation_m > 0.0 { Self::factor_for(near, 0.0) } else { 0.0 };
        let within = |sigmas: f64, share: f64| {
            let needed = |t: &Trial, axis: usize| {
                let rest = (t.error_m[axis] / sigmas).powi(2) - (extrapolation_m * t.unexplained).powi(2);
                ((rest.max(0.0) / t.variance_m2[axis]).sqrt(), t.weight)
            };
            weighted_quantile(near.iter().flat_map(|t| [needed(t, 0), needed(t, 1)]).collect(), share)
        };
        let tail = within(TAIL_SIGMAS, TAIL_SHARE).min(within(1.0, MOST_WITHIN));
        within(1.0, ONE_SIGMA).max(tail).max(LEAST_FACTOR * alone).max(1e-3)
    }
}

/// Log density of a Student t with 4 degrees of freedom without constants, so that outliers cost little more than
/// misses.
pub(super) fn log_student(error: f64, sigma: f64) -> f64 {
    -2.5 * (1.0 + (error / sigma).powi(2) / 4.0).ln() - sigma.ln()
}

/// The `fraction` quantile of a non-empty list of values, with linear interpolation.
pub(super) fn quantile(values: &[f64], fraction: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = fraction * (sorted.len() - 1) as f64;
    let low = at.floor() as usize;
    let high = (low + 1).min(sorted.len() - 1);
    sorted[low] + (at - low as f64) * (sorted[high] - sorted[low])
}

/// The `fraction` quantile of a non-empty list of values with weights above zero, with linear interpolation. With equal
/// weights this is [`quantile`].
pub(super) fn weighted_quantile(mut values: Vec<(f64, f64)>, fraction: f64) -> f64 {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let [first, last] = [values[0], values[values.len() - 1]];
    let total = values.iter().map(|v| v.1).sum::<f64>() - 0.5 * (first.1 + last.1);
    let target = fraction * total;
    let (mut below, mut reached) = (first, 0.0);
    for &value in &values[1..] {
        let step = 0.5 * (below.1 + value.1);
        if reached + step >= target {
            return below.0 + (target - reached) / step * (value.0 - below.0);
        }
        (below, reached) = (value, reached + step);
    }
    last.0
}

/// RMS distance of positions from their centroid, times sqrt 2: the radius if they cover a disc evenly.
pub(super) fn extent(positions: &[[f64; 2]]) -> f64 {
    let n = positions.len() as f64;
    let centre = [0, 1].map(|axis| positions.iter().map(|p| p[axis]).sum::<f64>() / n);
    let mean = positions.iter().map(|p| crate::plane::squared_distance(*p, centre)).sum::<f64>() / n;
    (2.0 * mean).sqrt()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Standard normal numbers by Box and Muller from a linear congruential generator.
    pub(in crate::locator) fn normals(count: usize) -> Vec<f64> {
        let mut state = 7_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let mut normal = || (-2.0 * (1.0 - uniform()).ln()).sqrt() * (std::f64::consts::TAU * uniform()).cos();
        (0..count).map(|_| normal()).collect()
    }

    /// Trials with posterior standard deviations of 1 mm, or of 2 mm every other one, and errors of such sizes.
    fn trials(count: usize, unexplained: f64) -> Vec<Trial> {
        let numbers = normals(2 * count);
        let trial = |i: usize| {
            let sigma_m = if i.is_multiple_of(2) { 1e-3 } else { 2e-3 };
            let error_m = [sigma_m * numbers[2 * i], sigma_m * numbers[2 * i + 1]];
            Trial { error_m, variance_m2: [sigma_m * sigma_m; 2], unexplained, weight: 1.0 }
        };
        (0..count).map(trial).collect()
    }

    /// Frames from an unpoked region resemble touches in a well-poked one, so the map leaves little unexplained there.
    #[test]
    fn errors_far_from_pokes_do_not_widen_the_posterior_near_them() {
        let near = trials(200, 0.02);
        let far: Vec<Trial> = (0..200).map(|i| Trial { error_m: [0.02; 2], ..near[i] }).collect();
        let spread = Spread::fit(&near, &far, 0.0);
        let sigmas_m = [1e-6, 4e-6].map(|variance_m2| spread.variance_m2(variance_m2, 0.02).sqrt());
        assert!((0.8e-3..1.25e-3).contains(&sigmas_m[0]), "{sigmas_m:?}");
        assert!((1.6e-3..2.5e-3).contains(&sigmas_m[1]), "{sigmas_m:?}");
    }

    /// Long tails widen sigma until 96 % of the errors are within 2.5 of it.
    #[test]
    fn long_tails_are_covered() {
        let mut near = trials(400, 0.0);
        near.iter_mut().step_by(12).for_each(|trial| trial.error_m = trial.error_m.map(|error| 3.0 * error));
        let spread = Spread::fit(&near, &[], 0.0);
        let is_inside =
            |trial: &&Trial| trial.error_m[0].abs() <= 2.5 * spread.variance_m2(trial.variance_m2[0], 0.0).sqrt();
        assert!(near.iter().filter(is_inside).count() >= 380, "{spread:?}");
        assert!(spread.factor < 2.5, "{spread:?}");
    }

    #[test]
    fn a_weighted_quantile_with_equal_weights_is_the_plain_one() {
        let values = [0.3, 0.1, 0.9, 0.5, 0.7];
        for fraction in [0.0, 0.2, 0.683, 1.0] {
            let weighted = weighted_quantile(values.iter().map(|v| (*v, 0.25)).collect(), fraction);
            assert!((weighted - quantile(&values, fraction)).abs() < 1e-12, "{fraction}: {weighted}");
        }
        let heavy = weighted_quantile(values.iter().map(|v| (*v, if *v > 0.6 { 1.0 } else { 0.01 })).collect(), 0.5);
        assert!((0.7..0.9).contains(&heavy), "{heavy}");
    }
}
