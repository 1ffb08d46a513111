//! Strength of touches compared with frames at rest.

use serde::{Deserialize, Serialize};

/// Share of the pokes that may be weaker than the weakest touch that counts.
const WEAK_SHARE: f64 = 0.02;
/// Quantile of frames at rest: this share is below the amplitude of rest, and above its standard deviation of
/// positions.
const REST_SHARE: f64 = 0.95;
/// A touch must exceed the upper bound of rest by the factor `ABOVE_REST`. If its position is precise, `BELOW_WEAK`
/// times the amplitude of weak pokes is enough.
const ABOVE_REST: f64 = 1.2;
const BELOW_WEAK: f64 = 0.7;
/// A frame no stronger than rest still shows a touch if its position is precise. Its standard deviation must be below
/// `BELOW_REST` times that of frames at rest, or `ABOVE_USUAL_ERROR` times the usual error of left-out pokes if that
/// is larger, and in any case below `BELOW_HALF_WIDTH` times half the shorter side. Noise resembles nothing in the
/// training data and could be anywhere; what a gel remembers of the last press may have a precise position.
const BELOW_REST: f64 = 0.5;
const ABOVE_USUAL_ERROR: f64 = 1.5;
const BELOW_HALF_WIDTH: f64 = 0.25;
/// Standard deviations above its mean that white noise stays below in `REST_SHARE` of the frames.
const SELDOM: f64 = 1.645;

/// A frame as seen by the locator.
#[derive(Clone, Copy, Debug)]
pub(super) struct Weighed {
    /// RMS of the frame, weighted as in the locator.
    pub amplitude: f64,
    /// Larger standard deviation of the coordinates of its position, metres.
    pub sigma_m: f64,
}

/// The noise of the frames in which touches are sought.
#[derive(Clone, Copy, Debug)]
pub(super) struct SessionNoise {
    /// RMS of the channels' standard deviations, weighted as in the locator.
    pub amplitude: f64,
    pub channels: usize,
    /// True if each frame has its own baseline, and the noise was measured from these.
    pub is_of_pairs: bool,
}

impl SessionNoise {
    /// The amplitude that the noise seldom exceeds. An RMS over c channels varies by 1 / sqrt(2 c) of itself.
    fn seldom(self) -> f64 {
        self.amplitude * (1.0 + SELDOM / (2.0 * self.channels as f64).sqrt())
    }
}

/// Amplitudes and standard deviations that separate a touch from rest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TouchStrength {
    /// Amplitude reached by all but the weakest pokes.
    pub weak: Option<f64>,
    /// Amplitude that frames at rest seldom reach, if there were frames at rest.
    pub rest: Option<f64>,
    /// Standard deviation of positions that frames at rest are seldom below, metres.
    #[serde(default)]
    pub rest_sigma_m: Option<f64>,
    /// True if amplitudes are in units of the channels' noise.
    #[serde(default)]
    pub in_noise: bool,
}

impl TouchStrength {
    /// Thresholds from the amplitudes of pokes, and from frames at rest.
    pub fn of(pokes: Vec<f64>, resting: &[Weighed], in_noise: bool) -> Self {
        let resting = |value: fn(&Weighed) -> f64| resting.iter().map(value).collect();
        Self {
            weak: quantile(pokes, WEAK_SHARE),
            rest: quantile(resting(|rest| rest.amplitude), REST_SHARE),
            rest_sigma_m: quantile(resting(|rest| rest.sigma_m), 1.0 - REST_SHARE),
            in_noise,
        }
    }

    /// The amplitudes below which a frame shows no touch. The basis is half the amplitude of weak pokes, or
    /// `hold_sigma` sigmas of the noise if that is less. It is raised above rest, both in the calibration's own
    /// frames and in the current session (`noise`, if known). The session's own rest decides alone if each frame has
    /// its own baseline: such frames do not remember earlier presses, and the calibration's baselines may have been
    /// far apart. If a frame has a precise position, the amplitude of weak pokes is enough, whatever rest reaches.
    /// `usual_error_m` is the error of left-out pokes, `half_width_m` half the shorter side of the skin.
    pub fn smallest(
        &self,
        hold_sigma: f64,
        noise: Option<SessionNoise>,
        usual_error_m: f64,
        half_width_m: f64,
    ) -> SmallestAmplitude {
        let weak = self.weak.unwrap_or(0.0);
        let usual = if self.in_noise { hold_sigma.min(0.5 * weak) } else { 0.5 * weak };
        let earlier = self.rest.filter(|_| noise.is_none_or(|noise| !noise.is_of_pairs)).unwrap_or(0.0);
        let rest = ABOVE_REST * earlier.max(noise.map_or(0.0, SessionNoise::seldom));
        // Without frames at rest, the precision of their positions is unknown.
        let placed_sigma_m = self.rest_sigma_m.map_or(f64::INFINITY, |rest_m| {
            (BELOW_REST * rest_m).max(ABOVE_USUAL_ERROR * usual_error_m).min(BELOW_HALF_WIDTH * half_width_m)
        });
        SmallestAmplitude { anywhere: usual.max(rest), placed: usual.max(rest.min(BELOW_WEAK * weak)), placed_sigma_m }
    }
}

