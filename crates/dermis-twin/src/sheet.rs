//! A bare conductor whose conductance depends on pressure: gel, carbon-filled silicone, hydrogel, fabric, with
//! electrodes and nothing above it.
//!
//! Under a pressure p the local sheet conductance is multiplied by `exp(a p - k e)`, limited to between 1/50 and 50:
//! - `e = p / E` is the compressive strain of a layer that is too thin and too well held to spread sideways, with E
//!   its compressive modulus;
//! - k, the gauge factor, is the relative loss of conductance per compressive strain. It is positive if thinning a
//!   layer removes conductor (a gel of constant conductivity has k near 1) and negative if compression packs a
//!   filler;
//! - a, the pressure coefficient, is the direct effect of pressure, as in fabrics whose fibres touch more. It is
//!   positive if pressing makes the layer conduct better.
//!
//! The exponential is the full form of the law `ds/s = (a - k/E) dp`: for small pressures the change is proportional
//! to p, and the conductance never reaches zero. The pressure of each element is taken at its centroid, smoothed by
//! the cover and including its memory.

use dermis_tomo::eit::{ForwardModel, Protocol};
use dermis_tomo::mesh::{ElectrodedMesh, Outline, Point};

use crate::electroded_layer::ElectrodedLayer;
use crate::error::{TwinError, check, check_positive};
use crate::healing::{Treatment, Wear, Wound};
use crate::instrument::Instrument;
use crate::mechanics::{Cover, Indenter, Memory, PressureState};
use crate::physics::{ConductanceMap, Cut, damaged_conductance};
use crate::twin::Frontend;

/// Limits of the conductance factor under any pressure.
const FACTORS: [f64; 2] = [0.02, 50.0];

/// Description of a bare sheet. SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct SheetOptions {
    /// The sheet with its electrodes.
    pub layer: ElectrodedLayer,
    /// Sheet conductance at rest, siemens: conductivity times thickness.
    pub sheet_s: f64,
    /// a: relative rise of the conductance per pascal, 1/Pa; see the module.
    pub pressure_coefficient_per_pa: f64,
    /// k: relative loss of conductance per compressive strain; see the module.
    pub gauge_factor: f64,
    /// E: compressive modulus, pascals.
    pub modulus_pa: f64,
    /// Spreading of pressure on its way to the sheet.
    pub cover: Cover,
    /// Viscoelastic memory of sheet and cover, if any.
    pub memory: Option<Memory>,
}

impl SheetOptions {
    /// The same skin with triangles of other edge lengths: in general, and at electrodes.
    #[must_use]
    pub fn meshed(mut self, element_size_m: f64, electrode_element_size_m: f64) -> Self {
        self.layer = self.layer.meshed(element_size_m, electrode_element_size_m);
        self
    }

    fn check(&self) -> Result<(), TwinError> {
        check_positive("sheet_s", self.sheet_s)?;
        check("pressure_coefficient_per_pa", self.pressure_coefficient_per_pa, f64::MIN, f64::MAX, "finite")?;
        check("gauge_factor", self.gauge_factor, f64::MIN, f64::MAX, "finite")?;
        check_positive("modulus_pa", self.modulus_pa)?;
        self.cover.check()?;
        self.memory.as_ref().map_or(Ok(()), Memory::check)?;
        self.layer.check()
    }
}

/// The sheet; see the module. Cuts block the elements that they cross as a whole ([`damaged_conductance`]). It does
/// not heal.
#[derive(Debug)]
pub struct SheetSkin {
    outline: Outline,
    model: ForwardModel,
    cover: Cover,
    state: PressureState,
    /// Relative change of the conductance per pascal: a - k/E.
    per_pa: f64,
    sheet_s: f64,
    conductance: ConductanceMap,
    /// Length by which cuts are shortened at both ends.
    inset_m: f64,
    wear: Wear,
    triangles_m: Vec<[Point; 3]>,
    centroids_m: Vec<Point>,
    pressure_pa: Vec<f64>,
    /// Sheet conductance of each element without pressure, siemens.
    rest_s: Vec<f64>,
    conductance_s: Vec<f64>,
    /// The conductance to which `voltages_v` belongs; empty at first.
    solved_s: Vec<f64>,
    voltages_v: Vec<f64>,
}

