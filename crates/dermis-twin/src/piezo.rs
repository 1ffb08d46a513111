//! The piezoresistive skins of paper P (Sánchez-Delgado et al., Intelligent Service Robotics 17, 2024): a carbon-sprayed
//! sheet over 64 small electrodes on a circuit board, under loose fabric patches on a neoprene backing. Pressing brings
//! patches into contact with the sheet and raises its local conductivity. Square, disc, and the square bent on a cylinder.
//!
//! The electrodes' places are in figures that were not at hand: they are taken as the regular 8 x 8 grid on the square,
//! and as its image under the equal-area concentric map (Shirley and Chiu 1997) on the disc, numbered row by row to and
//! fro from the bottom left, so that 1 and 2, 2 and 3, ... are neighbours and only the last pair, as in the paper, is not.

mod experiments;

use dermis_tomo::eit::{Drive, Driven, Measure, Order, Protocol, ProtocolSpec, Reference};
use dermis_tomo::mesh::{ElectrodeShape, ElectrodedMesh, Outline, SheetSpec};
use serde::{Deserialize, Serialize};

use crate::error::{TwinError, check, check_positive};
use crate::instrument::{Instrument, InstrumentOptions};
use crate::mechanics::{ContactLaw, Cover, Indenter, Memory, PressureState};
use crate::physics::{ContactCell, PatchLayout, PatchedSheet, Surface};
use crate::scene::{Scene, SceneOptions, Script};
use crate::twin::{Frontend, Twin};

pub use experiments::{
    CorrelationCurve, DetectionCurve, ForcePoint, PUBLISHED_DISTANCES_M, PUBLISHED_LIMITS_PA, PaperP, PiezoFacts,
    ShiftPoint,
};

/// Electrodes along a side of the grid.
const PER_SIDE: usize = 8;

/// Outline of a piezoresistive skin, laid flat.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum PiezoShape {
    /// A square.
    Square {
        /// Its side, metres.
        side_m: f64,
    },
    /// A disc.
    Disc {
        /// Its diameter, metres.
        diameter_m: f64,
    },
}

/// Parameters of the twin. Those that paper P gives: shapes, 64 electrodes, current steps, thickness of the backing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PiezoOptions {
    /// Outline.
    pub shape: PiezoShape,
    /// What it lies on.
    pub surface: Surface,
    /// Radius of an electrode, metres (assumed; the paper says small).
    pub electrode_radius_m: f64,
    /// Edge length of the twin's triangles, metres.
    pub element_size_m: f64,
    /// Edge length at the electrodes, metres.
    pub electrode_element_size_m: f64,
    /// Resistance of a square of the sprayed layer, ohm. Assumed: much above the 400 ohm of the multiplexer, as stated.
    pub sheet_resistance_ohm: f64,
    /// Specific contact impedance of the electrodes, ohm.m^2 (assumed).
    pub contact_impedance_ohm_m2: f64,
    /// Current, amperes: 15 of the source's steps of 2.6 uA.
    pub current_a: f64,
    /// Frames a second for those who pace the twin. The paper's converter takes 860 samples a second and so 4.8 s for
    /// 4,096; the default is what makes a touch visible as it moves.
    pub frame_rate_hz: f64,
    /// The fabric patches.
    pub patches: PatchLayout,
    /// How pressure spreads through the backing: evenly over its thickness of 5.5 mm to either side has the standard
    /// deviation 5.5 mm / sqrt 3.
    pub cover: Cover,
    /// Contact of sheet and patches; see [`PiezoOptions::square`].
    pub contact: ContactLaw,
    /// Viscoelastic memory of the backing, where wanted.
    pub memory: Option<Memory>,
    /// Noise, drift, converter.
    pub instrument: InstrumentOptions,
    /// Fading, and how script and people share the skin.
    pub scene: SceneOptions,
    /// What touches it by itself.
    pub script: Option<Script>,
    /// Seed of the instrument's noise.
    pub seed: u64,
}

