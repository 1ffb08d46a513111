//! The pipeline's results for one frame.

use std::borrow::Cow;

use dermis_touch::Touch;
use dermis_touch::guard::GuardReport;
use dermis_touch::health::Health;

use crate::calibration::CircuitNews;
use crate::clock::FrameAnomalies;
use crate::stages::classes::SeenClasses;
use crate::stages::damage::DamageView;

/// Everything known about one frame after the pipeline has processed it. It borrows the pipeline's memory until the
/// next frame; [`SkinFrame::into_owned`] copies it.
#[derive(Debug, Clone, Default)]
pub struct SkinFrame<'a> {
    /// The device's frame number. Gaps are lost frames.
    pub sequence: u64,
    /// Seconds since the pipeline's first frame, by the device's clock if it has one. Never runs backwards.
    pub time_s: f64,
    /// Time of the frame on the host's monotonic clock, nanoseconds; `HostStamp::on_system_clock` makes it comparable
    /// with other processes.
    pub time_ns: u64,
    /// Time of the frame on the host's wall clock, nanoseconds since 1970-01-01 UTC.
    pub wall_ns: u64,
    /// Time of the frame on the device's own clock, nanoseconds from an origin of its choice, if it has one.
    pub device_time_ns: Option<u64>,
    /// False while the first frames make the baseline. Until then the image is `NaN`, and there are no touches.
    pub is_ready: bool,
    /// Readings in the skin's channel order and the instrument's unit; NaN where missing.
    pub raw: Cow<'a, [f64]>,
    /// Readings minus baseline, in the same order.
    pub compensated: Cow<'a, [f64]>,
    /// The image, row-major, `rows * columns` values, row 0 at the top (+y); NaN outside the skin.
    pub image: Cow<'a, [f32]>,
    /// Pixels in a row of the image.
    pub columns: usize,
    /// Rows of the image.
    pub rows: usize,
    /// Touches on the skin in this frame, their phase begin or move: positions in metres from the skin's centre, x
    /// right, y up.
    pub touches: Cow<'a, [Touch]>,
    /// Touches that ended in this frame, with the last values measured.
    pub ended: Cow<'a, [Touch]>,
    /// A network's classes for this frame or a slightly earlier one, if there is a network.
    pub classes: Option<SeenClasses<'a>>,
    /// Excluded channels, and faulty electrodes.
    pub health: Health<'a>,
    /// Damage, baselines and proposals, if damage is monitored.
    pub damage: DamageView<'a>,
    /// Result of a search for the readout's circuit that was completed with this frame, if the skin file requests
    /// one.
    pub circuit: Option<CircuitNews>,
    /// Anomalies of the frame's number or time.
    pub anomalies: FrameAnomalies,
    /// The guard's verdict, if there is a guard.
    pub guard: Option<GuardReport>,
}

impl SkinFrame<'_> {
    /// The same frame, in memory of its own.
    pub fn into_owned(self) -> SkinFrame<'static> {
        SkinFrame {
            raw: Cow::Owned(self.raw.into_owned()),
            compensated: Cow::Owned(self.compensated.into_owned()),
            image: Cow::Owned(self.image.into_owned()),
            touches: Cow::Owned(self.touches.into_owned()),
            ended: Cow::Owned(self.ended.into_owned()),
            classes: self.classes.map(SeenClasses::into_owned),
            health: self.health.into_owned(),
            damage: self.damage.into_owned(),
            ..self
        }
    }
}
