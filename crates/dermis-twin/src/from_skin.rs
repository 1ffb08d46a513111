//! Builds the twin of a skin from its file alone: geometry, layer, instrument and presses.
//!
//! The twin's mesh depends on size and layer, and differs from the reconstruction's mesh: the element size is a share
//! of the side (see [`MeshSizes`]), smaller at electrodes. `[twin]` in the file can override all of it.

mod electronics;
mod history;
mod press;

use dermis_mit::{CoilArray, Coupling};
use dermis_skin::budget::Budget;
use dermis_skin::{CircuitChoice, Layer, LiquidLayer, PatchesLayer, SandwichLayer, SheetLayer, Skin};
use dermis_tomo::mesh::ElectrodeShape;

use crate::circuit::{BehindCircuit, impedance_protocol};
use crate::electroded_layer::ElectrodedLayer;
use crate::elements::{Conductor, ElementOptions, ElementSkin};
use crate::error::TwinError;
use crate::healing::HealingLaw;
use crate::liquid::{LiquidOptions, LiquidSkin, LiquidSolver};
use crate::mechanics::{ContactLaw, Cover, Indenter, Memory, Springs};
use crate::patched::{PatchedOptions, PatchedSkin};
use crate::physics::{ConductanceMap, PatchLayout};
use crate::sandwich::{Sandwich, SandwichOptions};
use crate::scene::{SceneOptions, Script};
use crate::sheet::{SheetOptions, SheetSkin};
use crate::twin::{Frontend, Twin, TwinOptions};

pub use electronics::{instrument_options, resting_voltage_v};
pub use history::{timed_faults, timed_treatments, treatment_of};
pub use press::{PressRange, demonstration, press_range, usual_travel_share};

const MM: f64 = 1e-3;
/// Default seed.
const SEED: u64 = 1;

/// Seed of a twin's noise and tolerances: from the file, otherwise 1.
pub fn seed_of(skin: &Skin) -> u64 {
    skin.twin.seed.unwrap_or(SEED)
}

/// Maximum degree of the coupling between elements, and number of sweeps.
const COUPLING: (usize, usize) = (3, 2);
/// Maximum distance between coupled elements, in cells; includes diagonal neighbours.
const REACH_CELLS: f64 = 1.5;
/// R, J/(mol K).
const GAS_CONSTANT: f64 = 8.314;

/// A twin of any skin.
pub type AnyTwin = Twin<Box<dyn Frontend>>;

/// A twin with its presses and demonstration.
#[derive(Debug)]
pub struct TwinKit {
    /// The twin, at rest.
    pub twin: AnyTwin,
    /// Range of presses available to users.
    pub press: PressRange,
    /// Touches that the twin plays by itself while idle.
    pub demo: Script,
}

impl AnyTwin {
    /// The twin of a skin, with the faults and treatments in its file.
    ///
    /// # Errors
    /// Geometry that cannot be meshed, or a physically impossible combination.
    pub fn from_skin(skin: &Skin) -> Result<Self, TwinError> {
        Ok(TwinKit::of(skin)?.twin)
    }
}

impl TwinKit {
    /// The twin of a skin, the range of presses, and its demonstration.
    ///
    /// # Errors
    /// As [`Twin::from_skin`].
    pub fn of(skin: &Skin) -> Result<Self, TwinError> {
        Self::built(skin, &AsBuilt::nominal(skin))
    }

    /// The same for a skin as actually built.
    ///
    /// # Errors
    /// As [`Twin::from_skin`].
    pub fn built(skin: &Skin, built: &AsBuilt) -> Result<Self, TwinError> {
        let side_m = skin.outline().area_m2().sqrt();
        // Number of equilateral triangles with this edge length.
        let triangles = 2.3 * (side_m / MeshSizes::of(skin).element_m).powi(2);
        Budget::of_twin(skin, triangles).check(skin, "its twin")?;
        let mut frontend = frontend_of(skin, built)?;
        let instrument = instrument_options(skin, resting_voltage_v(&mut *frontend)?);
        let seed = seed_of(skin);
        let options = TwinOptions { instrument, scene: SceneOptions::default(), script: None, seed };
        let mut twin = Twin::of(frontend, &options)?;
        twin.set_faults(timed_faults(&skin.twin))?;
        twin.set_treatments(timed_treatments(&skin.twin))?;
        let press = press_range(skin);
        Ok(Self { demo: demonstration(skin, &press), twin, press })
    }
}

/// Approximate readings of a skin at rest and under its typical press, from a twin with large elements.
#[derive(Clone, Debug, PartialEq)]
pub struct TypicalPress {
    /// Voltages at rest, one per channel.
    pub rest_v: Vec<f64>,
    /// Voltages under the initial press of the sliders ([`PressRange`]) in the middle of the skin.
    pub pressed_v: Vec<f64>,
}

