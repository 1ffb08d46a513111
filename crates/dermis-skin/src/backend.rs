//! The backend that reads a skin: instrument and protocol.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use dermis_tomo::eit::{Drive, Driven, Measure, Order, Protocol, ProtocolError, ProtocolSpec, Reference};

use crate::channel_list::ChannelList;
use crate::check::Checker;
use crate::electronics::Electronics;
use crate::error::Error;

/// Maximum number of listed pairs: enough to drive 1024 electrodes one after the other, four times over.
pub(crate) const MOST_PAIRS: usize = 4096;

/// Instrument and protocol.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Backend {
    /// Name of the instrument, for display.
    #[serde(default)]
    pub instrument: String,
    /// Current amplitude.
    pub current_ma: f64,
    /// Drive frequency.
    #[serde(default)]
    pub frequency_khz: Option<f64>,
    /// Every channel by its electrodes, in order; replaces `drive` and `measure`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub channels: Option<ChannelList>,
    /// Electrode pairs that drive.
    #[serde(default = "DrivePattern::listed", skip_serializing_if = "DrivePattern::is_listed")]
    pub drive: DrivePattern,
    /// Readings taken for each drive.
    #[serde(default = "MeasurePattern::listed", skip_serializing_if = "MeasurePattern::is_listed")]
    pub measure: MeasurePattern,
    /// Order of the readings of one drive.
    #[serde(default)]
    pub order: ReadingOrder,
    /// Treatment of channels that touch a driven electrode.
    #[serde(default)]
    pub driven: DrivenChannels,
    /// Kind of value that a reading is.
    #[serde(default)]
    pub reads: Reads,
    /// True if the values of a frame are already differences from the untouched skin, so no baseline is needed.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub differences: bool,
    /// How far the electrodes and pairs given here can be trusted.
    #[serde(default, skip_serializing_if = "Wiring::is_known")]
    pub wiring: Wiring,
    /// Effect of the readout on the potentials, if it is not an ideal voltmeter.
    #[serde(default)]
    pub circuit: Option<CircuitChoice>,
    /// Frames per second, if the instrument runs at its own rate.
    #[serde(default)]
    pub frames_per_s: Option<f64>,
    /// Text sent to a line-based instrument on every connection to start it after its reset, including the line end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub send: Option<String>,
    /// Errors that the electronics add to a reading, for twins.
    #[serde(default, skip_serializing_if = "Electronics::is_default")]
    pub electronics: Electronics,
}

/// Knowledge about the readout circuit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum CircuitChoice {
    /// The circuit is given.
    Known(Circuit),
    /// There is a circuit, but it is unknown and is identified from frames of unknown touches.
    ToLearn(LearnCircuit),
}

/// Keyword for a circuit that has to be identified.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum LearnCircuit {
    /// Written `learn` in the file.
    #[serde(rename = "learn")]
    Learn,
}

impl CircuitChoice {
    /// The circuit, if it is known.
    pub fn known(&self) -> Option<&Circuit> {
        match self {
            Self::Known(circuit) => Some(circuit),
            Self::ToLearn(_) => None,
        }
    }
}

/// A readout that loads the skin and reads a mixture of lines, see [`dermis_tomo::eit::ReadoutCircuit`]. Admittances
/// to ground are relative to the skin's sheet conductance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Circuit {
    /// Admittance of the sink and of both measuring lines.
    pub load: f64,
    /// Admittance of every idle electrode.
    pub idle: f64,
    /// Weights of the positive, the negative and the sink line in a reading.
    pub reading: [f64; 3],
}

impl Circuit {
    /// The circuit in the form that the forward model takes.
    pub fn readout(&self) -> dermis_tomo::eit::ReadoutCircuit {
        use dermis_tomo::eit::{CurrentReturn, Lines, ReadoutCircuit};
        let [plus, minus, sink] = self.reading;
        ReadoutCircuit {
            load: Lines { sink: self.load, plus: self.load, minus: self.load },
            idle: self.idle,
            reading: Lines { sink, plus, minus },
            current_return: CurrentReturn::Ground,
        }
    }
}

/// Drive patterns. Electrodes are numbered from 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DrivePattern {
    /// Pairs (k, k+1).
    Adjacent,
    /// Pairs (k, k+L/2).
    Opposite,
    /// Pairs (k, k+n+1).
    Skip(usize),
    /// Pairs (k, k+L/2-1).
    PseudoPolar,
    /// Cosines and sines over all electrodes.
    Trigonometric,
    /// Listed [sink, source].
    Pairs(Vec<[u32; 2]>),
    /// Coils, one after another.
    EachCoil,
    /// As listed by [`Backend::channels`]; cannot be written in the file.
    #[serde(skip)]
    Listed,
}

impl DrivePattern {
    fn listed() -> Self {
        Self::Listed
    }

