//! The causes of manufacturing errors.

use dermis_skin::{Layer, Skin, Tolerances};

/// One thing that goes wrong; see [`Tolerances`] for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Electrodes are displaced.
    ElectrodePlaces,
    /// Electrodes are too wide or too narrow.
    ElectrodeWidths,
    /// Electrodes make better or worse contact with the sheet.
    ContactImpedance,
    /// The sheet conducts unevenly.
    Conductivity,
    /// The sheet is thicker or thinner.
    Thickness,
    /// The layer responds differently to pressure.
    ContactLaw,
    /// Coils are displaced.
    CoilPlaces,
    /// Elements are too high or too low.
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
    /// Name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::ElectrodePlaces => "electrode positions",
            Self::ElectrodeWidths => "electrode widths",
            Self::ContactImpedance => "contact impedance",
            Self::Conductivity => "conductivity",
            Self::Thickness => "thickness",
            Self::ContactLaw => "response to pressure",
            Self::CoilPlaces => "coil positions",
            Self::ElementHeights => "element heights",
            Self::Stiffness => "stiffness",
            Self::Gain => "instrument gain",
            Self::Noise => "instrument noise",
            Self::BadElectrode => "a bad electrode",
        }
    }
}

/// The causes that apply to a skin.
pub fn causes(tolerances: &Tolerances, skin: &Skin) -> Vec<Cause> {
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
    causes.extend(tolerances.bad_electrode.then_some(Cause::BadElectrode));
    causes
}
