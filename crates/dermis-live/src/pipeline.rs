//! The live pipeline: frame, channels, baseline, image, touches. Typed stages are called one after another. After
//! start-up nothing is allocated per frame while nothing touches the skin, unless elements are solved for. The
//! pipeline knows neither where frames come from nor where results go. Stages know nothing of each other: those for
//! health, damage and classes return decisions, which are applied here.

mod as_built;
mod baselines;
mod calibrations;
mod circuit;
mod guard;
mod hyperparameter;
mod levels;
mod state;

use std::sync::Arc;
use std::time::Duration;

use dermis_device::{Frame, Layout};
use dermis_learn::Model;
use dermis_touch::health::Health;
use dermis_touch::{Baseline, BaselineChange, BaselineParams, BaselineState, Load, ReferenceRecord};

use crate::Error;
use crate::beside::Beside;
use crate::calibration::{Calibration, check_wiring};
pub use crate::channel_noise::TARE_FRAMES;
use crate::channels::ChannelReader;
use crate::clock::FrameClock;
pub use crate::forces::ForceSource;
use crate::instant::Instant;
pub use crate::latency::StageLatencies;
use crate::prepare::Prepared;
use crate::reference::Reference;
use crate::skin_frame::SkinFrame;
use crate::stages::build_learning::BuildLearning;
use crate::stages::circuit::CircuitStage;
use crate::stages::classes::{ClassPace, ClassStage};
use crate::stages::damage::{DamageDecision, DamageFrame, DamageStage, DamageView, LevelStage, lobe_floor};
use crate::stages::guard::GuardStage;
use crate::stages::health::{HealthDecision, HealthFrame, HealthStage, Sight};
use state::{Choices, Operators, Running, Starting, State, drift_compensation};

/// Before the first baseline, a frame counts if one in this many of its channels has a reading.
const LEAST_START: usize = 4;

/// The stages of one skin with their memory.
#[derive(Debug)]
pub struct Pipeline {
    prepared: Arc<Prepared>,
    choices: Choices,
    reader: ChannelReader,
    baseline: Baseline,
    /// `None` if the skin file disables channel monitoring.
    health: Option<HealthStage>,
    /// Number of failed attempts to make a baseline from the first frames, and the last reason.
    useless_starts: (u32, Option<Error>),
    /// `None` if the skin file does not request damage monitoring.
    damage: Option<DamageStage>,
    /// Replaces `damage` on skins that conduct less where they are pressed.
    levels: Option<LevelStage>,
    /// `None` if the readout's circuit need not be found.
    circuit: Option<CircuitStage>,
    /// Learns how the skin was built, unless a calibration gives it.
    building: Option<BuildLearning>,
    /// Samples manufacturing errors after a baseline that is not the first.
    errors: Beside<()>,
    /// A network that classifies pixels, if any.
    classes: Option<ClassStage>,
    /// `None` without limits in the skin file or from the user.
    guard: Option<GuardStage>,
    /// The touches are those of the current frame. False if it is in doubt, so that those of an earlier frame are
    /// repeated, or if its image shows more than its touches.
    is_seen: bool,
    state: State,
    operators: Operators,
    buffers: Buffers,
    timing: Timing,
}

/// The current frame on its way to an image.
#[derive(Debug)]
struct Buffers {
    channels: Vec<f64>,
    difference: Vec<f64>,
    image: Vec<f32>,
}

/// Arrival of frames, and processing times.
#[derive(Debug, Default)]
struct Timing {
    latencies: StageLatencies,
    /// Frames are timed from the first baseline on, but not those stamped before this: they waited for the operator.
    timed_from_ns: u64,
    frames: u64,
    /// Events on the skin are timed by the device's clock if it has one, so that a replay at another speed gives the
    /// same touches.
    clock: FrameClock,
}

/// Evidence of one frame about the skin.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// Something touches the skin.
    touched: bool,
    /// The image is of this frame, and reliable.
    believed: bool,
}

