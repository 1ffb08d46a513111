//! The EM-skins (paper E): coils under a membrane of conducting elements on sponge or springs. A force moves the elements
//! beneath it toward the coils; eddy currents in them change the mutual inductance of every pair of coils,
//! `V_mn = j w (M_mn + dM_mn) I`, of which the instrument reads the magnitude behind its rectifier.
//!
//! Elements answer as multipoles to degree 3 and excite each other; their resting heights scatter by a manufacturing
//! tolerance that whoever reconstructs does not know. An element is for the fields a sphere, or whatever body is given
//! ([`EmElement`]).

use dermis_tomo::eit::Protocol;
use dermis_tomo::mesh::Outline;
use dermis_tomo::mit::{Bodies, Body, CoilArray, CoilTables, Complex, Coupling, Sphere};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use crate::error::{TwinError, check, check_positive};
use crate::instrument::{Converter, GainRanges, Instrument, InstrumentOptions, Noise, Reading};
use crate::mechanics::{Indenter, Memory, PressureState, SpringGrid, Springs};
use crate::scene::{Scene, SceneOptions, Script};
use crate::twin::{Frontend, Twin};

/// The coil arrays of paper E.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EmArray {
    /// Eight hand-wound coils, [`CoilArray::em_8`].
    #[serde(rename = "em-8")]
    Em8,
    /// Sixteen round spirals, [`CoilArray::em_16_circular`].
    #[serde(rename = "em-16-circular")]
    Em16Circular,
    /// Sixteen square spirals, [`CoilArray::em_16_square`].
    #[serde(rename = "em-16-square")]
    Em16Square,
}

impl EmArray {
    /// Its coils.
    ///
    /// # Errors
    /// None with the paper's numbers.
    pub fn coils(self) -> Result<CoilArray, TwinError> {
        Ok(match self {
            Self::Em8 => CoilArray::em_8()?,
            Self::Em16Circular => CoilArray::em_16_circular()?,
            Self::Em16Square => CoilArray::em_16_square()?,
        })
    }
}

/// What an element is for the fields.
#[derive(Clone, Debug, PartialEq)]
pub enum EmElement {
    /// A sphere, as of the volume of the paper's cylinders.
    Sphere(Sphere),
    /// Any body whose answer is known at the drive frequency, as a cylinder from edge elements.
    Body(Body),
}

/// A ball of metal that lies near the coils and does not move. Elements and ball do not excite each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearbyMetal {
    /// The ball.
    pub sphere: Sphere,
    /// Its middle, metres.
    pub centre_m: [f64; 3],
}

impl NearbyMetal {
    /// What it does to every pair of coils, henries.
    fn changes_h(&self, coils: &CoilArray, frequency_hz: f64) -> Result<Vec<Complex>, TwinError> {
        let body = Body::sphere(&self.sphere, frequency_hz)?;
        for coil in coils.coils() {
            let distance_m = coil.distance_m(self.centre_m);
            let expected = "outside the nearby metal";
            if distance_m <= self.sphere.radius_m {
                return Err(TwinError::Value {
                    field: "distance of a coil from nearby metal (m)",
                    value: distance_m,
                    expected,
                });
            }
        }
        Ok(body.changes_h(coils, self.centre_m))
    }
}

