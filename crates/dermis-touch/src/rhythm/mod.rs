//! Spectra of uniformly sampled series: of a pixel, of a touch's value, or of the mean of a frame.
//!
//! The window is the periodic Hann window `w_n = (1 - cos(2 pi n / N)) / 2`, applied after subtracting the series'
//! mean. The spectrum is one-sided and amplitude-correct: a sine of amplitude A at a bin's frequency has the value A.
//! Peaks are located by a parabola through the logarithms of the largest bin and its neighbours. Their amplitude is
//! the largest bin divided by the window's response at that offset from the bin.

use std::sync::Arc;

use realfft::{RealFftPlanner, RealToComplex};

use crate::error::{TouchError, require, require_finite, require_length};

/// Minimum length of a series.
const FEWEST_SAMPLES: usize = 8;

/// Number of bins on each side of a peak that belong to it: the main lobe of the Hann window.
const LOBE_BINS: usize = 2;

/// A one-sided amplitude spectrum.
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum {
    /// Frequency step between bins, hertz: sample rate over count.
    pub bin_hz: f64,
    /// Amplitude at 0, `bin_hz`, 2 `bin_hz` ... up to half the sample rate, in the series' unit.
    pub amplitudes: Vec<f64>,
    /// Mean of the series, which is not in the spectrum.
    pub mean: f64,
}

/// One peak of a spectrum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpectralPeak {
    /// Frequency, interpolated between bins, hertz.
    pub frequency_hz: f64,
    /// Amplitude of the sine, in the series' unit, interpolated.
    pub amplitude: f64,
    /// `20 log10(amplitude / noise)`, where noise is the median amplitude of the bins outside the lobes of all peaks
    /// found; infinite without noise.
    pub snr_db: f64,
}

/// Computes spectra of series of one length and sample rate. Keeps its plan and memory.
pub struct SpectrumAnalyser {
    sample_rate_hz: f64,
    window: Vec<f64>,
    plan: Arc<dyn RealToComplex<f64>>,
}

impl std::fmt::Debug for SpectrumAnalyser {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let samples = self.window.len();
        f.debug_struct("SpectrumAnalyser").field("samples", &samples).field("rate_hz", &self.sample_rate_hz).finish()
    }
}

impl SpectrumAnalyser {
    /// An analyser for series of `samples` values taken `sample_rate_hz` times per second.
    ///
    /// # Errors
    /// Fewer than 8 samples, a rate that is not positive and finite.
    pub fn new(samples: usize, sample_rate_hz: f64) -> Result<Self, TouchError> {
        require(samples >= FEWEST_SAMPLES, "samples", samples as f64, "at least 8")?;
        let ok = sample_rate_hz.is_finite() && sample_rate_hz > 0.0;
        require(ok, "sample_rate_hz", sample_rate_hz, "positive and finite")?;
        let phase = 2.0 * std::f64::consts::PI / samples as f64;
        let window = (0..samples).map(|n| 0.5 - 0.5 * (phase * n as f64).cos()).collect();
        let plan = RealFftPlanner::new().plan_fft_forward(samples);
        Ok(Self { sample_rate_hz, window, plan })
    }

    /// Spectrum of one series.
    ///
    /// # Errors
    /// [`TouchError::Length`], [`TouchError::NonFinite`].
    pub fn spectrum(&self, series: &[f64]) -> Result<Spectrum, TouchError> {
        let count = self.window.len();
        require_length("series", count, series.len())?;
        require_finite("series", series)?;
        let mean = series.iter().sum::<f64>() / count as f64;
        let mut input: Vec<f64> = series.iter().zip(&self.window).map(|(value, w)| (value - mean) * w).collect();
        let mut output = self.plan.make_output_vec();
        // Cannot fail: the lengths are the plan's own.
        let done = self.plan.process(&mut input, &mut output);
        require(done.is_ok(), "samples", count as f64, "a length that the transform takes")?;
        // The window's values sum to N / 2; a sine shares its amplitude with the negative frequency.
        let scale = 4.0 / count as f64;
        let mut amplitudes: Vec<f64> = output.iter().map(|value| scale * value.norm()).collect();
        amplitudes[0] /= 2.0;
        if count.is_multiple_of(2)
            && let Some(last) = amplitudes.last_mut()
        {
            *last /= 2.0;
        }
        Ok(Spectrum { bin_hz: self.sample_rate_hz / count as f64, amplitudes, mean })
    }