impl Default for PiezoOptions {
    fn default() -> Self {
        Self::square()
    }
}

impl PiezoOptions {
    /// The square of 150 mm.
    ///
    /// Of the contact, the paper gives one number for the square, its limit of detection of 83 Pa. It fixes one parameter,
    /// the reference pressure ([`PaperP::fit`], the value here); the others are assumed. The gap must close below that
    /// limit, and not far below, as 258 Pa (10 g) already gave significant voltages; growth is that of elastic rough
    /// surfaces while the gap still closes; at saturation current turns into the fabric within
    /// `sqrt(0.5 mS / 200 S/m^2)` = 1.6 mm.
    pub fn square() -> Self {
        Self {
            shape: PiezoShape::Square { side_m: 0.15 },
            surface: Surface::Flat,
            electrode_radius_m: 1.5e-3,
            element_size_m: 3.2e-3,
            electrode_element_size_m: 1.2e-3,
            sheet_resistance_ohm: 2e3,
            contact_impedance_ohm_m2: 1e-3,
            current_a: 15.0 * 2.6e-6,
            frame_rate_hz: 30.0,
            patches: PatchLayout::default(),
            cover: Cover { smoothing_m: 5.5e-3 / 3_f64.sqrt() },
            contact: ContactLaw { threshold_pa: 50.0, reference_pa: 888.0, exponent: 1.5, saturation_s_per_m2: 200.0 },
            memory: None,
            instrument: InstrumentOptions::piezo(),
            scene: SceneOptions::default(),
            script: None,
            seed: 1,
        }
    }

    /// The disc of 120 mm; all else as on the square.
    pub fn disc() -> Self {
        Self { shape: PiezoShape::Disc { diameter_m: 0.12 }, ..Self::square() }
    }

    /// The square bent on a cylinder of 190 mm diameter. Positions are those of the unrolled sheet.
    pub fn cylinder() -> Self {
        Self { surface: Surface::Cylinder { radius_m: 0.095 }, ..Self::square() }
    }

    /// Sheet conductance of the sprayed layer, siemens.
    pub fn sheet_s(&self) -> f64 {
        1.0 / self.sheet_resistance_ohm
    }

    /// Outline of the unrolled sheet.
    pub fn outline(&self) -> Outline {
        match self.shape {
            PiezoShape::Square { side_m } => Outline::Rectangle { width_m: side_m, height_m: side_m },
            PiezoShape::Disc { diameter_m } => Outline::Disc { radius_m: 0.5 * diameter_m },
        }
    }

    /// Middles of the 64 electrodes on the unrolled sheet, metres, in order; see the module.
    pub fn electrode_positions_m(&self) -> Vec<[f64; 2]> {
        let unit = |k: usize| (2.0 * k as f64 + 1.0) / PER_SIDE as f64 - 1.0;
        let place = |k: usize| {
            let (row, step) = (k / PER_SIDE, k % PER_SIDE);
            let column = if row.is_multiple_of(2) { step } else { PER_SIDE - 1 - step };
            let (x, y) = (unit(column), unit(row));
            match self.shape {
                PiezoShape::Square { side_m } => [0.5 * side_m * x, 0.5 * side_m * y],
                PiezoShape::Disc { diameter_m } => square_to_disc([x, y]).map(|value| 0.5 * diameter_m * value),
            }
        };
        (0..PER_SIDE * PER_SIDE).map(place).collect()
    }

    /// The protocol of paper P's backend: neighbours (k, k+1) drive, the last with the first; for each, all 64
    /// electrodes are read against the one that sinks: 4,096 channels, of which 64 (the sinks themselves) are zero.
    ///
    /// # Errors
    /// A current that is not positive and finite.
    pub fn protocol(&self) -> Result<Protocol, TwinError> {
        Ok(Protocol::generate(&ProtocolSpec {
            electrode_count: PER_SIDE * PER_SIDE,
            drive: Drive::Adjacent,
            measure: Measure::SingleEnded(Reference::Sink),
            order: Order::Absolute,
            driven: Driven::Keep,
            amplitude_a: self.current_a,
        })?)
    }

