//! Manufacturing tolerances: how far a skin as built may be from its file.
//!
//! The defaults are assumptions about careful work with hand tools, laser cutters and printers. A skin file can state
//! its own in `[tolerances]`.

mod dice;
mod electrodes;

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use dice::Dice;
pub use electrodes::built_electrodes;

use crate::check::Checker;
use crate::error::{Error, FileError};
use crate::parts::read_skin_text;

/// Manufacturing tolerances. All are standard deviations unless noted otherwise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Tolerances {
    /// Position of each electrode along the rim, or along x and y for pads under the sheet. Electrodes stay on the
    /// sheet and apart.
    pub electrode_place_mm: f64,
    /// Width of each electrode, relative.
    pub electrode_width_percent: f64,
    /// Contact impedance of each electrode (log-normal): two in three are within this factor of the file's, up or
    /// down.
    pub contact_impedance_factor: f64,
    /// Local conductivity (log-normal): a random field with Gaussian correlation.
    pub conductivity_percent: f64,
    /// Correlation length of that field, as a share of the skin's shorter side: the L of `exp(-d^2 / (2 L^2))`.
    pub conductivity_length_share: f64,
    /// Thickness of the whole sheet, or depth of the liquid, relative.
    pub thickness_percent: f64,
    /// The layer's response to pressure, relative. For a sandwich or patches: threshold, reference and saturation of
    /// the contact law, each independently. For a bare sheet: modulus and pressure coefficient. For a liquid: the
    /// membrane's tension.
    pub contact_law_percent: f64,
    /// Gain of each channel, relative.
    pub gain_percent: f64,
    /// Noise of the whole instrument (log-normal), relative to the electronics in the skin file.
    pub noise_percent: f64,
    /// One random electrode or coil has no contact. Its channels are left out, as in a running skin that has detected
    /// the fault.
    pub bad_electrode: bool,
    /// Position of each coil along x and y. Coils stay clear of each other.
    pub coil_place_mm: f64,
    /// Height of each element at rest. Default: 0.3 mm and the skin file's own `height_tolerance_mm`, added in
    /// quadrature.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub element_height_mm: Option<f64>,
    /// Stiffness of the elements' springs, the same error for all, relative.
    pub stiffness_percent: f64,
}

impl Default for Tolerances {
    fn default() -> Self {
        Self {
            electrode_place_mm: 0.5,
            electrode_width_percent: 10.0,
            contact_impedance_factor: 2.0,
            conductivity_percent: 10.0,
            conductivity_length_share: 0.2,
            thickness_percent: 5.0,
            contact_law_percent: 10.0,
            gain_percent: 1.0,
            noise_percent: 20.0,
            bad_electrode: false,
            coil_place_mm: 0.5,
            element_height_mm: None,
            stiffness_percent: 10.0,
        }
    }
}

impl Tolerances {
    /// Zero tolerances: a skin built exactly as drawn.
    pub fn none() -> Self {
        Self {
            electrode_place_mm: 0.0,
            electrode_width_percent: 0.0,
            contact_impedance_factor: 1.0,
            conductivity_percent: 0.0,
            conductivity_length_share: 0.2,
            thickness_percent: 0.0,
            contact_law_percent: 0.0,
            gain_percent: 0.0,
            noise_percent: 0.0,
            bad_electrode: false,
            coil_place_mm: 0.0,
            element_height_mm: Some(0.0),
            stiffness_percent: 0.0,
        }
    }

    /// Reads a TOML file of tolerances. Missing keys have their defaults.
    ///
    /// # Errors
    /// No such file; unknown keys; values out of range, with key and value.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = read_skin_text(path).map_err(|source| Error::Io(FileError { file: path.to_path_buf(), source }))?;
        Self::parse(&text, path)
    }

    /// Like [`Tolerances::read`], from a string; `path` is for messages.
    ///
    /// # Errors
    /// As [`Tolerances::read`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, Error> {
        let file = path.display().to_string();
        let read: Self = toml::from_str(text).map_err(|error| Error::SkinFile {
            file: file.clone(),
            message: error.to_string().trim_end().to_string(),
        })?;
        read.check("", &Checker { file: &file })?;
        Ok(read)
    }

    /// Checks the ranges; `table` is the prefix of the keys in errors.
    pub(crate) fn check(&self, table: &str, checker: &Checker<'_>) -> Result<(), Error> {
        let ranges = [
            ("electrode_place_mm", self.electrode_place_mm, [0.0, 50.0]),
            ("electrode_width_percent", self.electrode_width_percent, [0.0, 30.0]),
            ("contact_impedance_factor", self.contact_impedance_factor, [1.0, 1e3]),
            ("conductivity_percent", self.conductivity_percent, [0.0, 100.0]),
            ("conductivity_length_share", self.conductivity_length_share, [0.02, 2.0]),
            ("thickness_percent", self.thickness_percent, [0.0, 30.0]),
            ("contact_law_percent", self.contact_law_percent, [0.0, 30.0]),
            ("gain_percent", self.gain_percent, [0.0, 30.0]),
            ("noise_percent", self.noise_percent, [0.0, 200.0]),
            ("coil_place_mm", self.coil_place_mm, [0.0, 50.0]),
            ("element_height_mm", self.element_height_mm.unwrap_or(0.0), [0.0, 50.0]),
            ("stiffness_percent", self.stiffness_percent, [0.0, 30.0]),
        ];
        ranges
            .into_iter()
            .try_for_each(|(key, value, [least, most])| checker.within(&format!("{table}{key}"), value, least, most))
    }

    /// True for the defaults, which files need not state.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// A file that [`Tolerances::read`] accepts.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_default()
    }
}