/// Parameters of the twin. Paper E gives coils, frequencies, frame rates, signal-to-noise ratios, the number of elements
/// and their size; heights, stiffness, travel and current are assumed.
#[derive(Clone, Debug, PartialEq)]
pub struct EmOptions {
    /// The coils.
    pub array: EmArray,
    /// Elements along a side.
    pub per_side: usize,
    /// Distance of neighbouring elements, metres.
    pub pitch_m: f64,
    /// Side of the whole square skin, metres.
    pub side_m: f64,
    /// Height of the elements' middles over the coils' at rest, metres.
    pub rest_m: f64,
    /// Standard deviation of that height between elements, metres.
    pub tolerance_m: f64,
    /// What the elements are.
    pub element: EmElement,
    /// What they stand on.
    pub springs: Springs,
    /// Viscoelastic memory, where wanted: a thin loop of hysteresis.
    pub memory: Option<Memory>,
    /// How elements excite each other; `None`: not at all.
    pub coupling: Option<Coupling>,
    /// Current in the driven coil, amperes, amplitude.
    pub current_a: f64,
    /// Drive frequency.
    pub frequency_hz: f64,
    /// Frames a second.
    pub frame_rate_hz: f64,
    /// Height of a plate of metal beneath the coils, as of a robot's arm, taken to conduct perfectly; below 0.
    pub plate_m: Option<f64>,
    /// Metal elsewhere.
    pub nearby: Option<NearbyMetal>,
    /// Noise, converter, rectifier.
    pub instrument: InstrumentOptions,
    /// Fading, and how script and people share the skin.
    pub scene: SceneOptions,
    /// What touches it by itself.
    pub script: Option<Script>,
    /// Seed of tolerances and noise.
    pub seed: u64,
}

/// Elements that moved by less are still, metres: 1e-6 of a reading's change by a press.
const STILL_M: f64 = 1e-9;
/// Aluminium, S/m.
const ALUMINIUM_S_PER_M: f64 = 3.5e7;

impl EmOptions {
    /// Eight coils at 55 kHz, 83 dB, 10 frames/s, under 5 x 5 aluminium cylinders of 10 mm (their height of 10 mm is assumed)
    /// on sponge; for the fields each is a sphere of the cylinder's volume.
    pub fn em_8() -> Self {
        Self {
            array: EmArray::Em8,
            per_side: 5,
            pitch_m: 0.02,
            side_m: 0.14,
            rest_m: 0.023,
            tolerance_m: 0.2e-3,
            element: EmElement::Sphere(aluminium(volume_radius_m(0.01, 0.01))),
            springs: Springs { stiffness_n_per_m: 400.0, limit_m: 0.011, sharpness: 2.0, coupling_n_per_m: 12.0 },
            memory: Some(Memory { share: 0.04, time_constant_s: 0.3 }),
            coupling: Some(Coupling { degree: 3, reach_m: 0.03, sweeps: 2 }),
            current_a: 0.1,
            frequency_hz: 55e3,
            frame_rate_hz: 10.0,
            plate_m: None,
            nearby: None,
            instrument: instrument(83.0),
            scene: SceneOptions::default(),
            script: None,
            seed: 1,
        }
    }

    /// Sixteen round spirals at 20 kHz, 50 dB, 1 frame/s, under 8 x 8 springs of 30 mm, 22 mm wide and 13 mm apart, each
    /// with a conductor, here a cylinder as wide as the spring and 10 mm high whose upper face is the spring's (assumed),
    /// for the fields a sphere of its volume.
    pub fn em_16_circular() -> Self {
        Self {
            array: EmArray::Em16Circular,
            per_side: 8,
            pitch_m: 0.035,
            side_m: 0.32,
            rest_m: 0.026,
            element: EmElement::Sphere(aluminium(volume_radius_m(0.022, 0.01))),
            springs: Springs { stiffness_n_per_m: 300.0, limit_m: 0.012, sharpness: 2.0, coupling_n_per_m: 0.0 },
            memory: Some(Memory { share: 0.02, time_constant_s: 0.3 }),
            coupling: Some(Coupling { degree: 3, reach_m: 0.05, sweeps: 2 }),
            frequency_hz: 20e3,
            frame_rate_hz: 1.0,
            instrument: instrument(50.0),
            ..Self::em_8()
        }
    }

    /// The same with square spirals, 53 dB.
    pub fn em_16_square() -> Self {
        Self { array: EmArray::Em16Square, instrument: instrument(53.0), ..Self::em_16_circular() }
    }

    /// The element as a body at the drive frequency.
    ///
    /// # Errors
    /// A sphere or a frequency that makes no sense.
    pub fn body(&self) -> Result<Body, TwinError> {
        Ok(match &self.element {
            EmElement::Sphere(sphere) => Body::sphere(sphere, self.frequency_hz)?,
            EmElement::Body(body) => body.clone(),
        })
    }

    /// Width of the membrane, metres: all cells.
    pub fn width_m(&self) -> f64 {
        self.pitch_m * self.per_side as f64
    }

