//! The noise of channels, measured over a few frames. A channel's own scatter gives its noise to within a quarter or
//! a third; all channels together give it to within a few percent.
//!
//! The channels of an instrument follow a common noise law, v = a + b L^2 with L the level of a channel's reading:
//! one part is the same for all, the other is proportional to the reading. The line is fitted to the variances s^2 of
//! all channels. Their logarithms scatter about it by trigamma(f / 2), since they are estimated with f degrees of
//! freedom; any excess is the true difference between channels. Each channel's logarithm is then the mean of its own
//! and the line's, weighted by the inverses of these two. This is an empirical Bayes estimate like that of G. K.
//! Smyth, Stat. Appl. Genet. Mol. Biol. 3 (2004), article 3, but about a trend, and normal in logarithms, since a few
//! channels may be far quieter than the others. A channel that is noisier than the others suggest keeps its own
//! estimate.

use dermis_touch::median;

use crate::frame_noise::{MEDIAN_TO_SIGMA, mean};

/// Number of frames averaged by a tare, and used to learn a live baseline.
pub const TARE_FRAMES: usize = 32;
/// Efficiency of a median absolute deviation: it is as precise as a standard deviation of this share of the values.
const MEDIAN_EFFICIENCY: f64 = 0.37;
/// Minimum number of channels for fitting a common law.
const FEWEST_CHANNELS: usize = 8;
/// Number of iterations of the weighted least squares that fit the line.
const ROUNDS: usize = 30;
/// Clip variances to this many of their standard deviations above the line.
const OUTLYING: f64 = 3.0;
/// A channel is noisy if its variance is too large to be expected by chance among this many times as many channels.
const CHANCE: f64 = 100.0;
/// If a channel's own estimate has more weight than this, the others have little to add, and each channel keeps its
/// own. Drift and what a gel remembers of presses cause such noise.
const MOST_OWN: f64 = 0.5;

/// Noise measured at rest.
#[derive(Clone, Copy, Debug)]
pub struct MeasuredNoise<'a> {
    /// Standard deviation of each channel, in the unit of the readings; `NaN` or zero if unknown.
    pub deviation: &'a [f64],
    /// Degrees of freedom of the variances: frames minus one if they are mean squares about the mean; fewer for other
    /// estimators.
    pub freedom: f64,
}

impl<'a> MeasuredNoise<'a> {
    /// Noise from median absolute deviations of the frames used to learn a live baseline
    /// ([`dermis_touch::Baseline::noise_std`]).
    pub fn of_start(deviation: &'a [f64]) -> Self {
        Self { deviation, freedom: MEDIAN_EFFICIENCY * (TARE_FRAMES - 1) as f64 }
    }

    /// The standard deviations, shrunk towards the common law, of channels that read `levels` at rest. Unknown ones
    /// are unchanged.
    pub(crate) fn moderated(&self, levels: &[f64]) -> Vec<f64> {
        let mut deviation = self.deviation.to_vec();
        let is_known = |channel: &usize| {
            let (sigma, level) = (self.deviation[*channel], levels[*channel]);
            sigma.is_finite() && sigma > 0.0 && level.is_finite()
        };
        let known: Vec<usize> = (0..deviation.len().min(levels.len())).filter(is_known).collect();
        if known.len() < FEWEST_CHANNELS || self.freedom < 1.0 {
            return deviation;
        }
        let variances: Vec<f64> = known.iter().map(|&channel| self.deviation[channel].powi(2)).collect();
        let squares: Vec<f64> = known.iter().map(|&channel| levels[channel].powi(2)).collect();
        let Some(line) = line(&variances, &squares, self.freedom) else { return deviation };
        let ratios: Vec<f64> = variances.iter().zip(&line).map(|(variance, line)| variance / line).collect();
        let own_scatter = trigamma(0.5 * self.freedom);
        let (offset, excess) = about_line(&ratios, own_scatter);
        let own = excess / (excess + own_scatter);
        if own > MOST_OWN {
            return deviation;
        }
        let most = largest_by_chance(CHANCE * known.len() as f64, self.freedom);
        for ((channel, ratio), line) in known.into_iter().zip(ratios).zip(line) {
            if ratio <= most {
                // The logarithm of an estimated variance is on average 1 / f below the true one's.
                let logarithm = own * ratio.ln() + (1.0 - own) * offset + 1.0 / self.freedom;
                deviation[channel] = (line * logarithm.exp()).sqrt();
            }
        }
        deviation
    }
}

