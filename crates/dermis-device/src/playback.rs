//! Plays a recording as a source: at its own pace, at a given rate, or on demand.

use std::thread;
use std::time::{Duration, Instant};

use crate::{Counters, DeviceError, Frame, FrameTable, HostStamp, Layout, Source, SourceEvent};

/// Timing of a recording's frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pacing {
    /// On demand.
    Immediate,
    /// At the recorded intervals.
    Recorded,
    /// At a constant rate.
    Rate {
        /// Frames per second.
        frames_per_s: f64,
    },
}

/// Behaviour after a recording's last frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Repeat {
    /// The source ends.
    Once,
    /// The recording starts again from its first frame; sequence numbers continue.
    Forever,
}

/// A [`FrameTable`] as a [`Source`].
///
/// Frames are stamped when they are delivered. Sequence numbers are the recording's, and gaps count as lost frames. A
/// recording without sequence numbers is numbered from 0.
#[derive(Debug)]
pub struct Playback {
    table: FrameTable,
    name: String,
    pacing: Pacing,
    repeat: Repeat,
    next: usize,
    due: Option<Instant>,
    sequence: Option<u64>,
    counters: Counters,
}

impl Playback {
    /// Plays `table` from its first frame.
    ///
    /// # Errors
    /// [`DeviceError::Pacing`] for [`Pacing::Recorded`] without finite recorded times, or a rate that is not positive.
    pub fn new(table: FrameTable, pacing: Pacing, repeat: Repeat) -> Result<Self, DeviceError> {
        let refuse = |expected, found| DeviceError::Pacing { file: table.source().to_owned(), expected, found };
        match (pacing, table.times_s()) {
            (Pacing::Recorded, None) => return Err(refuse("recorded frame times", "none".to_owned())),
            (Pacing::Recorded, Some(times)) => {
                if let Some(time_s) = times.iter().find(|time_s| !time_s.is_finite()) {
                    return Err(refuse("finite frame times", format!("{time_s} s")));
                }
            }
            (Pacing::Rate { frames_per_s }, _) if !(frames_per_s.is_finite() && frames_per_s > 0.0) => {
                return Err(refuse("a positive number of frames per second", frames_per_s.to_string()));
            }
            _ => {}
        }
        let name = table.source().display().to_string();
        let counters = Counters::default();
        Ok(Self { table, name, pacing, repeat, next: 0, due: None, sequence: None, counters })
    }

    /// The recording.
    pub fn table(&self) -> &FrameTable {
        &self.table
    }

    /// Sleeps until the next frame is due, but at most `timeout`. Returns true if it is due.
    fn wait(&self, timeout: Duration) -> bool {
        let Some(due) = self.due else { return true };
        let left = due.saturating_duration_since(Instant::now());
        thread::sleep(left.min(timeout));
        left <= timeout
    }

    /// Time between frame `index` and the previous one. When the recording repeats, its mean interval separates the
    /// last frame from the first.
    fn distance(&self, index: usize) -> Duration {
        let seconds = match (self.pacing, self.table.times_s()) {
            (Pacing::Rate { frames_per_s }, _) => frames_per_s.recip(),
            (Pacing::Recorded, Some(times)) if index > 0 => times[index] - times[index - 1],
            (Pacing::Recorded, Some(times)) => {
                let last = times.len() - 1;
                (times[last] - times[0]) / last.max(1) as f64
            }
            _ => 0.0,
        };
        // Clocks can't be set arbitrarily far ahead; a day is as good as never. Negative intervals count as zero.
        const LONGEST_S: f64 = 86_400.0;
        Duration::try_from_secs_f64(seconds.min(LONGEST_S)).unwrap_or_default()
    }

    /// Sequence number of frame `index`. Counts the frames that the recording lost before it.
    fn number(&mut self, index: usize) -> u64 {
        let following = self.sequence.map_or(0, |sequence| sequence.wrapping_add(1));
        let step = match self.table.sequences() {
            Some(numbers) if index > 0 => numbers[index].saturating_sub(numbers[index - 1]).saturating_sub(1),
            _ => 0,
        };
        self.counters.lost = self.counters.lost.saturating_add(step);
        let first = self.table.sequences().map_or(0, |numbers| numbers[0]);
        let number = if self.sequence.is_none() { first } else { following.wrapping_add(step) };
        self.sequence = Some(number);
        number
    }
}

