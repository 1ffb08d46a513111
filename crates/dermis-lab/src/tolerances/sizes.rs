//! What goes wrong in a workshop, and how much.

use std::io::Read;
use std::path::Path;

use dermis_skin::{Layer, Skin};
use serde::{Deserialize, Serialize};

use crate::Error;

/// What is read of a file of tolerances at most, bytes.
const MOST_BYTES: u64 = 1 << 20;

/// How much a workshop gets wrong. All are standard deviations unless they say otherwise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Tolerances {
    /// Place of each electrode, along the rim, or along x and y for pads under the sheet. Electrodes stay on the sheet
    /// and apart.
    pub electrode_place_mm: f64,
    /// Width of each electrode, relative.
    pub electrode_width_percent: f64,
    /// Contact impedance of each electrode: two in three lie within this factor of the file's, up or down (log-normal).
    pub contact_impedance_factor: f64,
    /// Conductivity from place to place (log-normal), a random field with Gaussian correlation.
    pub conductivity_percent: f64,
    /// Correlation length of that field, as a share of the skin's shorter side: the distance L of
    /// `exp(-d^2 / (2 L^2))`.
    pub conductivity_length_share: f64,
    /// Thickness of the whole sheet, or depth of the liquid, relative.
    pub thickness_percent: f64,
    /// How the layer answers pressure, relative: threshold, reference and saturation of the contact law, each on its
    /// own; of a bare sheet modulus and pressure coefficient; of a liquid the membrane's tension.
    pub contact_law_percent: f64,
    /// Gain of each channel, relative.
    pub gain_percent: f64,
    /// Noise of the whole instrument (log-normal), about that of the skin file's electronics.
    pub noise_percent: f64,
    /// One electrode or coil, taken at random, has no contact. Its channels are left out, as a running skin does once
    /// it has found it.
    pub bad_electrode: bool,
    /// Place of each coil along x and y. Coils stay clear of each other.
    pub coil_place_mm: f64,
    /// Height of each element at rest. Left out: 0.3 mm and the skin file's own `height_tolerance_mm`, squares added.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub element_height_mm: Option<f64>,
    /// Stiffness of the elements' springs, all alike, relative.
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
    /// Nothing goes wrong.
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

    /// Reads a TOML file of tolerances; what it leaves out is as by default.
    ///
    /// # Errors
    /// No such file; keys that do not exist; values out of range, with key and value.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let failed = |source| Error::Io { file: path.to_path_buf(), source };
        let mut text = String::new();
        let file = dermis_device::open_regular(path).map_err(failed)?;
        file.take(MOST_BYTES).read_to_string(&mut text).map_err(failed)?;
        Self::parse(&text, path)
    }

    /// As [`Tolerances::read`], of a text; `path` is for messages.
    ///
    /// # Errors
    /// As [`Tolerances::read`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, Error> {
        let content =
            |field: &str, reason: String| Error::Content { file: path.to_path_buf(), field: field.into(), reason };
        let read: Self =
            toml::from_str(text).map_err(|error| content("tolerances", error.to_string().trim_end().to_string()))?;
        let ranges = [
            ("electrode_place_mm", read.electrode_place_mm, [0.0, 50.0]),
            ("electrode_width_percent", read.electrode_width_percent, [0.0, 30.0]),
            ("contact_impedance_factor", read.contact_impedance_factor, [1.0, 1e3]),
            ("conductivity_percent", read.conductivity_percent, [0.0, 100.0]),
            ("conductivity_length_share", read.conductivity_length_share, [0.02, 2.0]),
            ("thickness_percent", read.thickness_percent, [0.0, 30.0]),
            ("contact_law_percent", read.contact_law_percent, [0.0, 30.0]),
            ("gain_percent", read.gain_percent, [0.0, 30.0]),
            ("noise_percent", read.noise_percent, [0.0, 200.0]),
            ("coil_place_mm", read.coil_place_mm, [0.0, 50.0]),
            ("element_height_mm", read.element_height_mm.unwrap_or(0.0), [0.0, 50.0]),
            ("stiffness_percent", read.stiffness_percent, [0.0, 30.0]),
        ];
        for (key, value, [least, most]) in ranges {
            if !(least..=most).contains(&value) {
                return Err(content(key, format!("{value}, expected {least} to {most}")));
            }
        }
        Ok(read)
    }

    /// As a file that [`Tolerances::read`] takes.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_default()
    }

    /// What can go wrong with a skin.
    pub fn causes(&self, skin: &Skin) -> Vec<Cause> {
        let own: &[Cause] = match skin.frontend.coils {
            Some(_) => &[Cause::CoilPlaces, Cause::ElementHeights, Cause::Stiffness],
            None => &[
                Cause::ElectrodePlaces,
                Cause::ElectrodeWidths,
                Cause::ContactImpedance,
                Cause::Conductivity,
                Cause::Thickness,
                Cause::ContactLaw,
            ],
        };
        let mut causes = own.to_vec();
        // Objects in a tank without a membrane press nothing.
        if matches!(&skin.frontend.layer, Layer::Liquid(liquid) if liquid.tension_n_per_m == 0.0) {
            causes.retain(|cause| *cause != Cause::ContactLaw);
        }
        causes.extend([Cause::Gain, Cause::Noise]);
        causes.extend(self.bad_electrode.then_some(Cause::BadElectrode));
        causes
    }
}

/// One thing that goes wrong; see [`Tolerances`] for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Electrodes lie elsewhere.
    ElectrodePlaces,
    /// Electrodes are wider or narrower.
    ElectrodeWidths,
    /// Electrodes touch the sheet better or worse.
    ContactImpedance,
    /// The sheet conducts unevenly.
    Conductivity,
    /// The sheet is thicker or thinner.
    Thickness,
    /// The layer answers pressure otherwise.
    ContactLaw,
    /// Coils lie elsewhere.
    CoilPlaces,
    /// Elements stand higher or lower.
    ElementHeights,
    /// Springs are stiffer or softer.
    Stiffness,
    /// Channels read too much or too little.
    Gain,
    /// The instrument is noisier or quieter.
    Noise,
    /// One electrode or coil is dead.
    BadElectrode,
}

impl Cause {
    /// For people.
    pub fn name(self) -> &'static str {
        match self {
            Self::ElectrodePlaces => "electrode places",
            Self::ElectrodeWidths => "electrode widths",
            Self::ContactImpedance => "contact impedance",
            Self::Conductivity => "conductivity",
            Self::Thickness => "thickness",
            Self::ContactLaw => "answer to pressure",
            Self::CoilPlaces => "coil places",
            Self::ElementHeights => "element heights",
            Self::Stiffness => "stiffness",
            Self::Gain => "instrument gain",
            Self::Noise => "instrument noise",
            Self::BadElectrode => "a bad electrode",
        }
    }
}
