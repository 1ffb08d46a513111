//! Corrects the forces that a layer's law gives, by presses of known force.
//!
//! `ln F = ln L + w . m + e`: L is the force by the law, m the monomials 1, ln (L / L0), x, y, x^2, xy, y^2 with
//! positions over a length, w has a Gaussian prior, and the standard deviation of e is that of ln L times `spread`.
//! spread and the prior of the last five weights maximise the marginal likelihood (Rasmussen & Williams, Gaussian
//! Processes for Machine Learning, 2006, section 2.1 and eq. 2.30). Few presses thus leave the law as it is.

use faer::prelude::*;
use faer::{Mat, Side};
use serde::{Deserialize, Serialize};

use super::sample::ForceSample;
use crate::error::{TouchError, require, require_finite};

/// Number of weights.
const TERMS: usize = 7;
/// Prior standard deviations of the first two weights: stiffness and thickness of a layer are known to about a third,
/// and laws are off by a power of the force.
const LEVEL: f64 = 0.4;
const POWER: f64 = 0.3;
/// Candidates for the prior standard deviation of the others, the variation over the skin.
const VARIATIONS: [f64; 4] = [0.0, 0.05, 0.15, 0.5];
/// Candidates for the spread are powers of this number between 1 / 30 and 3; the logarithm of its prior has a standard
/// deviation of 1.
const SPREAD_STEP: f64 = 1.25;
const SPREAD_STEPS: [i32; 2] = [-15, 5];

/// The correction of a law.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LawCorrection {
    /// L0, the geometric mean of the forces by the law, newtons.
    pub mean_n: f64,
    /// Length by which positions are divided, metres.
    pub scale_m: f64,
    /// w.
    pub weights: [f64; TERMS],
    /// Covariance of w.
    pub covariance: [[f64; TERMS]; TERMS],
    /// Standard deviation of the corrected force over that of the law's.
    pub spread: f64,
}

/// One press: its force (newtons), its monomials, `ln F - ln L`, and the standard deviation of ln L.
struct Row {
    force_n: f64,
    terms: [f64; TERMS],
    off: f64,
    sigma: f64,
}

/// Weights for one choice of the prior, with the logarithm of its marginal likelihood.
struct Fitted {
    log_likelihood: f64,
    weights: [f64; TERMS],
    covariance: [[f64; TERMS]; TERMS],
}

impl LawCorrection {
    /// Fits the presses that have a force by the law, and returns the root mean square error of presses left out,
    /// newtons.
    ///
    /// # Errors
    /// Fewer than two presses; forces that are not positive.
    pub(super) fn fit(samples: &[ForceSample]) -> Result<(Self, f64), TouchError> {
        let with_law = |sample: &ForceSample| Some((*sample, sample.by_law?));
        let presses: Vec<(ForceSample, [f64; 2])> = samples.iter().filter_map(with_law).collect();
        require(presses.len() >= 2, "presses with a force by the law", presses.len() as f64, "at least 2")?;
        for (sample, [force_n, sigma_n]) in &presses {
            require(sample.force_n > 0.0, "force_n", sample.force_n, "above 0")?;
            require(*force_n > 0.0 && *sigma_n > 0.0, "force by the law in N", *force_n, "above 0, with a sigma")?;
        }
        let mean_n = (presses.iter().map(|(_, law)| law[0].ln()).sum::<f64>() / presses.len() as f64).exp();
        let lengths = presses.iter().flat_map(|(sample, _)| sample.position_m.map(f64::abs));
        let scale_m = lengths.fold(f64::MIN_POSITIVE, f64::max);
        let row = |(sample, [law_n, sigma_n]): &(ForceSample, [f64; 2])| Row {
            force_n: sample.force_n,
            terms: terms(sample.position_m, scale_m, law_n / mean_n),
            off: (sample.force_n / law_n).ln(),
            sigma: sigma_n / law_n,
        };
        let rows: Vec<Row> = presses.iter().map(row).collect();
        let mut best: Option<(f64, f64, Fitted)> = None;
        for step in SPREAD_STEPS[0]..=SPREAD_STEPS[1] {
            let spread = SPREAD_STEP.powi(step);
            for variation in VARIATIONS {
                let Some(fitted) = fitted(&rows, spread, variation) else { continue };
                let score = fitted.log_likelihood - 0.5 * spread.ln().powi(2);
                if best.as_ref().is_none_or(|(most, ..)| score > *most) {
                    best = Some((score, spread, fitted));
                }
            }
        }
        let Some((_, spread, Fitted { weights, covariance, .. })) = best else {
            return Err(TouchError::NonFinite { what: "forces by the law", index: 0, value: f64::NAN });
        };
        // The residual of a press left out is its residual over 1 minus its own share.
        let left_out = |row: &Row| {
            let own = quadratic(&covariance, &row.terms) / (spread * row.sigma).powi(2);
            let off = (row.off - dot(&weights, &row.terms)) / (1.0 - own).max(f64::EPSILON);
            (row.force_n * off).powi(2)
        };
        let squares: f64 = rows.iter().map(left_out).sum();
        let residual_n = (squares / rows.len() as f64).sqrt();
        Ok((Self { mean_n, scale_m, weights, covariance, spread }, residual_n))
    }

