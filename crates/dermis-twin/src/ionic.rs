//! `ionic-disc` and `ionic-square`, the liquid skins of paper I: salted water in a shallow tray under a stretched latex
//! membrane, closed and full, with 16 bolts through its wall. Pressing dents the membrane, the liquid beneath gets
//! shallower there and deeper elsewhere, and the voltages follow from the depth alone.

use std::f64::consts::FRAC_PI_2;

use dermis_tomo::eit::{Drive, Driven, Measure, Order, Protocol, ProtocolSpec};
use dermis_tomo::mesh::{Direction, ElectrodeShape, Outline};
use serde::{Deserialize, Serialize};

use crate::error::{TwinError, check_positive};
use crate::instrument::{Instrument, InstrumentOptions, Noise};
use crate::mechanics::{Cover, Indenter, Membrane, MembraneSpec, Memory, PressureState, STANDARD_GRAVITY_M_PER_S2};
use crate::physics::{LiquidElectrodes, LiquidFields, LiquidSpec};
use crate::scene::{Scene, SceneOptions, Script};
use crate::twin::{Frontend, Twin};

/// Bolts of a skin.
const ELECTRODES: usize = 16;
/// Share of the depth that always stays liquid: a membrane that touches the bottom is clipped to this film.
const LEAST_FILM: f64 = 0.02;
/// Loads that differ by less than this in all, newtons, are the same: 1/60,000 of paper I's smallest weight.
const SAME_LOAD_N: f64 = 1e-6;

/// Outline of a liquid skin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum IonicShape {
    /// Round; electrode 1 at the top, numbered clockwise.
    Disc {
        /// Diameter of the liquid.
        diameter_m: f64,
    },
    /// Square, four electrodes a side; electrode 1 at the left of the bottom side, numbered counter-clockwise.
    Square {
        /// Side of the liquid.
        side_m: f64,
    },
}

/// How fields are solved.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum IonicFields {
    /// In the plane, with the depth as a sheet's conductance: fast.
    DepthAveraged,
    /// On tetrahedra, with the bolts as small as they are: a second or two a frame, to check the other.
    Solid {
        /// About how many layers of elements.
        layers: usize,
    },
}

/// Parameters of the twin. The defaults are those of paper I where it gives any.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IonicOptions {
    /// Outline.
    pub shape: IonicShape,
    /// Depth of the liquid at rest, metres.
    pub depth_m: f64,
    /// Conductivity of the liquid, S/m. Assumed: tap water with about 2.5 g/l of salt; the paper only says that salt was
    /// added until the instrument was content.
    pub conductivity_s_per_m: f64,
    /// Density of the liquid, kg/m^3.
    pub density_kg_per_m3: f64,
    /// Side of the square that stands for a bolt's washer, metres. Assumed: the area of a standard M3 washer of 7 mm.
    pub electrode_side_m: f64,
    /// Height of the bolts' middles as a share of the depth: 0.5 is mid-depth. Only fields in three dimensions know it.
    pub electrode_height_share: f64,
    /// Specific contact impedance of the bolts, ohm.m^2; assumed. Four-electrode voltages hardly depend on it.
    pub contact_impedance_ohm_m2: f64,
    /// Tension of the membrane, newtons per metre: fitted, see the book's page on this skin.
    pub tension_n_per_m: f64,
    /// Gravity in the skin's frame, m/s^2; the default lies flat, face up.
    pub gravity_m_per_s2: [f64; 3],
    /// How pressure spreads on its way through the latex of 0.4 mm.
    pub cover: Cover,
    /// Viscoelastic memory of the latex: fitted.
    pub memory: Option<Memory>,
    /// How fields are solved.
    pub fields: IonicFields,
    /// Edge length of the twin's triangles, metres. Its mesh is finer than a reconstruction's and of other sizes.
    pub element_size_m: f64,
    /// Edge length at the bolts, metres.
    pub electrode_element_size_m: f64,
    /// Electrodes passed over between the two of a drive, and between those of a measuring pair; 0 is adjacent, as published.
    pub skip: usize,
    /// Amplitude of the current, amperes.
    pub current_a: f64,
    /// Frames a second for those who pace the twin.
    pub frame_rate_hz: f64,
    /// Noise, drift, converter.
    pub instrument: InstrumentOptions,
    /// Fading, and how script and people share the skin.
    pub scene: SceneOptions,
    /// What touches it by itself.
    pub script: Option<Script>,
    /// Seed of the instrument's noise.
    pub seed: u64,
}