impl Pipeline {
    /// Builds the pipeline of a prepared skin for frames of a layout. The first 32 frames make the baseline.
    /// Pipelines of identical skins may share the prepared model.
    ///
    /// # Errors
    /// A layout that does not contain the skin's channels; a requested search for the circuit that cannot run in the
    /// background.
    pub fn new(
        prepared: impl Into<Arc<Prepared>>,
        layout: &Layout,
        calibration: Option<Calibration>,
    ) -> Result<Self, Error> {
        let mut prepared = prepared.into();
        if let Some(built) = calibration.as_ref().map(|c| c.skin_as_built(&prepared)).transpose()?.flatten() {
            prepared = Arc::new(built);
        }
        let reader = ChannelReader::new(layout, &prepared.protocol, prepared.skin.backend.reads, "the source")?;
        let drift = drift_compensation(&prepared);
        let baseline = Baseline::new(prepared.channels(), BaselineParams { startup_frames: TARE_FRAMES, drift })?;
        let circuit = match &calibration {
            Some(calibration) => {
                calibration.check(&prepared)?;
                None
            }
            None => {
                check_wiring(&prepared)?;
                CircuitStage::new(&prepared)?
            }
        };
        // Readings with unknown wiring, and differences, cannot be compared with the model's resting values.
        let backend = &prepared.skin.backend;
        let is_watched = prepared.skin.health.watch && backend.wiring.is_known() && !backend.differences;
        let by_levels = LevelStage::is_wanted(&prepared);
        let by_image = prepared.skin.damage.watch && !by_levels;
        // Build an operator that does not depend on the baseline now, before any frame has to wait for it.
        let starting = || Starting::new(&prepared, calibration.as_ref());
        let watches = || -> Result<_, Error> {
            let health = is_watched.then(|| HealthStage::new(&prepared)).transpose()?;
            let levels = by_levels.then(|| LevelStage::new(&prepared)).transpose()?;
            let damage = by_image.then(|| DamageStage::new(&prepared)).transpose()?;
            Ok((health, levels, damage))
        };
        let (starting, watches) = rayon::join(starting, watches);
        let (starting, (health, levels, damage)) = (starting?, watches?);
        let image = vec![f32::NAN; prepared.map.grid().len()];
        let building = if calibration.is_none() { BuildLearning::of(&prepared) } else { None };
        let guard = prepared.skin.guard.as_ref().map(|settings| GuardStage::new(settings, &prepared.skin));
        Ok(Self {
            choices: Choices { calibration, ..Choices::default() },
            reader,
            baseline,
            health,
            useless_starts: (0, None),
            damage,
            levels,
            circuit,
            building,
            errors: Beside::patient(),
            classes: None,
            guard,
            is_seen: false,
            state: State::Starting(Box::new(starting)),
            operators: Operators::after(0),
            buffers: Buffers { channels: Vec::new(), difference: Vec::new(), image },
            timing: Timing::default(),
            prepared,
        })
    }

    /// The skin.
    pub fn prepared(&self) -> &Prepared {
        &self.prepared
    }

