//! Force as a function of signal: a line, a parabola, or a monotone piecewise cubic through an isotonic regression.

use serde::{Deserialize, Serialize};

use crate::error::{TouchError, require};
use faer::prelude::*;

/// A curve is saturated where signal per force has dropped to this share of its usual value.
const SATURATION_SHARE: f64 = 0.05;

/// Number of points at which slopes are evaluated.
const SLOPE_POINTS: usize = 200;

/// Kind of curve to fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CurveKind {
    /// `F = a + b s`.
    Linear,
    /// `F = a + b s + c s^2`.
    Quadratic,
    /// Isotonic least squares (pool adjacent violators), interpolated by the monotone cubic of Fritsch and Butland,
    /// SIAM J. Sci. Stat. Comput. 5 (1984) 300 (PCHIP).
    Monotone,
}

/// A fitted curve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Curve {
    /// `F = sum_k c_k s^k`, newtons; two or three coefficients.
    Polynomial(Vec<f64>),
    /// Monotone cubic pieces, constant beyond their ends.
    Pchip {
        /// Ascending signals.
        signals: Vec<f64>,
        /// Forces at these signals, newtons.
        forces_n: Vec<f64>,
        /// Slopes at these signals, newtons per signal.
        slopes: Vec<f64>,
    },
}

impl Curve {
    /// Fits (signal, force) points, sorted by signal.
    pub(super) fn fit(kind: CurveKind, points: &[(f64, f64)]) -> Result<Self, TouchError> {
        match kind {
            CurveKind::Linear => polynomial(points, 2),
            CurveKind::Quadratic => polynomial(points, 3),
            CurveKind::Monotone => {
                let (signals, forces_n) = isotonic(points);
                require(signals.len() >= 2, "distinct calibrated signals", signals.len() as f64, "at least 2")?;
                let slopes = pchip_slopes(&signals, &forces_n);
                Ok(Self::Pchip { signals, forces_n, slopes })
            }
        }
    }

    /// Force for a signal, newtons.
    #[must_use]
    pub fn force_n(&self, signal: f64) -> f64 {
        match self {
            Self::Polynomial(c) => c.iter().rev().fold(0.0, |sum, coefficient| sum * signal + coefficient),
            Self::Pchip { signals, forces_n, slopes } => pchip(signals, forces_n, slopes, signal),
        }
    }

    /// Checks lengths, and that numbers are finite.
    pub(super) fn check(&self) -> Result<(), TouchError> {
        let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
        let ok = match self {
            Self::Polynomial(c) => (2..=3).contains(&c.len()) && finite(c),
            Self::Pchip { signals, forces_n, slopes } => {
                let lengths = signals.len() >= 2 && signals.len() == forces_n.len() && signals.len() == slopes.len();
                let ascending = signals.windows(2).all(|pair| pair[0] < pair[1]);
                lengths && ascending && finite(signals) && finite(forces_n) && finite(slopes)
            }
        };
        let expected = "finite coefficients, or as many forces and slopes as ascending signals";
        require(ok, "force curve", f64::NAN, expected)
    }

    /// Checks that force never falls with signal within the range, and rises over the range as a whole.
    pub(super) fn check_rising(&self, [low, high]: [f64; 2]) -> Result<(), TouchError> {
        require(high > low, "range of calibrated signals", high - low, "above 0")?;
        let rise = self.force_n(high) - self.force_n(low);
        require(rise > 0.0, "rise of the force curve in N", rise, "above 0")?;
        let least = self.pieces([low, high]).map(|(_, slope)| slope).fold(f64::INFINITY, f64::min);
        let ok = least * (high - low) >= -1e-9 * rise;
        require(ok, "least slope of the force curve", least, "zero or more: it folds back, use another curve")
    }

    /// Signal above which signal per force stays below a twentieth of its mean over the lower half of the range.
    pub(super) fn saturation(&self, [low, high]: [f64; 2]) -> Option<f64> {
        let middle = 0.5 * (low + high);
        let usual = (self.force_n(middle) - self.force_n(low)) / (middle - low);
        let pieces: Vec<(f64, f64)> = self.pieces([low, high]).collect();
        let tail = pieces.iter().rev().take_while(|(_, slope)| *slope * SATURATION_SHARE >= usual);
        tail.last().map(|(signal, _)| *signal).filter(|_| usual > 0.0)
    }

    /// Left end and slope (newtons per signal) of equal pieces of a range.
    fn pieces(&self, [low, high]: [f64; 2]) -> impl Iterator<Item = (f64, f64)> + '_ {
        let step = (high - low) / SLOPE_POINTS as f64;
        (0..SLOPE_POINTS).map(move |k| {
            let left = low + step * k as f64;
            (left, (self.force_n(left + step) - self.force_n(left)) / step)
        })
    }
}

