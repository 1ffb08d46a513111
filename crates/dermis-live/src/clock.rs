//! The time and the numbers of frames, where they are not what they should be: clocks that jump or start anew, numbers
//! that skip, wrap or begin again. Time goes on at the pace it had, so that touches neither freeze nor tear off, and
//! what happened is marked. It follows from the frames alone, so that a replay anomalies the same.

use dermis_device::Frame;

/// A device's clock that is ahead by more than this many frames' time, and by [`LEAST_JUMP_NS`], has jumped.
const MOST_FRAMES: u64 = 10;
/// Shorter jumps are taken for pauses.
const LEAST_JUMP_NS: u64 = 2_000_000_000;
/// Time between frames before two have come, nanoseconds.
const FIRST_PERIOD_NS: u64 = 50_000_000;
/// The first two frames may be so far apart, nanoseconds: slower skins are none.
const LONGEST_PERIOD_NS: u64 = 1_000_000_000_000;
/// One in so many parts of a new period enters the mean.
const SMOOTHING: u64 = 8;

/// What is odd about a frame's place in the stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameAnomalies {
    /// Frames that the numbers say should have come before it.
    pub lost_before: u64,
    /// Its number is not above the one before: the device was reset, or its counter has wrapped.
    pub renumbered: bool,
    /// The clock that times frames was off by this, nanoseconds: positive where it ran ahead. 0: it was not.
    pub clock_jump_ns: i64,
}

impl FrameAnomalies {
    /// True where nothing is odd.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// Makes a time that never runs back, at the device's pace, out of frames.
#[derive(Clone, Debug, Default)]
pub(crate) struct FrameClock {
    last: Option<Last>,
    period_ns: Option<u64>,
    time_ns: u64,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    read_ns: u64,
    sequence: u64,
}

impl FrameClock {
    /// Time of the last frame, nanoseconds, from where the first one's clock stood.
    pub fn time_ns(&self) -> u64 {
        self.time_ns
    }

    /// Takes in the next frame.
    pub fn advance(&mut self, frame: &Frame) -> FrameAnomalies {
        let read_ns = frame.device_time_ns.unwrap_or(frame.host_monotonic_ns);
        let mut anomalies = FrameAnomalies::default();
        if let Some(last) = self.last {
            anomalies.renumbered = frame.sequence <= last.sequence;
            anomalies.lost_before = frame.sequence.saturating_sub(last.sequence).saturating_sub(1);
            let expected_ns = self.period_ns.unwrap_or(FIRST_PERIOD_NS).saturating_mul(anomalies.lost_before + 1);
            let elapsed_ns = read_ns.checked_sub(last.read_ns);
            // The host's own clock does not jump: what it shows are pauses.
            let most_ns = match frame.device_time_ns {
                // There is no pace yet that it could have left.
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
            self.time_ns = read_ns;
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
    fn a_clock_set_back_or_ahead_is_marked_and_time_goes_on_at_its_pace() {
        for (jump_ns, read_ns) in [(-3_600_000_000_000_i64, 400_000_000), (7_200_000_000_000, 10_800_400_000_000)] {
            let start_ns = 3_600_000_000_000;
            let mut clock = running(start_ns);
            let anomalies = clock.advance(&frame(10, read_ns));
            assert_eq!(anomalies, FrameAnomalies { clock_jump_ns: jump_ns, ..FrameAnomalies::default() });
            assert_eq!(clock.time_ns(), start_ns + 10 * PERIOD_NS);
            // From there on the new clock is followed.
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
        // A long gap that the numbers account for is no jump.
        let anomalies = clock.advance(&frame(1014, 1014 * PERIOD_NS));
        assert_eq!(anomalies, FrameAnomalies { lost_before: 999, ..FrameAnomalies::default() });
    }

    #[test]
    fn numbers_that_begin_again_are_marked_with_the_clock_that_does() {
        let mut clock = running(5_000_000_000);
        let anomalies = clock.advance(&frame(0, 0));
        assert!(anomalies.renumbered && anomalies.lost_before == 0 && anomalies.clock_jump_ns == -5_400_000_000);
        assert_eq!(clock.time_ns(), 5_000_000_000 + 10 * PERIOD_NS);
        // A counter of 16 bits that wraps, its clock going on.
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
        // Two hours are no pace.
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
