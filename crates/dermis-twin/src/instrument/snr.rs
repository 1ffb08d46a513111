//! The signal-to-noise ratio that paper H reports.

/// Paper H, eq. 5, of one channel: `10 log10(sum V^2 / sum (V - mean)^2)` over repeated readings of a skin at rest.
/// Infinite for readings that never change.
pub fn snr_db(readings: &[f64]) -> f64 {
    let mean = readings.iter().sum::<f64>() / readings.len() as f64;
    let power: f64 = readings.iter().map(|v| v * v).sum();
    let scatter: f64 = readings.iter().map(|v| (v - mean) * (v - mean)).sum();
    10.0 * (power / scatter).log10()
}

#[cfg(test)]
mod tests {
    #[test]
    fn snr_of_two_values() {
        // 3, 5: power 34, mean 4, scatter 2.
        assert!((super::snr_db(&[3.0, 5.0]) - 10.0 * 17.0_f64.log10()).abs() < 1e-12);
    }
}
