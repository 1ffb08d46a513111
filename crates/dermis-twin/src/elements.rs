//! Coils under a membrane of conducting elements on sponge or springs. A force moves the elements under it towards
//! the coils. Eddy currents in them change the mutual inductance of every pair of coils,
//! `V_mn = j w (M_mn + dM_mn) I`; the instrument reads the magnitude behind its rectifier.
//!
//! Elements respond as multipoles up to degree 3 and excite each other. Their resting heights vary by a manufacturing
//! tolerance unknown to the reconstruction. For the fields, an element is a sphere or a given body ([`Conductor`]).

use std::sync::{Mutex, PoisonError};

use dermis_mit::{CoilArray, CoilTables, Complex, Coupling, MultipoleArray, Polarizability, Sphere};
use dermis_tomo::eit::Protocol;
use dermis_tomo::mesh::{Outline, Point};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::error::{TwinError, check, check_positive};
use crate::instrument::Instrument;
use crate::mechanics::{Indenter, Memory, PressureState, SpringGrid, Springs};
use crate::twin::Frontend;

/// Model of an element for the fields.
#[derive(Clone, Debug, PartialEq)]
pub enum Conductor {
    /// A sphere, for example with the volume of a cylinder.
    Sphere(Sphere),
    /// Any body with a known response at the drive frequency, for example a cylinder from edge elements.
    Body(Polarizability),
}

/// A metal ball near the coils that does not move. Elements and ball do not excite each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearbyMetal {
    /// The ball.
    pub sphere: Sphere,
    /// Centre, metres.
    pub centre_m: [f64; 3],
}

impl NearbyMetal {
    /// Change of the inductance of every pair of coils, henries.
    fn changes_h(&self, coils: &CoilArray, frequency_hz: f64) -> Result<Vec<Complex>, TwinError> {
        let body = Polarizability::sphere(&self.sphere, frequency_hz)?;
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

/// Description of a skin with elements over coils. SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct ElementOptions {
    /// Outline of the whole skin.
    pub outline: Outline,
    /// The coils, with a metal plate under them if there is one ([`CoilArray::with_shield`]).
    pub coils: CoilArray,
    /// Centres of the elements, metres, in any order; 1 to 1024 elements.
    pub places_m: Vec<Point>,
    /// Width and height of the cell around each element, metres; pressure on a cell presses its element. Elements one
    /// cell apart, within a tenth of a cell, are neighbours.
    pub cell_m: [f64; 2],
    /// Height of the elements' centres above the coils' centres at rest, metres.
    pub rest_m: f64,
    /// Standard deviation of that height between elements, metres.
    pub tolerance_m: f64,
    /// Model of the elements.
    pub element: Conductor,
    /// Springs under the elements.
    pub springs: Springs,
    /// Viscoelastic memory, if any: a narrow hysteresis loop.
    pub memory: Option<Memory>,
    /// Coupling between elements; `None` for no coupling.
    pub coupling: Option<Coupling>,
    /// Current amplitude in the driven coil, amperes.
    pub current_a: f64,
    /// Drive frequency, hertz.
    pub frequency_hz: f64,
    /// Metal nearby that does not move.
    pub nearby: Option<NearbyMetal>,
    /// Seed of the tolerances.
    pub seed: u64,
}

/// Movement below which an element counts as still, metres: 1e-6 of the reading's change due to a press.
const STILL_M: f64 = 1e-9;

impl ElementOptions {
    /// The element as a body at the drive frequency.
    ///
    /// # Errors
    /// An invalid sphere or frequency.
    pub fn body(&self) -> Result<Polarizability, TwinError> {
        Ok(match &self.element {
            Conductor::Sphere(sphere) => Polarizability::sphere(sphere, self.frequency_hz)?,
            Conductor::Body(body) => body.clone(),
        })
    }

    /// Minimum and maximum height of an element's centre that the tables must cover, metres.
    fn range_m(&self) -> [f64; 2] {
        let slack = 5.0 * self.tolerance_m + 0.1e-3;
        [self.rest_m - self.springs.limit_m - slack, self.rest_m + slack]
    }

