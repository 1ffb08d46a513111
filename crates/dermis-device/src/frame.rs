//! One frame of measurements, with its times. Frames are created once and refilled, so the live path doesn't allocate.

use std::sync::LazyLock;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use dermis_wire::Status;

/// One frame: one reading of every channel.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Frame {
    /// The device's frame number, or a count from 0 if the device sends none. Gaps are lost frames.
    pub sequence: u64,
    /// The device's own clock in nanoseconds, if it sends one. The device chooses the origin.
    pub device_time_ns: Option<u64>,
    /// Host monotonic clock at the frame's first byte, nanoseconds since [`HostStamp`]'s origin.
    pub host_monotonic_ns: u64,
    /// Host wall clock at the frame's first byte, nanoseconds since 1970-01-01 UTC.
    pub host_wall_ns: u64,
    /// Readings in the instrument's channel order and unit; real parts for complex instruments. NaN if missing.
    pub values: Vec<f64>,
    /// Imaginary part of each reading; empty for instruments that read real values or magnitudes.
    pub imaginary: Vec<f64>,
    /// Events that the instrument reports for this frame; empty for instruments that report none.
    pub status: Status,
    /// The instrument's own gain code, if it reports one; the first if there are several. For information only:
    /// readings are in volts.
    pub gain: Option<u8>,
    /// Time of each reading after `device_time_ns`, in nanoseconds; empty for instruments that report none.
    pub channel_times_ns: Vec<u64>,
}

impl Frame {
    /// An empty frame with room for `channels` real readings.
    pub fn with_capacity(channels: usize) -> Self {
        Self { values: Vec::with_capacity(channels), ..Self::default() }
    }

    /// Clears the content and keeps the memory.
    pub fn clear(&mut self) {
        self.sequence = 0;
        self.device_time_ns = None;
        self.stamp(HostStamp { monotonic_ns: 0, wall_ns: 0 });
        self.values.clear();
        self.imaginary.clear();
        self.status = Status::default();
        self.gain = None;
        self.channel_times_ns.clear();
    }

    /// Replaces the content. Allocates only if there are more readings than ever before. Pass an empty `imaginary` for
    /// real readings.
    pub fn refill(&mut self, sequence: u64, at: HostStamp, values: &[f64], imaginary: &[f64]) {
        self.clear();
        self.sequence = sequence;
        self.stamp(at);
        self.values.extend_from_slice(values);
        self.imaginary.extend_from_slice(imaginary);
    }

    /// Sets both host times.
    pub fn stamp(&mut self, at: HostStamp) {
        self.host_monotonic_ns = at.monotonic_ns;
        self.host_wall_ns = at.wall_ns;
    }
}

/// Both host clocks, read together. Take a stamp when a frame's first byte arrives.
///
/// The monotonic clock starts at the first use in the process, so differences are meaningful across all sources of one
/// process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HostStamp {
    /// Monotonic clock, nanoseconds since the process's first stamp.
    pub monotonic_ns: u64,
    /// Wall clock, nanoseconds since 1970-01-01 UTC.
    pub wall_ns: u64,
}

/// The first use in the process, on this library's clock and on the system's.
static MONOTONIC_ORIGIN: LazyLock<(Instant, u64)> = LazyLock::new(|| (Instant::now(), system_now_ns()));

/// The system's monotonic clock, shared by all processes on a machine.
#[cfg(unix)]
fn system_now_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    (now.tv_sec as u64).saturating_mul(1_000_000_000).saturating_add(now.tv_nsec as u64)
}

/// The standard library has no such clock on other systems. There the origin is the process's first stamp.
#[cfg(not(unix))]
fn system_now_ns() -> u64 {
    0
}

impl HostStamp {
    /// Reads the clocks.
    pub fn now() -> Self {
        let (origin, _) = *MONOTONIC_ORIGIN;
        let monotonic_ns = Instant::now().saturating_duration_since(origin).as_nanos() as u64;
        let wall_ns = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
        Self { monotonic_ns, wall_ns }
    }

    /// Converts a [`Frame::host_monotonic_ns`] of this process to the system's own monotonic clock in nanoseconds
    /// (`CLOCK_MONOTONIC`, `time.monotonic_ns()` in Python, steady time in ROS). All processes on a machine share that
    /// clock, so data from two skins, a robot and a camera can be aligned. On systems without such a clock the origin
    /// stays the process's first stamp.
    pub fn on_system_clock(monotonic_ns: u64) -> u64 {
        // A browser has no clock to read here at all.
        if cfg!(unix) { monotonic_ns.saturating_add(MONOTONIC_ORIGIN.1) } else { monotonic_ns }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refilling_keeps_the_memory() {
        let mut frame = Frame::with_capacity(4);
        let memory = frame.values.as_ptr();
        for sequence in 0..3 {
            frame.refill(sequence, HostStamp::now(), &[1.0, 2.0, 3.0, f64::NAN], &[]);
        }
        assert_eq!((frame.sequence, frame.values.len()), (2, 4));
        assert_eq!(frame.values.as_ptr(), memory);
    }

    #[test]
    fn refilling_forgets_earlier_values() {
        let mut frame = Frame { device_time_ns: Some(5), imaginary: vec![1.0], ..Frame::default() };
        frame.refill(1, HostStamp { monotonic_ns: 7, wall_ns: 9 }, &[0.5], &[]);
        assert_eq!(
            frame,
            Frame { sequence: 1, host_monotonic_ns: 7, host_wall_ns: 9, values: vec![0.5], ..Frame::default() }
        );
    }

    #[cfg(unix)]
    #[test]
    fn stamps_are_brought_to_the_clock_that_all_processes_share() {
        let before = system_now_ns();
        let stamp = HostStamp::on_system_clock(HostStamp::now().monotonic_ns);
        let after = system_now_ns();
        // The two clocks of the origin are read one after the other.
        let apart = 50_000_000;
        assert!(stamp + apart >= before && stamp <= after + apart, "{before} {stamp} {after}");
    }

    #[test]
    fn the_monotonic_clock_never_runs_backwards() {
        let first = HostStamp::now();
        let second = HostStamp::now();
        assert!(second.monotonic_ns >= first.monotonic_ns);
        assert!(first.wall_ns > 0);
    }
}