    /// Lowest and highest middle of an element that tables must hold, metres.
    fn range_m(&self) -> [f64; 2] {
        let slack = 5.0 * self.tolerance_m + 0.1e-3;
        [self.rest_m - self.springs.limit_m - slack, self.rest_m + slack]
    }

    fn check(&self) -> Result<(), TwinError> {
        check_positive("current_a", self.current_a)?;
        check_positive("side_m", self.side_m)?;
        check_positive("frame_rate_hz", self.frame_rate_hz)?;
        check("tolerance_m", self.tolerance_m, 0.0, 0.1 * self.pitch_m, "0 to a tenth of the pitch")?;
        check("rest_m", self.rest_m, self.springs.limit_m, 1.0, "above the springs' limit")?;
        if let Some(z_m) = self.plate_m {
            check("plate_m", z_m, -10.0, -1e-3, "-10 to -0.001: below the coils")?;
        }
        self.memory.as_ref().map_or(Ok(()), Memory::check)
    }
}

/// Noise in proportion to each reading, as behind amplifiers that are ranged channel by channel, and the 16 bits of the
/// paper's converter.
fn instrument(snr_db: f64) -> InstrumentOptions {
    InstrumentOptions {
        noise: Noise { floor_v: 0.0, proportional: 10_f64.powf(-snr_db / 20.0) },
        converter: Some(Converter { bits: 16, range_v: 5.0, gain: 4.0 }),
        gain_ranges: Some(GainRanges { factor: 2.0, count: 16 }),
        reading: Reading::Magnitude,
        ..InstrumentOptions::ideal()
    }
}

fn aluminium(radius_m: f64) -> Sphere {
    Sphere { radius_m, conductivity_s_per_m: ALUMINIUM_S_PER_M, relative_permeability: 1.0 }
}

/// Radius of the sphere of a cylinder's volume.
fn volume_radius_m(diameter_m: f64, height_m: f64) -> f64 {
    (0.1875 * diameter_m * diameter_m * height_m).cbrt()
}

/// The skin itself; see the module.
#[derive(Clone, Debug)]
pub struct EmSkin {
    grid: SpringGrid,
    bodies: Bodies,
    state: PressureState,
    /// Mutual inductances without elements, henries.
    mutuals_h: Vec<Complex>,
    rest_m: Vec<f64>,
    volts_per_h: f64,
    side_m: f64,
    forces_n: Vec<f64>,
    travel_m: Vec<f64>,
    heights_m: Vec<f64>,
    solved_m: Vec<f64>,
    changes_h: Vec<Complex>,
}

impl EmSkin {
    /// Tabulates the coils' fields over the elements' travel: a second or so.
    ///
    /// # Errors
    /// Parameters that make no sense, elements that would reach into coils or each other.
    pub fn new(options: &EmOptions) -> Result<Self, TwinError> {
        options.check()?;
        let grid = SpringGrid::new(options.springs, options.per_side, options.pitch_m)?;
        let body = options.body()?;
        let mut coils = options.array.coils()?;
        if let Some(z_m) = options.plate_m {
            coils = coils.with_shield(z_m);
        }
        let tables = CoilTables::new(&coils, grid.places_m(), options.range_m(), body.radius_m)?;
        let count = grid.places_m().len();
        let bodies = Bodies::new(vec![body; count], tables, options.coupling)?;
        let mut random = ChaCha8Rng::seed_from_u64(options.seed ^ 0x5eed);
        let mut scatter = || {
            let value: f64 = StandardNormal.sample(&mut random);
            options.tolerance_m * value.clamp(-4.0, 4.0)
        };
        let rest_m: Vec<f64> = (0..count).map(|_| options.rest_m + scatter()).collect();
        let mut mutuals_h: Vec<Complex> = coils.mutuals_h().iter().map(|m| Complex::new(*m, 0.0)).collect();
        if let Some(metal) = &options.nearby {
            let changes = metal.changes_h(&coils, options.frequency_hz)?;
            mutuals_h.iter_mut().zip(changes).for_each(|(m, change)| *m += change);
        }
        Ok(Self {
            state: PressureState::new(options.memory, count),
            forces_n: vec![0.0; count],
            travel_m: vec![0.0; count],
            heights_m: rest_m.clone(),
            solved_m: Vec::new(),
            changes_h: vec![Complex::new(0.0, 0.0); mutuals_h.len()],
            volts_per_h: std::f64::consts::TAU * options.frequency_hz * options.current_a,
            side_m: options.side_m,
            rest_m,
            grid,
            bodies,
            mutuals_h,
        })
    }

