//! The measurements of a frame, in order: one of the lists that follow from a rule and take no memory, or a list
//! sent by the host.

use dermis_wire::{List, NO_ELECTRODE};

/// Maximum number of electrodes of a board.
pub const MOST_ELECTRODES: u8 = 64;

/// A list of measurements given by a rule.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Named {
    /// Neighbours drive, the last one with the first. For each drive, every electrode is read against the sink. With
    /// 64 electrodes these are the 4,096 measurements of paper P.
    AdjacentSink,
    /// The same against ground, for converters without a second input.
    AdjacentGround,
    /// Neighbours drive, and neighbours without a driven electrode are read, starting after the drive: n (n - 3)
    /// measurements.
    Adjacent,
    /// Each coil drives, and every coil with a higher number is read: n (n - 1) / 2 measurements.
    HigherCoils,
}

impl Named {
    /// Name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Self::AdjacentSink => "adjacent-sink",
            Self::AdjacentGround => "adjacent-ground",
            Self::Adjacent => "adjacent",
            Self::HigherCoils => "higher-coils",
        }
    }

    /// Number of measurements in a frame.
    pub fn len(self, electrodes: u8) -> u16 {
        let n = u16::from(electrodes);
        match self {
            Self::AdjacentSink | Self::AdjacentGround => n * n,
            Self::Adjacent => n * n.saturating_sub(3),
            Self::HigherCoils => n * n.saturating_sub(1) / 2,
        }
    }

    /// True if there are too few electrodes to measure anything.
    pub fn is_empty(self, electrodes: u8) -> bool {
        self.len(electrodes) == 0
    }

    /// Measurement `index`, below [`Named::len`].
    pub fn measurement(self, electrodes: u8, index: u16) -> [u8; 4] {
        let n = u16::from(electrodes);
        let round = |electrode: u16| (electrode % n) as u8;
        match self {
            Self::AdjacentSink => {
                let (drive, read) = (index / n, index % n);
                [round(drive), round(drive + 1), round(read), round(drive + 1)]
            }
            Self::AdjacentGround => {
                let (drive, read) = (index / n, index % n);
                [round(drive), round(drive + 1), round(read), NO_ELECTRODE]
            }
            Self::Adjacent => {
                let (drive, step) = (index / (n - 3), index % (n - 3));
                [round(drive), round(drive + 1), round(drive + 2 + step), round(drive + 3 + step)]
            }
            Self::HigherCoils => {
                let (mut drive, mut rest) = (0, index);
                while rest >= n - 1 - drive {
                    rest -= n - 1 - drive;
                    drive += 1;
                }
                [round(drive), NO_ELECTRODE, round(drive + 1 + rest), NO_ELECTRODE]
            }
        }
    }
}

/// The current protocol, with memory for a list of measurements.
#[derive(Debug)]
pub struct Protocol<'l> {
    electrodes: u8,
    coils: bool,
    set: Set,
    list: &'l mut [[u8; 4]],
    /// Measurements received of a list that is arriving, and their total.
    coming: (u16, u16),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Set {
    Named(Named),
    Listed { len: u16 },
}

/// Result of receiving a part of a list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Taken {
    /// More parts must follow. An earlier list is gone if its memory has been reused.
    Part,
    /// The list is complete and set.
    Whole,
    /// The list doesn't fit or cannot be measured.
    Refused,
}

impl<'l> Protocol<'l> {
    /// A rule-based protocol, for electrodes or for `coils`.
    pub fn new(electrodes: u8, coils: bool, named: Named, list: &'l mut [[u8; 4]]) -> Self {
        Self { electrodes, coils, set: Set::Named(named), list, coming: (0, 0) }
    }

    /// Number of measurements in a frame.
    pub fn len(&self) -> u16 {
        match self.set {
            Set::Named(named) => named.len(self.electrodes),
            Set::Listed { len } => len,
        }
    }

    /// True if there is nothing to measure.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Name on the wire.
    pub fn name(&self) -> &'static str {
        match self.set {
            Set::Named(named) => named.name(),
            Set::Listed { .. } => "listed",
        }
    }

    /// Measurement `index`, below [`Protocol::len`].
    pub fn measurement(&self, index: u16) -> [u8; 4] {
        match self.set {
            Set::Named(named) => named.measurement(self.electrodes, index),
            Set::Listed { .. } => self.list[usize::from(index)],
        }
    }

    /// Sets a rule-based protocol.
    pub fn set_named(&mut self, named: Named) {
        (self.set, self.coming) = (Set::Named(named), (0, 0));
    }

    /// Takes a part of a list. Parts arrive in order, and the list is set with the last one. If a list was set
    /// before, `fallback` applies until then.
    pub fn take(&mut self, first: u16, total: u16, part: List<'_, [u8; 4]>, fallback: Named) -> Taken {
        let continues = first == 0 || (first, total) == self.coming;
        let fits = total > 0 && usize::from(total) <= self.list.len() && !part.is_empty();
        let known = part.iter().all(|measurement| self.can_measure(measurement));
        if !(continues && fits && known) {
            self.coming = (0, 0);
            return Taken::Refused;
        }
        if matches!(self.set, Set::Listed { .. }) {
            self.set = Set::Named(fallback);
        }
        let room = &mut self.list[usize::from(first)..usize::from(total)];
        room.iter_mut().zip(part.iter()).for_each(|(place, measurement)| *place = measurement);
        // The wire has checked that a part ends within its list.
        self.coming = (first + part.len() as u16, total);
        if self.coming.0 < total {
            return Taken::Part;
        }
        self.coming = (0, 0);
        self.set = Set::Listed { len: total };
        Taken::Whole
    }

    fn can_measure(&self, [source, sink, positive, negative]: [u8; 4]) -> bool {
        let there = |electrode: u8| electrode < self.electrodes;
        let there_or_ground = |electrode: u8| electrode == NO_ELECTRODE || there(electrode);
        if self.coils {
            return there(source) && there(positive) && source != positive && [sink, negative] == [NO_ELECTRODE; 2];
        }
        there(source) && there_or_ground(sink) && there(positive) && there_or_ground(negative)
    }
}
