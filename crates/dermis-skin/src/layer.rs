//! Material of a skin's layer. The kind decides the physics; each kind has its own parameters, units, defaults and
//! sources.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::Checker;
use crate::error::Error;
use crate::imaging::Polarity;

/// The conducting layer of a skin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Layer {
    /// A bare conductor: gel, carbon, hydrogel, fabric. Pressure changes its conductance directly.
    Sheet(SheetLayer),
    /// A sheet under a gap and a continuous shortcut layer that touches the sheet under pressure.
    Sandwich(SandwichLayer),
    /// A sheet under a gap and separate, highly conductive patches that touch the sheet under pressure.
    Patches(PatchesLayer),
    /// A liquid in a tray, under a membrane or open. Pressing makes it shallower.
    Liquid(LiquidLayer),
    /// Conductors on sponge or springs above coils.
    Elements(ElementsLayer),
}

/// A bare conductor. A pressure p multiplies the local conductance by `exp(c p - G p / E)`, with the pressure
/// coefficient c, the gauge factor G, and p/E, the compressive strain of a thin layer that cannot spread sideways.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SheetLayer {
    /// Thickness.
    pub thickness_mm: f64,
    /// Conductivity at rest.
    pub conductivity_s_per_m: f64,
    /// c: relative change of conductance with pressure, percent per kilopascal. Positive if pressing makes the
    /// material conduct better (carbon-filled foam).
    #[serde(default)]
    pub pressure_percent_per_kpa: f64,
    /// G: relative drop of conductance per compressive strain; 1 if conductance is proportional to thickness.
    #[serde(default = "one")]
    pub gauge_factor: f64,
    /// E: compressive modulus of the layer. Gelatin and hydrogels: 10 to 100 kPa.
    #[serde(default = "hundred")]
    pub modulus_kpa: f64,
    /// Distance over which pressure spreads on its way into the layer: standard deviation of a Gaussian. Default:
    /// half the thickness, at least 0.5 mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub smoothing_mm: Option<f64>,
    /// Viscoelastic memory, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory: Option<Memory>,
}

/// A sheet under a gap and a continuous shortcut layer (Chen, Wang et al., the self-healing sandwich).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SandwichLayer {
    /// Thickness of the sensing sheet.
    pub thickness_mm: f64,
    /// Conductivity at rest.
    pub conductivity_s_per_m: f64,
    /// Sheet conductance of the shortcut layer, which covers the whole skin; at least 100 times that of the sheet.
    /// Default: 35 um of copper at 5.8e7 S/m.
    #[serde(default = "SandwichLayer::copper_s")]
    pub shortcut_s: f64,
    /// Contact between sheet and shortcut.
    #[serde(default = "ContactLaw::sandwich")]
    pub contact: ContactLaw,
    /// Distance over which pressure spreads on its way to the gap: standard deviation of a Gaussian. Default: through
    /// 1 mm of composite and half a millimetre of gap.
    #[serde(default = "SandwichLayer::smoothing")]
    pub smoothing_mm: f64,
    /// Viscoelastic memory, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory: Option<Memory>,
}

/// A sheet under separate patches (Sánchez-Delgado et al. 2024).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PatchesLayer {
    /// Thickness of the sensing sheet.
    pub thickness_mm: f64,
    /// Conductivity at rest.
    pub conductivity_s_per_m: f64,
    /// Distance between the centres of neighbouring square patches along x and y. Default 10 (assumed; not in the
    /// paper).
    #[serde(default = "PatchesLayer::pitch")]
    pub pitch_mm: f64,
    /// Bare sheet between neighbouring patches. Default 1 (assumed).
    #[serde(default = "one")]
    pub gap_mm: f64,
    /// Number of contact cells along the side of a patch in the twin. Default: 5, or fewer on a skin with many
    /// patches.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cells_per_side: Option<usize>,
    /// Contact between sheet and patches.
    #[serde(default = "ContactLaw::patches")]
    pub contact: ContactLaw,
    /// Distance over which pressure spreads through the backing: standard deviation of a Gaussian. Default: 5.5 /
    /// sqrt(3), a uniform spread over 5.5 mm of neoprene to either side.
    #[serde(default = "PatchesLayer::smoothing")]
    pub smoothing_mm: f64,
    /// Viscoelastic memory, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory: Option<Memory>,
}

