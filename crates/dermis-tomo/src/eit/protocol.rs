//! Stimulation and measurement patterns as explicit lists, and generators for the patterns common in the field.
//!
//! A drive pair `(a, b)` puts `-I` on electrode `a` and `+I` on `b`; a measuring pair `(a, b)` reads `U_a - U_b` (the
//! EIDORS convention). Indices are zero-based.

mod generators;

use std::collections::HashMap;

use thiserror::Error;

/// A sparse vector over electrodes: `(electrode, weight)`, sorted by electrode, no zeros.
#[derive(Clone, Debug, PartialEq)]
pub struct Pattern(Vec<(u32, f64)>);

impl Pattern {
    /// Sorts, merges and drops zeros.
    pub fn new(mut entries: Vec<(u32, f64)>) -> Self {
        entries.sort_unstable_by_key(|entry| entry.0);
        let mut merged: Vec<(u32, f64)> = Vec::with_capacity(entries.len());
        for (electrode, weight) in entries {
            match merged.last_mut() {
                Some(last) if last.0 == electrode => last.1 += weight,
                _ => merged.push((electrode, weight)),
            }
        }
        merged.retain(|entry| entry.1 != 0.0);
        Self(merged)
    }

    /// A pair with weights `first` on `a` and `-first` on `b`.
    pub fn pair(a: u32, b: u32, first: f64) -> Self {
        Self::new(vec![(a, first), (b, -first)])
    }

    /// The entries, sorted by electrode.
    pub fn entries(&self) -> &[(u32, f64)] {
        &self.0
    }

    /// Sum of the weights; zero for a balanced pattern.
    pub fn sum(&self) -> f64 {
        self.0.iter().map(|entry| entry.1).sum()
    }

    /// True if this electrode has a weight.
    pub fn touches(&self, electrode: u32) -> bool {
        self.0.iter().any(|entry| entry.0 == electrode)
    }

    fn key(&self) -> Vec<(u32, u64)> {
        self.0.iter().map(|&(electrode, weight)| (electrode, weight.to_bits())).collect()
    }
}

/// One channel: its stimulation and its measuring pattern.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Measurement {
    /// Index into [`Protocol::stimulations`].
    pub stimulation: u32,
    /// Index into [`Protocol::patterns`].
    pub pattern: u32,
}

/// Errors of a protocol.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum ProtocolError {
    /// Fewer electrodes than the generator needs.
    #[error("{pattern} needs at least {needed} electrodes{even}, got {got}", even = if *.even { " and an even number" } else { "" })]
    TooFewElectrodes {
        /// Name of the generator.
        pattern: &'static str,
        /// Minimum number.
        needed: usize,
        /// True if the count must be even.
        even: bool,
        /// Number requested.
        got: usize,
    },
    /// An electrode that does not exist.
    #[error("{what} {index} names electrode index {electrode}, but there are only {count} electrodes")]
    ElectrodeOutOfRange {
        /// `stimulation` or `measurement`.
        what: &'static str,
        /// Index in its list.
        index: usize,
        /// Index of the electrode.
        electrode: usize,
        /// Number of electrodes.
        count: usize,
    },
    /// The currents of a stimulation do not sum to zero, or there is no current.
    #[error("stimulation {index}: currents add to {sum:e} A, expected 0 with at least two electrodes driven")]
    Unbalanced {
        /// Index of the stimulation.
        index: usize,
        /// Net current.
        sum: f64,
    },
    /// A row has the wrong length or a list the wrong count.
    #[error("{what} {index}: expected {expected} values, got {got}")]
    Length {
        /// Name of the list.
        what: &'static str,
        /// Index of the row.
        index: usize,
        /// Expected length.
        expected: usize,
        /// Found length.
        got: usize,
    },
    /// A weight is NaN or infinite, or an amplitude is not positive.
    #[error("{what} {index}: {value} is not {expected}")]
    Value {
        /// Name of the list.
        what: &'static str,
        /// Index of the row.
        index: usize,
        /// The value.
        value: f64,
        /// Expected values.
        expected: &'static str,
    },
    /// No channel is left.
    #[error("the protocol has no measurements left after dropping driven electrodes")]
    Empty,
}

