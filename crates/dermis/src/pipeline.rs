//! The live pipeline: frame, channels, baseline, image, touches. Typed stages called one after another; after start-up
//! nothing is allocated per frame, but where touches are fitted as contacts or elements are solved for. It knows neither where frames come from nor where results go.

use std::time::{Duration, Instant};

use dermis_device::{Frame, Layout};
use dermis_learn::Model;
use dermis_tomo::inverse::SpotModel;
use dermis_touch::force::ForceCalibration;
use dermis_touch::health::Health;
use dermis_touch::{
    Baseline, BaselineChange, BaselineParams, BaselineState, DriftCompensation, Load, ReferenceRecord, TareGuard,
};

use crate::Error;
use crate::calibrate::{CalibratedImager, Calibration, PlacementFinder};
use crate::channels::ChannelReader;
use crate::classes::{ClassPace, ClassStage};
use crate::clock::FrameClock;
use crate::damage::{DamageInput, DamageStage, DamageView};
use crate::health::{HealthStage, Judgement};
use crate::imager::Imager;
use crate::latency::LatencyHistogram;
use crate::patches::PatchStage;
use crate::prepare::Prepared;
use crate::reference::Reference;
use crate::sink::Output;
use crate::touches::TouchStage;

/// Frames averaged by a tare.
pub const TARE_FRAMES: usize = 32;

/// Time spent in each stage, in order.
#[derive(Debug, Default)]
pub struct StageLatencies {
    /// From the first byte of the frame to the start of processing.
    pub queue: LatencyHistogram,
    /// Channels, baseline, difference.
    pub condition: LatencyHistogram,
    /// Difference to image.
    pub image: LatencyHistogram,
    /// Image to touches.
    pub touches: LatencyHistogram,
    /// First byte to touches.
    pub total: LatencyHistogram,
}

