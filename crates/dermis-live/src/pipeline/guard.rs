//! The guard's verdict on the current frame.

use dermis_device::Frame;
use dermis_skin::GuardSettings;
use dermis_touch::guard::{GuardLimits, GuardReport};
use dermis_touch::{ReferenceOrigin, ReferenceRecord};

use super::Pipeline;
use super::baselines::GONE_REASON;
use super::state::State;
use crate::Error;
use crate::clock::FrameAnomalies;
use crate::stages::guard::{GuardStage, SeenFrame};

impl Pipeline {
    /// Uses a guard with these limits, as if they were in the skin file, or none.
    ///
    /// # Errors
    /// Limits out of range, or a skin whose health is not watched, where a guard would miss faults.
    pub fn set_guard(&mut self, settings: Option<GuardSettings>) -> Result<(), Error> {
        let mut skin = self.prepared.skin.clone();
        skin.guard = settings;
        let skin = skin.checked()?;
        self.guard = settings.map(|settings| GuardStage::new(&settings, &skin));
        Ok(())
    }

    /// The guard's limits, if there is a guard.
    pub fn guard_limits(&self) -> Option<GuardLimits> {
        self.guard.as_ref().map(GuardStage::limits)
    }

    /// The guard's verdict before the first frame, at a time on the host's monotonic clock, if there is a guard.
    pub fn guard_before_frames(&self, now_ns: u64) -> Option<GuardReport> {
        self.guard.as_ref().map(|guard| guard.before_frames(now_ns))
    }

    /// States whether frames come from an instrument, in real time, rather than from a file or a twin, which may run at
    /// any speed. The guard then sees frames that queued up on the way, by the device's clock. Work in the background
    /// that is late takes effect later, instead of keeping frames waiting.
    pub fn set_live(&mut self, is_live: bool) {
        if let Some(guard) = &mut self.guard {
            guard.watch_lag(is_live);
        }
        self.choices.is_live = is_live;
        self.pass_on_live();
    }

    /// Tells all background work whether frames come from an instrument. Call it after replacing any of it.
    pub(super) fn pass_on_live(&mut self) {
        let is_live = self.choices.is_live;
        self.errors.set_live(is_live);
        self.operators.coming.set_live(is_live);
        if let Some(building) = &mut self.building {
            building.set_live(is_live);
        }
        if let Some(circuit) = &mut self.circuit {
            circuit.set_live(is_live);
        }
        match &mut self.state {
            State::Starting(starting) => starting.refinement.set_live(is_live),
            State::Running(running) => running.reconstructor.refinement.set_live(is_live),
        }
    }

    pub(super) fn judge(&mut self, frame: &Frame, anomalies: FrameAnomalies, now_ns: u64) -> Option<GuardReport> {
        let mut guard = self.guard.take()?;
        let damage = self.damage();
        let running = self.running();
        let report = guard.judge(&SeenFrame {
            now_ns,
            frame,
            anomalies,
            has_baseline: running.is_some(),
            is_baseline_trusted: is_trusted(self.baseline_records()) && damage.proposal.is_none(),
            is_seen: self.is_seen,
            health: self.health(),
            readings: self.baseline.raw(),
            touches: running.map_or(&[], |running| running.reconstructor.touches.touches()),
            damages: &damage.damages,
        });
        self.guard = Some(guard);
        Some(report)
    }
}

/// False if the baseline comes from a forced tare, which hides whatever touched the skin. Damage adopted later is added
/// to that baseline.
fn is_trusted(records: &[ReferenceRecord]) -> bool {
    let base = records.iter().rev().find(|record| record.origin != ReferenceOrigin::Damage);
    base.is_none_or(|record| record.origin != ReferenceOrigin::ForcedTare || record.reason == GONE_REASON)
}
