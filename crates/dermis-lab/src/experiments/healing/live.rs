//! The sandwich's twin followed frame by frame by the live pipeline, for processes that take time: cuts, presses,
//! heat and baselines.

use dermis_device::{Frame, HostStamp, Layout};
use dermis_tomo::mesh::Point;
use dermis_touch::Touch;
use dermis_touch::damage::{Damage, DamageEvent};
use dermis_twin::{Frontend, Treatment, Wound};

use super::bench::{PRESSURE_PA, SKIN};
use crate::Error;
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_skin::{Skin, TwinAction};
use dermis_twin::{AnyTwin, TwinKit};

/// Pressure of a press, pascals, and radius of the 20 mm indenter, metres.
const PRESS: (f64, f64) = (PRESSURE_PA, 10e-3);

/// A twin and the pipeline that follows it.
pub(super) struct Line {
    twin: AnyTwin,
    pub(super) pipeline: Pipeline,
    ticks: u64,
    time_s: f64,
    /// Seconds between frames.
    pub(super) frame_s: f64,
    pub(super) events: Vec<DamageEvent>,
    /// Image of the last frame.
    pub(super) image: Vec<f32>,
    /// Image of the last frame relative to the intact skin.
    pub(super) damage_image: Vec<f32>,
    pub(super) touches: Vec<Touch>,
}

impl Line {
    /// A line that has run long enough to have a baseline.
    pub(super) fn new() -> Result<Self, Error> {
        let skin = Skin::open(SKIN)?;
        let twin = TwinKit::of(&skin)?.twin;
        let frame_s = 1.0 / skin.backend.frame_rate_hz();
        let prepared = Prepared::new(skin)?;
        let layout = Layout::Channels { count: prepared.channels() };
        let pipeline = Pipeline::new(prepared, &layout, None)?;
        let (image, damage_image) = (Vec::new(), Vec::new());
        let (touches, events) = (Vec::new(), Vec::new());
        let mut line = Self { twin, pipeline, ticks: 0, time_s: 0.0, frame_s, events, image, damage_image, touches };
        line.run(2.0)?;
        Ok(line)
    }

    /// Runs for the given time.
    pub(super) fn run(&mut self, seconds: f64) -> Result<(), Error> {
        let mut values = Vec::new();
        for _ in 0..(seconds / self.frame_s).ceil() as u64 {
            self.twin.step(self.time_s, &mut values)?;
            let time_ns = (self.time_s * 1e9) as u64;
            let mut frame = Frame::default();
            frame.refill(self.ticks, HostStamp { monotonic_ns: time_ns, wall_ns: 0 }, &values, &[]);
            frame.device_time_ns = Some(time_ns);
            self.ticks += 1;
            self.time_s += self.frame_s;
            let output = self.pipeline.process(&frame, time_ns)?;
            self.events.extend_from_slice(&output.damage.events);
            self.touches.clear();
            self.touches.extend_from_slice(&output.touches);
            self.image.clear();
            self.image.extend_from_slice(&output.image);
            self.damage_image.clear();
            self.damage_image.extend_from_slice(&output.damage.image);
        }
        Ok(())
    }

    pub(super) fn treat(&mut self, action: TwinAction) -> Result<(), Error> {
        let treatment: Treatment = dermis_twin::from_skin::treatment_of(action);
        Ok(self.twin.frontend_mut().treat(&treatment)?)
    }

    /// Presses the 20 mm indenter at a place, or moves it there.
    pub(super) fn press(&mut self, [x_mm, y_mm]: [f64; 2]) -> Result<(), Error> {
        Ok(self.twin.scene_mut().press(1, 1e-3 * x_mm, 1e-3 * y_mm, PRESS.1, PRESS.0)?)
    }

    pub(super) fn release(&mut self) {
        self.twin.scene_mut().release(1);
    }

    /// Presses at a place for the given time and releases for as long; returns the touches at the end of the press.
    pub(super) fn touched(&mut self, place_mm: Point, seconds: f64) -> Result<Vec<Touch>, Error> {
        self.press(place_mm)?;
        self.run(seconds)?;
        let touches = self.touches.clone();
        self.release();
        self.run(seconds)?;
        Ok(touches)
    }

    /// Damages currently believed to exist.
    pub(super) fn open(&self) -> Vec<Damage> {
        self.pipeline.damage().damages.iter().filter(|damage| damage.is_open()).copied().collect()
    }

    /// The true cuts.
    pub(super) fn wounds(&self) -> Vec<Wound> {
        self.twin.frontend().wounds()
    }
}
