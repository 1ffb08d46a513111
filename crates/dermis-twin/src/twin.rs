//! A twin: scene, frontend and instrument stepped together, one frame per step.

use std::any::Any;
use std::sync::atomic::AtomicBool;

use dermis_tomo::mesh::Outline;
use serde::Serialize;

use crate::error::{TwinError, check};
use crate::healing::{TimedTreatment, Treatment, Wound};
use crate::instrument::{FaultSchedule, FrameFate, Instrument, InstrumentOptions, TimedFault};
use crate::mechanics::{Indenter, check_on_skin};
use crate::scene::{Pointer, Scene, SceneOptions, Script};

/// Work for a treatment that can run in another thread, see [`Frontend::preparation`]. It stops between two trials
/// once the flag is set.
pub type Preparation = Box<dyn FnOnce(&AtomicBool) -> Box<dyn Any + Send> + Send>;

/// The physical part of a skin: from loads to true voltages.
pub trait Frontend: std::fmt::Debug + Send {
    /// Number of channels in a frame.
    fn channel_count(&self) -> usize;

    /// Outline of the skin laid flat.
    fn extent(&self) -> Outline;

    /// Refuses an indenter that this skin cannot carry. [`Frontend::voltages`] accepts any indenter and ignores what
    /// hangs over the rim.
    ///
    /// # Errors
    /// As [`check_on_skin`].
    fn check_indenter(&self, indenter: &Indenter) -> Result<(), TwinError> {
        check_on_skin(&self.extent(), indenter)
    }

    /// Message about the part of the last frame outside the model's validity, for display; `None` if there is nothing
    /// to report.
    fn outside_validity(&self) -> Option<String> {
        None
    }

    /// Cuts, heats or renews the sheet.
    ///
    /// # Errors
    /// A skin whose sheet does not support it, or invalid numbers.
    fn treat(&mut self, _treatment: &Treatment) -> Result<(), TwinError> {
        Err(TwinError::NotTreatable)
    }

    /// Preparation for several simultaneous treatments, to run in another thread while frames continue. `None` if
    /// [`Frontend::treat`] is fast anyway. Pass its result to [`Frontend::adopt`].
    fn preparation(&self, _treatments: &[Treatment]) -> Option<Preparation> {
        None
    }

    /// Applies prepared treatments. Returns the reasons for those refused; if all were refused, the skin is
    /// unchanged.
    fn adopt(&mut self, _prepared: Box<dyn Any + Send>) -> Vec<TwinError> {
        Vec::new()
    }

    /// Its cuts and their healing state.
    fn wounds(&self) -> Vec<Wound> {
        Vec::new()
    }

    /// Sets the electrodes or coils used by an instrument's channels, which some of its faults need.
    ///
    /// # Errors
    /// An instrument with a different number of channels.
    fn wired(&self, instrument: Instrument) -> Result<Instrument, TwinError> {
        Ok(instrument)
    }

    /// True voltages (volts, [`Frontend::channel_count`] of them) under these indenters, `dt_s` seconds after the
    /// previous call.
    ///
    /// # Errors
    /// Fields that cannot be solved.
    fn voltages(&mut self, indenters: &[Indenter], dt_s: f64, voltages_v: &mut [f64]) -> Result<(), TwinError>;
}

impl<F: Frontend + ?Sized> Frontend for Box<F> {
    fn channel_count(&self) -> usize {
        (**self).channel_count()
    }

    fn extent(&self) -> Outline {
        (**self).extent()
    }

    fn check_indenter(&self, indenter: &Indenter) -> Result<(), TwinError> {
        (**self).check_indenter(indenter)
    }

    fn outside_validity(&self) -> Option<String> {
        (**self).outside_validity()
    }

    fn treat(&mut self, treatment: &Treatment) -> Result<(), TwinError> {
        (**self).treat(treatment)
    }

    fn preparation(&self, treatments: &[Treatment]) -> Option<Preparation> {
        (**self).preparation(treatments)
    }

    fn adopt(&mut self, prepared: Box<dyn Any + Send>) -> Vec<TwinError> {
        (**self).adopt(prepared)
    }

    fn wounds(&self) -> Vec<Wound> {
        (**self).wounds()
    }

    fn wired(&self, instrument: Instrument) -> Result<Instrument, TwinError> {
        (**self).wired(instrument)
    }

