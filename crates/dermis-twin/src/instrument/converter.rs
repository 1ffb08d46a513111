//! The analogue-to-digital converter.

use serde::{Deserialize, Serialize};

/// The converter behind the amplifier.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Converter {
    /// Resolution over the whole range, both signs, bits.
    pub bits: u32,
    /// Maximum magnitude that can be converted, volts after the gain.
    pub range_v: f64,
    /// Gain in front of the converter.
    pub gain: f64,
}

impl Converter {
    /// Voltage at the skin between adjacent codes.
    pub fn step_v(&self) -> f64 {
        self.range_v / self.gain / f64::from(self.bits - 1).exp2()
    }

    /// The reading for a voltage at the skin: the nearest two's complement code, in volts at the skin.
    pub fn read_v(&self, voltage_v: f64) -> f64 {
        let codes = f64::from(self.bits - 1).exp2();
        let step = self.step_v();
        (voltage_v / step).round().clamp(-codes, codes - 1.0) * step
    }
}

/// Serialises a converter as a table, and none as the word `"none"` or a missing key, because TOML has no null.
pub(super) mod converter_or_none {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use super::Converter;

    #[derive(Serialize, Deserialize)]
    #[serde(rename_all = "lowercase")]
    enum Word {
        None,
    }

    #[derive(Serialize, Deserialize)]
    #[serde(untagged)]
    enum Written {
        Word(Word),
        Table(Converter),
    }

    pub fn serialize<S: Serializer>(converter: &Option<Converter>, serializer: S) -> Result<S::Ok, S::Error> {
        converter.map_or(Written::Word(Word::None), Written::Table).serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Converter>, D::Error> {
        Ok(match Written::deserialize(deserializer)? {
            Written::Word(Word::None) => None,
            Written::Table(converter) => Some(converter),
        })
    }
}