impl Default for IonicOptions {
    fn default() -> Self {
        Self {
            shape: IonicShape::Disc { diameter_m: 0.174 },
            depth_m: 10.25e-3,
            conductivity_s_per_m: 0.5,
            density_kg_per_m3: 1000.0,
            electrode_side_m: 6.2e-3,
            electrode_height_share: 0.5,
            contact_impedance_ohm_m2: 1e-4,
            tension_n_per_m: 60.0,
            gravity_m_per_s2: [0.0, 0.0, -STANDARD_GRAVITY_M_PER_S2],
            cover: Cover { smoothing_m: 0.5e-3 },
            memory: Some(Memory { share: 0.05, time_constant_s: 20.0 }),
            fields: IonicFields::DepthAveraged,
            element_size_m: 4.5e-3,
            electrode_element_size_m: 1.2e-3,
            skip: 0,
            current_a: 6e-3,
            frame_rate_hz: 16.0,
            instrument: InstrumentOptions::ionic(),
            scene: SceneOptions::default(),
            script: None,
            seed: 1,
        }
    }
}

impl IonicOptions {
    /// The round skin of 174 mm.
    pub fn disc() -> Self {
        Self::default()
    }

    /// The square skin of 212 mm.
    pub fn square() -> Self {
        Self { shape: IonicShape::Square { side_m: 0.212 }, ..Self::default() }
    }

    /// Noise in proportion to each reading that has the paper's 59.7 dB if they are an amplitude ratio as usual,
    /// `20 log10(mean / deviation)`: 1.0e-3 of the reading. The default, and the harder of the two readings.
    pub fn amplitude_noise() -> Noise {
        InstrumentOptions::ionic().noise
    }

    /// The same if they are what the paper's eq. 1 prints, `10 log10(mean / deviation)`: 1.1e-6 of the reading, better
    /// than converters of 16 bits can do.
    pub fn printed_noise() -> Noise {
        InstrumentOptions::ionic_as_printed().noise
    }

    /// Outline of the liquid.
    pub fn outline(&self) -> Outline {
        match self.shape {
            IonicShape::Disc { diameter_m } => Outline::Disc { radius_m: 0.5 * diameter_m },
            IonicShape::Square { side_m } => Outline::Rectangle { width_m: side_m, height_m: side_m },
        }
    }

    /// The stretches of the rim that the bolts cover, in order.
    pub fn electrodes(&self) -> Vec<ElectrodeShape> {
        match self.shape {
            IonicShape::Disc { .. } => {
                Outline::rim_arcs(ELECTRODES, self.electrode_side_m, FRAC_PI_2, Direction::Clockwise)
            }
            IonicShape::Square { .. } => {
                self.outline().rim_per_side(ELECTRODES / 4, self.electrode_side_m, Direction::CounterClockwise)
            }
        }
    }

    /// Adjacent drive and measurement (or pairs farther apart), channels on driven electrodes dropped: 208 channels where
    /// adjacent.
    ///
    /// # Errors
    /// A current that is not positive and finite, a skip of too many electrodes.
    pub fn protocol(&self) -> Result<Protocol, TwinError> {
        Ok(Protocol::generate(&ProtocolSpec {
            electrode_count: ELECTRODES,
            drive: Drive::Skip(self.skip),
            measure: Measure::Skip(self.skip),
            order: Order::Absolute,
            driven: Driven::Drop,
            amplitude_a: self.current_a,
        })?)
    }

    fn liquid(&self) -> LiquidSpec {
        LiquidSpec {
            outline: self.outline(),
            depth_m: self.depth_m,
            conductivity_s_per_m: self.conductivity_s_per_m,
            electrodes: LiquidElectrodes {
                rim: self.electrodes(),
                height_m: self.electrode_side_m,
                middle_m: self.electrode_height_share * self.depth_m,
                contact_impedance_ohm_m2: self.contact_impedance_ohm_m2,
            },
            element_size_m: self.element_size_m,
            electrode_element_size_m: self.electrode_element_size_m,
        }
    }
}

/// The liquid skin itself; see the module.
#[derive(Debug)]
pub struct IonicSkin {
    outline: Outline,
    depth_m: f64,
    cover: Cover,
    membrane: Membrane,
    fields: LiquidFields,
    memory: PressureState,
    load_n: Vec<f64>,
    /// The load that `voltages_v` belongs to, once there are any.
    solved_n: Vec<f64>,
    solved: bool,
    depth_at_m: Vec<f64>,
    bottomed_nodes: usize,
    bottomed_frames: u64,
    voltages_v: Vec<f64>,
}