/// Element size of the twin used for a typical press, relative to the actual twin.
const COARSER: f64 = 2.5;

impl TypicalPress {
    /// The typical press of a skin; `None` if its middle cannot be pressed.
    ///
    /// # Errors
    /// As [`Twin::from_skin`].
    pub fn of(skin: &Skin) -> Result<Option<Self>, TwinError> {
        let MeshSizes { element_m, electrode_m } = MeshSizes::of(skin);
        let mut coarse = skin.clone();
        coarse.twin.element_mm = Some(COARSER * element_m / MM);
        coarse.twin.electrode_element_mm = Some(COARSER * electrode_m / MM);
        let mut frontend = frontend_of(&coarse, &AsBuilt::nominal(&coarse))?;
        let press = press_range(skin);
        let indenter = Indenter::disc([0.0; 2], press.initial_radius_m, press.initial_pressure_pa);
        if frontend.check_indenter(&indenter).is_err() {
            return Ok(None);
        }
        let [mut rest_v, mut pressed_v] = [vec![0.0; frontend.channel_count()], vec![0.0; frontend.channel_count()]];
        frontend.voltages(&[], 0.0, &mut rest_v)?;
        frontend.voltages(&[indenter], 0.0, &mut pressed_v)?;
        Ok(Some(Self { rest_v, pressed_v }))
    }
}

/// Geometry of a skin as actually built. Materials and instrument come from the skin file.
#[derive(Clone, Debug)]
pub struct AsBuilt {
    /// Actual electrode positions, in order; empty for skins with coils.
    pub electrodes: Vec<ElectrodeShape>,
    /// Factor on the contact impedance of each electrode.
    pub contact_factors: Vec<f64>,
    /// Sheet conductance over the skin, relative to the file's.
    pub conductance: ConductanceMap,
}

impl AsBuilt {
    /// Exactly as in the file.
    pub fn nominal(skin: &Skin) -> Self {
        let of_coils = skin.frontend.coils.is_some();
        let electrodes = if of_coils { Vec::new() } else { skin.electrode_shapes() };
        let contact_factors = vec![1.0; electrodes.len()];
        Self { electrodes, contact_factors, conductance: ConductanceMap::Even }
    }
}

/// Edge lengths of a twin's elements, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshSizes {
    /// Default edge length: the square root of the area divided by 60 (sandwich), 50 (sheet), 45 (patches), 35
    /// (liquid). Where a fingertip is small against the skin, it is less, so that at least 4 (sandwich), 3.3 (sheet) or
    /// 2.3 (liquid) elements span its radius; at most 1.5 times less, for the sake of time.
    pub element_m: f64,
    /// Edge length at electrodes: a sixth of the narrowest, or a quarter of small round pads; at most the default.
    pub electrode_m: f64,
}

/// Edge length in radii of a fingertip, times the number of parts of a skin's side.
const OF_FINGERTIP: f64 = 15.0;
/// Largest factor by which a fingertip makes elements smaller. Solving takes up to three times as long.
const MOST_FINER: f64 = 1.5;

impl MeshSizes {
    /// The sizes for a skin.
    pub fn of(skin: &Skin) -> Self {
        let parts = match skin.frontend.layer {
            Layer::Sandwich(_) => 60.0,
            Layer::Sheet(_) => 50.0,
            Layer::Patches(_) => 45.0,
            Layer::Liquid(_) | Layer::Elements(_) => 35.0,
        };
        let side_m = skin.outline().area_m2().sqrt();
        let usual_m = side_m / parts;
        let natural_m = match skin.frontend.layer {
            // The cells of a patch resolve a fingertip.
            Layer::Patches(_) | Layer::Elements(_) => usual_m,
            _ => usual_m.min(skin.fingertip_m() * OF_FINGERTIP / parts).max(usual_m / MOST_FINER),
        };
        let element_m = skin.twin.element_mm.map_or(natural_m, |mm| mm * MM);
        let width = |shape: &ElectrodeShape| match *shape {
            ElectrodeShape::RimArc { width_m, .. } | ElectrodeShape::RimSegment { width_m, .. } => width_m / 6.0,
            ElectrodeShape::PadRectangle { width_m, height_m, .. } => width_m.min(height_m) / 6.0,
            ElectrodeShape::PadCircle { radius_m, .. } => radius_m / 2.0,
            ElectrodeShape::Point { .. } | ElectrodeShape::RimPoint { .. } => f64::INFINITY,
        };
        let narrowest_m = skin.electrode_shapes().iter().map(width).fold(f64::INFINITY, f64::min);
        // Elements that are tiny compared to the skin would only cost time.
        let natural_m = narrowest_m.max(side_m / 1000.0).min(element_m);
        Self { element_m, electrode_m: skin.twin.electrode_element_mm.map_or(natural_m, |mm| (mm * MM).min(element_m)) }
    }
}