impl StageLatencies {
    /// Names and histograms, in order.
    pub fn stages(&self) -> [(&'static str, &LatencyHistogram); 5] {
        [
            ("queue", &self.queue),
            ("condition", &self.condition),
            ("image", &self.image),
            ("touches", &self.touches),
            ("total", &self.total),
        ]
    }
}

/// What the pipeline needs once it has a baseline.
#[derive(Debug)]
struct Ready {
    reference: Reference,
    imager: Imager,
    touches: TouchStage,
    placement: Option<PlacementFinder>,
    /// What touches are refined by, with all channels.
    spots: Option<SpotModel>,
}

/// The stages of one skin with their memory.
#[derive(Debug)]
pub struct Pipeline {
    prepared: Prepared,
    calibration: Option<Calibration>,
    reader: ChannelReader,
    baseline: Baseline,
    /// `None` where the skin file wants channels not to be watched.
    health: Option<HealthStage>,
    /// `None` where the skin file does not ask for damage to be watched.
    damage: Option<DamageStage>,
    ready: Option<Ready>,
    /// The operator, until there is a baseline to use it with.
    prebuilt: Option<Imager>,
    /// What touches are refined by, until the noise is known.
    spots: Option<SpotModel>,
    /// The same of a sandwich.
    patches: Option<PatchStage>,
    /// A network that classifies pixels, where there is one.
    classes: Option<ClassStage>,
    hyperparameter: Option<f64>,
    forces: Option<ForceCalibration>,
    channels: Vec<f64>,
    difference: Vec<f64>,
    image: Vec<f32>,
    /// The image is of this frame, and to be believed.
    believed: bool,
    latencies: StageLatencies,
    /// Frames stamped before this waited while the operator was made, which happens once; their times are not counted.
    timed_from_ns: u64,
    frames: u64,
    /// What happens on the skin is timed by the device where it has a clock, so that a replay at another pace gives the same
    /// touches.
    clock: FrameClock,
}

impl Pipeline {
    /// Sets up the pipeline of a prepared skin for frames of a layout. The first 32 frames make the baseline.
    ///
    /// # Errors
    /// A layout that does not hold the skin's channels.
    pub fn new(prepared: Prepared, layout: &Layout, calibration: Option<Calibration>) -> Result<Self, Error> {
        let reader = ChannelReader::new(layout, &prepared.protocol, prepared.skin.backend.reads, "the source")?;
        let settings = &prepared.skin.touch;
        let drift = match settings.drift_time_constant_s {
            time_constant_s if time_constant_s > 0.0 && prepared.skin.damage.watch => {
                DriftCompensation::Uniform { time_constant_s, settle_s: 2.0 }
            }
            time_constant_s if time_constant_s > 0.0 => {
                DriftCompensation::Exponential { time_constant_s, settle_s: 2.0 }
            }
            _ => DriftCompensation::Off,
        };
        let baseline = Baseline::new(prepared.channels(), BaselineParams { startup_frames: TARE_FRAMES, drift })?;
        if let Some(calibration) = &calibration {
            calibration.check(&prepared)?;
        }
        // An operator that does not depend on the baseline is built before any frame has to wait for it.
        let prebuilt = if calibration.is_none() && prepared.operator_needs_no_baseline() {
            Some(prepared.imager(&prepared.reference_from(&prepared.voltages, None)?, &[])?)
        } else {
            None
        };
        let health = if prepared.skin.health.watch { Some(HealthStage::new(&prepared)?) } else { None };
        let damage = if prepared.skin.damage.watch { Some(DamageStage::new(&prepared)?) } else { None };
        let refines = prepared.refines_touches(calibration.as_ref());
        let sandwich = prepared.is_sandwich();
        let spots = if refines && !sandwich { Some(prepared.assumed_spot_model()?) } else { None };
        let patches =
            if refines && sandwich { Some(prepared.patch_stage(&vec![0.0; prepared.channels()])?) } else { None };
        Ok(Self {
            reader,
            baseline,
            health,
            damage,
            ready: None,
            prebuilt,
            spots,
            patches,
            classes: None,
            hyperparameter: None,
            forces: None,
            channels: Vec::new(),
            difference: Vec::new(),
            image: vec![f32::NAN; prepared.map.grid().len()],
            believed: false,
            latencies: StageLatencies::default(),
            timed_from_ns: 0,
            frames: 0,
            clock: FrameClock::default(),
            calibration,
            prepared,
        })
    }

    /// The skin.
    pub fn prepared(&self) -> &Prepared {
        &self.prepared
    }