    /// True if the skin file lists its channels instead.
    pub fn is_listed(&self) -> bool {
        *self == Self::Listed
    }
}

/// Measurement patterns. Electrodes are numbered from 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MeasurePattern {
    /// Pairs (j, j+1).
    Adjacent,
    /// Pairs (j, j+L/2).
    Opposite,
    /// Pairs (j, j+n+1).
    Skip(usize),
    /// Pairs (j, j+L/2-1).
    PseudoPolar,
    /// Every electrode against `mean`, `sink` or a numbered electrode.
    SingleEnded(ReferenceChoice),
    /// Listed [plus, minus].
    Pairs(Vec<[u32; 2]>),
    /// Coils with a higher number than the driving one.
    HigherCoils,
    /// As listed by [`Backend::channels`]; cannot be written in the file.
    #[serde(skip)]
    Listed,
}

impl MeasurePattern {
    fn listed() -> Self {
        Self::Listed
    }

    /// True if the skin file lists its channels instead.
    pub fn is_listed(&self) -> bool {
        *self == Self::Listed
    }
}

/// Reference of single-ended readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ReferenceChoice {
    /// Mean of all electrodes.
    Mean,
    /// The electrode that sinks the current.
    Sink,
    /// One electrode, numbered from 1.
    Electrode(u32),
}

/// Order of the readings of one drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ReadingOrder {
    /// By electrode number.
    #[default]
    Absolute,
    /// Starting from the drive pair.
    Rotating,
}

/// Treatment of channels that touch a driven electrode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DrivenChannels {
    /// Left out of the readings.
    #[default]
    Drop,
    /// Read like all others.
    Keep,
}

/// Kind of value that a reading is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Reads {
    /// A signed voltage (in-phase).
    #[default]
    Signed,
    /// A rectified voltage; the sign comes from the model.
    Magnitude,
    /// Real and imaginary parts; the component in phase with the baseline is used.
    Complex,
}

/// How far the electrodes and pairs given in the file can be trusted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Wiring {
    /// They are correct, so physics predicts the effect of a touch.
    #[default]
    Known,
    /// Only the number of channels is correct; the effect of a touch is learnt from pokes alone.
    Unknown,
}

impl Wiring {
    /// True if physics can be relied on.
    pub fn is_known(&self) -> bool {
        *self == Self::Known
    }
}

impl Backend {
    /// Frames per second; 50 if the file does not say.
    pub fn frame_rate_hz(&self) -> f64 {
        self.frames_per_s.unwrap_or(50.0)
    }

    /// True if coils drive and read instead of electrodes.
    pub fn is_of_coils(&self) -> bool {
        self.drive == DrivePattern::EachCoil && self.measure == MeasurePattern::HigherCoils
    }

    /// Stimulation and measurement as explicit lists, for `count` electrodes or coils.
    ///
    /// # Errors
    /// Fails if a pattern needs a different count or names electrodes that do not exist.
    pub fn protocol(&self, count: usize) -> Result<Protocol, ProtocolError> {
        let amplitude_a = self.current_ma * 1e-3;
        if let Some(channels) = &self.channels {
            return channels.protocol(count, amplitude_a);
        }
        if self.is_of_coils() {
            return Protocol::coil_pairs(count, amplitude_a);
        }
        let coils = ProtocolError::TooFewElectrodes {
            pattern: "a pattern of coils, without them,",
            needed: usize::MAX,
            even: false,
            got: count,
        };
        // Numbers start at 1. A mistaken 0 wraps to an index that is out of range and is refused.
        let zero_based =
            |pairs: &[[u32; 2]]| pairs.iter().map(|p| (p[0].wrapping_sub(1), p[1].wrapping_sub(1))).collect::<Vec<_>>();
        Protocol::generate(&ProtocolSpec {
            electrode_count: count,
            drive: match &self.drive {
                DrivePattern::Adjacent => Drive::Adjacent,
                DrivePattern::Opposite => Drive::Opposite,
                DrivePattern::Skip(skip) => Drive::Skip(*skip),
                DrivePattern::PseudoPolar => Drive::PseudoPolar,
                DrivePattern::Trigonometric => Drive::Trigonometric,
                DrivePattern::Pairs(pairs) => Drive::Pairs(zero_based(pairs)),
                DrivePattern::EachCoil => return Err(coils),
                DrivePattern::Listed => return Err(ProtocolError::Empty),
            },
            measure: match &self.measure {
                MeasurePattern::Adjacent => Measure::Adjacent,
                MeasurePattern::Opposite => Measure::Opposite,
                MeasurePattern::Skip(skip) => Measure::Skip(*skip),
                MeasurePattern::PseudoPolar => Measure::PseudoPolar,
                MeasurePattern::Pairs(pairs) => Measure::Pairs(zero_based(pairs)),
                MeasurePattern::HigherCoils => return Err(coils),
                MeasurePattern::Listed => return Err(ProtocolError::Empty),
                MeasurePattern::SingleEnded(reference) => Measure::SingleEnded(match reference {
                    ReferenceChoice::Mean => Reference::Mean,
                    ReferenceChoice::Sink => Reference::Sink,
                    ReferenceChoice::Electrode(number) => Reference::Electrode(number.wrapping_sub(1)),
                }),
            },
            order: match self.order {
                ReadingOrder::Absolute => Order::Absolute,
                ReadingOrder::Rotating => Order::Rotating,
            },
            driven: match self.driven {
                DrivenChannels::Drop => Driven::Drop,
                DrivenChannels::Keep => Driven::Keep,
            },
            amplitude_a,
        })
    }

