//! Signal-to-noise ratios as defined in two papers of the field, and the noise that yields a given value of the
//! second.

/// Signal-to-noise ratio of one channel as a ratio of powers: `10 log10(sum V^2 / sum (V - mean)^2)` over repeated
/// readings of a skin at rest. Infinite for constant readings.
pub fn snr_db(readings: &[f64]) -> f64 {
    let mean = readings.iter().sum::<f64>() / readings.len() as f64;
    let power: f64 = readings.iter().map(|v| v * v).sum();
    let scatter: f64 = readings.iter().map(|v| (v - mean) * (v - mean)).sum();
    10.0 * (power / scatter).log10()
}

/// Expected signal-to-noise ratio as printed for the ionic skins, `(1/N) sum 10 log10(mean V / std V)` over K frames,
/// for noise with these standard deviations. It is ten times the logarithm of an amplitude ratio.
///
/// The logarithm of a sample's standard deviation is biased: `E ln(s / sd) = (psi(n/2) - ln(n/2)) / 2` with n = K -
/// 1, here computed from its series `-1/(2 n) - 1/(6 n^2)`.
pub fn expected_ionic_snr_db(voltages_v: &[f64], deviation_v: impl Fn(f64) -> f64, frames: usize) -> f64 {
    let logarithms = voltages_v.iter().map(|v| (v.abs() / deviation_v(*v)).log10()).sum::<f64>();
    10.0 * (logarithms / voltages_v.len() as f64 - deviation_bias(frames) / std::f64::consts::LN_10)
}

/// The noise floor (volts) at which [`expected_ionic_snr_db`] of these noiseless voltages is `target_db`, in addition
/// to noise proportional to the voltage. Found by bisection. `None` if the proportional noise alone is too large, a
/// voltage is 0 or not finite, or there are fewer than 2 frames.
pub fn floor_for_ionic_snr_v(voltages_v: &[f64], target_db: f64, frames: usize, proportional: f64) -> Option<f64> {
    let usable = voltages_v.iter().all(|v| v.is_finite() && *v != 0.0) && !voltages_v.is_empty() && frames >= 2;
    if !usable || !target_db.is_finite() {
        return None;
    }
    let at = |floor: f64| expected_ionic_snr_db(voltages_v, |v| floor.hypot(proportional * v), frames);
    // Without proportional noise there is a closed form, which is an upper bound of the floor.
    let mean_log = voltages_v.iter().map(|v| v.abs().ln()).sum::<f64>() / voltages_v.len() as f64;
    let closed = (mean_log - deviation_bias(frames) - target_db / 10.0 * std::f64::consts::LN_10).exp();
    if proportional == 0.0 {
        return Some(closed);
    }
    if at(0.0) < target_db {
        return None;
    }
    let (mut low, mut high) = (0.0, closed);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if at(middle) > target_db { low = middle } else { high = middle }
    }
    Some(0.5 * (low + high))
}

/// Expected logarithm of the ratio of a sample's standard deviation to the true one.
fn deviation_bias(frames: usize) -> f64 {
    let n = frames as f64 - 1.0;
    -0.5 / n - 1.0 / (6.0 * n * n)
}

#[cfg(test)]
mod tests {
    #[test]
    fn snr_of_two_values() {
        // 3, 5: power 34, mean 4, scatter 2.
        assert!((super::snr_db(&[3.0, 5.0]) - 10.0 * 17.0_f64.log10()).abs() < 1e-12);
    }
}
