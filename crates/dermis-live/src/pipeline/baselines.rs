//! The pipeline's baselines: learnt from frames, given by the user, or reused, and the consequences of a new one.

use dermis_device::FrameTable;
use dermis_touch::{BaselineState, ReferenceOrigin, ReferenceRecord, TareGuard};

use super::state::{Running, State};
use super::{Pipeline, TARE_FRAMES};
use crate::Error;
use crate::channels::ChannelReader;
use crate::reconstructor::Reconstructor;
use crate::reference::{MeasuredNoise, Reference};
use crate::stages::ended_presses::Gone;
use crate::stages::health::HealthStage;
use crate::stages::workshop_ensemble::built_error;

/// Delay before manufacturing errors are used, nanoseconds: several times the time to sample them on one slow core.
const ERRORS_READY_NS: u64 = 5_000_000_000;
/// Number of frames averaged for the new baseline after a press in the old one has ended.
const GONE_FRAMES: usize = 8;
/// Reason for that baseline in the records.
pub(super) const GONE_REASON: &str = "a press included in the baseline has ended";

impl Pipeline {
    /// Starts to take the mean of the next frames as the new baseline. Returns their number.
    ///
    /// # Errors
    /// If the skin is touched, unless forced.
    pub fn tare(&mut self, force: bool, reason: &str) -> Result<usize, Error> {
        let guard = if force { TareGuard::Force } else { TareGuard::RefuseUnderLoad };
        self.baseline.tare(TARE_FRAMES, guard, reason)?;
        Ok(TARE_FRAMES)
    }

    /// Reuses an earlier baseline, given by its index in [`Pipeline::baseline_records`].
    ///
    /// # Errors
    /// An index without a baseline whose values are kept.
    pub fn reuse_baseline(&mut self, record: usize, reason: &str) -> Result<(), Error> {
        self.baseline.reuse(self.timing.clock.time_ns(), record, reason)?;
        self.use_baseline((0, self.timing.frames))
    }

    /// Continues from an earlier baseline instead of learning one from the first frames: one value per channel of the
    /// protocol, with the noise of the channels at rest.
    ///
    /// # Errors
    /// The wrong number of channels for the skin, or a baseline that does not fit its model.
    pub fn restore_baseline(
        &mut self,
        record: ReferenceRecord,
        values: &[f64],
        noise_std: &[f64],
    ) -> Result<(), Error> {
        self.baseline.restore(record, values, noise_std)?;
        self.use_baseline((0, self.timing.frames))
    }

    /// Starts from frames of the untouched skin instead of learning the baseline from the first live frames. Their
    /// mean is the baseline. The scatter of 8 frames or more gives the noise; with fewer, it is the value that the
    /// skin file assumes.
    ///
    /// # Errors
    /// A table without the skin's channels, or one without readings.
    pub fn set_baseline(&mut self, table: &FrameTable) -> Result<(), Error> {
        let file = table.source().display().to_string();
        let reads = self.prepared.skin.backend.reads;
        let mut reader = ChannelReader::new(table.layout(), &self.prepared.protocol, reads, &file)?;
        let frames = reader.read_table(table)?;
        let Reference { baseline, scale, noise, .. } = Reference::of(&self.prepared, &frames)?;
        self.reader.share_phase_of(&reader);
        let as_measured: Vec<f64> = noise.iter().zip(&scale).map(|(volts, scale)| volts / scale.abs()).collect();
        let (reason, origin) = (format!("frames of {file}"), ReferenceOrigin::Given);
        let record = ReferenceRecord { time_ns: 0, frames: frames.len(), origin, reason };
        self.restore_baseline(record, &baseline, &as_measured)
    }

    /// Removes presses that have ended from the baseline.
    pub(super) fn correct_baseline(&mut self) -> Result<(), Error> {
        let State::Running(running) = &mut self.state else { return Ok(()) };
        let Running { reference, reconstructor } = &mut **running;
        let as_measured = |volts: &[f64]| -> Vec<f64> {
            volts.iter().zip(&reference.scale).map(|(volts, scale)| volts / scale).collect()
        };
        // With a watch for damage, the watch judges negative changes itself.
        if self.damage.is_some() || self.levels.is_some() {
            return Ok(());
        }
        let is_touched = reconstructor.touches.is_loaded();
        match reconstructor.refinement.gone() {
            None => {}
            Some(Gone::BesideOthers(volts)) => self.baseline.shift(as_measured(volts).into_iter()),
            // A search for touches in progress would block a tare that refuses under load. But another press may begin
            // while the baseline is learnt.
            Some(Gone::Alone) if self.baseline.state() == BaselineState::Ready && !is_touched => {
                self.baseline.tare(GONE_FRAMES, TareGuard::Still, GONE_REASON)?;
            }
            Some(Gone::Alone) => {}
        }
        Ok(())
    }