    fn check(&self) -> Result<(), TwinError> {
        match self.shape {
            PiezoShape::Square { side_m } => check_positive("side_m", side_m)?,
            PiezoShape::Disc { diameter_m } => check_positive("diameter_m", diameter_m)?,
        }
        if let Surface::Cylinder { radius_m } = self.surface {
            check_positive("surface radius_m", radius_m)?;
        }
        check_positive("electrode_radius_m", self.electrode_radius_m)?;
        check_positive("sheet_resistance_ohm", self.sheet_resistance_ohm)?;
        check_positive("contact_impedance_ohm_m2", self.contact_impedance_ohm_m2)?;
        check_positive("frame_rate_hz", self.frame_rate_hz)?;
        check_positive("cover smoothing_m", self.cover.smoothing_m)?;
        self.patches.check()?;
        // Cells couple pairwise: their number is bounded by memory.
        let (low, high) = self.outline().bounds_m();
        let cells = (high[0] - low[0]) * (high[1] - low[1]) / self.patches.cell_m().powi(2);
        check("contact cells on the sheet", cells, 1.0, 8000.0, "at most 8000: larger cells or patches")?;
        self.contact.check()?;
        self.memory.as_ref().map_or(Ok(()), Memory::check)
    }
}

/// The equal-area concentric map of Shirley and Chiu (1997): the square [-1, 1]^2 to the unit disc, squares about the centre
/// to circles.
pub fn square_to_disc([x, y]: [f64; 2]) -> [f64; 2] {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
    let (radius, angle) = if x.abs() > y.abs() {
        (x, FRAC_PI_4 * y / x)
    } else if y != 0.0 {
        (y, FRAC_PI_2 - FRAC_PI_4 * x / y)
    } else {
        (0.0, 0.0)
    };
    [radius * angle.cos(), radius * angle.sin()]
}

/// The skin itself; see the module.
#[derive(Clone, Debug)]
pub struct PiezoSkin {
    outline: Outline,
    body: ElectrodedMesh,
    surface: Surface,
    protocol: Protocol,
    sheet: PatchedSheet,
    places_m: Vec<[f64; 2]>,
    cover: Cover,
    contact: ContactLaw,
    state: PressureState,
    pressure_pa: Vec<f64>,
    contact_s_per_m2: Vec<f64>,
    /// The contact that `voltages_v` belongs to.
    solved_s_per_m2: Vec<f64>,
    solved: bool,
    voltages_v: Vec<f64>,
}

impl PiezoSkin {
    /// Meshes the skin, bends it, and solves the sheet without contact. A second in release.
    ///
    /// # Errors
    /// Parameters that make no sense, a mesh that cannot be made.
    pub fn new(options: &PiezoOptions) -> Result<Self, TwinError> {
        options.check()?;
        let protocol = options.protocol()?;
        let pad = |centre_m| ElectrodeShape::PadCircle { centre_m, radius_m: options.electrode_radius_m };
        let pads = options.electrode_positions_m().into_iter().map(pad).collect();
        let mut spec = SheetSpec::new(options.outline(), pads, options.element_size_m);
        spec.electrode_element_size_m = options.electrode_element_size_m;
        let (flat, _) = spec.build(&[options.contact_impedance_ohm_m2])?;
        let body = options.surface.bend(&flat)?;
        let sheet = PatchedSheet::new(&options.surface.unroll(&body)?, options.sheet_s(), options.patches)?;
        let places_m: Vec<[f64; 2]> = sheet.cells().iter().map(|cell| cell.centre_m).collect();
        let cells = places_m.len();
        Ok(Self {
            voltages_v: vec![0.0; protocol.channel_count()],
            outline: options.outline(),
            surface: options.surface,
            cover: options.cover,
            contact: options.contact,
            state: PressureState::new(options.memory, cells),
            pressure_pa: vec![0.0; cells],
            contact_s_per_m2: vec![0.0; cells],
            solved_s_per_m2: vec![0.0; cells],
            solved: false,
            places_m,
            body,
            protocol,
            sheet,
        })
    }

