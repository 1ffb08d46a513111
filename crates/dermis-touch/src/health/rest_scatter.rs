//! Channels that are unsteady while nothing touches the skin. Loose contacts of a torn sheet jump, and a channel
//! whose noise has grown since calibration can no longer be trusted.

use crate::statistics::median;

/// Minimum number of resting frames.
pub const FEWEST_AT_REST: usize = 8;
/// A channel jumps if its standard deviation is this many times the robust one. The ratio is 0.8 for drift and 1 for
/// Gaussian noise.
const JUMPS: f64 = 2.5;
/// A channel that jumps in this share of a session is unsound.
const OFTEN: f64 = 0.5;
/// Frames per piece of a session.
const PIECE: usize = 15;
/// Noise has grown if it is this many times its earlier value.
const GROWN: f64 = 2.5;
/// If more than this share of the channels would be unsound, the skin normally rests this way.
const MOST_LEFT_OUT: f64 = 0.8;
/// Ratio of a Gaussian's standard deviation to its median absolute deviation.
const GAUSSIAN: f64 = 1.4826;

/// Scatter of each channel over resting frames, in their unit.
#[derive(Debug, Clone, PartialEq)]
pub struct RestScatter {
    /// Share of the session in which each channel jumps.
    jumping: Vec<f64>,
    robust: Vec<f64>,
}

impl RestScatter {
    /// Measures the scatter of frames of the untouched skin, all of one length; NaN where missing. `None` for fewer
    /// than [`FEWEST_AT_REST`] frames. The session is divided into pieces of about 15 frames, so that slow changes of
    /// the skin do not count as noise.
    pub fn of(frames: &[Vec<f64>]) -> Option<Self> {
        let channels = frames.first().filter(|_| frames.len() >= FEWEST_AT_REST)?.len();
        let pieces = (frames.len() / PIECE).max(1);
        let piece = |k: usize| &frames[k * frames.len() / pieces..(k + 1) * frames.len() / pieces];
        let of_channel = |channel: usize| {
            let (mut jumping, mut squares) = (0, 0.0);
            for k in 0..pieces {
                let [deviation, robust] = scatter(piece(k).iter().filter_map(|frame| frame.get(channel).copied()));
                jumping += usize::from(deviation > JUMPS * robust);
                squares += robust * robust;
            }
            (jumping as f64 / pieces as f64, (squares / pieces as f64).sqrt())
        };
        let (jumping, robust) = (0..channels).map(of_channel).unzip();
        Some(Self { jumping, robust })
    }

    /// Standard deviation of each channel without jumps; NaN where it has no readings.
    pub fn robust(&self) -> &[f64] {
        &self.robust
    }

    /// Channels that jump, or whose scatter is well above `usual` (the value of [`RestScatter::robust`] at
    /// calibration). Empty if nearly all channels qualify, since the cause is then not the channels.
    pub fn unsound(&self, usual: Option<&[f64]>) -> Vec<u32> {
        let usual = usual.filter(|usual| usual.len() == self.robust.len());
        let has_grown = |c: usize| usual.is_some_and(|usual| usual[c] > 0.0 && self.robust[c] > GROWN * usual[c]);
        let found: Vec<u32> =
            (0..self.robust.len()).filter(|&c| self.jumping[c] >= OFTEN || has_grown(c)).map(|c| c as u32).collect();
        if found.len() as f64 > MOST_LEFT_OUT * self.robust.len() as f64 { Vec::new() } else { found }
    }
}

/// Standard deviation and robust standard deviation of the finite values; NaN for fewer than two.
fn scatter(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let values: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let deviation = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0)).sqrt();
    let middle = median(&values);
    [deviation, GAUSSIAN * median(&values.iter().map(|v| (v - middle).abs()).collect::<Vec<_>>())]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sum of twelve uniform numbers: nearly Gaussian, standard deviation 1.
    fn noise(seed: u64) -> f64 {
        let uniform = |k: u64| {
            let hash = (seed * 31 + k).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            ((hash ^ hash >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40) as f64 / f64::from(1 << 24)
        };
        (0..12).map(uniform).sum::<f64>() - 6.0
    }

    /// Twenty frames of seven channels: noise, noise with jumps, drift, six times the noise, constant, never read,
    /// and noise like the first.
    fn frames() -> Vec<Vec<f64>> {
        (0..20)
            .map(|k: u64| {
                let jump = if k == 7 || k == 13 { 40.0 } else { 0.0 };
                let [a, b, c, d, e] = [0, 1, 2, 3, 4].map(|channel| noise(100 * channel + k));
                vec![a, b + jump, 0.1 * c + k as f64, 6.0 * d, 5.0, f64::NAN, e]
            })
            .collect()
    }

    #[test]
    fn channels_that_jump_or_grew_noisy_are_unsound_and_drifting_ones_are_not() {
        let scatter = RestScatter::of(&frames()).unwrap();
        assert_eq!(scatter.unsound(None), [1]);
        let usual = [1.0, 1.0, 7.0, 1.0, 0.0, 1.0, 1.0];
        assert_eq!(scatter.unsound(Some(&usual)), [1, 3]);
        // A uniform drift over 20 has a median absolute deviation of 5. The robust deviation of 20 Gaussian samples
        // is 1 +- 0.25.
        assert!((scatter.robust()[2] / (GAUSSIAN * 5.0) - 1.0).abs() < 0.05, "{:?}", scatter.robust());
        assert!((0.6..1.6).contains(&scatter.robust()[0]) && scatter.robust()[5].is_nan(), "{:?}", scatter.robust());
    }

    #[test]
    fn a_step_between_two_sessions_is_no_noise() {
        let step = |k: u64| if k < 15 { 0.0 } else { 50.0 };
        let scatter = RestScatter::of(&(0..30).map(|k| vec![noise(k) + step(k)]).collect::<Vec<_>>()).unwrap();
        assert!(scatter.unsound(None).is_empty() && scatter.robust()[0] < 2.0, "{scatter:?}");
    }

    #[test]
    fn few_frames_prove_no_fault_and_channels_are_not_all_excluded() {
        assert!(RestScatter::of(&frames()[..7]).is_none() && RestScatter::of(&[]).is_none());
        let scatter = RestScatter::of(&frames()).unwrap();
        assert!(scatter.unsound(Some(&[1e-6; 7])).len() <= 5);
        let all = RestScatter::of(&frames().into_iter().map(|f| vec![f[1], f[1]]).collect::<Vec<_>>()).unwrap();
        assert!(all.unsound(None).is_empty());
        assert!(scatter.unsound(Some(&[1e-6; 3])) == [1], "a list of another length is none");
    }
}
