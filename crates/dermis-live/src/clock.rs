//! Corrects the times and sequence numbers of frames: clocks that jump or restart, numbers that skip, wrap or
//! restart. Time continues at its earlier pace, so that touches neither freeze nor break off, and the anomaly is
//! reported. The result depends on the frames alone, so a replay reports the same anomalies.

use dermis_device::Frame;

/// A device's clock has jumped if it is ahead by more than the time of this many frames and by [`LEAST_JUMP_NS`].
const MOST_FRAMES: u64 = 10;
/// Shorter jumps count as pauses.
const LEAST_JUMP_NS: u64 = 2_000_000_000;
/// Assumed time between frames until two have arrived, nanoseconds.
const FIRST_PERIOD_NS: u64 = 50_000_000;
/// Maximum time between the first two frames, nanoseconds: no skin is slower.
const LONGEST_PERIOD_NS: u64 = 1_000_000_000_000;
/// Averaging length of the period: a new period has the weight 1 / `SMOOTHING`.
const SMOOTHING: u64 = 8;

/// Anomalies of a frame in the stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameAnomalies {
    /// Number of frames lost before it, according to the sequence numbers.
    pub lost_before: u64,
    /// Its number is not above the previous one: the device was reset, or its counter has wrapped.
    pub renumbered: bool,
    /// Error of the clock that timestamps frames, nanoseconds: positive if it ran ahead, 0 if there was none.
    pub clock_jump_ns: i64,
}

impl FrameAnomalies {
    /// True if there are no anomalies.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// Computes a time from frames that never runs backwards and keeps the device's pace.
#[derive(Clone, Debug, Default)]
pub(crate) struct FrameClock {
    last: Option<Last>,
    period_ns: Option<u64>,
    time_ns: u64,
    first_ns: u64,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    read_ns: u64,
    sequence: u64,
}

impl FrameClock {
    /// Time of the last frame, nanoseconds, starting from the first frame's clock.
    pub fn time_ns(&self) -> u64 {
        self.time_ns
    }

    /// Time of the last frame since the first, seconds.
    pub fn elapsed_s(&self) -> f64 {
        1e-9 * self.time_ns.saturating_sub(self.first_ns) as f64
    }

    /// Takes the next frame.
    pub fn advance(&mut self, frame: &Frame) -> FrameAnomalies {
        let read_ns = frame.device_time_ns.unwrap_or(frame.host_monotonic_ns);
        let mut anomalies = FrameAnomalies::default();
        if let Some(last) = self.last {
            anomalies.renumbered = frame.sequence <= last.sequence;
            anomalies.lost_before = frame.sequence.saturating_sub(last.sequence).saturating_sub(1);
            let expected_ns = self.period_ns.unwrap_or(FIRST_PERIOD_NS).saturating_mul(anomalies.lost_before + 1);
            let elapsed_ns = read_ns.checked_sub(last.read_ns);
            // The host's own clock does not jump, so its gaps are pauses.
            let most_ns = match frame.device_time_ns {
                // No pace has been established yet.
                Some(_) if self.period_ns.is_none() => LONGEST_PERIOD_NS.saturating_mul(anomalies.lost_before + 1),
                Some(_) => expected_ns.saturating_mul(MOST_FRAMES).max(LEAST_JUMP_NS.saturating_add(expected_ns)),
                None => u64::MAX,
            };
            match elapsed_ns.filter(|elapsed| *elapsed <= most_ns) {
                Some(elapsed_ns) => {
                    self.time_ns = self.time_ns.saturating_add(elapsed_ns);
                    self.learn(elapsed_ns / (anomalies.lost_before + 1));
                }
                None => {
                    self.time_ns = self.time_ns.saturating_add(expected_ns);
                    let off = i128::from(read_ns) - i128::from(last.read_ns) - i128::from(expected_ns);
                    anomalies.clock_jump_ns = off.clamp(i64::MIN.into(), i64::MAX.into()) as i64;
                }
            }
        } else {
            (self.first_ns, self.time_ns) = (read_ns, read_ns);
        }
        self.last = Some(Last { read_ns, sequence: frame.sequence });
        anomalies
    }

