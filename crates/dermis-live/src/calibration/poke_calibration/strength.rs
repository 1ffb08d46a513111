//! How strong touches are, against frames at rest.

use serde::{Deserialize, Serialize};

/// The part of the pokes that may be weaker than the weakest touch that counts.
const WEAK_SHARE: f64 = 0.02;
/// The part of the frames at rest that stay below the amplitude of rest.
const REST_SHARE: f64 = 0.95;
/// A touch is so many times stronger than the noise at rest, than what frames at rest seldom reach; and weak pokes are
/// so much stronger than the weakest touch that counts, whatever rest does.
const ABOVE_REST: f64 = 1.6;
const ABOVE_RECORDED_REST: f64 = 1.2;
const BELOW_WEAK: f64 = 0.7;

/// Amplitudes (root mean squares of frames weighted as the locator does) that tell a touch from rest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TouchStrength {
    /// What all but the weakest pokes reach.
    pub weak: Option<f64>,
    /// What frames at rest seldom reach, where there were frames at rest.
    pub rest: Option<f64>,
    /// Whether amplitudes are in units of the channels' noise.
    #[serde(default)]
    pub in_noise: bool,
}

impl TouchStrength {
    /// Of the amplitudes of pokes and of frames at rest.
    pub fn of(pokes: Vec<f64>, resting: Vec<f64>, in_noise: bool) -> Self {
        Self { weak: quantile(pokes, WEAK_SHARE), rest: quantile(resting, REST_SHARE), in_noise }
    }

    /// Of the amplitudes of pokes alone; all of them count as touches.
    pub fn of_all(pokes: Vec<f64>) -> Self {
        Self { weak: quantile(pokes, 0.0), rest: None, in_noise: true }
    }

    /// The amplitude below which a frame shows no touch: half of the weakest pokes, or less where that many sigmas of
    /// the noise (`hold_sigma`) are less; but more than rest reaches, in the calibration's own frames and in the session
    /// at hand (`noise`: the amplitude of its noise, where it is known). Unless `is_beside_model`, what weak pokes reach
    /// is enough, whatever rest does.
    pub fn smallest(&self, hold_sigma: f64, noise: Option<f64>, is_beside_model: bool) -> f64 {
        let weak = self.weak.unwrap_or(0.0);
        let usual = if self.in_noise { hold_sigma.min(0.5 * weak) } else { 0.5 * weak };
        let session = noise.map_or(0.0, |noise| ABOVE_REST * noise);
        let rest = self.rest.map_or(0.0, |rest| ABOVE_RECORDED_REST * rest).max(session);
        let enough = if is_beside_model { f64::INFINITY } else { BELOW_WEAK * weak };
        usual.max(rest.min(enough))
    }
}

/// The `share` quantile, a value that is there; `None` of nothing.
fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    values.get((share * last as f64).round() as usize).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames at rest reach 0.9 to 1.1, and 1.32 stands clear of that.
    fn resting() -> Vec<f64> {
        (0..40_u32).map(|i| 0.9 + 0.005 * f64::from(i)).collect()
    }

    #[test]
    fn pokes_as_weak_as_rest_count_as_touches_unless_the_model_sees_the_others() {
        let pokes = (0..40).map(|i| if i < 6 { 1.0 } else { 10.0 }).collect::<Vec<f64>>();
        let smallest = |beside| TouchStrength::of(pokes.clone(), resting(), true).smallest(4.0, None, beside);
        assert_eq!(smallest(false), BELOW_WEAK);
        assert!(smallest(true) > 1.2, "{}", smallest(true));
    }

    #[test]
    fn a_noisy_session_asks_for_more_up_to_what_weak_pokes_reach() {
        let strength = TouchStrength::of(vec![10.0; 40], resting(), true);
        assert_eq!(strength.smallest(4.0, Some(3.0), false), ABOVE_REST * 3.0);
        assert_eq!(strength.smallest(4.0, Some(30.0), false), BELOW_WEAK * 10.0);
        // What the model does not see is no touch, unless it stands clear of the noise.
        assert_eq!(strength.smallest(4.0, Some(30.0), true), ABOVE_REST * 30.0);
    }

    #[test]
    fn without_frames_at_rest_all_pokes_count() {
        let strength = TouchStrength::of(vec![0.5, 4.0, 4.0, 4.0], Vec::new(), false);
        assert_eq!(strength, TouchStrength { weak: Some(0.5), rest: None, in_noise: false });
        assert_eq!(strength.smallest(4.0, None, false), 0.25);
    }
}
