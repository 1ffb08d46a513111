//! The live pipeline: frame, channels, baseline, image, touches. Typed stages called one after another; after start-up
//! nothing is allocated per frame. It knows neither where frames come from nor where results go.

use std::time::{Duration, Instant};

use dermis_device::{Frame, Layout};
use dermis_tomo::inverse::SpotModel;
use dermis_touch::force::ForceCalibration;
use dermis_touch::{
    Baseline, BaselineChange, BaselineParams, BaselineState, DriftCompensation, Load, ReferenceRecord, TareGuard,
};

use crate::Error;
use crate::calibrate::{CalibratedImager, Calibration, PlacementFinder};
use crate::channels::ChannelReader;
use crate::imager::Imager;
use crate::latency::LatencyHistogram;
use crate::prepare::Prepared;
use crate::reference::Reference;
use crate::sink::Output;
use crate::spots::SpotStage;
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
}

/// The stages of one skin with their memory.
#[derive(Debug)]
pub struct Pipeline {
    prepared: Prepared,
    calibration: Option<Calibration>,
    reader: ChannelReader,
    baseline: Baseline,
    ready: Option<Ready>,
    /// The operator, until there is a baseline to use it with.
    prebuilt: Option<Imager>,
    /// What touches are refined by, until the noise is known.
    spots: Option<SpotModel>,
    hyperparameter: Option<f64>,
    forces: Option<ForceCalibration>,
    channels: Vec<f64>,
    difference: Vec<f64>,
    image: Vec<f32>,
    latencies: StageLatencies,
    /// Frames stamped before this waited while the operator was made, which happens once; their times are not counted.
    timed_from_ns: u64,
    frames: u64,
    /// Number and time of the last frame.
    last: Option<(u64, u64)>,
    /// Time of the last frame: what happens on the skin is timed by the device where it has a clock, so that a replay at
    /// another pace gives the same touches.
    time_ns: u64,
}

impl Pipeline {
    /// Sets up the pipeline of a prepared skin for frames of a layout. The first 32 frames make the baseline.
    ///
    /// # Errors
    /// A layout that does not hold the skin's channels.
    pub fn new(prepared: Prepared, layout: &Layout, calibration: Option<Calibration>) -> Result<Self, Error> {
        let reader = ChannelReader::new(layout, &prepared.protocol, prepared.skin.backend.reads, "the source")?;
        let settings = &prepared.skin.touch;
        let drift = if settings.drift_time_constant_s > 0.0 {
            DriftCompensation::Exponential { time_constant_s: settings.drift_time_constant_s, settle_s: 2.0 }
        } else {
            DriftCompensation::Off
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
        let refines = prepared.refines_touches(calibration.as_ref());
        let spots = if refines { Some(prepared.assumed_spot_model()?) } else { None };
        Ok(Self {
            reader,
            baseline,
            ready: None,
            prebuilt,
            spots,
            hyperparameter: None,
            forces: None,
            channels: Vec::new(),
            difference: Vec::new(),
            image: vec![f32::NAN; prepared.map.grid().len()],
            latencies: StageLatencies::default(),
            timed_from_ns: 0,
            frames: 0,
            last: None,
            time_ns: 0,
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
        // A clock that was set back must not stop the skin: time then stands still until it has caught up.
        self.time_ns = self.time_ns.max(frame.device_time_ns.unwrap_or(frame.host_monotonic_ns));
        let time_ns = self.time_ns;
        self.notice_gap(frame.sequence);
        self.baseline.observe(time_ns, &self.channels)?;
        let mut load = Load::Free;
        if let Some(ready) = &mut self.ready {
            self.difference.clear();
            let scaled = self.baseline.compensated().iter().zip(&ready.reference.scale).map(|(d, s)| d * s);
            self.difference.extend(scaled);
            let conditioned = Instant::now();
            self.latencies.condition.record(conditioned - start);
            ready.imager.image(&self.difference, &mut self.image)?;
            let imaged = Instant::now();
            self.latencies.image.record(imaged - conditioned);
            let placement = match &mut ready.placement {
                Some(finder) => finder.place(&self.difference)?,
                None => None,
            };
            ready.touches.process(time_ns, &self.image, ready.imager.filled(), placement)?;
            self.latencies.touches.record(imaged.elapsed());
            if ready.touches.is_loaded() {
                load = Load::Touched;
            }
        }
        let change = self.baseline.learn(load);
        if matches!(change, BaselineChange::Started | BaselineChange::Tared) {
            self.renew()?;
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
        })
    }

    /// Ends touches where the frames before this one were lost for so long that others may have begun.
    fn notice_gap(&mut self, sequence: u64) {
        let before = self.last.replace((sequence, self.time_ns));
        if let (Some((last, last_ns)), Some(ready)) = (before, &mut self.ready) {
            let lost = sequence.saturating_sub(last).saturating_sub(1);
            if ready.touches.is_interruption(lost, self.time_ns - last_ns) {
                ready.touches.interrupt(self.time_ns);
            }
        }
    }

    /// A new baseline stands: match it to the model and, the first time, build the operator.
    fn renew(&mut self) -> Result<(), Error> {
        let reference = self.prepared.reference_from(self.baseline.baseline(), Some(self.baseline.noise_std()))?;
        if let Some(ready) = &mut self.ready {
            ready.imager.set_noise(&reference.noise);
            ready.touches.set_noise(ready.imager.noise_image());
            ready.reference = reference;
            return Ok(());
        }
        let CalibratedImager { mut imager, reference, placement } = match self.prebuilt.take() {
            Some(mut imager) => {
                imager.set_noise(&reference.noise);
                CalibratedImager { imager, reference, placement: None }
            }
            None => self.prepared.calibrated_imager(self.calibration.as_ref(), reference, &[])?,
        };
        if let Some(lambda) = self.hyperparameter {
            imager.set_hyperparameter(lambda, &reference.noise)?;
        }
        let mut touches = TouchStage::new(&self.prepared, imager.noise_image())?;
        touches.set_forces(self.forces.clone());
        if let Some(model) = self.spots.take() {
            touches.set_spots(Some(SpotStage::new(&self.prepared, model.reweighted(&reference.noise)?)));
        }
        self.ready = Some(Ready { reference, imager, touches, placement });
        Ok(())
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

    /// Rebuilds the operator at another lambda.
    ///
    /// # Errors
    /// A lambda that is not positive and finite.
    pub fn set_hyperparameter(&mut self, lambda: f64) -> Result<(), Error> {
        if let Some(ready) = &mut self.ready {
            ready.imager.set_hyperparameter(lambda, &ready.reference.noise)?;
            ready.touches.set_noise(ready.imager.noise_image());
        }
        self.hyperparameter = Some(lambda);
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
