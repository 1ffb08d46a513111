//! The pipeline's results for one frame.

use dermis_touch::Touch;
use dermis_touch::guard::GuardReport;
use dermis_touch::health::Health;

use crate::calibration::CircuitNews;
use crate::clock::FrameAnomalies;
use crate::stages::classes::SeenClasses;
use crate::stages::damage::DamageView;

/// Everything known about one frame after the pipeline has processed it.
#[derive(Debug, Clone, Copy)]
pub struct Output<'a> {
    /// The device's frame number. Gaps are lost frames.
    pub sequence: u64,
    /// Time of the frame on the host's monotonic clock, nanoseconds; `HostStamp::on_system_clock` makes it comparable
    /// with other processes.
    pub time_ns: u64,
    /// Time of the frame on the host's wall clock, nanoseconds since 1970-01-01 UTC.
    pub wall_ns: u64,
    /// Time of the frame on the device's own clock, nanoseconds from an origin of its choice, if it has one.
    pub device_time_ns: Option<u64>,
    /// Readings in the skin's channel order and the instrument's unit; NaN where missing.
    pub raw: &'a [f64],
    /// Readings minus baseline, in the same order.
    pub compensated: &'a [f64],
    /// The image, row-major, `rows * columns` values, row 0 at the top (+y); NaN outside the skin.
    pub image: &'a [f32],
    /// Pixels in a row of the image.
    pub columns: usize,
    /// Rows of the image.
    pub rows: usize,
    /// Touches on the skin in this frame, their phase begin or move.
    pub touches: &'a [Touch],
    /// Touches that ended in this frame, with the last values measured.
    pub ended: &'a [Touch],
    /// A network's classes for this frame or a slightly earlier one, if there is a network.
    pub classes: Option<SeenClasses<'a>>,
    /// Excluded channels, and faulty electrodes.
    pub health: Health<'a>,
    /// Damage, baselines and proposals, if damage is monitored.
    pub damage: DamageView<'a>,
    /// Result of a search for the readout's circuit that was completed with this frame, if the skin file requests
    /// one.
    pub circuit: Option<&'a CircuitNews>,
    /// Anomalies of the frame's number or time.
    pub anomalies: FrameAnomalies,
    /// The guard's verdict, if there is a guard.
    pub guard: Option<GuardReport>,
}