impl SheetSkin {
    /// Meshes the sheet.
    ///
    /// # Errors
    /// Invalid parameters, electrodes that do not fit the protocol, or a mesh that cannot be built.
    pub fn new(options: SheetOptions) -> Result<Self, TwinError> {
        options.check()?;
        let layer = options.layer;
        let (body, _) = layer.sheet_spec().build(&layer.contact_impedances_ohm_m2)?;
        let at = |node: u32| [body.mesh.nodes()[node as usize][0], body.mesh.nodes()[node as usize][1]];
        let triangles_m: Vec<[Point; 3]> = body.mesh.elements().map(|cell| [0, 1, 2].map(|k| at(cell[k]))).collect();
        let middle = |corners: &[Point; 3]| [0, 1].map(|axis| corners.iter().map(|p| p[axis]).sum::<f64>() / 3.0);
        let centroids_m: Vec<Point> = triangles_m.iter().map(middle).collect();
        let elements = centroids_m.len();
        let rest_s: Vec<f64> = centroids_m.iter().map(|place| options.sheet_s * layer.conductance.at(*place)).collect();
        Ok(Self {
            voltages_v: vec![0.0; layer.protocol.channel_count()],
            outline: layer.outline,
            model: ForwardModel::new(body, layer.protocol)?,
            cover: options.cover,
            state: PressureState::new(options.memory, elements),
            per_pa: options.pressure_coefficient_per_pa - options.gauge_factor / options.modulus_pa,
            sheet_s: options.sheet_s,
            inset_m: 0.5 * layer.element_size_m,
            wear: Wear::new(None),
            pressure_pa: vec![0.0; elements],
            conductance_s: rest_s.clone(),
            rest_s,
            conductance: layer.conductance,
            solved_s: Vec::new(),
            triangles_m,
            centroids_m,
        })
    }

    /// Its mesh with electrodes.
    pub fn body(&self) -> &ElectrodedMesh {
        self.model.body()
    }

    /// Currents and measurements.
    pub fn stimulation(&self) -> &Protocol {
        self.model.protocol()
    }

    /// Sheet conductance of each element after the last frame, siemens.
    pub fn conductance_s(&self) -> &[f64] {
        &self.conductance_s
    }

    fn renew_sheet(&mut self) {
        let cuts: Vec<Cut> = self.wear.wounds().map(|wound| wound.cut.shortened(self.inset_m)).collect();
        let share = self.wear.share();
        for ((rest, corners), centroid) in self.rest_s.iter_mut().zip(&self.triangles_m).zip(&self.centroids_m) {
            let sheet_s = self.sheet_s * share(*centroid) * self.conductance.at(*centroid);
            *rest = damaged_conductance(sheet_s, &cuts, *corners).xx;
        }
    }
}

impl Frontend for SheetSkin {
    fn channel_count(&self) -> usize {
        self.voltages_v.len()
    }

    fn extent(&self) -> Outline {
        self.outline.clone()
    }

    fn wired(&self, instrument: Instrument) -> Result<Instrument, TwinError> {
        instrument.with_protocol(self.model.protocol())
    }

    fn treat(&mut self, treatment: &Treatment) -> Result<(), TwinError> {
        if let Treatment::Cut(cut) = treatment {
            cut.check_reach(&self.outline)?;
        }
        self.wear.treat(treatment)?;
        self.renew_sheet();
        Ok(())
    }

    fn wounds(&self) -> Vec<Wound> {
        self.wear.wounds().collect()
    }

    fn voltages(&mut self, indenters: &[Indenter], dt_s: f64, voltages_v: &mut [f64]) -> Result<(), TwinError> {
        if self.wear.advance(dt_s) {
            self.renew_sheet();
        }
        self.pressure_pa.fill(0.0);
        for indenter in indenters {
            indenter.add_pressure(self.cover, &self.centroids_m, &mut self.pressure_pa);
        }
        self.state.apply(dt_s, &mut self.pressure_pa);
        let [least, most] = FACTORS.map(f64::ln);
        for ((now, rest), pressure) in self.conductance_s.iter_mut().zip(&self.rest_s).zip(&self.pressure_pa) {
            *now = rest * (self.per_pa * pressure).clamp(least, most).exp();
        }
        // A skin that is idle or held still costs nothing.
        if self.conductance_s != self.solved_s {
            self.voltages_v = self.model.voltages(&self.conductance_s)?;
            self.solved_s.clone_from(&self.conductance_s);
        }
        voltages_v.copy_from_slice(&self.voltages_v);
        Ok(())
    }
}