/// A liquid in a tray: enclosed and full under a stretched membrane, or open (the liquid skins of ionic).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LiquidLayer {
    /// Depth at rest.
    pub depth_mm: f64,
    /// Conductivity.
    pub conductivity_s_per_m: f64,
    /// Density. Default: water.
    #[serde(default = "LiquidLayer::density")]
    pub density_kg_per_m3: f64,
    /// Tension of the membrane; 0 for an open tank that objects are dipped into. Default 60, fitted to the published
    /// skin.
    #[serde(default = "LiquidLayer::tension")]
    pub tension_n_per_m: f64,
    /// Gravity in the skin's frame, z pointing out of the skin. Default: flat, face up.
    #[serde(default = "LiquidLayer::gravity")]
    pub gravity_m_per_s2: [f64; 3],
    /// Height of the electrodes on the wall, over which current enters. Default: the depth.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub electrode_height_mm: Option<f64>,
    /// Distance over which pressure spreads through the membrane: standard deviation of a Gaussian.
    #[serde(default = "LiquidLayer::smoothing")]
    pub smoothing_mm: f64,
    /// True if holes in the outline have walls that hold the membrane. A liquid without such walls cannot have holes.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub hole_walls: bool,
    /// Viscoelastic memory of the membrane, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory: Option<Memory>,
}

/// Conductors on sponge or springs above coils (the EM-skins). Their positions and shapes are in `frontend.elements`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ElementsLayer {
    /// Conductivity of the elements' metal.
    pub conductivity_s_per_m: f64,
    /// Relative permeability of the metal.
    #[serde(default = "one")]
    pub relative_permeability: f64,
    /// Stiffness of each spring at rest.
    pub stiffness_n_per_m: f64,
    /// Sharpness of stiffening towards the end of travel: 1 stiffens from the start, larger values stiffen later and
    /// more abruptly.
    #[serde(default = "ElementsLayer::sharpness")]
    pub sharpness: f64,
    /// Stiffness between neighbours, for instance through a common sponge; 0 for independent springs.
    #[serde(default)]
    pub coupling_n_per_m: f64,
    /// Standard deviation of the elements' heights; unknown to the reconstruction.
    #[serde(default = "ElementsLayer::tolerance")]
    pub height_tolerance_mm: f64,
    /// Viscoelastic memory, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory: Option<Memory>,
}

/// Contact conductance per area as a function of pressure: 0 up to the threshold, then `g_max x / (1 + x)` with
/// `x = ((p - p_t) / p_ref)^n`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ContactLaw {
    /// p_t: pressure that closes the gap.
    pub threshold_kpa: f64,
    /// p_ref: pressure above the threshold at half the saturated conductance.
    pub reference_kpa: f64,
    /// n: exponent of the power law.
    pub exponent: f64,
    /// g_max: conductance per area at saturation.
    pub saturation_s_per_m2: f64,
}

/// First-order viscoelastic memory (standard linear solid): a share of the pressure acts with this time constant.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Memory {
    /// Share of the pressure that acts with a delay, 0 to 1.
    pub share: f64,
    /// Time constant of the delay.
    pub time_constant_s: f64,
}

fn one() -> f64 {
    1.0
}

fn hundred() -> f64 {
    100.0
}