    /// Spectrum of each pixel (or channel, or touch) of `frames`, stored one after another with `width` values each.
    /// `None` for a series with a value that is not finite, as outside the skin.
    ///
    /// # Errors
    /// [`TouchError::Length`] if the frames are not `samples` times `width` values.
    pub fn per_pixel(&self, frames: &[f64], width: usize) -> Result<Vec<Option<Spectrum>>, TouchError> {
        let count = self.window.len();
        require_length("frames", count * width, frames.len())?;
        let series = |pixel: usize| -> Vec<f64> { (0..count).map(|frame| frames[frame * width + pixel]).collect() };
        Ok((0..width).map(|pixel| self.spectrum(&series(pixel)).ok()).collect())
    }

    /// Spectrum of the mean of each frame over its finite values.
    ///
    /// # Errors
    /// As [`SpectrumAnalyser::per_pixel`]; [`TouchError::NonFinite`] with the index of a frame without finite values.
    pub fn of_frame_mean(&self, frames: &[f64], width: usize) -> Result<Spectrum, TouchError> {
        require(width > 0, "width", 0.0, "at least 1")?;
        require_length("frames", self.window.len() * width, frames.len())?;
        let series: Vec<f64> = frames.chunks_exact(width).map(frame_mean).collect();
        self.spectrum(&series)
    }
}

/// Mean of the finite values; NaN without any.
#[must_use]
pub fn frame_mean(frame: &[f64]) -> f64 {
    let finite = frame.iter().filter(|value| value.is_finite());
    let (sum, count) = finite.fold((0.0, 0usize), |(sum, count), value| (sum + value, count + 1));
    sum / count as f64
}

impl Spectrum {
    /// Up to `most` peaks, largest first. Peaks are local maxima at bin 2 or above (slower ones cannot be
    /// distinguished from drift and offset), more than 2 bins from a larger one and `min_snr_db` above the noise.
    #[must_use]
    pub fn peaks(&self, most: usize, min_snr_db: f64) -> Vec<SpectralPeak> {
        let a = &self.amplitudes;
        let is_peak = |k: &usize| a[*k] > a[k - 1] && a[*k] >= a[k + 1];
        let mut order: Vec<usize> = (LOBE_BINS..a.len().saturating_sub(1)).filter(is_peak).collect();
        order.sort_by(|&left, &right| a[right].total_cmp(&a[left]));
        let mut found: Vec<usize> = Vec::new();
        for bin in order {
            if found.len() < most && found.iter().all(|&other| bin.abs_diff(other) > LOBE_BINS) {
                found.push(bin);
            }
        }
        let noise = self.noise_outside(&found);
        let peaks = found.iter().map(|&bin| self.refine(bin, noise));
        peaks.filter(|peak| peak.snr_db >= min_snr_db).collect()
    }

    /// Median amplitude of the bins outside the lobes of `peaks` and of zero frequency.
    fn noise_outside(&self, peaks: &[usize]) -> f64 {
        let outside = |bin: &usize| peaks.iter().all(|&peak| bin.abs_diff(peak) > LOBE_BINS);
        let mut rest: Vec<f64> =
            (LOBE_BINS..self.amplitudes.len()).filter(outside).map(|bin| self.amplitudes[bin]).collect();
        rest.sort_by(f64::total_cmp);
        rest.get(rest.len() / 2).copied().unwrap_or(0.0)
    }

    /// Interpolates a peak: frequency by the parabola through the logarithms of three bins, amplitude by the window's
    /// lobe at that shift.
    fn refine(&self, bin: usize, noise: f64) -> SpectralPeak {
        let logarithm = |k: usize| self.amplitudes[k].max(f64::MIN_POSITIVE).ln();
        let (left, middle, right) = (logarithm(bin - 1), logarithm(bin), logarithm(bin + 1));
        let curvature = left - 2.0 * middle + right;
        let shift = if curvature < 0.0 { (0.5 * (left - right) / curvature).clamp(-0.5, 0.5) } else { 0.0 };
        let amplitude = self.amplitudes[bin] / hann_lobe(shift);
        let snr_db = 20.0 * (amplitude / noise).log10();
        SpectralPeak { frequency_hz: (bin as f64 + shift) * self.bin_hz, amplitude, snr_db }
    }
}