/// The layer of a skin that has electrodes, as built.
fn electroded_layer(skin: &Skin, built: &AsBuilt) -> Result<ElectrodedLayer, TwinError> {
    let impedances = skin.sheet_contact_impedances(&built.electrodes);
    let MeshSizes { element_m, electrode_m } = MeshSizes::of(skin);
    Ok(ElectrodedLayer {
        outline: skin.outline(),
        contact_impedances_ohm_m2: impedances.zip(&built.contact_factors).map(|(z, factor)| z * factor).collect(),
        electrodes: built.electrodes.clone(),
        protocol: match skin.backend.circuit {
            Some(_) => impedance_protocol(built.electrodes.len())?,
            None => skin.protocol()?,
        },
        conductance: built.conductance.clone(),
        element_size_m: element_m,
        electrode_element_size_m: electrode_m,
    })
}

/// Options of a skin of patches, from its file.
///
/// # Errors
/// A skin with another layer, or patterns that need other electrodes.
pub fn patched_options(skin: &Skin) -> Result<PatchedOptions, TwinError> {
    let Layer::Patches(layer) = &skin.frontend.layer else {
        return Err(TwinError::Missing { field: "frontend.layer of kind \"patches\"", of: "a skin of patches" });
    };
    Ok(patches(skin, layer, electroded_layer(skin, &AsBuilt::nominal(skin))?))
}

fn frontend_of(skin: &Skin, built: &AsBuilt) -> Result<Box<dyn Frontend>, TwinError> {
    let behind = read_frontend_of(skin, built)?;
    // A circuit that is still to be identified is not part of the twin.
    Ok(match skin.backend.circuit.as_ref().and_then(CircuitChoice::known) {
        Some(circuit) => {
            let (protocol, sheet_s) = (skin.protocol()?, skin.sheet_conductance_s());
            Box::new(BehindCircuit::new(behind, circuit.readout(), protocol, sheet_s))
        }
        None => behind,
    })
}

/// The skin as its protocol reads it; or, behind a circuit, its transfer impedances.
fn read_frontend_of(skin: &Skin, built: &AsBuilt) -> Result<Box<dyn Frontend>, TwinError> {
    let electroded = || electroded_layer(skin, built);
    Ok(match &skin.frontend.layer {
        Layer::Sheet(layer) => Box::new(SheetSkin::new(sheet_options(skin, layer, electroded()?))?),
        Layer::Sandwich(layer) => Box::new(Sandwich::new(sandwich_options(skin, layer, electroded()?))?),
        Layer::Patches(layer) => Box::new(PatchedSkin::new(patches(skin, layer, electroded()?))?),
        Layer::Liquid(layer) => Box::new(LiquidSkin::new(liquid_options(skin, layer, electroded()?))?),
        Layer::Elements(_) => Box::new(ElementSkin::new(element_options(skin)?)?),
    })
}

fn memory(memory: Option<dermis_skin::Memory>) -> Option<Memory> {
    memory.map(|memory| Memory { share: memory.share, time_constant_s: memory.time_constant_s })
}

impl From<&dermis_skin::ContactLaw> for ContactLaw {
    fn from(law: &dermis_skin::ContactLaw) -> Self {
        Self {
            threshold_pa: law.threshold_kpa * 1e3,
            reference_pa: law.reference_kpa * 1e3,
            exponent: law.exponent,
            saturation_s_per_m2: law.saturation_s_per_m2,
        }
    }
}

fn cover(smoothing_mm: f64) -> Cover {
    Cover { smoothing_m: smoothing_mm * MM }
}

fn sheet_options(skin: &Skin, layer: &SheetLayer, electroded: ElectrodedLayer) -> SheetOptions {
    SheetOptions {
        layer: electroded,
        sheet_s: skin.sheet_conductance_s(),
        pressure_coefficient_per_pa: layer.pressure_percent_per_kpa * 1e-5,
        gauge_factor: layer.gauge_factor,
        modulus_pa: layer.modulus_kpa * 1e3,
        cover: cover(layer.spread_mm()),
        memory: memory(layer.memory),
    }
}

fn sandwich_options(skin: &Skin, layer: &SandwichLayer, electroded: ElectrodedLayer) -> SandwichOptions {
    let healing = skin.twin.healing.map(|law| HealingLaw {
        temperature_c: law.temperature_c,
        duration_s: law.hours * 3600.0,
        room_c: law.room_c,
        activation_k: law.activation_kj_per_mol * 1e3 / GAS_CONSTANT,
        peak_rise: law.peak_rise,
        lasting_rise: law.lasting_rise,
        relaxation_s: law.relaxation_hours * 3600.0,
        scar_m: law.scar_mm * MM,
        pad_rim_m: law.pad_rim_mm * MM,
    });
    SandwichOptions {
        layer: electroded,
        sheet_s: skin.sheet_conductance_s(),
        shortcut_s: layer.shortcut_s,
        cover: cover(layer.smoothing_mm),
        contact: ContactLaw::from(&layer.contact),
        memory: memory(layer.memory),
        healing,
    }
}