    /// Force and its standard deviation, newtons, of a press with this force by the law.
    pub(super) fn read(&self, position_m: [f64; 2], [law_n, sigma_n]: [f64; 2]) -> [f64; 2] {
        let terms = terms(position_m, self.scale_m, law_n / self.mean_n);
        let force_n = law_n * dot(&self.weights, &terms).exp();
        let variance = (self.spread * sigma_n / law_n).powi(2) + quadratic(&self.covariance, &terms).max(0.0);
        [force_n, force_n * variance.sqrt()]
    }

    /// Checks a loaded correction.
    pub(super) fn check(&self) -> Result<(), TouchError> {
        for (what, value) in [("mean_n", self.mean_n), ("scale_m", self.scale_m), ("spread", self.spread)] {
            require(value.is_finite() && value > 0.0, what, value, "positive and finite")?;
        }
        require_finite("weights of the force law", &self.weights)?;
        self.covariance.iter().try_for_each(|row| require_finite("covariance of the force law", row))
    }
}

fn terms(position_m: [f64; 2], scale_m: f64, relative: f64) -> [f64; TERMS] {
    let [x, y] = position_m.map(|length| length / scale_m);
    [1.0, relative.ln(), x, y, x * x, x * y, y * y]
}

/// The weights given the prior, by the inverse of `1 + S M' D^-1 M S` with the prior's standard deviations S.
fn fitted(rows: &[Row], spread: f64, variation: f64) -> Option<Fitted> {
    let deviations = [LEVEL, POWER, variation, variation, variation, variation, variation];
    let scaled = |row: &Row, k: usize| deviations[k] * row.terms[k] / (spread * row.sigma);
    let off = |row: &Row| row.off / (spread * row.sigma);
    let precision = Mat::from_fn(TERMS, TERMS, |a, b| {
        f64::from(u8::from(a == b)) + rows.iter().map(|row| scaled(row, a) * scaled(row, b)).sum::<f64>()
    });
    let right = Mat::from_fn(TERMS, 1, |k, _| rows.iter().map(|row| scaled(row, k) * off(row)).sum::<f64>());
    let factor = precision.llt(Side::Lower).ok()?;
    let (solved, inverse) = (factor.solve(&right), factor.solve(Mat::<f64>::identity(TERMS, TERMS)));
    let log_determinant: f64 = (0..TERMS).map(|k| 2.0 * factor.L()[(k, k)].ln()).sum();
    let squares: f64 = rows.iter().map(|row| off(row).powi(2)).sum();
    let explained: f64 = (0..TERMS).map(|k| right[(k, 0)] * solved[(k, 0)]).sum();
    let log_noise: f64 = rows.iter().map(|row| 2.0 * (spread * row.sigma).ln()).sum();
    let log_likelihood = -0.5 * (squares - explained + log_determinant + log_noise);
    log_likelihood.is_finite().then(|| Fitted {
        log_likelihood,
        weights: std::array::from_fn(|k| deviations[k] * solved[(k, 0)]),
        covariance: std::array::from_fn(|a| std::array::from_fn(|b| deviations[a] * inverse[(a, b)] * deviations[b])),
    })
}

