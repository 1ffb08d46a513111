//! Robust mean and standard deviation of values with outliers.

use crate::typical::median_in_place;

/// Ratio of a Gaussian's standard deviation to its median absolute deviation, 1 / Phi^-1(3/4).
const MAD_TO_STD: f64 = 1.482_602_218_505_602;
/// Ratio of a Gaussian's standard deviation to its mean absolute deviation, sqrt(pi/2).
const MEAN_DEVIATION_TO_STD: f64 = 1.253_314_137_315_500_3;

/// Mean of the values within three robust standard deviations of the median, and that standard deviation.
///
/// If more than half of the values are equal (coarse quantisation), the standard deviation comes from the mean
/// absolute deviation instead (Iglewicz and Hoaglin, *How to Detect and Handle Outliers*, 1993). NaN without values.
pub(super) fn robust_mean_and_std(values: impl Iterator<Item = f64>, sorted: &mut Vec<f64>) -> (f64, f64) {
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
