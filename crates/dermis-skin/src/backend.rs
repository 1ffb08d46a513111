//! What reads a skin: instrument and protocol.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use dermis_tomo::eit::{Drive, Driven, Measure, Order, Protocol, ProtocolError, ProtocolSpec, Reference};

use crate::channel_list::ChannelList;
use crate::check::Checker;
use crate::electronics::Electronics;
use crate::error::Error;

/// Most listed pairs: all that 1024 electrodes could be driven by one after the other, four times over.
pub(crate) const MOST_PAIRS: usize = 4096;

/// Instrument and protocol.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Backend {
    /// Name of the instrument, for people.
    #[serde(default)]
    pub instrument: String,
    /// Current amplitude.
    pub current_ma: f64,
    /// Drive frequency.
    #[serde(default)]
    pub frequency_khz: Option<f64>,
    /// Every channel by its electrodes, in order; in place of `drive` and `measure`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub channels: Option<ChannelList>,
    /// Which pairs drive.
    #[serde(default = "DrivePattern::listed", skip_serializing_if = "DrivePattern::is_listed")]
    pub drive: DrivePattern,
    /// What is read for each.
    #[serde(default = "MeasurePattern::listed", skip_serializing_if = "MeasurePattern::is_listed")]
    pub measure: MeasurePattern,
    /// Order of the readings of a drive.
    #[serde(default)]
    pub order: ReadingOrder,
    /// Channels that touch a driven electrode.
    #[serde(default)]
    pub driven: DrivenChannels,
    /// What a reading is.
    #[serde(default)]
    pub reads: Reads,
    /// The values of a frame are differences from the untouched skin already: there is no baseline to ask for.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub differences: bool,
    /// Whether electrodes and pairs are what they are said to be.
    #[serde(default, skip_serializing_if = "Wiring::is_known")]
    pub wiring: Wiring,
    /// What the readout does to the potentials, where it is not an ideal voltmeter.
    #[serde(default)]
    pub circuit: Option<CircuitChoice>,
    /// Frames a second, where the instrument has a rate of its own.
    #[serde(default)]
    pub frames_per_s: Option<f64>,
    /// What is sent to an instrument of lines with every connection: what starts it after its reset, line end included.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub send: Option<String>,
    /// What the electronics add to a reading, for twins.
    #[serde(default, skip_serializing_if = "Electronics::is_default")]
    pub electronics: Electronics,
}

/// What is known of the readout's circuit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum CircuitChoice {
    /// It is this one.
    Known(Circuit),
    /// Only that there is one: it is found from frames of unknown touches.
    ToLearn(LearnCircuit),
}

/// The word for a circuit that is to be found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum LearnCircuit {
    /// As it stands in the file.
    #[serde(rename = "learn")]
    Learn,
}

impl CircuitChoice {
    /// The circuit, where it is known.
    pub fn known(&self) -> Option<&Circuit> {
        match self {
            Self::Known(circuit) => Some(circuit),
            Self::ToLearn(_) => None,
        }
    }
}

/// A readout that loads the skin and reads a mixture of lines, see [`dermis_tomo::eit::ReadoutCircuit`]. Admittances to
/// ground are relative to the skin's sheet conductance.
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
    /// As the forward model takes it.
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

/// Drive patterns; electrodes are numbered from 1.
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
    /// Coils, one after the other.
    EachCoil,
    /// As [`Backend::channels`] lists them; no word of the file.
    #[serde(skip)]
    Listed,
}

impl DrivePattern {
    fn listed() -> Self {
        Self::Listed
    }

    fn is_listed(&self) -> bool {
        *self == Self::Listed
    }
}

/// Measuring patterns; electrodes are numbered from 1.
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
    /// Every electrode against `mean`, `sink`, or an electrode number.
    SingleEnded(ReferenceChoice),
    /// Listed [plus, minus].
    Pairs(Vec<[u32; 2]>),
    /// Coils of higher number than the one that drives.
    HigherCoils,
    /// As [`Backend::channels`] lists them; no word of the file.
    #[serde(skip)]
    Listed,
}

impl MeasurePattern {
    fn listed() -> Self {
        Self::Listed
    }

    fn is_listed(&self) -> bool {
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
    /// From the drive pair on.
    Rotating,
}

/// Channels that touch a driven electrode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DrivenChannels {
    /// Not among the readings.
    #[default]
    Drop,
    /// Read like all others.
    Keep,
}

/// What a reading is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Reads {
    /// A signed voltage (in-phase).
    #[default]
    Signed,
    /// A rectified voltage: the sign is the model's.
    Magnitude,
    /// Real and imaginary parts: the component in phase with the baseline is used.
    Complex,
}

/// Whether electrodes and pairs are what they are said to be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Wiring {
    /// They are: physics predicts what a touch does.
    #[default]
    Known,
    /// Only their number of channels is: what a touch does is learnt from pokes alone.
    Unknown,
}

impl Wiring {
    /// True where physics may be relied on.
    pub fn is_known(&self) -> bool {
        *self == Self::Known
    }
}

impl Backend {
    /// Frames a second; 50 where the file gives none.
    pub fn frame_rate_hz(&self) -> f64 {
        self.frames_per_s.unwrap_or(50.0)
    }

    /// True where coils drive and read, rather than electrodes.
    pub fn is_of_coils(&self) -> bool {
        self.drive == DrivePattern::EachCoil && self.measure == MeasurePattern::HigherCoils
    }

    /// Stimulation and measurement as explicit lists, for so many electrodes or coils.
    ///
    /// # Errors
    /// Patterns that need another number, or name electrodes that do not exist.
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
        // Electrode 0 does not exist on paper; wrapping makes it an index that is out of range and is refused as such.
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

    /// Reads a list of channels from its file, looked for in `folder`. A list says all that patterns and orders say, so
    /// those beside it are dropped.
    pub(crate) fn read_channels(&mut self, file: &str, folder: Option<&Path>) -> Result<(), Error> {
        let Some(channels) = &mut self.channels else { return Ok(()) };
        channels.read(file, folder)?;
        (self.drive, self.measure) = (DrivePattern::Listed, MeasurePattern::Listed);
        (self.order, self.driven) = (ReadingOrder::default(), DrivenChannels::default());
        Ok(())
    }

    /// `coils`: the skin has coils and elements in place of electrodes, of which there are `count`.
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
                let expected = "a weight of 1e-6 or more: nothing else is read";
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
