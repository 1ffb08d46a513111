//! State of a scan: the next measurement, and the readings waiting to be sent.

use dermis_wire::Status;

use crate::board::Reading;

/// Readings per part of a frame.
pub const PART_READINGS: usize = 128;

/// A scan through the measurements of a frame.
#[derive(Debug, Clone)]
pub(crate) struct Scan {
    /// Number of the frame.
    pub(crate) sequence: u32,
    /// Index of the next measurement.
    pub(crate) index: u16,
    /// Number of readings held, which precede `index`.
    pub(crate) held: usize,
    pub(crate) readings: [i16; PART_READINGS],
    /// Times after the start of the first reading held, ns.
    pub(crate) times_ns: [u32; PART_READINGS],
    /// Start of the first reading held, ns.
    pub(crate) part_ns: u64,
    /// Events during the readings held.
    pub(crate) status: Status,
    /// Events during the frame.
    pub(crate) frame_status: Status,
    /// Largest magnitude among the frame's readings, counts.
    pub(crate) largest: u16,
    /// Start of the frame, ns.
    pub(crate) frame_ns: u64,
    /// Start of the current reading, ns.
    pub(crate) reading_ns: Option<u64>,
}

impl Scan {
    pub(crate) fn new() -> Self {
        Self {
            sequence: 0,
            index: 0,
            held: 0,
            readings: [0; PART_READINGS],
            times_ns: [0; PART_READINGS],
            part_ns: 0,
            status: Status::default(),
            frame_status: Status::default(),
            largest: 0,
            frame_ns: 0,
            reading_ns: None,
        }
    }

    /// True between frames.
    pub(crate) fn is_between(&self) -> bool {
        self.index == 0 && self.reading_ns.is_none()
    }

    /// Restarts the frame.
    pub(crate) fn restart(&mut self) {
        (self.index, self.held, self.reading_ns) = (0, 0, None);
        (self.status, self.frame_status, self.largest) = (Status::default(), Status::default(), 0);
    }

    /// Moves on after the frame has been sent.
    pub(crate) fn next_frame(&mut self) {
        self.sequence = self.sequence.wrapping_add(1);
        self.restart();
    }

    /// Stores a reading; there must be room for it.
    pub(crate) fn keep(&mut self, reading: Reading) {
        let began_ns = self.reading_ns.take().unwrap_or(self.part_ns);
        if self.index == 0 {
            self.frame_ns = began_ns;
        }
        if self.held == 0 {
            (self.part_ns, self.status) = (began_ns, Status::default());
        }
        self.readings[self.held] = reading.counts;
        self.times_ns[self.held] = u32::try_from(began_ns.saturating_sub(self.part_ns)).unwrap_or(u32::MAX);
        self.status = self.status.with(reading.status);
        self.frame_status = self.frame_status.with(reading.status);
        self.largest = self.largest.max(reading.counts.unsigned_abs());
        self.held += 1;
        self.index += 1;
    }
}
