//! The skin at rest. A suspicion may be a touch that was in the reference and is now gone. And if the skin has rested
//! for long enough at values other than its baseline's, a new baseline is proposed, but never adopted automatically.

use dermis_touch::Baseline;
use dermis_touch::damage::{Damage, DamageMonitor, DamageState};

use super::frame::DamageFrame;
use super::healing::Healing;
use super::readings::Readings;
use super::view::{Proposal, ProposalReason};

/// Rest needed before a proposal, seconds.
const REST_S: f64 = 30.0;
/// Readings are at rest if their means move by less than this many standard deviations (RMS over the channels).
const RESTING: f64 = 0.5;
/// A baseline is good enough if it is off by less than this, in the same units.
const OFF: f64 = 1.0;
/// Interval between tests whether a suspicion is a released touch, seconds, and minimum number of frames in the mean.
const RELEASE_S: f64 = 0.6;
const FEWEST_FOR_RELEASE: usize = 3;

/// State of the rest that proposals wait for.
#[derive(Debug)]
pub(super) struct Rest {
    /// Readings at the start of the rest.
    readings: Vec<f64>,
    since_ns: Option<u64>,
    /// Time when a suspicion began, or was last tested.
    looked_ns: u64,
    /// Time since which the baseline is known to have been taken under a touch. The intact reference is then what was
    /// read after the release.
    released_ns: Option<u64>,
    proposal: Option<Proposal>,
}

impl Rest {
    pub fn new(channels: usize) -> Self {
        let readings = Vec::with_capacity(channels);
        Self { readings, since_ns: None, looked_ns: 0, released_ns: None, proposal: None }
    }

    /// The proposed baseline.
    pub fn proposal(&self) -> Option<Proposal> {
        self.proposal
    }

    /// Reports a new baseline, against which nothing is known.
    pub fn restart(&mut self) {
        (self.since_ns, self.proposal, self.released_ns) = (None, None, None);
    }

    /// Reports that something lies on the skin.
    pub fn interrupt(&mut self) {
        (self.since_ns, self.proposal) = (None, None);
    }

    /// Postpones the next test, since a suspicion has just begun or cannot be judged.
    pub fn postpone_look(&mut self, time_ns: u64) {
        self.looked_ns = time_ns;
    }

    /// True if it is time to test for a touch that was in the reference and is gone. If so, postpones the next test.
    pub fn is_look_due(&mut self, frame: &DamageFrame<'_>, readings: &Readings, monitor: &DamageMonitor) -> bool {
        let due = frame.time_ns.saturating_sub(self.looked_ns) as f64 * 1e-9 >= RELEASE_S;
        let alone = !monitor.damages().iter().any(Damage::is_open);
        let seen = alone && readings.frames >= FEWEST_FOR_RELEASE && monitor.is_suspicious();
        let is_due = due && seen && !frame.loaded && frame.refinement.knows_releases();
        if is_due {
            self.looked_ns = frame.time_ns;
        }
        is_due
    }

    /// Records that a touch was in the reference and is gone.
    pub fn note_release(&mut self, time_ns: u64) {
        self.released_ns = Some(time_ns);
    }

    /// Updates the rest with a frame of a free skin.
    pub fn update(
        &mut self,
        time_ns: u64,
        readings: &Readings,
        baseline: &Baseline,
        monitor: &DamageMonitor,
        healing: &[Healing],
    ) {
        let moved = |from: &[f64]| deviation(&readings.mean, from, baseline.noise_std());
        if let Some(since_ns) = self.released_ns {
            let offset_sigma = moved(baseline.baseline());
            self.proposal = Some(Proposal { reason: ProposalReason::Touched, since_ns, offset_sigma });
            return;
        }
        let quiet = readings.frames >= 16 && !monitor.is_suspicious() && monitor.events().is_empty();
        let resting = self.since_ns.filter(|_| quiet && moved(&self.readings) < RESTING);
        let Some(since_ns) = resting else {
            self.proposal = None;
            self.since_ns = quiet.then_some(time_ns);
            self.readings.clear();
            self.readings.extend_from_slice(&readings.mean);
            return;
        };
        let offset_sigma = moved(baseline.baseline());
        let rested = time_ns.saturating_sub(since_ns) as f64 * 1e-9 >= REST_S;
        let healed = monitor.damages().iter().any(|damage| damage.state == DamageState::Healed);
        let settled = healing.iter().all(|state| state.settled);
        let reason = if healed { ProposalReason::Healed } else { ProposalReason::Offset };
        let useful = offset_sigma >= OFF || healed;
        self.proposal = (rested && settled && useful).then_some(Proposal { reason, since_ns, offset_sigma });
    }
}

/// RMS over the channels of the difference between means and other readings, in standard deviations.
fn deviation(means: &[f64], from: &[f64], noise_std: &[f64]) -> f64 {
    let (mut sum, mut noise) = (0.0, 0.0);
    for ((mean, from), sigma) in means.iter().zip(from).zip(noise_std) {
        if (mean + from + sigma).is_finite() {
            sum += (mean - from).powi(2);
            noise += sigma * sigma;
        }
    }
    if noise > 0.0 { (sum / noise).sqrt() } else { 0.0 }
}