impl Layer {
    /// Keyword for the kind in the file.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Sheet(_) => "sheet",
            Self::Sandwich(_) => "sandwich",
            Self::Patches(_) => "patches",
            Self::Liquid(_) => "liquid",
            Self::Elements(_) => "elements",
        }
    }

    /// Thickness of the conducting layer, or depth of the liquid, metres; `None` for elements.
    pub fn thickness_m(&self) -> Option<f64> {
        let mm = match self {
            Self::Sheet(layer) => layer.thickness_mm,
            Self::Sandwich(layer) => layer.thickness_mm,
            Self::Patches(layer) => layer.thickness_mm,
            Self::Liquid(layer) => layer.depth_mm,
            Self::Elements(_) => return None,
        };
        Some(mm * 1e-3)
    }

    /// Conductivity at rest, S/m; for elements, the conductivity of their metal.
    pub fn conductivity_s_per_m(&self) -> f64 {
        match self {
            Self::Sheet(layer) => layer.conductivity_s_per_m,
            Self::Sandwich(layer) => layer.conductivity_s_per_m,
            Self::Patches(layer) => layer.conductivity_s_per_m,
            Self::Liquid(layer) => layer.conductivity_s_per_m,
            Self::Elements(layer) => layer.conductivity_s_per_m,
        }
    }

    /// Height over which electrodes on the rim touch the layer, metres; `None` for elements.
    pub fn rim_height_m(&self) -> Option<f64> {
        match self {
            Self::Liquid(layer) => Some(layer.electrode_height_mm.unwrap_or(layer.depth_mm) * 1e-3),
            other => other.thickness_m(),
        }
    }

    /// True for a liquid without a membrane: a tank that objects are dipped into.
    pub fn is_open_tank(&self) -> bool {
        matches!(self, Self::Liquid(layer) if layer.tension_n_per_m == 0.0)
    }

    /// Sign of the conductivity change under a touch, used if the file does not set it.
    pub fn polarity(&self) -> Polarity {
        match self {
            Self::Sheet(layer) if layer.response_per_kpa() < 0.0 => Polarity::LowersConductivity,
            Self::Liquid(_) => Polarity::LowersConductivity,
            _ => Polarity::RaisesConductivity,
        }
    }

    pub(crate) fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        let key = |name: &str| format!("frontend.layer.{name}");
        let conductivity = self.conductivity_s_per_m();
        checker.within(&key("conductivity_s_per_m"), conductivity, 1e-9, 1e9)?;
        match self {
            Self::Sheet(layer) => {
                checker.within(&key("thickness_mm"), layer.thickness_mm, 1e-6, 1e3)?;
                checker.within(&key("pressure_percent_per_kpa"), layer.pressure_percent_per_kpa, -1e4, 1e4)?;
                checker.within(&key("gauge_factor"), layer.gauge_factor, -1e3, 1e3)?;
                checker.within(&key("modulus_kpa"), layer.modulus_kpa, 1e-2, 1e9)?;
                if layer.response_per_kpa() == 0.0 {
                    let expected =
                        "a pressure coefficient or a gauge factor other than 0: otherwise a touch has no effect";
                    return Err(checker.refused(&key("gauge_factor"), layer.gauge_factor, expected));
                }
                if let Some(smoothing) = layer.smoothing_mm {
                    checker.within(&key("smoothing_mm"), smoothing, 1e-3, 1e3)?;
                }
                check_memory(layer.memory, checker)
            }
            Self::Sandwich(layer) => {
                checker.within(&key("thickness_mm"), layer.thickness_mm, 1e-6, 1e3)?;
                let sheet_s = conductivity * layer.thickness_mm * 1e-3;
                checker.within(&key("shortcut_s"), layer.shortcut_s, 100.0 * sheet_s, 1e9)?;
                layer.contact.check(checker)?;
                checker.within(&key("smoothing_mm"), layer.smoothing_mm, 1e-3, 1e3)?;
                check_memory(layer.memory, checker)
            }
            Self::Patches(layer) => {
                checker.within(&key("thickness_mm"), layer.thickness_mm, 1e-6, 1e3)?;
                checker.within(&key("pitch_mm"), layer.pitch_mm, 0.1, 1e3)?;
                checker.within(&key("gap_mm"), layer.gap_mm, 0.0, 0.9 * layer.pitch_mm)?;
                if let Some(cells) = layer.cells_per_side {
                    checker.count(&key("cells_per_side"), cells, 1, 16)?;
                }
                layer.contact.check(checker)?;
                checker.within(&key("smoothing_mm"), layer.smoothing_mm, 1e-3, 1e3)?;
                check_memory(layer.memory, checker)
            }
            Self::Liquid(layer) => {
                checker.within(&key("depth_mm"), layer.depth_mm, 1e-2, 1e4)?;
                checker.within(&key("density_kg_per_m3"), layer.density_kg_per_m3, 1.0, 1e5)?;
                // A membrane with almost no tension is neither a membrane nor an open tank.
                if layer.tension_n_per_m != 0.0 && !(1e-3..=1e6).contains(&layer.tension_n_per_m) {
                    let expected = "0 for an open tank, or 0.001 to 1e6";
                    return Err(checker.refused(&key("tension_n_per_m"), layer.tension_n_per_m, expected));
                }
                let gravity = layer.gravity_m_per_s2;
                gravity.iter().try_for_each(|&g| checker.within(&key("gravity_m_per_s2"), g, -1e3, 1e3))?;
                if layer.tension_n_per_m == 0.0 && gravity[2] >= 0.0 {
                    let expected = "a component z below 0: an open tank lies face up";
                    return Err(checker.refused(&key("gravity_m_per_s2"), format!("{gravity:?}"), expected));
                }
                if let Some(height) = layer.electrode_height_mm {
                    checker.within(&key("electrode_height_mm"), height, 1e-3, layer.depth_mm)?;
                }
                checker.within(&key("smoothing_mm"), layer.smoothing_mm, 1e-3, 1e3)?;
                check_memory(layer.memory, checker)
            }
            Self::Elements(layer) => {
                checker.within(&key("relative_permeability"), layer.relative_permeability, 0.5, 1e6)?;
                checker.within(&key("stiffness_n_per_m"), layer.stiffness_n_per_m, 1e-3, 1e9)?;
                checker.within(&key("sharpness"), layer.sharpness, 1.0, 100.0)?;
                checker.within(&key("coupling_n_per_m"), layer.coupling_n_per_m, 0.0, layer.stiffness_n_per_m)?;
                checker.within(&key("height_tolerance_mm"), layer.height_tolerance_mm, 0.0, 100.0)?;
                check_memory(layer.memory, checker)
            }
        }
    }
}