    /// Processes one frame through all stages. Until there is a baseline, the image is `NaN` and there are no
    /// touches. `now_ns` is the host's monotonic clock at the call.
    ///
    /// # Errors
    /// A frame of the wrong length, or times that run backwards.
    pub fn process(&mut self, frame: &Frame, now_ns: u64) -> Result<SkinFrame<'_>, Error> {
        let start = Instant::now();
        let is_ready = self.is_running();
        self.timing.frames += 1;
        self.reader.read(&frame.values, &frame.imaginary, &mut self.buffers.channels)?;
        let before_ns = self.timing.clock.time_ns();
        let anomalies = self.timing.clock.advance(frame);
        let time_ns = self.timing.clock.time_ns();
        if let State::Running(running) = &mut self.state
            && running.reconstructor.touches.is_interruption(anomalies.lost_before, time_ns - before_ns)
        {
            // Frames were missing for so long that other touches may have begun.
            running.reconstructor.interrupt(time_ns);
        }
        self.take_up_operator(time_ns)?;
        let at = (frame.host_monotonic_ns, frame.sequence);
        self.take_up_circuit(time_ns, at)?;
        self.take_up_build(time_ns, at)?;
        self.take_up_errors(time_ns);
        let change = match self.is_blank() {
            // Nothing to learn from: the baseline starts with the first frame that has readings.
            true => BaselineChange::None,
            false => self.learn_from(time_ns, at, start)?,
        };
        if matches!(change, BaselineChange::Started | BaselineChange::Tared) {
            self.use_new_baseline(time_ns, at)?;
            self.learn_build(time_ns);
            self.timing.timed_from_ns = now_ns.saturating_add(nanoseconds(start.elapsed()));
        }
        // Waiting is measured by the host's clock alone, since the device's may have another origin and rate.
        let waited = Duration::from_nanos(now_ns.saturating_sub(frame.host_monotonic_ns));
        if is_ready && frame.host_monotonic_ns >= self.timing.timed_from_ns {
            self.timing.latencies.queue.record(waited);
            self.timing.latencies.total.record(waited + start.elapsed());
        }
        let guard = self.judge(frame, anomalies, now_ns.saturating_add(nanoseconds(start.elapsed())));
        let grid = self.prepared.map.grid();
        let (touches, ended) = match &self.state {
            State::Running(running) => (running.reconstructor.touches.touches(), running.reconstructor.touches.ended()),
            State::Starting(_) => (&[][..], &[][..]),
        };
        Ok(SkinFrame {
            sequence: frame.sequence,
            time_s: self.timing.clock.elapsed_s(),
            time_ns: frame.host_monotonic_ns,
            wall_ns: frame.host_wall_ns,
            device_time_ns: frame.device_time_ns,
            is_ready,
            raw: self.baseline.raw().into(),
            compensated: self.baseline.compensated().into(),
            image: (&self.buffers.image).into(),
            columns: grid.columns,
            rows: grid.rows,
            touches: touches.into(),
            ended: ended.into(),
            classes: self.classes.as_ref().and_then(ClassStage::seen),
            health: self.health(),
            damage: self.damage(),
            circuit: self.circuit.as_ref().and_then(CircuitStage::news).copied(),
            anomalies,
            guard,
        })
    }

    /// True if a frame before the first baseline has hardly any readings.
    fn is_blank(&self) -> bool {
        let channels = &self.buffers.channels;
        let finite = channels.iter().filter(|value| value.is_finite()).count();
        matches!(self.state, State::Starting(_)) && LEAST_START * finite < channels.len()
    }

    /// Evaluates the current frame, and lets the baseline learn from it.
    fn learn_from(&mut self, time_ns: u64, at: (u64, u64), start: Instant) -> Result<BaselineChange, Error> {
        if let Some(health) = &mut self.health {
            health.read(&self.buffers.channels)?;
        }
        // A frame that is wrong as a whole says nothing about levels, baselines or damage.
        let is_sound = self.health.as_ref().is_none_or(HealthStage::is_frame_sound);
        if is_sound {
            self.follow_levels(time_ns)?;
        }
        self.baseline.observe(time_ns, &self.buffers.channels)?;
        let seen = self.see(time_ns, at, start)?;
        self.is_seen = seen.believed && !self.running().is_some_and(|run| run.reconstructor.is_unexplained());
        self.gather_presses(time_ns, seen.believed);
        let is_level = is_sound && self.watch_levels(time_ns, at)?;
        let is_free = seen.believed && (self.watch_damage(time_ns, at, seen.touched)? || is_level);
        Ok(self.baseline.learn(if seen.touched && !is_free { Load::Touched } else { Load::Free }))
    }

    fn is_running(&self) -> bool {
        matches!(self.state, State::Running(_))
    }

    /// Takes the current frame to touches, once there is a baseline.
    fn see(&mut self, time_ns: u64, at: (u64, u64), start: Instant) -> Result<Seen, Error> {
        let State::Running(running) = &mut self.state else { return Ok(Seen { touched: false, believed: false }) };
        let Running { reference, .. } = &**running;
        let difference = &mut self.buffers.difference;
        difference.clear();
        difference.extend(self.baseline.compensated().iter().zip(&reference.scale).map(|(d, s)| d * s));
        let sight = self.examine_health(time_ns, at)?;
        let State::Running(running) = &mut self.state else { return Ok(Seen { touched: false, believed: false }) };
        let reconstructor = &mut running.reconstructor;
        let Buffers { difference, image, .. } = &mut self.buffers;
        let conditioned = Instant::now();
        self.timing.latencies.condition.record(conditioned - start);
        match sight {
            Sight::Clear => {}
            Sight::Doubtful => {
                // Keep the last image and its contacts until the fault is identified, a few frames at most.
                reconstructor.touches.repeat(time_ns)?;
                return Ok(Seen { touched: true, believed: false });
            }
            Sight::Blind => {
                // Nothing can be seen: clear the image and end all touches.
                image.fill(f32::NAN);
                if let Some(classes) = &mut self.classes {
                    classes.forget(at.1);
                }
                reconstructor.forget(time_ns);
                // The skin may be touched, so the baseline must not learn.
                return Ok(Seen { touched: true, believed: false });
            }
        }
        reconstructor.image(difference, image)?;
        let imaged = Instant::now();
        self.timing.latencies.image.record(imaged - conditioned);
        let placement = reconstructor.place(time_ns, difference)?;
        if self.damage.is_some() {
            reconstructor.touches.set_floor(lobe_floor(image));
        }
        if let Some(levels) = &self.levels {
            // While the readings stay at their levels, image contents come from noise and drift, not from touch.
            reconstructor.touches.set_floor(if levels.is_disturbed() { 0.0 } else { f64::INFINITY });
        }
        reconstructor.follow_touches(time_ns, image, placement)?;
        self.correct_baseline()?;
        let State::Running(running) = &mut self.state else { return Ok(Seen { touched: false, believed: false }) };
        let (reconstructor, Buffers { difference, .. }) = (&mut running.reconstructor, &mut self.buffers);
        self.timing.latencies.touches.record(imaged.elapsed());
        if let Some(classes) = &mut self.classes {
            classes.classify(at.1, time_ns, &reconstructor.fitted(difference))?;
        }
        Ok(Seen { touched: reconstructor.is_loaded(), believed: true })
    }

    /// Checks the health of the current frame and applies the result. Excluded channels are removed from it, and
    /// operator, image noise and refinement continue with the others.
    fn examine_health(&mut self, time_ns: u64, at: (u64, u64)) -> Result<Sight, Error> {
        let (Some(health), State::Running(running)) = (&mut self.health, &mut self.state) else {
            return Ok(Sight::Clear);
        };
        let Running { reference, reconstructor } = &mut **running;
        let difference = &mut self.buffers.difference;
        let is_touched = reconstructor.is_loaded() || reconstructor.refinement.is_unsure();
        let expected = match health.mask(difference) {
            Some(masked) => Some(reconstructor.imager.fill_in(masked)?),
            None => None,
        };
        let (raw, scale) = (self.baseline.raw(), &reference.scale);
        let frame = HealthFrame { at, raw, scale, difference, expected, is_touched };
        let HealthDecision { excluded, left_out, moved, sight } =
            health.examine(&frame, || reconstructor.refinement.explains(time_ns, difference))?;
        for (value, _) in difference.iter_mut().zip(excluded).filter(|(_, excluded)| **excluded) {
            *value = f64::NAN;
        }
        for &(channel, reading) in moved {
            self.baseline.move_channel(channel, reading);
        }
        // With no channel left there is no operator: frames are blind until a channel recovers.
        if let Some(left_out) = left_out.filter(|left_out| left_out.len() < reference.noise.len()) {
            reconstructor.leave_out(&self.prepared, left_out, &reference.noise)?;
            reconstructor.refinement.postpone();
            self.damage.iter_mut().for_each(|damage| damage.set_noise(reconstructor.imager.noise_image()));
            self.levels.iter_mut().for_each(|levels| levels.set_noise(reconstructor.imager.noise_image()));
        }
        Ok(sight)
    }

    /// Looks for damage in the current frame, and applies the result: confirmed damage becomes part of the touches'
    /// baseline. True if nothing lies on the skin, even if that baseline suggests otherwise.
    fn watch_damage(&mut self, time_ns: u64, at: (u64, u64), loaded: bool) -> Result<bool, Error> {
        let (Some(damage), State::Running(running)) = (&mut self.damage, &mut self.state) else { return Ok(false) };
        let Running { reference, reconstructor } = &mut **running;
        let (difference, scale) = (&self.buffers.difference, &reference.scale);
        let (change, image) = damage.compare(&self.baseline, difference, scale);
        reconstructor.image(change, image)?;
        if let Some((known, image)) = damage.update_known() {
            reconstructor.image(known, image)?;
        }
        let frame = DamageFrame {
            time_ns,
            baseline: &self.baseline,
            difference,
            scale,
            noise: &reference.noise,
            touches: reconstructor.touches.touches(),
            contacts: reconstructor.touches.contacts(),
            refinement: &reconstructor.refinement,
            loaded,
        };
        let DamageDecision { adopt, hold_drift, follow_rest, is_free } = damage.process(&frame, &self.prepared)?;
        if let Some(adoption) = &adopt {
            self.baseline.adopt(time_ns, &adoption.readings, adoption.frames, &adoption.reason)?;
        }
        self.baseline.hold_drift(hold_drift);
        self.baseline.follow_rest(follow_rest);
        if adopt.is_some() {
            self.use_baseline(at)?;
        }
        Ok(is_free)
    }

    /// Damage, earlier baselines, and a new one if proposed.
    pub fn damage(&self) -> DamageView<'_> {
        let now_ns = self.timing.clock.time_ns();
        let by_image = self.damage.as_ref().map(|damage| damage.view(&self.baseline));
        let by_levels = self.levels.as_ref().map(|levels| levels.view(&self.baseline));
        by_image.or(by_levels).map_or_else(DamageView::default, |view| DamageView { now_ns, ..view })
    }

    /// Excluded channels, and faulty electrodes.
    pub fn health(&self) -> Health<'_> {
        self.health.as_ref().map_or_else(Health::default, HealthStage::health)
    }

    /// Makes the health stage use the current reference and operator.
    fn compare_with_reference(&mut self) -> Result<(), Error> {
        if let (Some(health), State::Running(running)) = (&mut self.health, &self.state) {
            health.compare_with(&running.reference, running.reconstructor.imager.operator())?;
        }
        Ok(())
    }

    /// Number of frames that waited for background work: operators for other hyperparameters, sheets with new cuts,
    /// searches for the readout's circuit, models of the skin as built, manufacturing errors. Zero on a machine that
    /// is fast enough for the stream.
    pub fn waits(&self) -> u64 {
        let of_sheets = self.running().map_or(0, |running| running.reconstructor.refinement.waits());
        let of_circuits = self.circuit.as_ref().map_or(0, CircuitStage::waits);
        let of_builds = self.building.as_ref().map_or(0, BuildLearning::waits);
        self.operators.waits() + of_sheets + of_circuits + of_builds + self.errors.waits()
    }

    /// Starts classifying the pixels of frames by a network, or stops.
    ///
    /// # Errors
    /// A model of another skin, or a thread that cannot be started.
    pub fn set_classifier(&mut self, model: Option<&Model>, pace: ClassPace) -> Result<(), Error> {
        self.classes = model.map(|model| ClassStage::new(&self.prepared, model, pace)).transpose()?;
        Ok(())
    }

    /// Current lambda, once there is a baseline.
    pub fn hyperparameter(&self) -> Option<f64> {
        self.running().map(|running| running.reconstructor.imager.hyperparameter())
    }

    /// lambda from the skin file's rule or a calibration, once there is a baseline.
    pub fn rule_hyperparameter(&self) -> Option<f64> {
        self.running().map(|running| running.reconstructor.imager.rule_hyperparameter())
    }

    /// The current reference, once there is a baseline.
    pub fn reference(&self) -> Option<&Reference> {
        self.running().map(|running| &running.reference)
    }

    /// Image noise of each pixel, once there is a baseline.
    pub fn noise_image(&self) -> Option<Vec<f32>> {
        self.running().map(|running| running.reconstructor.imager.noise_image())
    }

    /// State of the baseline.
    pub fn baseline_state(&self) -> BaselineState {
        self.baseline.state()
    }

    /// All references used, oldest first.
    pub fn baseline_records(&self) -> &[ReferenceRecord] {
        self.baseline.records()
    }

    /// The baseline, as measured, and the noise of its channels.
    pub fn baseline(&self) -> (&[f64], &[f64]) {
        (self.baseline.baseline(), self.baseline.noise_std())
    }

    /// Processing times of the stages.
    pub fn latencies(&self) -> &StageLatencies {
        &self.timing.latencies
    }

    /// Number of frames processed.
    pub fn frames(&self) -> u64 {
        self.timing.frames
    }

    fn running(&self) -> Option<&Running> {
        match &self.state {
            State::Starting(_) => None,
            State::Running(running) => Some(running),
        }
    }
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}
