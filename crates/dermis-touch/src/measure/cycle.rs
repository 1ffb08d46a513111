//! Measures of repeated and cyclic loading: the area of the hysteresis loop, the scatter of repeats, and drift under
//! constant conditions.

use crate::error::{TouchError, require, require_finite, require_length};
use crate::statistics::{line, mean_std};

/// A loading and unloading cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hysteresis {
    /// Area between unloading and loading, signal times load; positive if unloading reads higher.
    pub area: f64,
    /// [`Hysteresis::area`] over (largest - smallest load) times (largest - smallest signal).
    pub area_fraction: f64,
    /// Largest difference between the branches at one load, over the signal's full scale.
    pub largest_gap_fraction: f64,
}

/// Loop area of a cycle as a fraction of full scale. Each branch is (load, signal), loads ascending in `loading` and
/// descending in `unloading`. The branches are compared, linearly between points, over the loads that both cover.
///
/// # Errors
/// Fewer than 2 points in a branch, loads that do not ascend or descend, values that are not finite, branches without
/// a common range, a signal without range.
pub fn hysteresis(loading: &[(f64, f64)], unloading: &[(f64, f64)]) -> Result<Hysteresis, TouchError> {
    let up = Branch::new("loading", loading.to_vec())?;
    let down = Branch::new("unloading", unloading.iter().rev().copied().collect())?;
    let (low, high) = (up.first().max(down.first()), up.last().min(down.last()));
    require(high > low, "common range of loads", high - low, "above 0")?;
    let mut loads: Vec<f64> = up.points.iter().chain(&down.points).map(|point| point.0).collect();
    loads.retain(|load| (low..=high).contains(load));
    loads.sort_by(f64::total_cmp);
    // Both branches are straight between these loads, so the trapezoidal rule is exact.
    let gaps: Vec<(f64, f64)> = loads.iter().map(|&load| (load, down.at(load) - up.at(load))).collect();
    let area: f64 = gaps.windows(2).map(|pair| (pair[1].0 - pair[0].0) * (pair[0].1 + pair[1].1) / 2.0).sum();
    let signals = || loading.iter().chain(unloading).map(|point| point.1);
    let scale = signals().fold(f64::MIN, f64::max) - signals().fold(f64::MAX, f64::min);
    require(scale > 0.0, "range of the signal", scale, "above 0")?;
    let largest = gaps.iter().map(|gap| gap.1.abs()).fold(0.0, f64::max);
    Ok(Hysteresis { area, area_fraction: area / (scale * (high - low)), largest_gap_fraction: largest / scale })
}

/// One branch, loads ascending.
struct Branch {
    points: Vec<(f64, f64)>,
}

impl Branch {
    fn new(what: &'static str, points: Vec<(f64, f64)>) -> Result<Self, TouchError> {
        if points.len() < 2 {
            return Err(TouchError::TooFewFrames { what, expected: 2, got: points.len() });
        }
        for (index, point) in points.iter().enumerate() {
            let value = point.0 + point.1;
            if !value.is_finite() {
                return Err(TouchError::NonFinite { what, index, value });
            }
        }
        if let Some(pair) = points.windows(2).find(|pair| pair[1].0 <= pair[0].0) {
            let expected = "loads that ascend while loading and descend while unloading";
            return Err(TouchError::Parameter { name: what, value: pair[1].0, expected });
        }
        Ok(Self { points })
    }

    fn first(&self) -> f64 {
        self.points[0].0
    }

    fn last(&self) -> f64 {
        self.points[self.points.len() - 1].0
    }

    /// Signal at a load within the branch.
    fn at(&self, load: f64) -> f64 {
        let right = self.points.partition_point(|point| point.0 < load).clamp(1, self.points.len() - 1);
        let ((x0, y0), (x1, y1)) = (self.points[right - 1], self.points[right]);
        y0 + (y1 - y0) * (load - x0) / (x1 - x0)
    }
}

/// Scatter of repeats of the same loads.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Repeatability {
    /// Pooled standard deviation of a single reading, in the signal's unit.
    pub std: f64,
    /// [`Repeatability::std`] over the range of the group means.
    pub std_fraction: f64,
    /// Largest difference between two readings of one load over the range of the group means.
    pub largest_spread_fraction: f64,
}

/// Repeatability of `groups`, each the repeated readings of one load.
///
/// # Errors
/// Fewer than 2 groups or 2 readings in a group, readings that are not finite, equal means.
pub fn repeatability(groups: &[Vec<f64>]) -> Result<Repeatability, TouchError> {
    require(groups.len() >= 2, "loads of a repeatability", groups.len() as f64, "at least 2")?;
    let (mut squares, mut freedom, mut spread) = (0.0, 0usize, 0.0_f64);
    let (mut low, mut high) = (f64::MAX, f64::MIN);
    for group in groups {
        if group.len() < 2 {
            return Err(TouchError::TooFewFrames { what: "repeats of a load", expected: 2, got: group.len() });
        }
        require_finite("repeats of a load", group)?;
        let (mean, std) = mean_std(group);
        squares += std * std * (group.len() - 1) as f64;
        freedom += group.len() - 1;
        (low, high) = (low.min(mean), high.max(mean));
        let largest = group.iter().fold(f64::MIN, |a, &b| a.max(b));
        spread = spread.max(largest - group.iter().fold(f64::MAX, |a, &b| a.min(b)));
    }
    require(high > low, "range of the loads' means", high - low, "above 0")?;
    let std = (squares / freedom as f64).sqrt();
    Ok(Repeatability { std, std_fraction: std / (high - low), largest_spread_fraction: spread / (high - low) })
}