impl SheetLayer {
    /// Relative change of conductance with pressure for small pressures, 1/kPa.
    pub fn response_per_kpa(&self) -> f64 {
        0.01 * self.pressure_percent_per_kpa - self.gauge_factor / self.modulus_kpa
    }

    /// `smoothing_mm`, or its default.
    pub fn spread_mm(&self) -> f64 {
        self.smoothing_mm.unwrap_or((0.5 * self.thickness_mm).max(0.5))
    }
}

impl SandwichLayer {
    /// Contact under a usual press, as a share of the saturated contact.
    pub const USUAL_CONTACT: f64 = 0.6;

    fn copper_s() -> f64 {
        35e-6 * 5.8e7
    }

    fn smoothing() -> f64 {
        1.5
    }
}

impl PatchesLayer {
    /// Contact under a usual press, as a share of the saturated contact. Patches far from electrodes need more pressure
    /// to be visible than one layer over the whole sheet.
    pub const USUAL_CONTACT: f64 = 6.0 / 7.0;

    fn pitch() -> f64 {
        10.0
    }

    fn smoothing() -> f64 {
        5.5 / 3_f64.sqrt()
    }
}

impl LiquidLayer {
    fn density() -> f64 {
        1000.0
    }

    fn tension() -> f64 {
        60.0
    }

    fn gravity() -> [f64; 3] {
        [0.0, 0.0, -9.80665]
    }

    fn smoothing() -> f64 {
        0.5
    }
}

impl ElementsLayer {
    fn sharpness() -> f64 {
        2.0
    }

    fn tolerance() -> f64 {
        0.2
    }
}

impl ContactLaw {
    /// Pressure at this share of the saturated contact, kPa.
    pub fn pressure_at_kpa(&self, share: f64) -> f64 {
        self.threshold_kpa + self.reference_kpa * (share / (1.0 - share)).powf(self.exponent.recip())
    }

    /// Assumed, not fitted: the 80 kPa of the published presses then reach about 60 % of saturation, and current
    /// crosses into the copper within 2.4 mm of the indenter's edge.
    fn sandwich() -> Self {
        Self { threshold_kpa: 3.0, reference_kpa: 60.0, exponent: 1.5, saturation_s_per_m2: 1500.0 }
    }

    /// The reference pressure is fitted to the published limit of detection of 83 Pa; the other values are assumed.
    fn patches() -> Self {
        Self { threshold_kpa: 0.05, reference_kpa: 0.888, exponent: 1.5, saturation_s_per_m2: 200.0 }
    }

    fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        let key = |name: &str| format!("frontend.layer.contact.{name}");
        checker.within(&key("threshold_kpa"), self.threshold_kpa, 0.0, 1e6)?;
        checker.within(&key("reference_kpa"), self.reference_kpa, 1e-6, 1e6)?;
        checker.within(&key("exponent"), self.exponent, 0.1, 10.0)?;
        checker.within(&key("saturation_s_per_m2"), self.saturation_s_per_m2, 1e-6, 1e9)
    }
}

fn check_memory(memory: Option<Memory>, checker: &Checker<'_>) -> Result<(), Error> {
    let Some(memory) = memory else { return Ok(()) };
    checker.within("frontend.layer.memory.share", memory.share, 0.0, 1.0)?;
    checker.within("frontend.layer.memory.time_constant_s", memory.time_constant_s, 1e-3, 1e6)
}