    fn learn(&mut self, period_ns: u64) {
        let mean = self.period_ns.map_or(period_ns, |mean| (mean * (SMOOTHING - 1) + period_ns) / SMOOTHING);
        self.period_ns = Some(mean.max(1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 40_000_000;

    fn frame(sequence: u64, time_ns: u64) -> Frame {
        Frame { sequence, device_time_ns: Some(time_ns), host_monotonic_ns: time_ns, ..Frame::default() }
    }

    /// A clock after ten frames from `start_ns` on.
    fn running(start_ns: u64) -> FrameClock {
        let mut clock = FrameClock::default();
        for k in 0..10 {
            assert!(clock.advance(&frame(k, start_ns + k * PERIOD_NS)).is_none());
        }
        assert_eq!(clock.time_ns(), start_ns + 9 * PERIOD_NS);
        clock
    }

    #[test]
    fn clock_jumps_are_marked_and_time_continues_at_the_same_pace() {
        for (jump_ns, read_ns) in [(-3_600_000_000_000_i64, 400_000_000), (7_200_000_000_000, 10_800_400_000_000)] {
            let start_ns = 3_600_000_000_000;
            let mut clock = running(start_ns);
            let anomalies = clock.advance(&frame(10, read_ns));
            assert_eq!(anomalies, FrameAnomalies { clock_jump_ns: jump_ns, ..FrameAnomalies::default() });
            assert_eq!(clock.time_ns(), start_ns + 10 * PERIOD_NS);
            // From there on it follows the new clock.
            assert!(clock.advance(&frame(11, read_ns + PERIOD_NS)).is_none());
            assert_eq!(clock.time_ns(), start_ns + 11 * PERIOD_NS);
        }
    }

    #[test]
    fn frames_that_are_missing_are_counted_and_their_time_passes() {
        let mut clock = running(0);
        let anomalies = clock.advance(&frame(14, 14 * PERIOD_NS));
        assert_eq!(anomalies, FrameAnomalies { lost_before: 4, ..FrameAnomalies::default() });
        assert_eq!(clock.time_ns(), 14 * PERIOD_NS);
        // A long gap that the numbers account for is not a jump.
        let anomalies = clock.advance(&frame(1014, 1014 * PERIOD_NS));
        assert_eq!(anomalies, FrameAnomalies { lost_before: 999, ..FrameAnomalies::default() });
    }

    #[test]
    fn numbers_that_begin_again_are_marked_with_the_clock_that_does() {
        let mut clock = running(5_000_000_000);
        let anomalies = clock.advance(&frame(0, 0));
        assert!(anomalies.renumbered && anomalies.lost_before == 0 && anomalies.clock_jump_ns == -5_400_000_000);
        assert_eq!(clock.time_ns(), 5_000_000_000 + 10 * PERIOD_NS);
        // A 16-bit counter that wraps while its clock continues.
        let mut clock = FrameClock::default();
        clock.advance(&frame(65_535, 0));
        assert_eq!(
            clock.advance(&frame(0, PERIOD_NS)),
            FrameAnomalies { renumbered: true, ..FrameAnomalies::default() }
        );
    }

    #[test]
    fn without_a_clock_of_the_device_a_pause_is_a_pause() {
        let mut clock = FrameClock::default();
        for (sequence, time_ns) in [(0, 0), (1, PERIOD_NS), (2, 60_000_000_000)] {
            let frame = Frame { device_time_ns: None, ..frame(sequence, time_ns) };
            assert!(clock.advance(&frame).is_none());
            assert_eq!(clock.time_ns(), time_ns);
        }
    }

    #[test]
    fn frames_may_be_far_apart_from_the_start() {
        let mut clock = FrameClock::default();
        for sequence in 0..5 {
            let time_ns = 8_000_000_000 * sequence;
            assert!(clock.advance(&frame(sequence, time_ns)).is_none());
            assert_eq!(clock.time_ns(), time_ns);
        }
        // Two hours are not a plausible period.
        let mut clock = FrameClock::default();
        clock.advance(&frame(0, 0));
        assert_eq!(clock.advance(&frame(1, 7_200_000_000_000)).clock_jump_ns, 7_199_950_000_000);
    }

    #[test]
    fn absurd_times_do_not_overflow() {
        let mut clock = FrameClock::default();
        for time_ns in [0, u64::MAX, 0, u64::MAX, 1] {
            clock.advance(&frame(u64::MAX, time_ns));
        }
        assert!(clock.time_ns() < u64::MAX);
    }
}
