//! Coils under a membrane of conducting elements on sponge or springs. A force moves the elements beneath it toward the
//! coils; eddy currents in them change the mutual inductance of every pair of coils, `V_mn = j w (M_mn + dM_mn) I`, of
//! which the instrument reads the magnitude behind its rectifier.
//!
//! Elements answer as multipoles to degree 3 and excite each other; their resting heights scatter by a manufacturing
//! tolerance that whoever reconstructs does not know. An element is for the fields a sphere, or whatever body is given
//! ([`Conductor`]).

use std::sync::{Mutex, PoisonError};

use dermis_mit::{CoilArray, CoilTables, Complex, Coupling, MultipoleArray, Polarizability, Sphere};
use dermis_tomo::eit::Protocol;
use dermis_tomo::mesh::Outline;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::error::{TwinError, check, check_positive};
use crate::instrument::Instrument;
use crate::mechanics::{Indenter, Memory, PressureState, SpringGrid, Springs};
use crate::twin::Frontend;

/// What an element is for the fields.
#[derive(Clone, Debug, PartialEq)]
pub enum Conductor {
    /// A sphere, as of the volume of a cylinder.
    Sphere(Sphere),
    /// Any body whose answer is known at the drive frequency, as a cylinder from edge elements.
    Body(Polarizability),
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

/// What a skin of elements over coils is. SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct ElementOptions {
    /// Outline of the whole skin.
    pub outline: Outline,
    /// The coils; with a plate of metal beneath them where there is one ([`CoilArray::with_shield`]).
    pub coils: CoilArray,
    /// Middles of the elements, metres, in any order; 1 to 1024 of them.
    pub places_m: Vec<[f64; 2]>,
    /// Width and height of the cell around each element, metres: what presses on it presses the element. Elements one
    /// cell apart, within a tenth of a cell, are neighbours.
    pub cell_m: [f64; 2],
    /// Height of the elements' middles over the coils' at rest, metres.
    pub rest_m: f64,
    /// Standard deviation of that height between elements, metres.
    pub tolerance_m: f64,
    /// What the elements are.
    pub element: Conductor,
    /// What they stand on.
    pub springs: Springs,
    /// Viscoelastic memory, where wanted: a thin loop of hysteresis.
    pub memory: Option<Memory>,
    /// How elements excite each other; `None`: not at all.
    pub coupling: Option<Coupling>,
    /// Current in the driven coil, amperes, amplitude.
    pub current_a: f64,
    /// Drive frequency, hertz.
    pub frequency_hz: f64,
    /// Metal elsewhere that does not move.
    pub nearby: Option<NearbyMetal>,
    /// Seed of the tolerances.
    pub seed: u64,
}

/// Elements that moved by less are still, metres: 1e-6 of a reading's change by a press.
const STILL_M: f64 = 1e-9;

impl ElementOptions {
    /// The element as a body at the drive frequency.
    ///
    /// # Errors
    /// A sphere or a frequency that makes no sense.
    pub fn body(&self) -> Result<Polarizability, TwinError> {
        Ok(match &self.element {
            Conductor::Sphere(sphere) => Polarizability::sphere(sphere, self.frequency_hz)?,
            Conductor::Body(body) => body.clone(),
        })
    }

    /// Lowest and highest middle of an element that tables must hold, metres.
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

/// The skin itself; see the module.
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
    /// Tabulates the coils' fields over the elements' travel: a second or so.
    ///
    /// # Errors
    /// Parameters that make no sense, elements that would reach into coils or each other.
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

    /// Where the elements are, metres, in their order.
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

/// Tables that were made last, the newest first, with what they were made from.
type MadeTables = (CoilArray, Vec<[f64; 2]>, [f64; 2], f64, CoilTables);
static LAST_TABLES: Mutex<Vec<MadeTables>> = Mutex::new(Vec::new());
/// So many are kept: what a skin and a few that differ from it in other things than their coils need.
const MOST_TABLES: usize = 4;

/// As [`CoilTables::new`]; the same tables are not made anew for every skin that differs in other things.
fn tables_of(
    coils: &CoilArray,
    places_m: &[[f64; 2]],
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