    fn voltages(&mut self, indenters: &[Indenter], dt_s: f64, voltages_v: &mut [f64]) -> Result<(), TwinError> {
        (**self).voltages(indenters, dt_s, voltages_v)
    }
}

/// Environment of a skin in its twin.
#[derive(Clone, Debug, PartialEq)]
pub struct TwinOptions {
    /// Noise, drift, converter.
    pub instrument: InstrumentOptions,
    /// Fading, and how script and user share the skin.
    pub scene: SceneOptions,
    /// Touches that the twin makes by itself.
    pub script: Option<Script>,
    /// Seed of the instrument's noise.
    pub seed: u64,
}

impl Default for TwinOptions {
    /// An ideal instrument and no script.
    fn default() -> Self {
        let (instrument, scene) = (InstrumentOptions::ideal(), SceneOptions::default());
        Self { instrument, scene, script: None, seed: 1 }
    }
}

/// True state of one touch.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TouchTruth {
    /// Source of the touch.
    pub pointer: Pointer,
    /// Position to the right of the centroid.
    pub x_m: f64,
    /// Position above the centroid.
    pub y_m: f64,
    /// Radius of the indenter, or of a disc of equal area.
    pub radius_m: f64,
    /// Current mean pressure under it, including fading.
    pub pressure_pa: f64,
}

/// True state at the time of a frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Truth {
    /// Frame number assigned by the device, from 0. A dropped frame uses up its number; a duplicated one has the
    /// number of the previous frame.
    pub sequence: u64,
    /// Fate of the frame. Callers that forward frames must skip dropped ones.
    pub fate: FrameFate,
    /// Time of the frame on the twin's clock.
    pub device_time_s: f64,
    /// The touches, ordered by pointer.
    pub touches: Vec<TouchTruth>,
}

/// A skin with its scene and its instrument.
#[derive(Debug)]
pub struct Twin<F> {
    frontend: F,
    instrument: Instrument,
    scene: Scene,
    indenters: Vec<Indenter>,
    truth: Truth,
    next_sequence: u64,
    delivered_sequence: u64,
    /// Time since the first frame, seconds.
    running_s: f64,
    faults: FaultSchedule,
    /// Pending treatments of the sheet, last one first.
    treatments: Vec<TimedTreatment>,
    last_time_s: Option<f64>,
}

impl<F: Frontend> Twin<F> {
    /// The twin of a skin. Its instrument knows the skin's electrodes or coils, its scene the skin's outline.
    ///
    /// # Errors
    /// Invalid options, or a script that presses off the skin.
    pub fn of(frontend: F, options: &TwinOptions) -> Result<Self, TwinError> {
        let instrument = Instrument::new(options.instrument, frontend.channel_count(), options.seed)?;
        let instrument = frontend.wired(instrument)?;
        let scene = Scene::new(options.scene, options.script.clone())?.on(frontend.extent())?;
        Ok(Self::new(frontend, instrument, scene))
    }

    /// Builds a twin from its parts. The instrument must have as many channels as the frontend.
    pub fn new(frontend: F, instrument: Instrument, scene: Scene) -> Self {
        Self {
            frontend,
            instrument,
            scene,
            indenters: Vec::new(),
            truth: Truth::default(),
            next_sequence: 0,
            delivered_sequence: 0,
            running_s: 0.0,
            faults: FaultSchedule::default(),
            treatments: Vec::new(),
            last_time_s: None,
        }
    }

    /// The same twin with its frontend boxed, so that twins of all skins have one type.
    pub fn boxed(self) -> Twin<Box<dyn Frontend>>
    where
        F: 'static,
    {
        Twin {
            frontend: Box::new(self.frontend),
            instrument: self.instrument,
            scene: self.scene,
            indenters: self.indenters,
            truth: self.truth,
            next_sequence: self.next_sequence,
            delivered_sequence: self.delivered_sequence,
            running_s: self.running_s,
            faults: self.faults,
            treatments: self.treatments,
            last_time_s: self.last_time_s,
        }
    }

    /// Its parts, for pressing and reading without a scene.
    pub fn into_parts(self) -> (F, Instrument, Scene) {
        (self.frontend, self.instrument, self.scene)
    }