/// Least squares by QR, with the signal scaled to at most 1.
fn polynomial(points: &[(f64, f64)], terms: usize) -> Result<Curve, TouchError> {
    let mut distinct: Vec<f64> = points.iter().map(|point| point.0).collect();
    distinct.dedup();
    let expected = "as many as the curve has coefficients";
    require(distinct.len() >= terms, "distinct calibrated signals", distinct.len() as f64, expected)?;
    let scale = points.iter().map(|point| point.0.abs()).fold(0.0, f64::max);
    let matrix = Mat::from_fn(points.len(), terms, |row, power| (points[row].0 / scale).powi(power as i32));
    let forces = Mat::from_fn(points.len(), 1, |row, _| points[row].1);
    let solution = matrix.qr().solve_lstsq(forces);
    Ok(Curve::Polynomial((0..terms).map(|power| solution[(power, 0)] / scale.powi(power as i32)).collect()))
}

/// Isotonic regression (pool adjacent violators) of sorted points. Averages equal signals first. Every signal gets
/// the mean of its block.
fn isotonic(points: &[(f64, f64)]) -> (Vec<f64>, Vec<f64>) {
    let mut groups: Vec<(f64, f64, f64)> = Vec::new();
    for &(signal, force) in points {
        match groups.last_mut() {
            Some(last) if last.0 == signal => (last.1, last.2) = (last.1 + force, last.2 + 1.0),
            _ => groups.push((signal, force, 1.0)),
        }
    }
    // Blocks of (sum, weight, groups).
    let mut blocks: Vec<(f64, f64, usize)> = Vec::new();
    for &(_, sum, weight) in &groups {
        blocks.push((sum, weight, 1));
        while let [.., before, last] = blocks[..]
            && before.0 * last.1 > last.0 * before.1
        {
            blocks.truncate(blocks.len() - 2);
            blocks.push((before.0 + last.0, before.1 + last.1, before.2 + last.2));
        }
    }
    let forces = blocks.iter().flat_map(|block| std::iter::repeat_n(block.0 / block.1, block.2)).collect();
    (groups.iter().map(|group| group.0).collect(), forces)
}

/// Slopes that keep the pieces monotone: harmonic means inside, the limited three-point formula at the ends.
fn pchip_slopes(x: &[f64], y: &[f64]) -> Vec<f64> {
    let count = x.len();
    let h: Vec<f64> = x.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let secant: Vec<f64> = (0..count - 1).map(|k| (y[k + 1] - y[k]) / h[k]).collect();
    if count == 2 {
        return vec![secant[0]; 2];
    }
    let end = |h0: f64, h1: f64, d0: f64, d1: f64| {
        let slope = ((2.0 * h0 + h1) * d0 - h0 * d1) / (h0 + h1);
        if slope * d0 <= 0.0 {
            0.0
        } else if d0 * d1 <= 0.0 && slope.abs() > 3.0 * d0.abs() {
            3.0 * d0
        } else {
            slope
        }
    };
    let mut slopes = vec![0.0; count];
    slopes[0] = end(h[0], h[1], secant[0], secant[1]);
    slopes[count - 1] = end(h[count - 2], h[count - 3], secant[count - 2], secant[count - 3]);
    for k in 1..count - 1 {
        let (before, after) = (secant[k - 1], secant[k]);
        if before * after > 0.0 {
            let (left, right) = (2.0 * h[k] + h[k - 1], h[k] + 2.0 * h[k - 1]);
            slopes[k] = (left + right) / (left / before + right / after);
        }
    }
    slopes
}

/// Cubic Hermite pieces, constant beyond the ends.
pub(super) fn pchip(x: &[f64], y: &[f64], slopes: &[f64], at: f64) -> f64 {
    let last = x.len() - 1;
    if at <= x[0] {
        return y[0];
    }
    if at >= x[last] {
        return y[last];
    }
    let k = x.partition_point(|value| *value <= at).clamp(1, last) - 1;
    let h = x[k + 1] - x[k];
    let t = (at - x[k]) / h;
    let (t2, t3) = (t * t, t * t * t);
    y[k] * (2.0 * t3 - 3.0 * t2 + 1.0)
        + h * slopes[k] * (t3 - 2.0 * t2 + t)
        + y[k + 1] * (3.0 * t2 - 2.0 * t3)
        + h * slopes[k + 1] * (t3 - t2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_agree_with_scipy() {
        let (x, y) = ([0.0, 1.0, 2.5, 3.0, 5.0], [0.0, 0.5, 0.6, 2.0, 2.2]);
        let slopes = pchip_slopes(&x, &y);
        // Values from scipy 1.17, PchipInterpolator.
        let expected = [
            (0.3, 0.19917008264462807),
            (1.7, 0.5427142589136723),
            (2.8, 1.4975475123018034),
            (4.1, 2.16780593220339),
            (4.9, 2.199677118644068),
        ];
        for (at, value) in expected {
            assert!((pchip(&x, &y, &slopes, at) - value).abs() < 1e-13, "{at}");
        }
    }

    #[test]
    fn regression_agrees_with_scipy() {
        let y = [1.0, 3.0, 2.0, 4.0, 3.5, 3.0, 6.0];
        let points: Vec<(f64, f64)> = y.iter().enumerate().map(|(k, &y)| (k as f64, y)).collect();
        // Values from scipy 1.17, optimize.isotonic_regression.
        assert_eq!(isotonic(&points).1, [1.0, 2.5, 2.5, 3.5, 3.5, 3.5, 6.0]);
    }
}
