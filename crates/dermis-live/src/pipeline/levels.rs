//! Frames of a skin whose damage is detected by levels. The baseline of touches follows the drift of each channel,
//! and permanent changes of the levels are imaged and judged.

use super::Pipeline;
use super::state::{Running, State};
use crate::Error;
use crate::stages::health::HealthStage;

impl Pipeline {
    /// Sets the baseline to the levels for comparison with the current frame.
    pub(super) fn follow_levels(&mut self, time_ns: u64) -> Result<(), Error> {
        let Some(levels) = &mut self.levels else { return Ok(()) };
        let left_out = self.health.as_ref().map_or(&[][..], HealthStage::left_out);
        levels.read(time_ns, &self.buffers.channels, left_out)?;
        let Some(levels) = levels.levels() else { return Ok(()) };
        // Excluded channels are moved by the health stage.
        for (channel, &level) in levels.iter().enumerate() {
            if left_out.binary_search(&(channel as u32)).is_err() {
                self.baseline.move_channel(channel, level);
            }
        }
        Ok(())
    }

    /// Images and judges changes of the levels; damage becomes part of the baseline of touches. True if the readings
    /// have not left the levels, whatever contacts noise makes.
    pub(super) fn watch_levels(&mut self, time_ns: u64, at: (u64, u64)) -> Result<bool, Error> {
        let (Some(levels), State::Running(running)) = (&mut self.levels, &mut self.state) else { return Ok(false) };
        let Running { reference, reconstructor } = &mut **running;
        if let Some((change, image)) = levels.change(&reference.scale) {
            reconstructor.image(change, image)?;
        }
        // A change judged to be damage in this frame is still in its difference.
        if self.buffers.difference.iter().any(|value| value.is_finite()) {
            let (difference, image) = levels.compare(&self.buffers.difference, &reference.scale);
            reconstructor.image(difference, image)?;
        }
        let adoption = levels.judge(time_ns)?;
        let is_free = !levels.is_disturbed();
        if let Some(adoption) = adoption {
            self.baseline.adopt(time_ns, &adoption.readings, adoption.frames, &adoption.reason)?;
            self.use_baseline(at)?;
        }
        Ok(is_free)
    }
}