/// Slow change of a signal under constant conditions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drift {
    /// Slope of the least-squares line, signal units per second.
    pub per_s: f64,
    /// Change of that line over the whole time, signal units.
    pub total: f64,
    /// Standard deviation about the line (divided by count - 2; NaN for two values).
    pub residual_std: f64,
}

/// Drift of a signal over time.
///
/// # Errors
/// Different lengths, fewer than 2 values, equal times, values that are not finite.
pub fn drift(times_s: &[f64], signal: &[f64]) -> Result<Drift, TouchError> {
    require_length("signal", times_s.len(), signal.len())?;
    require_finite("times_s", times_s)?;
    require_finite("signal", signal)?;
    let (intercept, per_s) = line(times_s, signal)?;
    let span = times_s.iter().fold(f64::MIN, |a, &b| a.max(b)) - times_s.iter().fold(f64::MAX, |a, &b| a.min(b));
    let squares: f64 = times_s.iter().zip(signal).map(|(t, v)| (v - intercept - per_s * t).powi(2)).sum();
    let freedom = (times_s.len() - 2) as f64;
    Ok(Drift { per_s, total: per_s * span, residual_std: (squares / freedom).sqrt() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loop_between_a_square_root_and_a_square() {
        // Loading x^2, unloading sqrt(x) on 0..1: area 2/3 - 1/3 of a full scale of 1 x 1.
        let up: Vec<(f64, f64)> = (0..=400).map(|i| f64::from(i) / 400.0).map(|x| (x, x * x)).collect();
        let down: Vec<(f64, f64)> = (0..=400).rev().map(|i| f64::from(i) / 400.0).map(|x| (x, x.sqrt())).collect();
        let result = hysteresis(&up, &down).unwrap();
        // Chords of 400 pieces: the first piece of the root misses (1/400)^1.5 / 6.
        assert!((result.area_fraction - 1.0 / 3.0).abs() < 1e-4, "{result:?}");
        // sqrt(x) - x^2 is largest at x = 4^(-2/3): 0.4725.
        assert!((result.largest_gap_fraction - 0.472_47).abs() < 1e-4, "{result:?}");
        assert!(
            (hysteresis(
                &down.iter().rev().copied().collect::<Vec<_>>(),
                &up.iter().rev().copied().collect::<Vec<_>>()
            )
            .unwrap()
            .area_fraction
                + 1.0 / 3.0)
                .abs()
                < 1e-4
        );
    }

    #[test]
    fn branches_with_other_loads_are_interpolated() {
        let result = hysteresis(&[(0.0, 0.0), (4.0, 8.0)], &[(4.0, 8.0), (1.0, 4.0), (0.0, 0.0)]).unwrap();
        // A triangle with base 4 and gap 2 at load 1.
        assert!((result.area - 4.0).abs() < 1e-14 && (result.area_fraction - 0.125).abs() < 1e-14);
        assert!((result.largest_gap_fraction - 0.25).abs() < 1e-14);
        assert!(hysteresis(&[(1.0, 0.0), (0.0, 1.0)], &[(1.0, 1.0), (0.0, 0.0)]).is_err());
        assert!(hysteresis(&[(0.0, 0.0), (1.0, 1.0)], &[(3.0, 1.0), (2.0, 0.0)]).is_err());
    }

    #[test]
    fn repeats_are_pooled() {
        // Deviations 1 and 2 about means 10 and 30, three and two readings: (2 * 1 + 1 * 8) / 3.
        let result = repeatability(&[vec![9.0, 10.0, 11.0], vec![28.0, 32.0]]).unwrap();
        assert!((result.std - (10.0_f64 / 3.0).sqrt()).abs() < 1e-14);
        assert!((result.largest_spread_fraction - 0.2).abs() < 1e-15);
        assert!(repeatability(&[vec![1.0], vec![2.0, 3.0]]).is_err());
    }

    #[test]
    fn drift_is_the_slope() {
        let result = drift(&[0.0, 1.0, 2.0, 3.0], &[1.0, 4.0, 5.0, 8.0]).unwrap();
        // Slope 2.2, residuals -0.2, 0.6, -0.6, 0.2: 0.8 / 2.
        assert!((result.per_s - 2.2).abs() < 1e-14 && (result.total - 6.6).abs() < 1e-13);
        assert!((result.residual_std - 0.4_f64.sqrt()).abs() < 1e-14);
        assert!(drift(&[1.0], &[1.0]).is_err() && drift(&[1.0, 1.0], &[1.0, 2.0]).is_err());
    }
}
