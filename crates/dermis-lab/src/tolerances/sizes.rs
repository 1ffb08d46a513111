//! The causes of manufacturing errors, and their sizes.

use std::io::Read;
use std::path::Path;

use dermis_skin::{Layer, Skin};
use serde::{Deserialize, Serialize};

use crate::Error;

/// Largest file of tolerances, bytes.
const MOST_BYTES: u64 = 1 << 20;

/// Sizes of manufacturing errors. All are standard deviations unless stated otherwise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Tolerances {
    /// Position of each electrode, along the rim, or along x and y for pads under the sheet. Electrodes stay on the
    /// sheet and apart.
    pub electrode_place_mm: f64,
    /// Width of each electrode, relative.
    pub electrode_width_percent: f64,
    /// Contact impedance of each electrode: two in three lie within this factor of the file's, up or down
    /// (log-normal).
    pub contact_impedance_factor: f64,
    /// Variation of conductivity over the sheet (log-normal), a random field with Gaussian correlation.
    pub conductivity_percent: f64,
    /// Correlation length of that field, as a share of the skin's shorter side: the distance L of
    /// `exp(-d^2 / (2 L^2))`.
    pub conductivity_length_share: f64,
    /// Thickness of the whole sheet, or depth of the liquid, relative.
    pub thickness_percent: f64,
    /// Response of the layer to pressure, relative. For a contact law: threshold, reference and saturation, each
    /// independently. For a bare sheet: modulus and pressure coefficient. For a liquid: tension of the membrane.
    pub contact_law_percent: f64,
    /// Gain of each channel, relative.
    pub gain_percent: f64,
    /// Noise of the whole instrument (log-normal), relative to the skin file's electronics.
    pub noise_percent: f64,
    /// One random electrode or coil has no contact. Its channels are left out, as in a running skin that has detected
    /// it.
    pub bad_electrode: bool,
    /// Position of each coil along x and y. Coils stay clear of each other.
    pub coil_place_mm: f64,
    /// Height of each element at rest. If omitted, 0.3 mm combined with the skin file's own `height_tolerance_mm`
    /// (root of the sum of squares).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub element_height_mm: Option<f64>,
    /// Stiffness of the elements' springs, relative; the same for all.
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
    /// No errors at all.
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

    /// Reads a TOML file of tolerances; omitted keys keep their defaults.
    ///
    /// # Errors
    /// The file doesn't exist, has unknown keys, or has a value out of range (named with its key).
    pub fn read(path: &Path) -> Result<Self, Error> {
        let failed = |source| Error::Io { file: path.to_path_buf(), source };
        let mut text = String::new();
        let file = dermis_device::open_regular(path).map_err(failed)?;
        file.take(MOST_BYTES).read_to_string(&mut text).map_err(failed)?;
        Self::parse(&text, path)
    }

    /// Like [`Tolerances::read`], from text; `path` is only used in messages.
    ///
    /// # Errors
    /// As for [`Tolerances::read`].
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

    /// The content of a file that [`Tolerances::read`] accepts.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_default()
    }

    /// The causes that apply to a skin.
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
        // Objects in a tank without a membrane don't press on anything.
        if matches!(&skin.frontend.layer, Layer::Liquid(liquid) if liquid.tension_n_per_m == 0.0) {
            causes.retain(|cause| *cause != Cause::ContactLaw);
        }
        causes.extend([Cause::Gain, Cause::Noise]);
        causes.extend(self.bad_electrode.then_some(Cause::BadElectrode));
        causes
    }
}

/// One cause of error; see [`Tolerances`] for details.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Electrodes are displaced.
    ElectrodePlaces,
    /// Electrodes are wider or narrower.
    ElectrodeWidths,
    /// Contact impedances are higher or lower.
    ContactImpedance,
    /// The conductivity varies over the sheet.
    Conductivity,
    /// The sheet is thicker or thinner.
    Thickness,
    /// The layer responds to pressure differently.
    ContactLaw,
    /// Coils are displaced.
    CoilPlaces,
    /// Elements stand higher or lower.
    ElementHeights,
    /// Springs are stiffer or softer.
    Stiffness,
    /// Channel gains are too high or too low.
    Gain,
    /// The instrument is noisier or quieter.
    Noise,
    /// One electrode or coil is dead.
    BadElectrode,
}

impl Cause {
    /// Name for people.
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
