//! Small measures of series that the experiments need: a spectrum and the area of a hysteresis loop.

use std::f64::consts::TAU;

/// Amplitude spectrum of a uniformly sampled series, its mean removed, under a Hann window: (frequency, amplitude) from
/// 0 to half the rate. A sine of amplitude A on a line of the spectrum shows as A.
pub(super) fn spectrum(series: &[f64], rate_hz: f64) -> Vec<[f64; 2]> {
    let count = series.len();
    let mean = series.iter().sum::<f64>() / count.max(1) as f64;
    let window = |k: usize| 0.5 * (1.0 - (TAU * k as f64 / count as f64).cos());
    let windowed: Vec<f64> = series.iter().enumerate().map(|(k, v)| (v - mean) * window(k)).collect();
    let line = |index: usize| {
        let turn = TAU * index as f64 / count as f64;
        let (real, imaginary) = windowed.iter().enumerate().fold((0.0, 0.0), |(re, im), (k, v)| {
            let angle = turn * k as f64;
            (re + v * angle.cos(), im - v * angle.sin())
        });
        // The window's mean is one half, a sine's share in one line is one half.
        [rate_hz * index as f64 / count as f64, 4.0 * real.hypot(imaginary) / count as f64]
    };
    (0..=count / 2).map(line).collect()
}

/// Frequency of the largest line, refined by the parabola through it and its neighbours.
pub(super) fn largest_line_hz(spectrum: &[[f64; 2]]) -> f64 {
    let inner = 1..spectrum.len().saturating_sub(1);
    let Some(peak) = inner.max_by(|&a, &b| spectrum[a][1].total_cmp(&spectrum[b][1])) else { return f64::NAN };
    let [low, here, high] = [peak - 1, peak, peak + 1].map(|k| spectrum[k][1]);
    let curvature = low - 2.0 * here + high;
    let shift = if curvature < 0.0 { 0.5 * (low - high) / curvature } else { 0.0 };
    spectrum[peak][0] + shift * (spectrum[1][0] - spectrum[0][0])
}

/// Area between loading and unloading over the area of the box that both fill: the loop's share of full scale. Both by
/// rising force, points (force, signal).
pub(super) fn loop_share(loading: &[[f64; 2]], unloading: &[[f64; 2]]) -> f64 {
    let area =
        |points: &[[f64; 2]]| points.windows(2).map(|p| 0.5 * (p[1][1] + p[0][1]) * (p[1][0] - p[0][0])).sum::<f64>();
    let all = || loading.iter().chain(unloading);
    let extent = |axis: usize| {
        let (low, high) = all().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p[axis]), h.max(p[axis])));
        high - low
    };
    (area(unloading) - area(loading)).abs() / (extent(0) * extent(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sine_shows_its_frequency_and_amplitude() {
        let rate = 16.0;
        for frequency in [1.0, 2.53, 7.5] {
            let series: Vec<f64> =
                (0..256).map(|k| 3.0 + 0.2 * (TAU * frequency * f64::from(k) / rate).sin()).collect();
            let lines = spectrum(&series, rate);
            // A Hann window's main lobe is nearly a parabola: a tenth of a line, 6 mHz.
            assert!((largest_line_hz(&lines) - frequency).abs() < 6e-3, "{}", largest_line_hz(&lines));
            let amplitude = lines.iter().map(|line| line[1]).fold(0.0, f64::max);
            assert!(amplitude > 0.84 * 0.2 && amplitude < 1.01 * 0.2, "{amplitude}");
        }
    }

    #[test]
    fn the_loop_of_a_square_path_is_known() {
        // Up along the diagonal, down along the upper edge: half of the box.
        let up = [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]];
        let down = [[0.0, 2.0], [1.0, 2.0], [2.0, 2.0]];
        assert!((loop_share(&up, &down) - 0.5).abs() < 1e-12);
        assert_eq!(loop_share(&up, &up), 0.0);
    }
}