    fn check(&self) -> Result<(), TwinError> {
        check_positive("current_a", self.current_a)?;
        check_positive("frequency_hz", self.frequency_hz)?;
        check_positive("area of the outline, m^2", self.outline.area_m2())?;
        let most_m = 0.1 * self.cell_m[0].min(self.cell_m[1]);
        check("tolerance_m", self.tolerance_m, 0.0, most_m, "0 to a tenth of cell_m")?;
        check("rest_m", self.rest_m, self.springs.limit_m, 1.0, "above the springs' limit")?;
        self.memory.as_ref().map_or(Ok(()), Memory::check)
    }
}

/// The skin; see the module.
#[derive(Clone, Debug)]
pub struct ElementSkin {
    grid: SpringGrid,
    bodies: MultipoleArray,
    state: PressureState,
    /// Mutual inductances without elements, henries.
    mutuals_h: Vec<Complex>,
    rest_m: Vec<f64>,
    volts_per_h: f64,
    outline: Outline,
    coil_pairs: Protocol,
    forces_n: Vec<f64>,
    travel_m: Vec<f64>,
    heights_m: Vec<f64>,
    solved_m: Vec<f64>,
    changes_h: Vec<Complex>,
}

impl ElementSkin {
    /// Tabulates the coils' fields over the elements' travel; takes about a second.
    ///
    /// # Errors
    /// Invalid parameters, or elements that would reach into coils or each other.
    pub fn new(options: ElementOptions) -> Result<Self, TwinError> {
        options.check()?;
        let (body, range_m) = (options.body()?, options.range_m());
        let grid = SpringGrid::new(options.springs, options.places_m, options.cell_m)?;
        let coils = options.coils;
        let tables = tables_of(&coils, grid.places_m(), range_m, body.radius_m)?;
        let count = grid.places_m().len();
        let bodies = MultipoleArray::new(vec![body; count], tables, options.coupling)?;
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
            outline: options.outline,
            coil_pairs: Protocol::coil_pairs(coils.coils().len(), options.current_a)?,
            rest_m,
            grid,
            bodies,
            mutuals_h,
        })
    }

    /// Positions of the elements, metres, in their order.
    pub fn places_m(&self) -> &[Point] {
        self.grid.places_m()
    }

    /// Heights of the elements' centres after the last frame, metres.
    pub fn heights_m(&self) -> &[f64] {
        &self.heights_m
    }

    /// Travel of each element after the last frame, metres.
    pub fn travel_m(&self) -> &[f64] {
        &self.travel_m
    }

    /// Pairs of coils, in the order of the channels.
    pub fn pairs(&self) -> &[[usize; 2]] {
        self.bodies.pairs()
    }

    /// Magnitudes for given travels of the elements, metres, whatever caused them.
    ///
    /// # Errors
    /// The wrong number of elements or channels, or travel beyond the springs' limit.
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
        // A skin that is idle or held still costs nothing.
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

/// The last tables made, newest first, with their inputs.
type MadeTables = (CoilArray, Vec<[f64; 2]>, [f64; 2], f64, CoilTables);
static LAST_TABLES: Mutex<Vec<MadeTables>> = Mutex::new(Vec::new());
/// Number of tables kept: enough for a skin and a few variants with the same coils.
const MOST_TABLES: usize = 4;

/// As [`CoilTables::new`], but reuses tables for skins that differ in other respects.
fn tables_of(
    coils: &CoilArray,
    places_m: &[Point],
    range_m: [f64; 2],
    clearance_m: f64,
) -> Result<CoilTables, TwinError> {
    let last = || LAST_TABLES.lock().unwrap_or_else(PoisonError::into_inner);
    let is_it =
        |made: &MadeTables| made.0 == *coils && made.1 == places_m && made.2 == range_m && made.3 == clearance_m;
    if let Some(made) = last().iter().find(|made| is_it(made)) {
        return Ok(made.4.clone());
    }
    let tables = CoilTables::new(coils, places_m, range_m, clearance_m)?;
    let mut kept = last();
    kept.insert(0, (coils.clone(), places_m.to_vec(), range_m, clearance_m, tables.clone()));
    kept.truncate(MOST_TABLES);
    Ok(tables)
}

impl Frontend for ElementSkin {
    fn channel_count(&self) -> usize {
        self.mutuals_h.len()
    }

    fn extent(&self) -> Outline {
        self.outline.clone()
    }

    fn wired(&self, instrument: Instrument) -> Result<Instrument, TwinError> {
        instrument.with_coils(&self.coil_pairs)
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