/// Drive patterns, one after another.
#[derive(Clone, Debug, PartialEq)]
pub enum Drive {
    /// Pairs (k, k+1).
    Adjacent,
    /// Pairs (k, k+L/2).
    Opposite,
    /// Pairs (k, k+n+1); `Skip(0)` is adjacent.
    Skip(usize),
    /// Pairs (k, k+L/2-1): the 'pseudo-polar' pattern of paper H.
    PseudoPolar,
    /// cos(m theta) for m = 1..L/2 and sin(m theta) for m = 1..L/2-1 over all electrodes: L-1 patterns.
    Trigonometric,
    /// Listed pairs (sink, source).
    Pairs(Vec<(u32, u32)>),
}

/// Readings for each drive.
#[derive(Clone, Debug, PartialEq)]
pub enum Measure {
    /// Pairs (j, j+1).
    Adjacent,
    /// Pairs (j, j+L/2).
    Opposite,
    /// Pairs (j, j+n+1).
    Skip(usize),
    /// Pairs (j, j+L/2-1).
    PseudoPolar,
    /// Every electrode against a reference.
    SingleEnded(Reference),
    /// The same listed pairs (+, -) for every drive.
    Pairs(Vec<(u32, u32)>),
}

/// Reference of single-ended voltages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reference {
    /// One electrode.
    Electrode(u32),
    /// The electrode that sinks the current of the current drive (grounded sink).
    Sink,
    /// The mean of all electrodes.
    Mean,
}

/// Start of the list of measurements of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// At electrode 1 for every drive.
    Absolute,
    /// At the first electrode of the drive, wrapping around.
    Rotating,
}

/// Treatment of channels that touch a driven electrode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Driven {
    /// They are kept.
    Keep,
    /// They are dropped.
    Drop,
}

/// Input of [`Protocol::generate`].
#[derive(Clone, Debug, PartialEq)]
pub struct ProtocolSpec {
    /// Number of electrodes.
    pub electrode_count: usize,
    /// Drive patterns.
    pub drive: Drive,
    /// Measuring patterns.
    pub measure: Measure,
    /// Order of the measurements of a drive.
    pub order: Order,
    /// Treatment of channels on driven electrodes.
    pub driven: Driven,
    /// Drive amplitude, amperes.
    pub amplitude_a: f64,
}

/// Stimulations (amperes into the body), measuring patterns, and the channels that pair them.
#[derive(Clone, Debug, PartialEq)]
pub struct Protocol {
    electrode_count: usize,
    stimulations: Vec<Pattern>,
    patterns: Vec<Pattern>,
    measurements: Vec<Measurement>,
}