/// Amplitudes below which a frame shows no touch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::calibration) struct SmallestAmplitude {
    /// Threshold for any position; noise does not reach it.
    pub anywhere: f64,
    /// Threshold for a frame with a precise position, which noise does not have.
    pub placed: f64,
    /// Larger standard deviation of the coordinates up to which a position is precise, metres.
    pub placed_sigma_m: f64,
}

impl SmallestAmplitude {
    /// True if a frame with this amplitude and larger standard deviation shows a touch.
    pub fn is_touch(&self, amplitude: f64, sigma_m: f64) -> bool {
        amplitude >= self.anywhere || (amplitude >= self.placed && sigma_m <= self.placed_sigma_m)
    }
}

/// The `share` quantile, one of the values; `None` for an empty list.
pub(super) fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    values.get((share * last as f64).round() as usize).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames at rest reach 0.9 to 1.1, and 1.32 is clearly above; their positions are known to within 10 mm.
    fn resting() -> Vec<Weighed> {
        (0..40_u32).map(|i| Weighed { amplitude: 0.9 + 0.005 * f64::from(i), sigma_m: 0.01 }).collect()
    }

    /// Amplitudes of forty pokes, six of them weak.
    fn pokes_of(weak: f64) -> Vec<f64> {
        (0..40).map(|i| if i < 6 { weak } else { 10.0 }).collect()
    }

    #[test]
    fn pokes_as_weak_as_rest_count_as_touches_where_they_are_placed() {
        let smallest = TouchStrength::of(pokes_of(1.0), &resting(), true).smallest(4.0, None, 0.0, 0.1);
        assert_eq!(smallest.placed, BELOW_WEAK);
        assert!(smallest.is_touch(1.0, 0.004) && !smallest.is_touch(1.0, 0.006), "{smallest:?}");
        assert!(smallest.is_touch(1.4, 0.1) && !smallest.is_touch(0.6, 0.001), "{smallest:?}");
        // A frame as precise as pokes usually are is a touch, even if frames at rest are as precise: those remember a
        // touch.
        let remembered = TouchStrength::of(pokes_of(1.0), &resting(), true).smallest(4.0, None, 0.006, 0.1);
        assert!(remembered.is_touch(1.0, 0.008) && !remembered.is_touch(1.0, 0.01), "{remembered:?}");
        // On a skin of 20 mm, a position known to within 4 mm is not precise.
        let small = TouchStrength::of(pokes_of(1.0), &resting(), true).smallest(4.0, None, 0.0, 0.01);
        assert!(!small.is_touch(1.0, 0.004), "{small:?}");
        let unknown = TouchStrength { rest_sigma_m: None, ..TouchStrength::of(pokes_of(1.0), &resting(), true) };
        assert!(unknown.smallest(4.0, None, 0.0, 0.01).is_touch(1.0, 0.1));
    }

    #[test]
    fn a_noisy_session_asks_for_more_up_to_what_weak_pokes_reach() {
        let strength = TouchStrength::of(vec![10.0; 40], &resting(), true);
        // Over 200 channels, noise seldom exceeds 1.08 times its usual amplitude.
        let noisy = |noise: f64| ABOVE_REST * noise * (1.0 + SELDOM / 20.0);
        let smallest = |noise: f64, is_of_pairs: bool| {
            let noise = SessionNoise { amplitude: noise, channels: 200, is_of_pairs };
            let smallest = strength.smallest(0.5, Some(noise), 0.0, 0.1);
            (smallest.anywhere, smallest.placed)
        };
        assert_eq!(smallest(4.0, false), (noisy(4.0), noisy(4.0)));
        assert_eq!(smallest(30.0, false), (noisy(30.0), BELOW_WEAK * 10.0));
        // Frames at rest reached 1.1 in the calibration, which frames with their own baselines need not exceed.
        assert!(smallest(0.8, false).0 > ABOVE_REST);
        assert_eq!(smallest(0.8, true), (noisy(0.8), noisy(0.8)));
    }

    #[test]
    fn without_frames_at_rest_all_pokes_count() {
        let strength = TouchStrength::of(vec![0.5, 4.0, 4.0, 4.0], &[], false);
        assert_eq!(strength, TouchStrength { weak: Some(0.5), ..TouchStrength::default() });
        let smallest = strength.smallest(4.0, None, 0.0, 0.1);
        assert_eq!((smallest.anywhere, smallest.placed), (0.25, 0.25));
    }
}