    /// Where the elements are, metres, row by row from the bottom left.
    pub fn places_m(&self) -> &[[f64; 2]] {
        self.grid.places_m()
    }

    /// Heights of the elements' middles after the last frame, metres.
    pub fn heights_m(&self) -> &[f64] {
        &self.heights_m
    }

    /// How far each element is pressed in after the last frame, metres.
    pub fn travel_m(&self) -> &[f64] {
        &self.travel_m
    }

    /// Pairs of coils, in the order of the channels.
    pub fn pairs(&self) -> &[[usize; 2]] {
        self.bodies.pairs()
    }

    /// Magnitudes with the elements pressed in by this much, metres, whatever presses them.
    ///
    /// # Errors
    /// Another number of elements or channels, travel beyond the springs' limit.
    pub fn read_at(&mut self, travel_m: &[f64], voltages_v: &mut [f64]) -> Result<(), TwinError> {
        if travel_m.len() != self.rest_m.len() {
            let (value, expected) = (travel_m.len() as f64, "one for each element");
            return Err(TwinError::Value { field: "number of travels", value, expected });
        }
        self.travel_m.copy_from_slice(travel_m);
        self.solve(voltages_v)
    }

    fn solve(&mut self, voltages_v: &mut [f64]) -> Result<(), TwinError> {
        for ((height, rest), travel) in self.heights_m.iter_mut().zip(&self.rest_m).zip(&self.travel_m) {
            *height = rest - travel;
        }
        // A skin that is left alone, or held still, costs nothing.
        let moved = |(now, solved): (&f64, &f64)| (now - solved).abs() > STILL_M;
        if self.solved_m.is_empty() || self.heights_m.iter().zip(&self.solved_m).any(moved) {
            self.bodies.changes(&self.heights_m, &mut self.changes_h)?;
            self.solved_m.clone_from(&self.heights_m);
        }
        for ((voltage, mutual), change) in voltages_v.iter_mut().zip(&self.mutuals_h).zip(&self.changes_h) {
            *voltage = self.volts_per_h * (*change + *mutual).norm();
        }
        Ok(())
    }
}

impl Frontend for EmSkin {
    fn channel_count(&self) -> usize {
        self.mutuals_h.len()
    }

    fn extent(&self) -> Outline {
        Outline::Rectangle { width_m: self.side_m, height_m: self.side_m }
    }

    fn voltages(&mut self, indenters: &[Indenter], dt_s: f64, voltages_v: &mut [f64]) -> Result<(), TwinError> {
        self.grid.forces_n(indenters, &mut self.forces_n);
        self.state.apply(dt_s, &mut self.forces_n);
        let mut travel = std::mem::take(&mut self.travel_m);
        self.grid.travel_m(&self.forces_n, &mut travel);
        self.travel_m = travel;
        self.solve(voltages_v)
    }
}

impl Twin<EmSkin> {
    /// The twin of one of paper E's skins.
    ///
    /// # Errors
    /// Parameters that make no sense.
    pub fn em(options: &EmOptions) -> Result<Self, TwinError> {
        let frontend = EmSkin::new(options)?;
        let coils = frontend.pairs().iter().flatten().max().map_or(0, |last| last + 1);
        let pairs = Protocol::coil_pairs(coils, options.current_a)?;
        let instrument = Instrument::new(options.instrument, frontend.channel_count(), options.seed)?;
        let instrument = instrument.with_coils(&pairs)?;
        let scene = Scene::new(options.scene, options.script.clone())?.on(frontend.extent())?;
        Ok(Self::new(frontend, instrument, scene))
    }
}
