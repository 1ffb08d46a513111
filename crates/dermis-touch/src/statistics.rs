//! Medians, means, deviations, lines and spacings of values, and even choices of them.

use crate::error::{TouchError, require};

/// Median; the mean of the two middle values for an even number, NaN for none.
///
/// ```
/// assert_eq!(dermis_touch::median(&[3.0, 1.0, 2.0, 10.0]), 2.5);
/// assert!(dermis_touch::median(&[]).is_nan());
/// ```
pub fn median(values: &[f64]) -> f64 {
    median_in_place(&mut values.to_vec())
}

/// At most `most` of `count` indices, evenly spread.
///
/// ```
/// assert_eq!(dermis_touch::evenly(10, 3), [0, 3, 6]);
/// assert_eq!(dermis_touch::evenly(2, 3), [0, 1]);
/// ```
pub fn evenly(count: usize, most: usize) -> Vec<usize> {
    let kept = count.min(most);
    (0..kept).map(|i| i * count / kept).collect()
}

/// As [`median`], without a copy: sorts `values`.
pub(crate) fn median_in_place(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => values[n / 2],
        n => 0.5 * (values[n / 2 - 1] + values[n / 2]),
    }
}

/// Median distance from a position to its nearest neighbour, over at most 200 of them: the step of a lattice.
pub(crate) fn spacing(places_m: &[[f64; 2]]) -> f64 {
    let sampled = places_m.len().min(200);
    let nearest = |s: usize| {
        let here = places_m[s * places_m.len() / sampled];
        let d2 = places_m.iter().map(|q| (q[0] - here[0]).powi(2) + (q[1] - here[1]).powi(2)).filter(|d| *d > 0.0);
        d2.fold(f64::INFINITY, f64::min).sqrt()
    };
    median(&(0..sampled).map(nearest).collect::<Vec<_>>())
}

/// Ratio of a Gaussian's standard deviation to its median absolute deviation, 1 / Phi^-1(3/4).
const MAD_TO_STD: f64 = 1.482_602_218_505_602;
/// Ratio of a Gaussian's standard deviation to its mean absolute deviation, sqrt(pi/2).
const MEAN_DEVIATION_TO_STD: f64 = 1.253_314_137_315_500_3;

/// Mean of the values within three robust standard deviations of the median, and that standard deviation.
///
/// If more than half of the values are equal (coarse quantisation), the standard deviation comes from the mean
/// absolute deviation instead (Iglewicz and Hoaglin, *How to Detect and Handle Outliers*, 1993). NaN without values.
pub(crate) fn robust_mean_and_std(values: impl Iterator<Item = f64>, sorted: &mut Vec<f64>) -> (f64, f64) {
    sorted.clear();
    sorted.extend(values.filter(|value| value.is_finite()));
    if sorted.is_empty() {
        return (f64::NAN, f64::NAN);
    }
    let centre = median_in_place(sorted);
    // From here on the buffer holds deviations, sorted by size.
    for value in sorted.iter_mut() {
        *value -= centre;
    }
    sorted.sort_unstable_by(|a, b| a.abs().total_cmp(&b.abs()));
    let middle = sorted.len() / 2;
    let below = if sorted.len() % 2 == 1 { middle } else { middle - 1 };
    let median_deviation = 0.5 * (sorted[below].abs() + sorted[middle].abs());
    let mean_deviation = sorted.iter().map(|deviation| deviation.abs()).sum::<f64>() / sorted.len() as f64;
    let robust = MAD_TO_STD * median_deviation;
    let std = if robust > 0.0 { robust } else { MEAN_DEVIATION_TO_STD * mean_deviation };
    let kept = sorted.iter().filter(|deviation| deviation.abs() <= 3.0 * std);
    let (sum, count) = kept.fold((0.0, 0.0), |(sum, count), deviation| (sum + deviation, count + 1.0));
    (centre + if count > 0.0 { sum / count } else { 0.0 }, std)
}

/// Least-squares line `intercept + slope x`: (intercept, slope).
pub(crate) fn line(x: &[f64], y: &[f64]) -> Result<(f64, f64), TouchError> {
    let count = x.len() as f64;
    require(x.len() >= 2, "points of a line", count, "at least 2")?;
    let (mean_x, mean_y) = (x.iter().sum::<f64>() / count, y.iter().sum::<f64>() / count);
    let square: f64 = x.iter().map(|x| (x - mean_x).powi(2)).sum();
    require(square > 0.0, "spread of a line's abscissas", square, "above 0: they are all equal")?;
    let slope = x.iter().zip(y).map(|(x, y)| (x - mean_x) * (y - mean_y)).sum::<f64>() / square;
    Ok((mean_y - slope * mean_x, slope))
}

/// Mean and sample standard deviation; the deviation of fewer than two values is NaN.
pub(crate) fn mean_std(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let square: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (mean, if values.len() < 2 { f64::NAN } else { (square / (count - 1.0)).sqrt() })
}
