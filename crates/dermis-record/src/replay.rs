//! Plays a recording as a source, at its own pace, at a given rate or as fast as frames are requested.

use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::thread;
use std::time::{Duration, Instant};

use dermis_device::{Counters, DeviceError, Frame, HostStamp, Layout, Pacing, Repeat, Source, SourceEvent};

use super::Recording;

/// A [`Recording`] as a [`Source`].
///
/// Readings and sequence numbers are those of the recording, and gaps in the numbers count as lost; when the
/// recording is repeated, the numbers continue. Host times are taken when a frame is delivered. The device time is
/// the device's if it sent one, otherwise the recorded host time since the first frame, so that the original times
/// are available at any pace.
pub struct Replay<R = BufReader<File>> {
    recording: Recording<R>,
    name: String,
    pacing: Pacing,
    repeat: Repeat,
    /// The next frame, read in advance to know when it is due.
    ahead: Frame,
    ahead_is_there: bool,
    due: Option<Instant>,
    /// Recorded host times of the first and last frames delivered in this pass.
    first_ns: Option<u64>,
    last_ns: Option<u64>,
    /// Recorded sequence number of the last frame delivered in this pass, and the number it was delivered with.
    last_recorded: Option<u64>,
    last_sequence: Option<u64>,
    last_distance: Duration,
    counters: Counters,
    bad_before: u64,
}

impl<R> std::fmt::Debug for Replay<R> {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("Replay")
            .field("recording", &self.recording)
            .field("pacing", &self.pacing)
            .finish_non_exhaustive()
    }
}

impl<R: Read + Seek + Send> Replay<R> {
    /// Plays `recording` from its first frame.
    ///
    /// # Errors
    /// [`DeviceError::Pacing`] for a rate that is not positive.
    pub fn new(mut recording: Recording<R>, pacing: Pacing, repeat: Repeat) -> Result<Self, DeviceError> {
        if let Pacing::Rate { frames_per_s } = pacing
            && !(frames_per_s.is_finite() && frames_per_s > 0.0)
        {
            let expected = "a positive number of frames per second";
            let (file, found) = (recording.path().to_owned(), frames_per_s.to_string());
            return Err(DeviceError::Pacing { file, expected, found });
        }
        recording.rewind();
        let name = recording.path().display().to_string();
        Ok(Self {
            recording,
            name,
            pacing,
            repeat,
            ahead: Frame::default(),
            ahead_is_there: false,
            due: None,
            first_ns: None,
            last_ns: None,
            last_recorded: None,
            last_sequence: None,
            last_distance: Duration::ZERO,
            counters: Counters::default(),
            bad_before: 0,
        })
    }

    /// The recording, for its skin and its damage.
    pub fn recording(&self) -> &Recording<R> {
        &self.recording
    }

    /// Reads the next frame in advance; returns false after the last.
    fn read_ahead(&mut self) -> Result<bool, DeviceError> {
        while !self.ahead_is_there {
            if self.read_frame()? {
                self.ahead_is_there = true;
            } else if self.repeat == Repeat::Once || self.last_ns.is_none() {
                // Don't repeat a recording without any readable frame.
                return Ok(false);
            } else {
                self.bad_before += self.recording.damage().messages;
                self.recording.rewind();
                (self.first_ns, self.last_ns, self.last_recorded) = (None, None, None);
                continue;
            }
            let distance = self.distance();
            self.due = match self.pacing {
                Pacing::Immediate => None,
                _ => self.due.and_then(|due| due.checked_add(distance)),
            };
        }
        Ok(true)
    }

    fn read_frame(&mut self) -> Result<bool, DeviceError> {
        self.recording.try_next_frame(&mut self.ahead).map_err(|source| DeviceError::Io {
            file: self.recording.path().to_owned(),
            action: "read",
            source,
        })
    }

    /// Time between the frame read in advance and the one before it. For the first frame of a repetition, the
    /// interval between the last two.
    fn distance(&mut self) -> Duration {
        // Clocks cannot be set arbitrarily far ahead, and a day is as good as forever. Times that go back give a zero
        // interval.
        const LONGEST: Duration = Duration::from_secs(86_400);
        let distance = match (self.pacing, self.last_ns) {
            (Pacing::Rate { frames_per_s }, _) => Duration::try_from_secs_f64(frames_per_s.recip()).unwrap_or(LONGEST),
            (_, Some(last_ns)) => Duration::from_nanos(self.ahead.host_monotonic_ns.saturating_sub(last_ns)),
            (_, None) => self.last_distance,
        };
        self.last_distance = distance.min(LONGEST);
        self.last_distance
    }

    /// Sequence number for the frame read in advance; also counts frames that the recording lost before it.
    fn number(&mut self) -> u64 {
        let recorded = self.ahead.sequence;
        let lost = self.last_recorded.map_or(0, |last| recorded.saturating_sub(last).saturating_sub(1));
        self.counters.lost = self.counters.lost.saturating_add(lost);
        let number = match self.last_sequence {
            Some(last) => last.wrapping_add(1).wrapping_add(lost),
            None => recorded,
        };
        (self.last_recorded, self.last_sequence) = (Some(recorded), Some(number));
        number
    }

    /// Sleeps until the next frame is due, at most `timeout`; returns true if it is due.
    fn wait(&self, timeout: Duration) -> bool {
        let Some(due) = self.due else { return true };
        let left = due.saturating_duration_since(Instant::now());
        thread::sleep(left.min(timeout));
        left <= timeout
    }
}

impl<R: Read + Seek + Send> Source for Replay<R> {
    fn layout(&self) -> &Layout {
        &self.recording.head().layout
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn next_frame(&mut self, frame: &mut Frame, timeout: Duration) -> Result<SourceEvent, DeviceError> {
        if !self.read_ahead()? {
            return Ok(SourceEvent::End);
        }
        if !self.wait(timeout) {
            return Ok(SourceEvent::Idle);
        }
        let sequence = self.number();
        let recorded_ns = self.ahead.host_monotonic_ns;
        let first_ns = *self.first_ns.get_or_insert(recorded_ns);
        self.last_ns = Some(recorded_ns);
        std::mem::swap(frame, &mut self.ahead);
        self.ahead_is_there = false;
        frame.sequence = sequence;
        frame.device_time_ns.get_or_insert(recorded_ns.saturating_sub(first_ns));
        frame.stamp(HostStamp::now());
        if self.due.is_none() && self.pacing != Pacing::Immediate {
            self.due = Some(Instant::now());
        }
        self.counters.frames += 1;
        Ok(SourceEvent::Frame)
    }

    fn counters(&self) -> Counters {
        let bad = self.bad_before.saturating_add(self.recording.damage().messages);
        Counters { bad, ..self.counters }
    }

    fn incomplete(&self) -> Option<String> {
        let damage = self.recording.damage();
        (!damage.is_none()).then(|| format!("{}: parts could not be read: {damage}", self.recording.path().display()))
    }
}