    /// Its mesh with electrodes, in space: bent where the skin is.
    pub fn body(&self) -> &ElectrodedMesh {
        &self.body
    }

    /// How the sheet lies in space, for drawing: [`Surface::point_m`] and back.
    pub fn surface(&self) -> Surface {
        self.surface
    }

    /// Stimulation and measurement.
    pub fn stimulation(&self) -> &Protocol {
        &self.protocol
    }

    /// The sheet under its patches.
    pub fn sheet(&self) -> &PatchedSheet {
        &self.sheet
    }

    /// Cells of contact, in the order of [`PiezoSkin::contact_s_per_m2`].
    pub fn cells(&self) -> &[ContactCell] {
        self.sheet.cells()
    }

    /// Contact conductance of each cell after the last frame, S/m^2.
    pub fn contact_s_per_m2(&self) -> &[f64] {
        &self.contact_s_per_m2
    }

    /// Replaces the contact law, as when fitting it.
    ///
    /// # Errors
    /// As [`ContactLaw::check`].
    pub fn set_contact(&mut self, contact: ContactLaw) -> Result<(), TwinError> {
        contact.check()?;
        (self.contact, self.solved) = (contact, false);
        Ok(())
    }

    /// Voltages by superposition of the electrodes' unit currents.
    fn solve(&mut self) -> Result<(), TwinError> {
        let impedance = self.sheet.impedance(&self.contact_s_per_m2)?;
        for (voltage, channel) in self.voltages_v.iter_mut().zip(self.protocol.measurements()) {
            let stimulation = &self.protocol.stimulations()[channel.stimulation as usize];
            let pattern = &self.protocol.patterns()[channel.pattern as usize];
            *voltage = 0.0;
            for &(electrode, weight) in pattern.entries() {
                for &(driven, current) in stimulation.entries() {
                    *voltage += weight * current * impedance[(electrode as usize, driven as usize)];
                }
            }
        }
        self.solved_s_per_m2.copy_from_slice(&self.contact_s_per_m2);
        self.solved = true;
        Ok(())
    }
}

impl Frontend for PiezoSkin {
    fn channel_count(&self) -> usize {
        self.protocol.channel_count()
    }

    fn extent(&self) -> Outline {
        self.outline.clone()
    }

    fn voltages(&mut self, indenters: &[Indenter], dt_s: f64, voltages_v: &mut [f64]) -> Result<(), TwinError> {
        self.pressure_pa.fill(0.0);
        for indenter in indenters {
            indenter.add_pressure(self.cover, &self.places_m, &mut self.pressure_pa);
        }
        self.state.apply(dt_s, &mut self.pressure_pa);
        for (g, pressure) in self.contact_s_per_m2.iter_mut().zip(&self.pressure_pa) {
            *g = self.contact.conductance_s_per_m2(*pressure);
        }
        // A skin that is left alone, or held still, costs nothing.
        if !self.solved || self.contact_s_per_m2 != self.solved_s_per_m2 {
            self.solve()?;
        }
        voltages_v.copy_from_slice(&self.voltages_v);
        Ok(())
    }
}

impl Twin<PiezoSkin> {
    /// The twin of one of paper P's skins.
    ///
    /// # Errors
    /// Parameters that make no sense, a mesh that cannot be made.
    pub fn piezo(options: &PiezoOptions) -> Result<Self, TwinError> {
        let frontend = PiezoSkin::new(options)?;
        let instrument = Instrument::new(options.instrument, frontend.channel_count(), options.seed)?;
        let instrument = instrument.with_protocol(frontend.stimulation())?;
        let scene = Scene::new(options.scene, options.script.clone())?.on(frontend.extent())?;
        Ok(Self::new(frontend, instrument, scene))
    }
}