impl IonicSkin {
    /// Meshes the tray, factors its membrane and prepares its fields.
    ///
    /// # Errors
    /// Parameters that make no sense, a mesh that cannot be made, a membrane too slack to hang from.
    pub fn new(options: &IonicOptions) -> Result<Self, TwinError> {
        check_positive("frame_rate_hz", options.frame_rate_hz)?;
        check_positive("cover smoothing_m", options.cover.smoothing_m)?;
        options.memory.as_ref().map_or(Ok(()), Memory::check)?;
        let (liquid, protocol) = (options.liquid(), options.protocol()?);
        let fields = match options.fields {
            IonicFields::DepthAveraged => LiquidFields::averaged(liquid, protocol)?,
            IonicFields::Solid { layers } => LiquidFields::solid(liquid, layers, protocol)?,
        };
        let spec = MembraneSpec {
            tension_n_per_m: options.tension_n_per_m,
            density_kg_per_m3: options.density_kg_per_m3,
            gravity_m_per_s2: options.gravity_m_per_s2,
        };
        let membrane = Membrane::new(fields.plan(), spec)?;
        let nodes = membrane.positions_m().len();
        Ok(Self {
            outline: options.outline(),
            depth_m: options.depth_m,
            cover: options.cover,
            memory: PressureState::new(options.memory, nodes),
            load_n: vec![0.0; nodes],
            solved_n: vec![0.0; nodes],
            solved: false,
            depth_at_m: vec![options.depth_m; nodes],
            bottomed_nodes: 0,
            bottomed_frames: 0,
            voltages_v: vec![0.0; fields.protocol().channel_count()],
            membrane,
            fields,
        })
    }

    /// The membrane as the last frame left it.
    pub fn membrane(&self) -> &Membrane {
        &self.membrane
    }

    /// The liquid's fields.
    pub fn fields(&self) -> &LiquidFields {
        &self.fields
    }

    /// Depth of the liquid at each of the membrane's nodes in the last frame, metres.
    pub fn depth_at_m(&self) -> &[f64] {
        &self.depth_at_m
    }

    /// Nodes at which the membrane touched the bottom in the last frame. There the model ends: the depth is clipped to a
    /// film of 2 % of the tray's, the bottom bears no load, and liquid is not conserved.
    pub fn bottomed_nodes(&self) -> usize {
        self.bottomed_nodes
    }

    /// Frames so far in which the membrane touched the bottom anywhere.
    pub fn bottomed_frames(&self) -> u64 {
        self.bottomed_frames
    }

    fn solve(&mut self) -> Result<(), TwinError> {
        self.membrane.deflect(&self.load_n);
        let film = LEAST_FILM * self.depth_m;
        self.bottomed_nodes = 0;
        for (depth, w) in self.depth_at_m.iter_mut().zip(self.membrane.deflection_m()) {
            *depth = self.depth_m - w;
            if *depth < film {
                (*depth, self.bottomed_nodes) = (film, self.bottomed_nodes + 1);
            }
        }
        self.voltages_v = self.fields.voltages(&self.depth_at_m)?;
        self.solved_n.copy_from_slice(&self.load_n);
        self.solved = true;
        Ok(())
    }
}

impl Frontend for IonicSkin {
    fn channel_count(&self) -> usize {
        self.voltages_v.len()
    }

    fn extent(&self) -> Outline {
        self.outline.clone()
    }

    fn outside_validity(&self) -> Option<String> {
        (self.bottomed_nodes > 0).then(|| {
            let share = 100.0 * self.bottomed_nodes as f64 / self.depth_at_m.len() as f64;
            format!(
                "the membrane touches the bottom over {share:.1} % of its nodes; the model ends there: the liquid is taken to \
                 be a film of {:.0} % of its depth, and the bottom bears no load",
                100.0 * LEAST_FILM
            )
        })
    }

    fn voltages(&mut self, indenters: &[Indenter], dt_s: f64, voltages_v: &mut [f64]) -> Result<(), TwinError> {
        self.load_n.fill(0.0);
        for indenter in indenters {
            self.membrane.add_load(indenter, self.cover, &mut self.load_n);
        }
        self.memory.apply(dt_s, &mut self.load_n);
        // A skin that is left alone, or held still, costs nothing.
        let change: f64 = self.load_n.iter().zip(&self.solved_n).map(|(load, solved)| (load - solved).abs()).sum();
        if !self.solved || change > SAME_LOAD_N {
            self.solve()?;
        }
        self.bottomed_frames += u64::from(self.bottomed_nodes > 0);
        voltages_v.copy_from_slice(&self.voltages_v);
        Ok(())
    }
}

impl Twin<IonicSkin> {
    /// The twin of one of paper I's skins.
    ///
    /// # Errors
    /// Parameters that make no sense, a mesh that cannot be made.
    pub fn ionic(options: &IonicOptions) -> Result<Self, TwinError> {
        let frontend = IonicSkin::new(options)?;
        let instrument = Instrument::new(options.instrument, frontend.channel_count(), options.seed)?;
        let instrument = instrument.with_protocol(frontend.fields().protocol())?;
        let scene = Scene::new(options.scene, options.script.clone())?.on(frontend.extent())?;
        Ok(Self::new(frontend, instrument, scene))
    }
}
