//! The pipeline's baselines: learnt from frames, given, or taken up again, and what follows from a new one.

use dermis_device::FrameTable;
use dermis_touch::{BaselineState, ReferenceOrigin, ReferenceRecord, TareGuard};

use super::state::{Running, State};
use super::{Pipeline, TARE_FRAMES};
use crate::Error;
use crate::channels::ChannelReader;
use crate::reconstructor::Reconstructor;
use crate::reference::{MeasuredNoise, Reference};
use crate::stages::gone::Gone;
use crate::stages::health::HealthStage;

/// Frames that make the baseline after a press has gone from it.
const GONE_FRAMES: usize = 8;

impl Pipeline {
    /// Takes the mean of the next frames as the new baseline.
    ///
    /// # Errors
    /// While touched, unless forced.
    pub fn tare(&mut self, force: bool, reason: &str) -> Result<usize, Error> {
        let guard = if force { TareGuard::Force } else { TareGuard::RefuseUnderLoad };
        self.baseline.tare(TARE_FRAMES, guard, reason)?;
        Ok(TARE_FRAMES)
    }

    /// Takes up a baseline that was in use before, by its place in [`Pipeline::baseline_records`].
    ///
    /// # Errors
    /// A number without a baseline whose values are kept.
    pub fn reuse_baseline(&mut self, record: usize, reason: &str) -> Result<(), Error> {
        self.baseline.reuse(self.timing.clock.time_ns(), record, reason)?;
        self.use_baseline((0, self.timing.frames))
    }

    /// Goes on from a baseline that was in use before, one value a channel of the protocol, with the noise of the
    /// channels at rest, in place of learning one from the first frames.
    ///
    /// # Errors
    /// Another number of channels than the skin's, or a baseline that does not fit its model.
    pub fn restore_baseline(
        &mut self,
        record: ReferenceRecord,
        values: &[f64],
        noise_std: &[f64],
    ) -> Result<(), Error> {
        self.baseline.restore(record, values, noise_std)?;
        self.use_baseline((0, self.timing.frames))
    }

    /// Goes on from frames of the untouched skin, in place of learning the baseline from the first frames that come.
    /// Their mean is the baseline, and from 8 frames on their scatter is the noise, which is else the one that the skin
    /// file assumes.
    ///
    /// # Errors
    /// A table that does not hold the skin's channels, or one without readings.
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

    /// Corrects the baseline by presses that it holds and that have gone.
    pub(super) fn correct_baseline(&mut self) -> Result<(), Error> {
        let State::Running(running) = &mut self.state else { return Ok(()) };
        let Running { reference, reconstructor } = &mut **running;
        let as_measured = |volts: &[f64]| -> Vec<f64> {
            volts.iter().zip(&reference.scale).map(|(volts, scale)| volts / scale).collect()
        };
        // A watch for damage judges negative changes by itself.
        if self.damage.is_some() || self.levels.is_some() {
            return Ok(());
        }
        let is_touched = reconstructor.touches.is_loaded();
        match reconstructor.refinement.gone() {
            None => {}
            Some(Gone::BesideOthers(volts)) => self.baseline.shift(as_measured(volts).into_iter()),
            // A search for touches under way would stop a tare that heeds the load.
            Some(Gone::Alone) if self.baseline.state() == BaselineState::Ready && !is_touched => {
                self.baseline.tare(GONE_FRAMES, TareGuard::Force, "a press that the baseline held has gone")?;
            }
            Some(Gone::Alone) => {}
        }
        Ok(())
    }

    /// Takes up the baseline just learnt; one of a tare that is of no use gives way to the one before, and the first
    /// one to that of later frames.
    pub(super) fn use_new_baseline(&mut self, time_ns: u64, at: (u64, u64)) -> Result<(), Error> {
        let Err(error) = self.use_baseline(at) else { return Ok(()) };
        let Some(before) = self.baseline.records().len().checked_sub(2).filter(|_| self.is_running()) else {
            return self.start_over(error);
        };
        let reason = format!("the tare gave no baseline: {error}");
        tracing::warn!("{reason}");
        self.baseline.reuse(time_ns, before, &reason)?;
        match self.use_baseline(at) {
            // Not even with the baseline of before, since all channels are left out: its reference stays.
            Err(Error::Frames { .. }) => Ok(()),
            used => used,
        }
    }

    /// Frames that give no baseline, such as those of an instrument whose electrodes are not connected yet, are
    /// waited out; what no frames can mend is an error.
    fn start_over(&mut self, error: Error) -> Result<(), Error> {
        if !matches!(error, Error::Frames { .. }) {
            return Err(error);
        }
        let times = self.useless_starts.0 + 1;
        // Said at once, and then more and more seldom.
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

    /// Why there is no baseline yet, where frames came from which none could be made; told once.
    pub fn take_start_problem(&mut self) -> Option<Error> {
        self.useless_starts.1.take().filter(|_| !self.is_running())
    }

    /// A new baseline stands: it is matched to the model, and the watches for damage are told.
    pub(super) fn use_baseline(&mut self, at: (u64, u64)) -> Result<(), Error> {
        self.match_baseline(at)?;
        let State::Running(running) = &mut self.state else { return Ok(()) };
        self.baseline.catch_up(running.reconstructor.refinement.refines());
        if let Some(levels) = &mut self.levels {
            levels.set_baseline(&self.baseline, running.reconstructor.imager.noise_image())?;
        }
        if let Some(damage) = &mut self.damage {
            damage.set_baseline(&self.baseline, running.reconstructor.imager.noise_image());
            // Touches are fitted to the sheet with the cuts that the baseline includes.
            running.reconstructor.refinement.set_cuts(self.timing.clock.time_ns(), &damage.cuts());
        }
        Ok(())
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
                refinement.set_noise(&reference.noise);
                running.reconstructor.take_reference(&self.prepared, &reference);
                running.reference = reference;
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