/// Response of the window to a sine `shift` bins (at most 1/2) from a bin: `sinc(shift) / (1 - shift^2)`, the
/// transform of the Hann window for many samples.
fn hann_lobe(shift: f64) -> f64 {
    let angle = std::f64::consts::PI * shift;
    let sinc = if angle.abs() < 1e-6 { 1.0 } else { angle.sin() / angle };
    sinc / (1.0 - shift * shift)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn series(count: usize, rate: f64, value: impl Fn(f64) -> f64) -> Vec<f64> {
        (0..count).map(|n| value(n as f64 / rate)).collect()
    }

    #[test]
    fn a_sine_at_a_bin_has_its_amplitude_there_and_half_in_the_neighbours() {
        for count in [64, 75] {
            let analyser = SpectrumAnalyser::new(count, count as f64).unwrap();
            let spectrum =
                analyser.spectrum(&series(count, count as f64, |t| 5.0 + 3.0 * (TAU * 10.0 * t).sin())).unwrap();
            // The Hann window's transform is (1/4, 1/2, 1/4): the peak and two halves, nothing else.
            for (bin, amplitude) in spectrum.amplitudes.iter().enumerate() {
                let expected = match bin {
                    10 => 3.0,
                    9 | 11 => 1.5,
                    _ => 0.0,
                };
                assert!((amplitude - expected).abs() < 1e-12, "{count} {bin}: {amplitude}");
            }
            assert!((spectrum.mean - 5.0).abs() < 1e-12);
        }
    }

    #[test]
    fn two_rhythms_are_found_between_bins() {
        let (count, rate) = (320, 16.0);
        let value = |t: f64| 2.0 * (TAU * 1.013 * t).sin() + 0.4 * (TAU * 3.271 * t + 0.7).cos();
        let spectrum = SpectrumAnalyser::new(count, rate).unwrap().spectrum(&series(count, rate, value)).unwrap();
        let peaks = spectrum.peaks(2, 20.0);
        assert_eq!(peaks.len(), 2);
        // The parabola through the logarithms of a Hann lobe is off by less than 0.02 bins (of 0.05 Hz), hence the
        // amplitude by 1.5 %.
        for (peak, (frequency, amplitude)) in peaks.iter().zip([(1.013, 2.0), (3.271, 0.4)]) {
            assert!((peak.frequency_hz - frequency).abs() < 0.02 * 0.05, "{peak:?}");
            assert!((peak.amplitude / amplitude - 1.0).abs() < 0.015, "{peak:?}");
        }
    }

    #[test]
    fn pixels_and_frame_means_are_taken_apart() {
        let (count, rate, width) = (64, 32.0, 3);
        let frames: Vec<f64> = (0..count)
            .flat_map(|n| {
                let t = n as f64 / rate;
                [(TAU * 4.0 * t).sin(), f64::NAN, 3.0 * (TAU * 8.0 * t).sin()]
            })
            .collect();
        let analyser = SpectrumAnalyser::new(count, rate).unwrap();
        let spectra = analyser.per_pixel(&frames, width).unwrap();
        assert!(spectra[1].is_none());
        assert!((spectra[2].as_ref().unwrap().amplitudes[16] - 3.0).abs() < 1e-12);
        let mean = analyser.of_frame_mean(&frames, width).unwrap();
        assert!((mean.amplitudes[8] - 0.5).abs() < 1e-12 && (mean.amplitudes[16] - 1.5).abs() < 1e-12);
        assert!(analyser.of_frame_mean(&frames[1..], width).is_err());
    }

    #[test]
    fn bad_series_are_named() {
        assert!(SpectrumAnalyser::new(4, 1.0).is_err() && SpectrumAnalyser::new(16, 0.0).is_err());
        let analyser = SpectrumAnalyser::new(8, 1.0).unwrap();
        assert!(matches!(analyser.spectrum(&[0.0; 7]), Err(TouchError::Length { expected: 8, got: 7, .. })));
        assert!(analyser.spectrum(&[f64::NAN; 8]).is_err());
        assert!(analyser.spectrum(&[1.0; 8]).unwrap().peaks(3, 0.0).is_empty());
    }
}