fn patches(skin: &Skin, layer: &PatchesLayer, electroded: ElectrodedLayer) -> PatchedOptions {
    let (pitch_m, gap_m) = (layer.pitch_mm * MM, layer.gap_mm * MM);
    let natural = || PatchLayout::natural_cells(pitch_m, gap_m, &electroded.outline);
    let cells_per_side = layer.cells_per_side.unwrap_or_else(natural);
    PatchedOptions {
        layer: electroded,
        sheet_s: skin.sheet_conductance_s(),
        patches: PatchLayout { pitch_m, gap_m, cells_per_side },
        cover: cover(layer.smoothing_mm),
        contact: ContactLaw::from(&layer.contact),
        memory: memory(layer.memory),
    }
}

fn liquid_options(skin: &Skin, layer: &LiquidLayer, mut electroded: ElectrodedLayer) -> LiquidOptions {
    let depth_m = layer.depth_mm * MM;
    let specific = skin.frontend.contact_impedance_ohm_m2;
    let rim = |shape: &ElectrodeShape| {
        matches!(
            shape,
            ElectrodeShape::RimArc { .. } | ElectrodeShape::RimSegment { .. } | ElectrodeShape::RimPoint { .. }
        )
    };
    let height_m = layer.electrode_height_mm.map_or(depth_m, |mm| mm * MM);
    // The file gives specific impedances; on the rim the sheet divides them by the height.
    let back = |(shape, z): (&ElectrodeShape, &f64)| if rim(shape) { z * height_m } else { *z };
    let factors = electroded.electrodes.iter().zip(&electroded.contact_impedances_ohm_m2).map(back);
    electroded.contact_impedances_ohm_m2 = if factors.clone().all(|z| (z / specific - 1.0).abs() < 1e-12) {
        vec![specific; electroded.electrodes.len()]
    } else {
        factors.collect()
    };
    LiquidOptions {
        layer: electroded,
        electrode_height_m: height_m,
        electrode_middle_m: 0.5 * depth_m,
        depth_m,
        conductivity_s_per_m: layer.conductivity_s_per_m,
        density_kg_per_m3: layer.density_kg_per_m3,
        tension_n_per_m: layer.tension_n_per_m,
        gravity_m_per_s2: layer.gravity_m_per_s2,
        cover: cover(layer.smoothing_mm),
        memory: memory(layer.memory),
        solver: LiquidSolver::DepthAveraged,
    }
}

/// Options of the elements of a skin over coils.
///
/// # Errors
/// A skin without elements, invalid coils, or a body that cannot be computed.
pub fn element_options(skin: &Skin) -> Result<ElementOptions, TwinError> {
    let missing = |field: &'static str| TwinError::Missing { field, of: "a skin of elements over coils" };
    let Layer::Elements(layer) = &skin.frontend.layer else {
        return Err(missing("frontend.layer of kind \"elements\""));
    };
    let coils = skin.frontend.coils.as_ref().ok_or(missing("frontend.coils"))?;
    let elements = skin.frontend.elements.as_ref().ok_or(missing("frontend.elements"))?;
    let frequency_hz = 1e3 * skin.backend.frequency_khz.ok_or(missing("backend.frequency_khz"))?;
    let element = skin.element().ok_or(missing("frontend.elements"))?;
    let array: CoilArray = coils.array()?;
    let (degree, sweeps) = COUPLING;
    Ok(ElementOptions {
        outline: skin.outline(),
        coils: array,
        places_m: elements.places_m(),
        cell_m: elements.cell_m(),
        rest_m: elements.rest_mm / 1e3,
        tolerance_m: layer.height_tolerance_mm * MM,
        element: Conductor::Body(dermis_mit::catalogue::body_of(&element, frequency_hz)?),
        springs: Springs {
            stiffness_n_per_m: layer.stiffness_n_per_m,
            limit_m: elements.travel_mm / 1e3,
            sharpness: layer.sharpness,
            coupling_n_per_m: layer.coupling_n_per_m,
        },
        memory: memory(layer.memory),
        coupling: Some(Coupling { degree, reach_m: REACH_CELLS * elements.pitch_m(), sweeps }),
        current_a: skin.backend.current_ma / 1e3,
        frequency_hz,
        nearby: None,
        seed: seed_of(skin),
    })
}