    /// Takes the frame at `time_s` (seconds on any clock; a time before the last one counts as the same) and returns
    /// the true state. `frame` is resized to the number of channels, volts; its memory is reused.
    ///
    /// # Errors
    /// A time that is not finite, an indenter off the skin or larger than it, or fields that cannot be solved. The
    /// contents of `frame` are then meaningless.
    pub fn step(&mut self, time_s: f64, frame: &mut Vec<f64>) -> Result<&Truth, TwinError> {
        check("time_s", time_s, f64::MIN, f64::MAX, "finite")?;
        let now = self.last_time_s.map_or(time_s, |last| last.max(time_s));
        let dt = now - self.last_time_s.unwrap_or(now);
        self.last_time_s = Some(now);
        self.running_s += dt;
        if let Some(faults) = self.faults.change_at(self.running_s) {
            self.instrument.set_faults(faults)?;
        }
        while let Some(next) = self.treatments.last().filter(|next| next.at_s <= self.running_s).copied() {
            self.treatments.pop();
            self.frontend.treat(&next.treatment)?;
        }
        self.scene.advance(dt);
        self.indenters.clear();
        self.truth.touches.clear();
        for (pointer, indenter) in self.scene.indenters() {
            self.frontend.check_indenter(&indenter)?;
            self.indenters.push(indenter);
            self.truth.touches.push(TouchTruth {
                pointer,
                x_m: indenter.centre_m[0],
                y_m: indenter.centre_m[1],
                radius_m: indenter.shape.equal_area_radius_m(),
                pressure_pa: indenter.pressure_pa(),
            });
        }
        frame.resize(self.frontend.channel_count(), 0.0);
        self.frontend.voltages(&self.indenters, dt, frame)?;
        self.instrument.read(dt, frame);
        self.truth.fate = self.instrument.frame_fate();
        self.number();
        self.truth.device_time_s = now;
        Ok(&self.truth)
    }

    /// Numbers the frame just read. A copy has the number of its original, the last delivered frame.
    fn number(&mut self) {
        self.truth.fate = self.instrument.frame_fate();
        self.truth.sequence = match self.truth.fate {
            FrameFate::Duplicated => self.delivered_sequence,
            FrameFate::Delivered | FrameFate::Dropped => self.next_sequence,
        };
        self.next_sequence += u64::from(self.truth.fate != FrameFate::Duplicated);
        if self.truth.fate == FrameFate::Delivered {
            self.delivered_sequence = self.truth.sequence;
        }
    }

    /// Replaces the instrument's faults, each with its times; active ones apply from the next frame on. An empty list
    /// repairs the instrument.
    ///
    /// # Errors
    /// Faults of electrodes or channels that do not exist, probabilities outside 0 to 1, or times out of order.
    pub fn set_faults(&mut self, faults: Vec<TimedFault>) -> Result<(), TwinError> {
        faults.iter().try_for_each(TimedFault::check)?;
        let all: Vec<_> = faults.iter().map(|timed| timed.fault).collect();
        self.instrument.check_faults(&all)?;
        self.instrument.set_faults(Vec::new())?;
        self.faults = FaultSchedule::new(faults);
        Ok(())
    }

    /// Schedules treatments of the sheet, replacing those still pending.
    ///
    /// # Errors
    /// Negative times or invalid numbers. A skin that does not support treatments reports it at their time.
    pub fn set_treatments(&mut self, mut treatments: Vec<TimedTreatment>) -> Result<(), TwinError> {
        for timed in &treatments {
            check("treatment at_s", timed.at_s, 0.0, f64::MAX, "zero or more, finite")?;
            timed.treatment.check()?;
        }
        // Treatments at the same time keep the order of the list.
        treatments.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        treatments.reverse();
        self.treatments = treatments;
        Ok(())
    }

    /// The loads on the skin.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The loads on it, for pressing.
    pub fn scene_mut(&mut self) -> &mut Scene {
        &mut self.scene
    }

    /// The skin.
    pub fn frontend(&self) -> &F {
        &self.frontend
    }

    /// The skin, for damaging or healing it.
    pub fn frontend_mut(&mut self) -> &mut F {
        &mut self.frontend
    }

    /// The instrument.
    pub fn instrument(&self) -> &Instrument {
        &self.instrument
    }
}
