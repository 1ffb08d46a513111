//! A liquid skin: conducting liquid in a shallow tray, enclosed and full under a stretched membrane, or open.
//! Pressing dents the surface, so the liquid gets shallower there and deeper elsewhere. The voltages depend on the
//! depth alone.

use dermis_tomo::mesh::Outline;
use serde::{Deserialize, Serialize};

use crate::electroded_layer::ElectrodedLayer;
use crate::error::TwinError;
use crate::instrument::Instrument;
use crate::mechanics::{
    Cover, Indenter, Membrane, MembraneSpec, Memory, PressedMembrane, PressureState, check_membrane,
};
use crate::physics::{LiquidElectrodes, LiquidFields, LiquidSpec};
use crate::twin::Frontend;

/// Minimum depth, as a share of the depth at rest: a membrane that touches the bottom is clipped to this film.
const LEAST_FILM: f64 = 0.02;
/// Loads whose total difference is below this are considered equal, newtons: a tenth of a milligram.
const SAME_LOAD_N: f64 = 1e-6;

/// Method for solving the fields.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum LiquidSolver {
    /// In the plane, with depth as the conductance of a sheet: fast.
    DepthAveraged,
    /// On tetrahedra, with electrodes of their true size: a second or two per frame, to check the other method. All
    /// electrodes must be stretches of the rim.
    Solid {
        /// Approximate number of element layers.
        layers: usize,
    },
}

/// Description of a liquid skin. SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct LiquidOptions {
    /// The liquid with its electrodes: stretches of the rim on the wall, or pads on the bottom if fields are
    /// depth-averaged. The contact impedance of both is in ohm.m^2.
    pub layer: ElectrodedLayer,
    /// Height of the electrodes on the wall, metres, at most the depth.
    pub electrode_height_m: f64,
    /// Height of their centres above the bottom, metres. Makes no difference in depth-averaged fields.
    pub electrode_middle_m: f64,
    /// Depth of the liquid at rest, metres.
    pub depth_m: f64,
    /// Conductivity of the liquid, S/m.
    pub conductivity_s_per_m: f64,
    /// Density of the liquid, kg/m^3.
    pub density_kg_per_m3: f64,
    /// Tension of the membrane, newtons per metre. 0 is an open tank, which needs gravity pointing into the skin.
    pub tension_n_per_m: f64,
    /// Gravity in the skin's frame (z out of the skin), m/s^2.
    pub gravity_m_per_s2: [f64; 3],
    /// Spreading of pressure on its way through the membrane.
    pub cover: Cover,
    /// Viscoelastic memory of the membrane, if any.
    pub memory: Option<Memory>,
    /// Method for solving the fields.
    pub solver: LiquidSolver,
}

impl LiquidOptions {
    /// The same skin with triangles of other edge lengths: in general, and at electrodes.
    #[must_use]
    pub fn meshed(mut self, element_size_m: f64, electrode_element_size_m: f64) -> Self {
        self.layer = self.layer.meshed(element_size_m, electrode_element_size_m);
        self
    }

    fn liquid(&self) -> LiquidSpec {
        let layer = &self.layer;
        LiquidSpec {
            outline: layer.outline.clone(),
            depth_m: self.depth_m,
            conductivity_s_per_m: self.conductivity_s_per_m,
            conductance: layer.conductance.clone(),
            electrodes: LiquidElectrodes {
                shapes: layer.electrodes.clone(),
                height_m: self.electrode_height_m,
                middle_m: self.electrode_middle_m,
                contact_impedances_ohm_m2: layer.contact_impedances_ohm_m2.clone(),
            },
            element_size_m: layer.element_size_m,
            electrode_element_size_m: layer.electrode_element_size_m,
        }
    }
}

/// The liquid skin; see the module.
#[derive(Debug)]
pub struct LiquidSkin {
    outline: Outline,
    depth_m: f64,
    cover: Cover,
    membrane: Membrane,
    fields: LiquidFields,
    memory: PressureState,
    load_n: Vec<f64>,
    /// The load to which `voltages_v` belongs, once solved.
    solved_n: Vec<f64>,
    solved: bool,
    depth_at_m: Vec<f64>,
    bottomed_nodes: usize,
    bottomed_frames: u64,
    voltages_v: Vec<f64>,
}

impl LiquidSkin {
    /// Meshes the tray, factors its membrane and prepares its fields.
    ///
    /// # Errors
    /// Invalid parameters, electrodes that do not fit the protocol, a mesh that cannot be built, a membrane too slack
    /// to hold the liquid when it hangs underneath, or an open tank that gravity does not hold.
    pub fn new(options: LiquidOptions) -> Result<Self, TwinError> {
        options.cover.check()?;
        options.memory.as_ref().map_or(Ok(()), Memory::check)?;
        options.layer.check()?;
        let liquid = options.liquid();
        let fields = match options.solver {
            LiquidSolver::DepthAveraged => LiquidFields::averaged(liquid, options.layer.protocol)?,
            LiquidSolver::Solid { layers } => LiquidFields::solid(liquid, layers, options.layer.protocol)?,
        };
        let spec = MembraneSpec {
            tension_n_per_m: options.tension_n_per_m,
            density_kg_per_m3: options.density_kg_per_m3,
            gravity_m_per_s2: options.gravity_m_per_s2,
        };
        check_membrane(&spec)?;
        let membrane = Membrane::new(fields.plan(), spec)?;
        let nodes = membrane.positions_m().len();
        Ok(Self {
            outline: options.layer.outline,
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

    /// The membrane, or the open surface, after the last frame.
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

    /// Number of nodes where the membrane touched the bottom in the last frame. The model is not valid there: the
    /// depth is clipped to a film of 2 % of the tray's, the bottom carries no load, and liquid is not conserved.
    pub fn bottomed_nodes(&self) -> usize {
        self.bottomed_nodes
    }

    /// Number of frames in which the membrane touched the bottom anywhere.
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

impl Frontend for LiquidSkin {
    fn channel_count(&self) -> usize {
        self.voltages_v.len()
    }

    fn extent(&self) -> Outline {
        self.outline.clone()
    }

    fn wired(&self, instrument: Instrument) -> Result<Instrument, TwinError> {
        instrument.with_protocol(self.fields.protocol())
    }

    fn outside_validity(&self) -> Option<String> {
        (self.bottomed_nodes > 0).then(|| {
            let share = 100.0 * self.bottomed_nodes as f64 / self.depth_at_m.len() as f64;
            format!(
                "the membrane touches the bottom over {share:.1} % of its nodes; the model is not valid there: the liquid is taken to \
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
        // A skin that is idle or held still costs nothing.
        let change: f64 = self.load_n.iter().zip(&self.solved_n).map(|(load, solved)| (load - solved).abs()).sum();
        if !self.solved || change > SAME_LOAD_N {
            self.solve()?;
        }
        self.bottomed_frames += u64::from(self.bottomed_nodes > 0);
        voltages_v.copy_from_slice(&self.voltages_v);
        Ok(())
    }
}