    /// Runs one frame through all stages. Until the baseline stands, the image is `NaN` and there are no touches.
    /// `now_ns` is the host's monotonic clock at the call.
    ///
    /// # Errors
    /// A frame of the wrong length, or times that run backwards.
    pub fn process(&mut self, frame: &Frame, now_ns: u64) -> Result<Output<'_>, Error> {
        let start = Instant::now();
        self.frames += 1;
        self.reader.read(&frame.values, &frame.imaginary, &mut self.channels)?;
        let before_ns = self.clock.time_ns();
        let marks = self.clock.advance(frame);
        let time_ns = self.clock.time_ns();
        if let Some(ready) = &mut self.ready
            && ready.touches.is_interruption(marks.lost_before, time_ns - before_ns)
        {
            // The frames before this one were lost for so long that other touches may have begun.
            ready.touches.interrupt(time_ns);
        }
        self.baseline.observe(time_ns, &self.channels)?;
        if let Some(health) = &mut self.health {
            health.read(self.baseline.raw())?;
        }
        let at = (frame.host_monotonic_ns, frame.sequence);
        let load = if self.ready.is_some() && self.follow(time_ns, at, start)? { Load::Touched } else { Load::Free };
        self.watch_damage(time_ns, at, load)?;
        let change = self.baseline.learn(load);
        if matches!(change, BaselineChange::Started | BaselineChange::Tared) {
            self.renew(at)?;
            self.timed_from_ns = now_ns.saturating_add(u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX));
        }
        // Waiting is told by the host's clock alone; the device's may begin and run otherwise.
        let waited = Duration::from_nanos(now_ns.saturating_sub(frame.host_monotonic_ns));
        if frame.host_monotonic_ns >= self.timed_from_ns {
            self.latencies.queue.record(waited);
            self.latencies.total.record(waited + start.elapsed());
        }
        let grid = self.prepared.map.grid();
        let (touches, events) = match &self.ready {
            Some(ready) => (ready.touches.touches(), ready.touches.events()),
            None => (&[][..], &[][..]),
        };
        Ok(Output {
            sequence: frame.sequence,
            time_ns: frame.host_monotonic_ns,
            wall_ns: frame.host_wall_ns,
            raw: self.baseline.raw(),
            compensated: self.baseline.compensated(),
            image: &self.image,
            columns: grid.columns,
            rows: grid.rows,
            touches,
            events,
            classes: self.classes.as_ref().and_then(ClassStage::seen),
            health: self.health(),
            damage: self.damage(),
            marks,
        })
    }

    /// From the frame just observed to touches, once there is a baseline; true while something touches.
    fn follow(&mut self, time_ns: u64, at: (u64, u64), start: Instant) -> Result<bool, Error> {
        let Some(ready) = &mut self.ready else { return Ok(false) };
        self.difference.clear();
        let scaled = self.baseline.compensated().iter().zip(&ready.reference.scale).map(|(d, s)| d * s);
        self.difference.extend(scaled);
        let judgement = match &mut self.health {
            Some(health) => {
                let scale = &ready.reference.scale;
                health.judge(at, self.baseline.raw(), scale, &mut self.difference, &mut ready.imager)?
            }
            None => Judgement { changed: false, blind: false, doubtful: false },
        };
        if judgement.changed {
            self.leave_out()?;
        }
        let Some(ready) = &mut self.ready else { return Ok(false) };
        let conditioned = Instant::now();
        self.latencies.condition.record(conditioned - start);
        if judgement.blind {
            self.believed = false;
            // Nothing that could be seen: no image, and what was touched is let go.
            self.image.fill(f32::NAN);
            if let Some(classes) = &mut self.classes {
                classes.forget(at.1);
            }
            ready.touches.forget(time_ns);
            return Ok(false);
        }
        self.believed = !judgement.doubtful;
        if judgement.doubtful {
            // The last image and its contacts stay until it is known what is wrong, a few frames at most.
            ready.touches.repeat(time_ns)?;
            return Ok(true);
        }
        ready.imager.image(&self.difference, &mut self.image)?;
        if let Some(classes) = &mut self.classes {
            classes.see(at.1, time_ns, &self.difference)?;
        }
        let imaged = Instant::now();
        self.latencies.image.record(imaged - conditioned);
        let placement = match &mut ready.placement {
            Some(finder) => finder.place(&self.difference)?,
            None => None,
        };
        if self.damage.is_some() {
            ready.touches.set_floor(DamageStage::floor(&self.image));
        }
        ready.touches.process(time_ns, &self.image, ready.imager.filled(), placement)?;
        self.latencies.touches.record(imaged.elapsed());
        Ok(ready.touches.is_loaded())
    }

    /// Looks for damage in the frame just followed; a damage that is believed is taken into the baseline of touches.
    fn watch_damage(&mut self, time_ns: u64, at: (u64, u64), load: Load) -> Result<(), Error> {
        let (Some(damage), Some(ready)) = (&mut self.damage, &mut self.ready) else { return Ok(()) };
        // What is not to be believed says nothing of damage either.
        if !std::mem::take(&mut self.believed) {
            return Ok(());
        }
        let (touches, contacts, patches) = ready.touches.parts();
        let input = DamageInput {
            time_ns,
            difference: &self.difference,
            scale: &ready.reference.scale,
            noise: &ready.reference.noise,
            touches,
            contacts,
            loaded: load == Load::Touched,
        };
        let verdict = damage.process(&input, &self.prepared, &mut ready.imager, &mut self.baseline, patches)?;
        self.baseline.hold_drift(verdict.suspicious);
        self.baseline.follow_rest(verdict.healing);
        if verdict.adopted {
            self.renew(at)?;
        }
        Ok(())
    }

    /// Touches are fitted to the sheet with the cuts that the baseline includes.
    fn follow_cuts(&mut self) {
        let (Some(damage), Some(ready)) = (&self.damage, &mut self.ready) else { return };
        let Some(patches) = ready.touches.patches_mut() else { return };
        patches.set_cuts(self.clock.time_ns(), &damage.cuts());
    }

    /// Damage, the baselines that were in use, and a new one where that is proposed.
    pub fn damage(&self) -> DamageView<'_> {
        let now_ns = self.clock.time_ns();
        let Some(damage) = &self.damage else { return DamageView::default() };
        DamageView { now_ns, ..damage.view(&self.baseline) }
    }

    /// Brings operator, image noise and refinement to the channels that are left.
    fn leave_out(&mut self) -> Result<(), Error> {
        let (Some(ready), Some(health)) = (&mut self.ready, &mut self.health) else { return Ok(()) };
        health.adopt(&mut self.baseline);
        let (left_out, noise) = (health.left_out(), &ready.reference.noise);
        if left_out.len() == noise.len() {
            // No operator at all: the frames are blind until some channel is back.
            return Ok(());
        }
        ready.imager.leave_out(left_out, noise)?;
        ready.touches.set_noise(ready.imager.noise_image());
        ready.touches.leave_out(&self.prepared, ready.spots.as_ref(), left_out, noise)?;
        if let Some(damage) = &mut self.damage {
            damage.set_noise(ready.imager.noise_image());
        }
        Ok(())
    }

    /// Channels that are left out, and electrodes that are blamed.
    pub fn health(&self) -> Health<'_> {
        self.health.as_ref().map_or_else(Health::default, HealthStage::health)
    }

    /// A new baseline stands: match it to the model and, the first time, build the operator.
    fn renew(&mut self, at: (u64, u64)) -> Result<(), Error> {
        if let (Some(health), None) = (&mut self.health, &self.ready) {
            health.check_start(at, &self.prepared, &self.baseline)?;
        }
        let reference = match &self.health {
            Some(health) => health.reference(&self.prepared, &mut self.baseline)?,
            None => self.prepared.reference_from(self.baseline.baseline(), Some(self.baseline.noise_std()))?,
        };
        if let Some(ready) = &mut self.ready {
            ready.imager.set_noise(&reference.noise)?;
            ready.touches.set_noise(ready.imager.noise_image());
            if let Some(patches) = ready.touches.patches_mut() {
                patches.set_noise(&reference.noise);
            }
            ready.reference = reference;
        } else {
            self.ready = Some(self.begin(reference)?);
            if self.health.as_ref().is_some_and(|health| !health.left_out().is_empty()) {
                self.leave_out()?;
            }
        }
        if let (Some(health), Some(ready)) = (&mut self.health, &self.ready) {
            health.begin(&ready.reference, &ready.imager)?;
        }
        if let (Some(damage), Some(ready)) = (&mut self.damage, &self.ready) {
            damage.renew(&self.baseline, ready.imager.noise_image());
        }
        self.follow_cuts();
        Ok(())
    }

    /// What follows the first baseline.
    fn begin(&mut self, reference: Reference) -> Result<Ready, Error> {
        let CalibratedImager { mut imager, reference, placement } = match self.prebuilt.take() {
            Some(mut imager) => {
                imager.set_noise(&reference.noise)?;
                CalibratedImager { imager, reference, placement: None }
            }
            None => self.prepared.calibrated_imager(self.calibration.as_ref(), reference, &[])?,
        };
        if let Some(lambda) = self.hyperparameter {
            imager.set_hyperparameter(lambda, &reference.noise)?;
        }
        let mut touches = TouchStage::new(&self.prepared, imager.noise_image())?;
        touches.set_forces(self.forces.clone());
        if let Some(mut patches) = self.patches.take() {
            patches.set_noise(&reference.noise);
            touches.set_patches(Some(patches));
        }
        let spots = self.spots.take();
        touches.leave_out(&self.prepared, spots.as_ref(), &[], &reference.noise)?;
        Ok(Ready { reference, imager, touches, placement, spots })
    }

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
        self.baseline.reuse(self.clock.time_ns(), record, reason)?;
        self.renew((0, self.frames))
    }

    /// Goes on from a baseline that was in use before, one value a channel of the protocol, with the noise of the channels
    /// at rest, in place of learning one from the first frames.
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
        self.renew((0, self.frames))
    }

    /// Rebuilds the operator at another lambda.
    ///
    /// # Errors
    /// A lambda that is not positive and finite.
    pub fn set_hyperparameter(&mut self, lambda: f64) -> Result<(), Error> {
        if let Some(ready) = &mut self.ready {
            ready.imager.set_hyperparameter(lambda, &ready.reference.noise)?;
            ready.touches.set_noise(ready.imager.noise_image());
            if let Some(health) = &mut self.health {
                health.begin(&ready.reference, &ready.imager)?;
            }
            if let Some(damage) = &mut self.damage {
                damage.set_noise(ready.imager.noise_image());
            }
        }
        self.hyperparameter = Some(lambda);
        Ok(())
    }

    /// Classifies the pixels of frames by a network from now on, or no longer.
    ///
    /// # Errors
    /// A model of another skin, or a thread that cannot be started.
    pub fn set_classifier(&mut self, model: Option<&Model>, pace: ClassPace) -> Result<(), Error> {
        self.classes = model.map(|model| ClassStage::new(&self.prepared, model, pace)).transpose()?;
        Ok(())
    }

    /// Reads forces by a calibration from now on.
    ///
    /// # Errors
    /// A calibration of another skin, or numbers in it that make no sense.
    pub fn set_forces(&mut self, forces: ForceCalibration) -> Result<(), Error> {
        forces.check(&self.prepared.skin.name)?;
        if let Some(ready) = &mut self.ready {
            ready.touches.set_forces(Some(forces.clone()));
        }
        self.forces = Some(forces);
        Ok(())
    }

    /// lambda in use, once the baseline stands.
    pub fn hyperparameter(&self) -> Option<f64> {
        self.ready.as_ref().map(|ready| ready.imager.hyperparameter())
    }

    /// The reference in use, once the baseline stands.
    pub fn reference(&self) -> Option<&Reference> {
        self.ready.as_ref().map(|ready| &ready.reference)
    }

    /// Image noise of each pixel, once the baseline stands.
    pub fn noise_image(&self) -> Option<Vec<f32>> {
        self.ready.as_ref().map(|ready| ready.imager.noise_image())
    }

    /// Where the baseline is in its life.
    pub fn baseline_state(&self) -> BaselineState {
        self.baseline.state()
    }

    /// The references that were in use, oldest first.
    pub fn baseline_records(&self) -> &[ReferenceRecord] {
        self.baseline.records()
    }

    /// The baseline, as measured, and the noise of its channels.
    pub fn baseline(&self) -> (&[f64], &[f64]) {
        (self.baseline.baseline(), self.baseline.noise_std())
    }

    /// Times of the stages so far.
    pub fn latencies(&self) -> &StageLatencies {
        &self.latencies
    }

    /// Frames processed.
    pub fn frames(&self) -> u64 {
        self.frames
    }
}