    /// Reads a list of channels from its file in `folder`. The list replaces all patterns and orders, so those are
    /// dropped.
    pub(crate) fn read_channels(&mut self, file: &str, folder: Option<&Path>) -> Result<(), Error> {
        let Some(channels) = &mut self.channels else { return Ok(()) };
        channels.read(file, folder)?;
        (self.drive, self.measure) = (DrivePattern::Listed, MeasurePattern::Listed);
        (self.order, self.driven) = (ReadingOrder::default(), DrivenChannels::default());
        Ok(())
    }

    /// Checks the table. With `coils`, the skin has `count` coils with elements instead of `count` electrodes.
    pub(crate) fn check(&self, coils: bool, count: usize, checker: &Checker<'_>) -> Result<(), Error> {
        match &self.channels {
            Some(_) if coils => {
                return Err(checker.refused("backend.channels", "given", "none with layer.kind = \"elements\""));
            }
            Some(channels) => channels.check(count, checker)?,
            None => {
                for (field, listed) in
                    [("backend.drive", self.drive.is_listed()), ("backend.measure", self.measure.is_listed())]
                {
                    if listed {
                        let expected = "drive and measure, or channels that list every reading";
                        return Err(checker.refused(field, "left out", expected));
                    }
                }
            }
        }
        checker.within("backend.current_ma", self.current_ma, 1e-9, 1e6)?;
        if let Some(frequency) = self.frequency_khz {
            let low = if coils { 1e-3 } else { 0.0 };
            checker.within("backend.frequency_khz", frequency, low, 1e3)?;
        }
        if let Some(rate) = self.frames_per_s {
            checker.within("backend.frames_per_s", rate, 1e-3, 1e5)?;
        }
        self.electronics.check(checker)?;
        for (field, pairs) in [
            ("backend.drive", if let DrivePattern::Pairs(pairs) = &self.drive { pairs.len() } else { 1 }),
            ("backend.measure", if let MeasurePattern::Pairs(pairs) = &self.measure { pairs.len() } else { 1 }),
        ] {
            if !(1..=MOST_PAIRS).contains(&pairs) {
                return Err(checker.refused(field, format!("{pairs} pairs"), format!("1 to {MOST_PAIRS} pairs")));
            }
        }
        if let Some(circuit) = self.circuit.as_ref().and_then(CircuitChoice::known) {
            checker.within("backend.circuit.load", circuit.load, 0.0, 1e6)?;
            checker.within("backend.circuit.idle", circuit.idle, 0.0, 1e6)?;
            circuit.reading.iter().try_for_each(|w| checker.within("backend.circuit.reading", *w, -100.0, 100.0))?;
            if circuit.reading.iter().all(|weight| weight.abs() < 1e-6) {
                let expected = "a weight of 1e-6 or more: otherwise nothing is read";
                return Err(checker.refused("backend.circuit.reading", format!("{:?}", circuit.reading), expected));
            }
        }
        if !coils {
            if self.drive == DrivePattern::EachCoil || self.measure == MeasurePattern::HigherCoils {
                let expected = "a pattern of electrodes, except with layer.kind = \"elements\"";
                return Err(checker.refused("backend.drive", "coils", expected));
            }
            return Ok(());
        }
        if self.frequency_khz.is_none() {
            let expected = "0.001 to 1000 with layer.kind = \"elements\"";
            return Err(checker.refused("backend.frequency_khz", "left out", expected));
        }
        if !self.is_of_coils() {
            let expected = "drive = \"each-coil\" and measure = \"higher-coils\" with layer.kind = \"elements\"";
            return Err(checker.refused("backend.drive", "a pattern of electrodes", expected));
        }
        if self.circuit.is_some() {
            return Err(checker.refused("backend.circuit", "given", "none with layer.kind = \"elements\""));
        }
        if self.reads != Reads::Magnitude {
            let expected = "\"magnitude\" with layer.kind = \"elements\"";
            return Err(checker.refused("backend.reads", "another", expected));
        }
        Ok(())
    }
}