impl Source for Playback {
    fn layout(&self) -> &Layout {
        self.table.layout()
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn next_frame(&mut self, frame: &mut Frame, timeout: Duration) -> Result<SourceEvent, DeviceError> {
        if self.next == self.table.frames() {
            match self.repeat {
                Repeat::Once => return Ok(SourceEvent::End),
                Repeat::Forever => self.next = 0,
            }
        }
        if !self.wait(timeout) {
            return Ok(SourceEvent::Idle);
        }
        let index = self.next;
        let sequence = self.number(index);
        let values = self.table.row(index).unwrap_or_default();
        let imaginary = self.table.imaginary_row(index).unwrap_or_default();
        frame.refill(sequence, HostStamp::now(), values, imaginary);
        frame.device_time_ns = self.table.times_s().map(|times| ((times[index] - times[0]) * 1e9) as u64);
        self.counters.frames += 1;
        self.next += 1;
        let after = self.distance(self.next % self.table.frames());
        self.due = match self.pacing {
            Pacing::Immediate => None,
            _ => Some(self.due.unwrap_or_else(Instant::now) + after),
        };
        Ok(SourceEvent::Frame)
    }

    fn counters(&self) -> Counters {
        self.counters
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> FrameTable {
        let values = vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        FrameTable::new(Layout::Channels { count: 2 }, values, "made.csv").unwrap()
    }

    fn drain(source: &mut dyn Source, most: usize) -> Vec<(u64, Vec<f64>)> {
        let mut frame = Frame::with_capacity(2);
        let mut seen = Vec::new();
        while seen.len() < most && source.next_frame(&mut frame, Duration::MAX).unwrap() == SourceEvent::Frame {
            seen.push((frame.sequence, frame.values.clone()));
        }
        seen
    }

    #[test]
    fn every_frame_arrives_once_and_then_the_end() {
        let mut source = Playback::new(table(), Pacing::Immediate, Repeat::Once).unwrap();
        assert_eq!(drain(&mut source, 9), [(0, vec![1.0, 2.0]), (1, vec![3.0, 4.0]), (2, vec![5.0, 6.0])]);
        assert_eq!(source.next_frame(&mut Frame::default(), Duration::ZERO).unwrap(), SourceEvent::End);
        assert_eq!(source.counters(), Counters { frames: 3, lost: 0, bad: 0 });
    }

    #[test]
    fn repetitions_continue_the_numbering_and_gaps_are_lost_frames() {
        let table = table().with_sequences(vec![5, 8, 9]).unwrap();
        let mut source = Playback::new(table, Pacing::Immediate, Repeat::Forever).unwrap();
        let numbers: Vec<u64> = drain(&mut source, 7).iter().map(|(sequence, _)| *sequence).collect();
        assert_eq!(numbers, [5, 8, 9, 10, 13, 14, 15]);
        assert_eq!(source.counters(), Counters { frames: 7, lost: 4, bad: 0 });
    }

    #[test]
    fn a_frame_that_is_not_due_yet_is_idle_and_not_lost() {
        let table = table().with_times_s(vec![10.0, 10.0, 1e300]).unwrap();
        let mut source = Playback::new(table, Pacing::Recorded, Repeat::Once).unwrap();
        let mut frame = Frame::default();
        assert_eq!(source.next_frame(&mut frame, Duration::ZERO).unwrap(), SourceEvent::Frame);
        assert_eq!(source.next_frame(&mut frame, Duration::MAX).unwrap(), SourceEvent::Frame);
        let before = frame.clone();
        assert_eq!(source.next_frame(&mut frame, Duration::from_millis(1)).unwrap(), SourceEvent::Idle);
        assert_eq!(frame, before, "an idle wait must leave the frame alone");
        assert_eq!(source.counters().frames, 2);
    }

    #[test]
    fn unusable_pacing_is_refused() {
        assert!(Playback::new(table(), Pacing::Recorded, Repeat::Once).is_err());
        let timed = table().with_times_s(vec![0.0, f64::NAN, 1.0]).unwrap();
        assert!(Playback::new(timed, Pacing::Recorded, Repeat::Once).is_err());
        for frames_per_s in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(Playback::new(table(), Pacing::Rate { frames_per_s }, Repeat::Once).is_err());
        }
    }
}
