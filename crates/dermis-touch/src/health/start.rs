//! Checks at the baseline: channels that were broken from the start, and the reference for later frames.

use super::monitor::{FEWEST_TOGETHER, HealthMonitor};
use super::{ChannelFaultKind, HealthParams};
use crate::error::{TouchError, require_length};
use crate::statistics::median;

/// Noise beyond this many times the median channel's and `NOISE_SHARE` of the largest resting value is a fault, not
/// instrument noise.
const NOISE_RATIO: f64 = 10.0;
const NOISE_SHARE: f64 = 0.05;
/// Model values below this share of the largest cannot show whether a channel is dead.
const LEAST_SHARE: f64 = 0.02;

/// The reference that frames are compared with. One value per channel.
#[derive(Debug, Clone, Copy)]
pub struct HealthReference<'a> {
    /// Resting values, model volts.
    pub rest: &'a [f64],
    /// Standard deviation of a reading, model volts.
    pub deviation: &'a [f64],
    /// Resting values in the unit of the readings; empty to skip the check of whole frames.
    pub readings: &'a [f64],
    /// Standard deviation of `readings`, in the unit of the readings.
    pub readings_deviation: &'a [f64],
    /// Standard deviation of the residual that the other channels leave unexplained, model volts, if it is computed.
    pub unexplained: Option<&'a [f64]>,
}

impl HealthMonitor {
    /// Looks for channels that are broken while the baseline is taken. `baseline` and `noise` are as measured (NaN if
    /// missing), `expected` is from the model in any unit. Broken channels are declared as of frame `at`.
    ///
    /// # Errors
    /// [`TouchError::Length`].
    pub fn check_start(
        &mut self,
        at: (u64, u64),
        baseline: &[f64],
        noise: &[f64],
        expected: &[f64],
    ) -> Result<(), TouchError> {
        let count = self.channels.len();
        for (what, got) in [("baseline", baseline), ("noise", noise), ("expected values", expected)] {
            require_length(what, count, got.len())?;
        }
        let largest = finite(expected).fold(0.0, f64::max);
        let largest_read = finite(baseline).fold(0.0, f64::max);
        let usual_noise = median(&finite(noise).collect::<Vec<_>>());
        let telling = |c: usize| expected[c].abs() > LEAST_SHARE * largest;
        let gains = (0..count).filter(|&c| telling(c)).map(|c| baseline[c].abs() / expected[c].abs());
        let gain = median(&gains.filter(|gain| gain.is_finite()).collect::<Vec<_>>());
        let usual_repeats = median(&self.channels.iter().map(|state| state.repeat_share()).collect::<Vec<_>>());
        let gone = |c: usize| baseline[c].abs() <= self.params.dead_share * gain * expected[c].abs();
        let dead = dead_together(&self.wiring.groups, &self.params, telling, gone);
        for channel in 0..count {
            let stuck = self.channels[channel].never_moved() && usual_repeats < 0.5;
            let wild = noise[channel] > NOISE_RATIO * usual_noise && noise[channel] > NOISE_SHARE * largest_read;
            let kind = if !baseline[channel].is_finite() {
                ChannelFaultKind::Missing
            } else if stuck && baseline[channel].abs() >= largest_read {
                ChannelFaultKind::Saturated
            } else if stuck {
                ChannelFaultKind::Stuck
            } else if dead[channel] {
                ChannelFaultKind::Dead
            } else if wild {
                ChannelFaultKind::Noisy
            } else {
                continue;
            };
            self.channels[channel].bad.get_or_insert((kind, at.0, at.1));
            self.channels[channel].clean = 0;
        }
        self.conclude();
        Ok(())
    }

    /// Sets the reference for later frames.
    ///
    /// # Errors
    /// [`TouchError::Length`].
    pub fn begin(&mut self, reference: &HealthReference<'_>) -> Result<(), TouchError> {
        let count = self.channels.len();
        require_length("resting values", count, reference.rest.len())?;
        require_length("deviations", count, reference.deviation.len())?;
        require_length("unexplained deviations", count, reference.unexplained.map_or(count, <[f64]>::len))?;
        if !reference.readings.is_empty() {
            require_length("resting readings", count, reference.readings.len())?;
            require_length("deviations of readings", count, reference.readings_deviation.len())?;
            self.frame.begin(reference.readings, reference.readings_deviation);
        }
        self.restart(reference.rest, reference.deviation, reference.unexplained);
        Ok(())
    }
}

/// Channels whose signal has vanished together with most of a group.
fn dead_together(
    groups: &[Vec<u32>],
    params: &HealthParams,
    telling: impl Fn(usize) -> bool,
    gone: impl Fn(usize) -> bool,
) -> Vec<bool> {
    let count = groups.iter().flatten().map(|&c| c as usize + 1).max().unwrap_or(0);
    let mut dead = vec![false; count];
    for group in groups {
        let members: Vec<usize> = group.iter().map(|&c| c as usize).filter(|&c| telling(c)).collect();
        let silent = members.iter().filter(|&&c| gone(c)).count();
        if members.len() >= FEWEST_TOGETHER && silent as f64 >= params.dead_agreement * members.len() as f64 {
            // Channels that the model expects to be small are dead with the rest of their group.
            group.iter().map(|&c| c as usize).filter(|&c| !telling(c) || gone(c)).for_each(|c| dead[c] = true);
        }
    }
    dead
}

fn finite(values: &[f64]) -> impl Iterator<Item = f64> + '_ {
    values.iter().map(|v| v.abs()).filter(|v| v.is_finite())
}