/// a + b L^2 of each channel, both coefficients not negative: least squares weighted by the inverse variances of the
/// variances, which are proportional to the square of the line. `None` if the result is not positive.
fn line(variances: &[f64], squares: &[f64], freedom: f64) -> Option<Vec<f64>> {
    let scale = mean(squares);
    let most = 1.0 + OUTLYING * (2.0 / freedom).sqrt();
    let mut line = vec![mean(variances); variances.len()];
    for _ in 0..ROUNDS {
        let (mut s, mut sx, mut sxx, mut sy, mut sxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for ((variance, square), line) in variances.iter().zip(squares).zip(&line) {
            let (x, y, weight) = (square / scale.max(f64::MIN_POSITIVE), variance.min(most * line), line.powi(-2));
            s += weight;
            sx += weight * x;
            sxx += weight * x * x;
            sy += weight * y;
            sxy += weight * x * y;
        }
        let determinant = s * sxx - sx * sx;
        let (mut a, mut b) = ((sxx * sy - sx * sxy) / determinant, (s * sxy - sx * sy) / determinant);
        // Equal levels determine only one number.
        if determinant <= 1e-9 * s * sxx || b <= 0.0 {
            (a, b) = (sy / s, 0.0);
        } else if a <= 0.0 {
            (a, b) = (0.0, sxy / sxx);
        }
        for (line, square) in line.iter_mut().zip(squares) {
            *line = a + b * square / scale.max(f64::MIN_POSITIVE);
        }
        if !line.iter().all(|line| line.is_finite() && *line > 0.0) {
            return None;
        }
    }
    Some(line)
}

/// Median of the log ratios of the channels' variances to the line, and their excess scatter (a variance) beyond
/// their own estimation error.
fn about_line(ratios: &[f64], own_scatter: f64) -> (f64, f64) {
    let logarithms: Vec<f64> = ratios.iter().map(|ratio| ratio.ln()).collect();
    let middle = median(&logarithms);
    let scatter =
        (MEDIAN_TO_SIGMA * median(&logarithms.iter().map(|v| (v - middle).abs()).collect::<Vec<_>>())).powi(2);
    // A squared scatter from a median is uncertain by this amount; an excess of less than twice that counts as none.
    let sure = 2.0 * own_scatter * (2.0 / (MEDIAN_EFFICIENCY * ratios.len() as f64)).sqrt();
    let excess = scatter - own_scatter;
    (middle, if excess <= sure { 0.0 } else { excess })
}

/// Expected largest ratio of estimated to true variance among `count` channels, by the normal approximation of the
/// cube root of a chi-square (Wilson and Hilferty, 1931).
fn largest_by_chance(count: f64, freedom: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    (1.0 - spread + (2.0 * count.ln()).sqrt() * spread.sqrt()).powi(3)
}

/// The second derivative of ln Gamma, by its asymptotic series above 6 and the recurrence below.
fn trigamma(x: f64) -> f64 {
    let (mut x, mut below) = (x, 0.0);
    while x < 6.0 {
        below += x.powi(-2);
        x += 1.0;
    }
    let y = x.powi(-2);
    below + 1.0 / x + 0.5 * y + y / x * (1.0 / 6.0 - y * (1.0 / 30.0 - y / 42.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHANNELS: usize = 200;
    const FRAMES: usize = 16;

    /// Standard normal values by the Box-Muller transform of a linear congruential sequence.
    struct Normal(u64);

    impl Normal {
        fn uniform(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((self.0 >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
        }

        fn draw(&mut self) -> f64 {
            (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
        }
    }

    /// RMS of sixteen frames about their known mean, for channels with these standard deviations.
    fn measured(truth: &[f64], seed: u64) -> Vec<f64> {
        let mut normal = Normal(seed);
        let mut square = |sigma: f64| (0..FRAMES).map(|_| (sigma * normal.draw()).powi(2)).sum::<f64>();
        truth.iter().map(|sigma| (square(*sigma) / FRAMES as f64).sqrt()).collect()
    }

    fn moderated(deviation: &[f64], levels: &[f64]) -> Vec<f64> {
        MeasuredNoise { deviation, freedom: FRAMES as f64 }.moderated(levels)
    }

    /// RMS of the relative error.
    fn error(found: &[f64], truth: &[f64]) -> f64 {
        (found.iter().zip(truth).map(|(f, t)| (f / t - 1.0).powi(2)).sum::<f64>() / truth.len() as f64).sqrt()
    }

    fn levels() -> Vec<f64> {
        (0..CHANNELS).map(|channel| 10.0_f64.powf(-3.0 * channel as f64 / CHANNELS as f64)).collect()
    }

    #[test]
    fn pooling_channels_reduces_the_error_of_their_noise() {
        let levels = levels();
        let truth: Vec<f64> = levels.iter().map(|level| (1e-6_f64.powi(2) + (1e-4 * level).powi(2)).sqrt()).collect();
        let alone = measured(&truth, 1);
        // Each channel alone is known to within 1 / sqrt(2 * 16) = 18 %, the line to within a few percent.
        assert!(error(&alone, &truth) > 0.15, "{}", error(&alone, &truth));
        let together = moderated(&alone, &levels);
        assert!(error(&together, &truth) < 0.06, "{}", error(&together, &truth));
    }

    #[test]
    fn channels_that_differ_keep_their_own() {
        let mut normal = Normal(7);
        let truth: Vec<f64> = (0..CHANNELS).map(|_| 1e-5 * (1.5 * normal.draw()).exp()).collect();
        let alone = measured(&truth, 3);
        assert_eq!(moderated(&alone, &levels()), alone);
        // With a slight difference, both the channel and the others contribute.
        let truth: Vec<f64> = (0..CHANNELS).map(|_| 1e-5 * (0.12 * normal.draw()).exp()).collect();
        let alone = measured(&truth, 4);
        assert!(error(&moderated(&alone, &levels()), &truth) < 0.8 * error(&alone, &truth));
    }

    #[test]
    fn a_noisy_channel_stays_noisy_and_does_not_raise_the_others() {
        let mut truth = vec![1e-5; CHANNELS];
        truth[17] = 1e-3;
        let alone = measured(&truth, 5);
        let together = moderated(&alone, &levels());
        assert_eq!(together[17], alone[17]);
        let others =
            |values: &[f64]| values.iter().enumerate().filter(|v| v.0 != 17).map(|v| *v.1).collect::<Vec<f64>>();
        assert!(error(&others(&together), &others(&truth)) < 0.06, "{:?}", &together[..20]);
    }

    #[test]
    fn unknown_noise_stays_unknown() {
        let mut alone = measured(&vec![1e-5; CHANNELS], 9);
        (alone[3], alone[4]) = (f64::NAN, 0.0);
        let mut levels = levels();
        levels[5] = f64::NAN;
        let together = moderated(&alone, &levels);
        assert!(together[3].is_nan());
        assert_eq!((together[4], together[5]), (0.0, alone[5]));
        // Few channels, or levels or noise that are all zero, are left unchanged.
        assert_eq!(moderated(&alone[10..14], &levels[10..14]), alone[10..14]);
        assert_eq!(moderated(&[0.0; 20], &[1.0; 20]), [0.0; 20]);
        assert!(moderated(&alone[10..30], &[0.0; 20]).iter().all(|sigma| sigma.is_finite() && *sigma > 0.0));
    }

    /// pi^2 / 2 and pi^2 / 6 (Abramowitz and Stegun, 6.4.2 and 6.4.4).
    #[test]
    fn trigamma_has_its_known_values() {
        let square = std::f64::consts::PI.powi(2);
        assert!((trigamma(0.5) - square / 2.0).abs() < 1e-8);
        assert!((trigamma(1.0) - square / 6.0).abs() < 1e-8);
    }
}
