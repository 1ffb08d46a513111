//! Generators for common protocols (adjacent, opposite, trigonometric and others) and for pairs of coils.

use super::{Drive, Driven, Measure, Measurement, Order, Pattern, Protocol, ProtocolError, ProtocolSpec, Reference};

impl Protocol {
    /// Coils drive one after another while those with higher numbers are read: N(N-1)/2 channels (0, 1), (0, 2), ...,
    /// (N-2, N-1). For magnetic induction, where a coil's current needs no other coil as a return path.
    ///
    /// # Errors
    /// Fewer than two coils, or an amplitude that is not positive.
    pub fn coil_pairs(coil_count: usize, amplitude_a: f64) -> Result<Self, ProtocolError> {
        if coil_count < 2 {
            return Err(ProtocolError::TooFewElectrodes { pattern: "coils", needed: 2, even: false, got: coil_count });
        }
        if !(amplitude_a > 0.0 && amplitude_a.is_finite()) {
            let (what, index, expected) = ("amplitude", 0, "a positive number");
            return Err(ProtocolError::Value { what, index, value: amplitude_a, expected });
        }
        let single = |coil: usize, weight: f64| Pattern::new(vec![(coil as u32, weight)]);
        let count = coil_count as u32;
        let pairs = (0..count - 1).flat_map(|drive| (drive..count - 1).map(move |pattern| (drive, pattern)));
        Ok(Self {
            electrode_count: coil_count,
            stimulations: (0..coil_count - 1).map(|coil| single(coil, amplitude_a)).collect(),
            patterns: (1..coil_count).map(|coil| single(coil, 1.0)).collect(),
            measurements: pairs.map(|(stimulation, pattern)| Measurement { stimulation, pattern }).collect(),
        })
    }

    /// Generates the lists for a named pattern.
    ///
    /// # Errors
    /// Too few electrodes, an odd number with opposite pairs, listed pairs out of range, an amplitude that is not
    /// positive, or no measurements left.
    pub fn generate(spec: &ProtocolSpec) -> Result<Self, ProtocolError> {
        let count = spec.electrode_count;
        if !(spec.amplitude_a > 0.0 && spec.amplitude_a.is_finite()) {
            return Err(ProtocolError::Value {
                what: "drive amplitude (A)",
                index: 0,
                value: spec.amplitude_a,
                expected: "positive and finite",
            });
        }
        let stimulations = drive_patterns(&spec.drive, count, spec.amplitude_a)?;
        let pairs = measure_pairs(&spec.measure, count)?;
        let mut channels = Vec::new();
        for (index, stimulation) in stimulations.iter().enumerate() {
            for position in 0..pairs.len() {
                let choice = match spec.order {
                    Order::Absolute => position,
                    Order::Rotating => (position + index) % pairs.len(),
                };
                let pattern = match pairs[choice] {
                    MeasurePair::Pair(a, b) => Pattern::pair(a, b, 1.0),
                    MeasurePair::Single(electrode) => single_ended(&spec.measure, electrode, stimulation, count),
                };
                let drives = pattern.entries().iter().any(|entry| stimulation.touches(entry.0));
                if !(spec.driven == Driven::Drop && drives) {
                    channels.push((pattern, index));
                }
            }
        }
        Self::from_patterns(count, stimulations, channels)
    }
}

#[derive(Clone, Copy)]
enum MeasurePair {
    Pair(u32, u32),
    Single(u32),
}

fn ring_pairs(name: &'static str, count: usize, offset: usize) -> Result<Vec<(u32, u32)>, ProtocolError> {
    if offset == 0 || offset >= count {
        return Err(ProtocolError::TooFewElectrodes { pattern: name, needed: offset + 1, even: false, got: count });
    }
    Ok((0..count).map(|k| (k as u32, ((k + offset) % count) as u32)).collect())
}

fn half(name: &'static str, count: usize) -> Result<usize, ProtocolError> {
    if count < 4 || !count.is_multiple_of(2) {
        return Err(ProtocolError::TooFewElectrodes { pattern: name, needed: 4, even: true, got: count });
    }
    Ok(count / 2)
}

fn drive_patterns(drive: &Drive, count: usize, amplitude: f64) -> Result<Vec<Pattern>, ProtocolError> {
    let pairs = match drive {
        Drive::Adjacent => ring_pairs("adjacent drive", count.max(1), 1)?,
        Drive::Opposite => ring_pairs("opposite drive", count, half("opposite drive", count)?)?,
        Drive::Skip(skip) => ring_pairs("skip drive", count, skip.saturating_add(1))?,
        Drive::PseudoPolar => ring_pairs("pseudo-polar drive", count, half("pseudo-polar drive", count)? - 1)?,
        Drive::Pairs(pairs) => pairs.clone(),
        Drive::Trigonometric => return trigonometric(count, amplitude),
    };
    Ok(pairs.into_iter().map(|(a, b)| Pattern::pair(a, b, -amplitude)).collect())
}

fn trigonometric(count: usize, amplitude: f64) -> Result<Vec<Pattern>, ProtocolError> {
    let half = half("trigonometric drive", count)?;
    let wave = |harmonic: usize, sine: bool| {
        let entries = (0..count).map(|k| {
            let angle = std::f64::consts::TAU * (harmonic * k) as f64 / count as f64;
            let value = if sine { angle.sin() } else { angle.cos() };
            // Rounding errors in place of exact zeros would mark an electrode as driven.
            (k as u32, if value.abs() < 1e-12 { 0.0 } else { amplitude * value })
        });
        Pattern::new(entries.collect())
    };
    Ok((1..=half).map(|m| wave(m, false)).chain((1..half).map(|m| wave(m, true))).collect())
}

fn measure_pairs(measure: &Measure, count: usize) -> Result<Vec<MeasurePair>, ProtocolError> {
    let pairs = match measure {
        Measure::Adjacent => ring_pairs("adjacent measurement", count, 1)?,
        Measure::Opposite => ring_pairs("opposite measurement", count, half("opposite measurement", count)?)?,
        Measure::Skip(skip) => ring_pairs("skip measurement", count, skip.saturating_add(1))?,
        Measure::PseudoPolar => {
            ring_pairs("pseudo-polar measurement", count, half("pseudo-polar measurement", count)? - 1)?
        }
        Measure::Pairs(pairs) => pairs.clone(),
        Measure::SingleEnded(reference) => {
            if let Reference::Electrode(electrode) = *reference
                && electrode as usize >= count
            {
                return Err(ProtocolError::ElectrodeOutOfRange {
                    what: "reference",
                    index: 0,
                    electrode: electrode as usize,
                    count,
                });
            }
            return Ok((0..count as u32).map(MeasurePair::Single).collect());
        }
    };
    Ok(pairs.into_iter().map(|(a, b)| MeasurePair::Pair(a, b)).collect())
}

fn single_ended(measure: &Measure, electrode: u32, stimulation: &Pattern, count: usize) -> Pattern {
    let Measure::SingleEnded(reference) = measure else { return Pattern::new(vec![(electrode, 1.0)]) };
    let mut entries = vec![(electrode, 1.0)];
    match reference {
        Reference::Electrode(index) => entries.push((*index, -1.0)),
        Reference::Sink => {
            let sink = stimulation.entries().iter().min_by(|a, b| a.1.total_cmp(&b.1));
            entries.extend(sink.map(|entry| (entry.0, -1.0)));
        }
        Reference::Mean => entries.extend((0..count as u32).map(|other| (other, -1.0 / count as f64))),
    }
    Pattern::new(entries)
}