fn dot(a: &[f64; TERMS], b: &[f64; TERMS]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// `t' C t`.
fn quadratic(covariance: &[[f64; TERMS]; TERMS], terms: &[f64; TERMS]) -> f64 {
    covariance.iter().zip(terms).map(|(row, term)| term * dot(row, terms)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::force::{CalibrationScope, ForceCalibration};

    /// Presses of 0.5 to 4 N on a spiral, whose law says `L = F / factor`.
    fn presses(count: usize, factor: impl Fn([f64; 2], f64) -> f64) -> Vec<ForceSample> {
        let press = |k: usize| {
            let (angle, force_n) = (2.4 * k as f64, 0.5 * 1.23_f64.powi((7 * k % 11) as i32));
            let radius_m = 0.05 * ((k as f64 + 0.5) / count as f64).sqrt();
            let position_m = [radius_m * angle.cos(), radius_m * angle.sin()];
            let law_n = force_n / factor(position_m, force_n);
            ForceSample { position_m, force_n, signal: 0.0, by_law: Some([law_n, 0.05 * law_n]) }
        };
        (0..count).map(press).collect()
    }

    #[test]
    fn a_layer_of_another_stiffness_is_corrected() {
        let samples = presses(10, |_, force_n| 1.4 * force_n.powf(0.1));
        let (correction, residual_n) = LawCorrection::fit(&samples).unwrap();
        assert!(residual_n < 0.02, "{residual_n}");
        let [force_n, sigma_n] = correction.read([0.01, 0.02], [2.0 / (1.4 * 2.0_f64.powf(0.1)), 0.07]);
        // The prior pulls by some sigma squared over the number of presses: a thousandth.
        assert!((force_n - 2.0).abs() < 0.01 && sigma_n < 0.05, "{force_n} {sigma_n}");
    }

    #[test]
    fn a_law_that_holds_is_left_alone() {
        let samples = presses(5, |_, _| 1.0);
        let (correction, _) = LawCorrection::fit(&samples).unwrap();
        let [force_n, sigma_n] = correction.read([0.03, -0.02], [1.0, 0.05]);
        assert!((force_n - 1.0).abs() < 1e-9 && sigma_n < 0.05, "{force_n} {sigma_n}");
        // Far outside, the power is less certain.
        let [force_n, far_n] = correction.read([0.03, -0.02], [100.0, 5.0]);
        assert!((force_n - 100.0).abs() < 1e-6 && far_n > 150.0 * sigma_n, "{force_n} {far_n} {sigma_n}");
    }

    #[test]
    fn a_gain_over_the_skin_is_learned() {
        let truth = |[x, y]: [f64; 2], _: f64| (1.0 + 6.0 * x - 60.0 * (x * x + y * y)).abs();
        let samples = presses(30, truth);
        let (correction, residual_n) = LawCorrection::fit(&samples).unwrap();
        assert!(residual_n < 0.05, "{residual_n}");
        let place = [0.02, -0.015];
        let [force_n, _] = correction.read(place, [1.0 / truth(place, 1.0), 0.05]);
        assert!((force_n - 1.0).abs() < 0.03, "{force_n}");
    }

    #[test]
    fn scatter_widens_the_sigma() {
        // A scatter of 20 % under a law that claims 5 %.
        let scatter = |position: [f64; 2], _: f64| (0.28 * (9e4 * (position[0] - 0.3 * position[1])).sin()).exp();
        let samples = presses(40, scatter);
        let (correction, residual_n) = LawCorrection::fit(&samples).unwrap();
        let [_, sigma_n] = correction.read([0.0, 0.0], [1.0, 0.05]);
        assert!((0.14..0.3).contains(&sigma_n) && residual_n > 0.1, "{sigma_n} {residual_n}");
    }

    #[test]
    fn presses_on_a_twin_make_no_force_surer_than_the_law() {
        let exact = |of: CalibrationScope| ForceCalibration::fit_law(&presses(20, |_, _| 1.0), None, of).unwrap();
        let scope = CalibrationScope { skin: "skin".into(), indenter_area_m2: 1e-4, date: String::new() };
        let sigma_n = |of: &ForceCalibration| of.read([0.0; 2], 1.0, Some([1.0, 0.05])).unwrap().sigma_n().unwrap();
        let measured = exact(scope);
        assert!(sigma_n(&measured) < 0.03, "{}", sigma_n(&measured));
        assert!(sigma_n(&measured.of_twin()) >= 0.05);
    }

    #[test]
    fn bad_presses_are_refused() {
        let samples = presses(5, |_, _| 1.0);
        assert!(LawCorrection::fit(&samples[..1]).is_err());
        let mut bad = samples.clone();
        bad[2].by_law = Some([-1.0, 0.1]);
        assert!(LawCorrection::fit(&bad).is_err());
        let (mut correction, _) = LawCorrection::fit(&samples).unwrap();
        correction.check().unwrap();
        correction.covariance[3][3] = f64::NAN;
        assert!(correction.check().is_err());
    }
}
