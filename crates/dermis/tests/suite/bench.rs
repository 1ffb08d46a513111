//! A noisy twin followed by the live pipeline, for the tests of single skins.

use dermis_device::{Frame, HostStamp, Layout};
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_skin::Skin;
use dermis_touch::{Touch, TouchPhase};
use dermis_twin::AnyTwin;

/// A twin and the pipeline that processes its frames, at the skin's frame rate.
pub struct Bench {
    pub twin: AnyTwin,
    pub pipeline: Pipeline,
    /// Touches of the last frame.
    pub touches: Vec<Touch>,
    /// Number of touches that have begun.
    pub begun: usize,
    /// Largest value of the last image.
    pub strongest: f64,
    /// The pixel with this value.
    pub strongest_pixel: usize,
    frame: Frame,
    values: Vec<f64>,
    frames: u64,
    period_ns: u64,
}

impl Bench {
    /// A bench before its first frame. The pipeline knows the skin only; the twin may differ from it.
    pub fn new(skin: Skin, twin: AnyTwin) -> Self {
        let period_ns = (1e9 / skin.backend.frame_rate_hz()) as u64;
        let prepared = Prepared::new(skin).unwrap();
        let layout = Layout::Channels { count: prepared.channels() };
        let pipeline = Pipeline::new(prepared, &layout, None).unwrap();
        let (touches, values, frame) = (Vec::new(), Vec::new(), Frame::default());
        let (strongest, strongest_pixel) = (0.0, 0);
        Self { twin, pipeline, touches, begun: 0, strongest, strongest_pixel, frame, values, frames: 0, period_ns }
    }

    /// The same after the frames that make the baseline.
    pub fn with_baseline(mut self) -> Self {
        self.run(32);
        assert!(self.pipeline.reference().is_some(), "32 frames make the baseline");
        self
    }

    /// A bench of a skin and its own twin, with a baseline.
    pub fn of(skin: Skin) -> Self {
        let twin = AnyTwin::from_skin(&skin).unwrap();
        Self::new(skin, twin).with_baseline()
    }

    /// Runs this many frames.
    pub fn run(&mut self, frames: usize) {
        (0..frames).for_each(|_| self.run_changed(|_, _| {}));
    }

    /// Runs a frame whose readings are changed by their channel.
    pub fn run_changed(&mut self, change: impl Fn(usize, &mut f64)) {
        self.twin.step((self.frames * self.period_ns) as f64 * 1e-9, &mut self.values).unwrap();
        self.values.iter_mut().enumerate().for_each(|(channel, value)| change(channel, value));
        self.process();
    }

    /// Processes the last readings again without solving the fields, as for a skin held still without noise.
    pub fn process(&mut self) {
        let time_ns = self.frames * self.period_ns;
        let at = HostStamp { monotonic_ns: time_ns, wall_ns: time_ns };
        self.frame.refill(self.frames, at, &self.values, &[]);
        let output = self.pipeline.process(&self.frame, time_ns).unwrap();
        self.touches = output.touches.to_vec();
        self.begun += output.touches.iter().filter(|touch| touch.phase == TouchPhase::Begin).count();
        let values = output.image.iter().map(|value| f64::from(*value)).enumerate();
        let strongest = values.filter(|(_, value)| *value > 0.0).max_by(|a, b| a.1.total_cmp(&b.1));
        (self.strongest_pixel, self.strongest) = strongest.unwrap_or_default();
        self.frames += 1;
    }

    /// Releases everything and runs this many frames, after which no touch is left.
    pub fn release(&mut self, frames: usize) {
        self.twin.scene_mut().release_all();
        self.run(frames);
        assert!(self.touches.is_empty(), "released, and still {:?}", self.touches);
    }

    /// Distance from a place to the nearest touch, millimetres.
    pub fn error_mm(&self, [x_mm, y_mm]: [f64; 2]) -> f64 {
        let distance = |touch: &Touch| (touch.position_m[0] * 1e3 - x_mm).hypot(touch.position_m[1] * 1e3 - y_mm);
        self.touches.iter().map(distance).fold(f64::INFINITY, f64::min)
    }
}