    /// Uses the baseline just learnt. If a tare gave an unusable one, the baseline before it is used again; if the
    /// first one is unusable, a new one is learnt from later frames.
    pub(super) fn use_new_baseline(&mut self, time_ns: u64, at: (u64, u64)) -> Result<(), Error> {
        let Err(error) = self.use_baseline(at) else { return Ok(()) };
        let Some(before) = self.baseline.records().len().checked_sub(2).filter(|_| self.is_running()) else {
            return self.start_over(error);
        };
        let reason = format!("the tare gave no baseline: {error}");
        tracing::warn!("{reason}");
        self.baseline.reuse(time_ns, before, &reason)?;
        match self.use_baseline(at) {
            // Even the earlier baseline is unusable, since all channels are left out: keep its reference.
            Err(Error::Frames { .. }) => Ok(()),
            used => used,
        }
    }

    /// Waits for better frames if the first ones give no baseline, for example because the electrodes are not
    /// connected yet. An error that no frames can fix is returned.
    fn start_over(&mut self, error: Error) -> Result<(), Error> {
        if !matches!(error, Error::Frames { .. }) {
            return Err(error);
        }
        let times = self.useless_starts.0 + 1;
        // Warn at once, and then less and less often.
        if times.is_power_of_two() {
            tracing::warn!(times, "the first frames gave no baseline, waiting for others: {error}");
        }
        self.useless_starts = (times, Some(error));
        self.baseline.start_over();
        if self.health.is_some() {
            self.health = Some(HealthStage::new(&self.prepared)?);
        }
        Ok(())
    }

    /// The reason why there is no baseline yet, if frames came but gave none; reported once.
    pub fn take_start_problem(&mut self) -> Option<Error> {
        self.useless_starts.1.take().filter(|_| !self.is_running())
    }

    /// Puts a new baseline into use: matches it to the model and informs the watches for damage.
    pub(super) fn use_baseline(&mut self, at: (u64, u64)) -> Result<(), Error> {
        self.match_baseline(at)?;
        let State::Running(running) = &mut self.state else { return Ok(()) };
        self.baseline.catch_up(running.reconstructor.refinement.refines());
        if let Some(levels) = &mut self.levels {
            levels.set_baseline(&self.baseline, running.reconstructor.imager.noise_image())?;
        }
        if let Some(damage) = &mut self.damage {
            damage.set_baseline(&self.baseline, running.reconstructor.imager.noise_image());
            // Fit touches to the sheet with the cuts that the baseline includes.
            running.reconstructor.refinement.set_cuts(self.timing.clock.time_ns(), &damage.cuts());
        }
        Ok(())
    }

    /// Accounts for the skin's deviation from its file, at once or after an ensemble of such skins has been sampled.
    fn take_reference(&mut self) {
        self.errors.cancel();
        let State::Running(running) = &mut self.state else { return };
        let Running { reference, reconstructor } = &mut **running;
        if !reconstructor.takes_long(&self.prepared, reference) {
            reconstructor.take_reference(&self.prepared, reference);
            return;
        }
        let (prepared, misfit) = (self.prepared.clone(), reference.misfit);
        let due_ns = self.timing.clock.time_ns().saturating_add(ERRORS_READY_NS);
        self.errors.begin(due_ns, move |_| {
            built_error(&prepared, misfit);
            Some(())
        });
    }

    /// Uses that ensemble's errors, if they are due.
    pub(super) fn take_up_errors(&mut self, time_ns: u64) {
        if self.errors.take(time_ns).is_some() {
            self.take_reference();
        }
    }

    /// Matches the baseline to the model and, the first time, builds the operator.
    pub(super) fn match_baseline(&mut self, at: (u64, u64)) -> Result<(), Error> {
        if let (Some(health), State::Starting(_)) = (&mut self.health, &self.state) {
            health.check_start(at, &self.prepared, &self.baseline)?;
        }
        let left_out = self.health.as_ref().map_or(&[][..], HealthStage::left_out);
        let reference = match &self.health {
            Some(health) => health.reference(&self.prepared, &self.baseline)?,
            None => {
                let (rest, noise) = (self.baseline.baseline(), self.baseline.noise_std());
                Reference::from_baseline(&self.prepared, rest, Some(MeasuredNoise::of_start(noise)))?
            }
        };
        for channel in left_out.iter().map(|&channel| channel as usize) {
            self.baseline.move_channel(channel, reference.baseline[channel]);
        }
        match &mut self.state {
            State::Running(running) => {
                let Reconstructor { imager, touches, refinement, placement, .. } = &mut running.reconstructor;
                let reference = match placement {
                    Some(finder) => finder.adapt(reference),
                    None => reference,
                };
                imager.set_noise(&reference.noise)?;
                touches.set_noise(imager.noise_image());
                refinement.set_noise(&reference.noise)?;
                running.reference = reference;
                self.take_reference();
            }
            State::Starting(starting) => {
                let mut running = starting.run(&self.prepared, &mut self.choices, reference)?;
                if !left_out.is_empty() && left_out.len() < running.reference.noise.len() {
                    running.reconstructor.leave_out(&self.prepared, left_out, &running.reference.noise)?;
                }
                self.state = State::Running(Box::new(running));
            }
        }
        self.compare_with_reference()
    }
}