impl Protocol {
    /// Builds a protocol from dense rows as in `case.json`: `stimulations` (n_stim x n_electrodes, amperes),
    /// `measurements` (n_meas x n_electrodes), and the stimulation of each measurement.
    ///
    /// # Errors
    /// Rows of unequal length, non-finite values, unbalanced stimulations, stimulation indices out of range.
    pub fn from_rows(
        stimulations: &[Vec<f64>],
        measurements: &[Vec<f64>],
        stimulation_of: &[usize],
    ) -> Result<Self, ProtocolError> {
        let electrode_count = stimulations.first().map_or(0, Vec::len);
        let sparse = |what: &'static str, rows: &[Vec<f64>]| -> Result<Vec<Pattern>, ProtocolError> {
            rows.iter()
                .enumerate()
                .map(|(index, row)| {
                    if row.len() != electrode_count {
                        return Err(ProtocolError::Length { what, index, expected: electrode_count, got: row.len() });
                    }
                    Ok(Pattern::new(row.iter().enumerate().map(|(electrode, &w)| (electrode as u32, w)).collect()))
                })
                .collect()
        };
        if stimulation_of.len() != measurements.len() {
            return Err(ProtocolError::Length {
                what: "stimulation of each measurement, list",
                index: 0,
                expected: measurements.len(),
                got: stimulation_of.len(),
            });
        }
        let channels = sparse("measurement", measurements)?.into_iter().zip(stimulation_of.iter().copied()).collect();
        Self::from_patterns(electrode_count, sparse("stimulation", stimulations)?, channels)
    }

    /// Builds a protocol from sparse patterns: the stimulations, and the measuring pattern and stimulation index of
    /// each channel.
    ///
    /// # Errors
    /// As [`Protocol::from_rows`].
    pub fn from_patterns(
        electrode_count: usize,
        stimulations: Vec<Pattern>,
        channels: Vec<(Pattern, usize)>,
    ) -> Result<Self, ProtocolError> {
        for (index, stimulation) in stimulations.iter().enumerate() {
            check_pattern("stimulation", index, stimulation, electrode_count)?;
            let scale = stimulation.entries().iter().map(|entry| entry.1.abs()).fold(0.0, f64::max);
            if stimulation.entries().len() < 2 || stimulation.sum().abs() > 1e-6 * scale {
                return Err(ProtocolError::Unbalanced { index, sum: stimulation.sum() });
            }
        }
        let mut patterns: Vec<Pattern> = Vec::new();
        let mut known: HashMap<Vec<(u32, u64)>, u32> = HashMap::new();
        let mut measurements = Vec::with_capacity(channels.len());
        for (index, (pattern, stimulation)) in channels.into_iter().enumerate() {
            check_pattern("measurement", index, &pattern, electrode_count)?;
            if stimulation >= stimulations.len() {
                return Err(ProtocolError::Value {
                    what: "stimulation index of measurement",
                    index,
                    value: stimulation as f64,
                    expected: "an existing stimulation",
                });
            }
            let id = *known.entry(pattern.key()).or_insert_with(|| {
                patterns.push(pattern);
                patterns.len() as u32 - 1
            });
            measurements.push(Measurement { stimulation: stimulation as u32, pattern: id });
        }
        if measurements.is_empty() {
            return Err(ProtocolError::Empty);
        }
        Ok(Self { electrode_count, stimulations, patterns, measurements })
    }

    /// Number of electrodes.
    pub fn electrode_count(&self) -> usize {
        self.electrode_count
    }

    /// Stimulations, amperes into the body.
    pub fn stimulations(&self) -> &[Pattern] {
        &self.stimulations
    }

    /// The distinct measuring patterns.
    pub fn patterns(&self) -> &[Pattern] {
        &self.patterns
    }

    /// The channels in order.
    pub fn measurements(&self) -> &[Measurement] {
        &self.measurements
    }

    /// Number of channels in a frame.
    pub fn channel_count(&self) -> usize {
        self.measurements.len()
    }

    /// The measuring pattern of a channel.
    pub fn pattern_of(&self, channel: usize) -> &Pattern {
        &self.patterns[self.measurements[channel].pattern as usize]
    }

    /// The stimulation of a channel.
    pub fn stimulation_of(&self, channel: usize) -> &Pattern {
        &self.stimulations[self.measurements[channel].stimulation as usize]
    }

    /// True if the channel drives or reads this electrode.
    pub fn channel_touches(&self, channel: usize, electrode: u32) -> bool {
        self.pattern_of(channel).touches(electrode) || self.stimulation_of(channel).touches(electrode)
    }

    /// A label for display, one-based: `1-2 > 5-6`, the drive first, then the measurement, each pair in the order of
    /// a skin file. Current enters at the drive's second electrode and leaves at its first; the reading is the
    /// potential of the first measuring electrode minus that of the second. With 16 electrodes the last adjacent pair
    /// is `16-1`.
    pub fn channel_label(&self, channel: usize) -> String {
        let list = |pattern: &Pattern, first: f64| {
            let mut entries: Vec<(u32, f64)> = pattern.entries().to_vec();
            // Patterns of more than two electrodes are listed by number.
            if entries.len() == 2 {
                entries.sort_by(|a, b| (first * b.1).total_cmp(&(first * a.1)));
            }
            let names: Vec<String> = entries.iter().take(3).map(|e| (e.0 + 1).to_string()).collect();
            format!("{}{}", names.join("-"), if entries.len() > 3 { ".." } else { "" })
        };
        format!("{} > {}", list(self.stimulation_of(channel), -1.0), list(self.pattern_of(channel), 1.0))
    }
}

fn check_pattern(what: &'static str, index: usize, pattern: &Pattern, count: usize) -> Result<(), ProtocolError> {
    for &(electrode, weight) in pattern.entries() {
        if electrode as usize >= count {
            return Err(ProtocolError::ElectrodeOutOfRange { what, index, electrode: electrode as usize, count });
        }
        if !weight.is_finite() {
            return Err(ProtocolError::Value { what, index, value: weight, expected: "finite" });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
