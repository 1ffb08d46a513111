//! Descriptions of coils and their positions: any flat or layered winding of round or square turns, on a grid or at
//! listed places. A [`crate::CoilArray`] is made from one description and several places.
//!
//! Turns fill the space between inner and outer width evenly, in equal layers around the coil's middle plane; each is
//! one closed filament in the middle of its share. The conductor only affects the self inductance, through its
//! geometric mean distance from itself: `e^(-1/4) d / 2` for round wire, `0.2235 (w + t)` for a track (Grover,
//! Inductance Calculations, 1946, ch. 3). Windings of more than 128 turns are lumped: one filament stands for several
//! turns, and has the geometric mean distance of the rectangle they fill.

use crate::coil::{Coil, CoilShape, ROUND, WIRE_SHARE, WindingSection};
use crate::error::{MitError, positive};
use crate::vector::Vector;

/// Maximum number of turns of a coil.
pub const MOST_TURNS: usize = 10_000;
/// Maximum number of filaments in a coil's model.
const MOST_FILAMENTS: usize = 128;
/// Number of filament layers if turns are lumped both across and along.
const LUMPED_LAYERS: usize = 8;
/// Geometric mean distance of a rectangle from itself, relative to the sum of its sides.
const RECTANGLE: f64 = 0.2235;
/// Relative difference permitted between sizes that should be equal, for decimals in a file.
const ROUNDING: f64 = 1e-9;

/// Conductor of a coil.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Conductor {
    /// Round wire with known diameter only relative to the distance between neighbouring turns; 0.8 is typical.
    PitchShare(f64),
    /// Round wire.
    Wire {
        /// Diameter without insulation, metres.
        diameter_m: f64,
    },
    /// A track with rectangular cross-section, as on a circuit board.
    Track {
        /// Width, metres.
        width_m: f64,
        /// Thickness, metres.
        thickness_m: f64,
    },
}

/// A coil, independent of its position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoilSpec {
    /// Outline of its turns.
    pub shape: CoilShape,
    /// Inner width, metres: the diameter of round coils, the side of square ones.
    pub inner_m: f64,
    /// Outer width, metres.
    pub outer_m: f64,
    /// Total number of turns, 1 to [`MOST_TURNS`]; a multiple of the number of layers.
    pub turns: usize,
    /// Number of stacked layers.
    pub layers: usize,
    /// Distance between neighbouring layers, metres; ignored for a single layer.
    pub layer_pitch_m: f64,
    /// The conductor.
    pub conductor: Conductor,
    /// Measured self inductance, henries, to which fields are scaled. `None` keeps the value from the geometry.
    pub inductance_h: Option<f64>,
}

impl CoilSpec {
    /// A flat single-layer spiral of round wire that fills 80 % of the distance between turns.
    pub const fn spiral(shape: CoilShape, inner_m: f64, outer_m: f64, turns: usize) -> Self {
        let conductor = Conductor::PitchShare(WIRE_SHARE);
        Self { shape, inner_m, outer_m, turns, layers: 1, layer_pitch_m: 0.0, conductor, inductance_h: None }
    }

    /// A single turn of round wire whose centre line has this diameter (round) or side (square), metres.
    pub const fn single_turn(shape: CoilShape, width_m: f64, wire_diameter_m: f64) -> Self {
        let conductor = Conductor::Wire { diameter_m: wire_diameter_m };
        let (inner_m, outer_m) = (width_m - wire_diameter_m, width_m + wire_diameter_m);
        Self { shape, inner_m, outer_m, turns: 1, layers: 1, layer_pitch_m: 0.0, conductor, inductance_h: None }
    }

    /// The same coil with a measured self inductance, henries.
    pub const fn with_inductance(mut self, inductance_h: f64) -> Self {
        self.inductance_h = Some(inductance_h);
        self
    }

    /// Checks the numbers.
    ///
    /// # Errors
    /// Widths that are not positive or not in order, a number of turns outside 1 to [`MOST_TURNS`] or not a multiple
    /// of the layers, a conductor thicker than the distance between turns or layers, or an inductance that is not
    /// positive.
    pub fn check(&self) -> Result<(), MitError> {
        positive("inner_m", self.inner_m)?;
        positive("outer_m", self.outer_m)?;
        if self.outer_m <= self.inner_m {
            return refused("outer_m", self.outer_m, "above inner_m");
        }
        if !(1..=MOST_TURNS).contains(&self.turns) {
            return refused("turns", self.turns as f64, "1 to 10,000");
        }
        if self.layers == 0 || !self.turns.is_multiple_of(self.layers) {
            return refused("layers", self.layers as f64, "1 or more, and turns to be a multiple of it");
        }
        if self.layers > 1 {
            positive("layer_pitch_m", self.layer_pitch_m)?;
        }
        let within = |size_m: f64, room_m: f64| size_m <= room_m * (1.0 + ROUNDING);
        let pitch_m = self.even_pitch_m();
        let height_m = match self.conductor {
            Conductor::PitchShare(share) => {
                if !(share > 0.0 && share <= 1.0) {
                    return refused("conductor: share of the turns' distance", share, "above 0, at most 1");
                }
                share * pitch_m
            }
            Conductor::Wire { diameter_m } => {
                positive("conductor: diameter_m", diameter_m)?;
                if !within(diameter_m, pitch_m) {
                    return refused("conductor: diameter_m", diameter_m, "at most the distance of the turns");
                }
                diameter_m
            }
            Conductor::Track { width_m, thickness_m } => {
                positive("conductor: width_m", width_m)?;
                positive("conductor: thickness_m", thickness_m)?;
                if !within(width_m, pitch_m) {
                    return refused("conductor: width_m", width_m, "at most the distance of the turns");
                }
                thickness_m
            }
        };
        if self.layers > 1 && !within(height_m, self.layer_pitch_m) {
            return refused("layer_pitch_m", self.layer_pitch_m, "at least the height of the conductor");
        }
        match self.inductance_h {
            Some(inductance_h) => positive("inductance_h", inductance_h),
            None => Ok(()),
        }
    }

    /// The coil with its centre at a place, metres.
    ///
    /// # Errors
    /// As [`CoilSpec::check`]; a position that is not finite; a conductor too thick for its turn, so that the formula
    /// for the self inductance does not hold.
    pub fn coil(&self, centre_m: Vector) -> Result<Coil, MitError> {
        self.check()?;
        if let Some(value) = centre_m.into_iter().find(|x| !x.is_finite()) {
            return refused("centre_m", value, "finite");
        }
        let coil = Coil::filled([0.0; 3], &self.section());
        let self_h = coil.self_inductance_h();
        positive("self inductance from the coil's geometry (H)", self_h)?;
        let coil = match self.inductance_h {
            Some(measured_h) => coil.calibrated_to(measured_h)?.0,
            None => coil,
        };
        Ok(coil.moved(centre_m))
    }

    fn turns_per_layer(&self) -> usize {
        self.turns / self.layers
    }

    /// Distance between neighbouring turns that fill the width evenly, metres.
    pub fn even_pitch_m(&self) -> f64 {
        0.5 * (self.outer_m - self.inner_m) / self.turns_per_layer() as f64
    }

    /// The filaments of this coil.
    fn section(&self) -> WindingSection {
        let even_m = self.even_pitch_m();
        // Touching turns are exactly one wire diameter apart; avoids the rounding of outer minus inner.
        let pitch_m = match self.conductor {
            Conductor::Wire { diameter_m } if (even_m / diameter_m - 1.0).abs() < ROUNDING => diameter_m,
            _ => even_m,
        };
        let (conductor_height_m, mean_distance_m) = match self.conductor {
            Conductor::PitchShare(share) => (share * pitch_m, share * ROUND * pitch_m),
            Conductor::Wire { diameter_m } => (diameter_m, ROUND * diameter_m),
            Conductor::Track { width_m, thickness_m } => (thickness_m, RECTANGLE * (width_m + thickness_m)),
        };
        let layer_pitch_m = if self.layers > 1 { self.layer_pitch_m } else { 0.0 };
        let mut section = WindingSection {
            shape: self.shape,
            inner_m: self.inner_m,
            half_width_m: 0.5 * self.outer_m,
            across: (self.turns_per_layer(), pitch_m),
            layers: (self.layers, layer_pitch_m),
            turns_each: 1.0,
            conductor_height_m,
            mean_distance_m,
        };
        if self.turns > MOST_FILAMENTS {
            lump(&mut section);
        }
        section
    }
}

/// Reduces the number of filaments in the same cross-section.
fn lump(section: &mut WindingSection) {
    let ((across, pitch_m), (layers, layer_pitch_m)) = (section.across, section.layers);
    let fewer_across = across.min(MOST_FILAMENTS / layers.min(LUMPED_LAYERS));
    let fewer_layers = layers.min(MOST_FILAMENTS / fewer_across);
    let width_m = pitch_m * across as f64 / fewer_across as f64;
    let distance_m = layer_pitch_m * layers as f64 / fewer_layers as f64;
    let height_m = if layers > 1 { distance_m } else { section.conductor_height_m };
    section.across = (fewer_across, width_m);
    section.layers = (fewer_layers, distance_m);
    section.turns_each = (across * layers) as f64 / (fewer_across * fewer_layers) as f64;
    section.conductor_height_m = height_m;
    section.mean_distance_m = RECTANGLE * (width_m + height_m);
}

/// Positions on a grid around the origin, in the plane z = 0, numbered row by row from the bottom left.
#[derive(Clone, Debug, PartialEq)]
pub struct CoilGrid {
    /// Number of rows, along y.
    pub rows: usize,
    /// Number of columns, along x.
    pub columns: usize,
    /// Distance between neighbours along x and y, metres.
    pub pitch_m: [f64; 2],
    /// Numbers of the positions that stay empty, counted from 1 over all positions.
    pub left_out: Vec<usize>,
}

impl CoilGrid {
    /// Positions of the coils, metres; empty positions are not counted in their numbers.
    ///
    /// # Errors
    /// No rows or columns or more than 64 of either, pitches that are not positive, or an empty position that is not
    /// on the grid or is listed twice.
    pub fn places_m(&self) -> Result<Vec<Vector>, MitError> {
        for (field, count) in [("rows", self.rows), ("columns", self.columns)] {
            if !(1..=64).contains(&count) {
                return refused(field, count as f64, "1 to 64");
            }
        }
        positive("pitch_m along x", self.pitch_m[0])?;
        positive("pitch_m along y", self.pitch_m[1])?;
        let count = self.rows * self.columns;
        for (k, &place) in self.left_out.iter().enumerate() {
            if !(1..=count).contains(&place) {
                return refused("left_out", place as f64, "the number of a place on the grid, from 1");
            }
            if self.left_out[..k].contains(&place) {
                return refused("left_out", place as f64, "each place once");
            }
        }
        let along = |index: usize, of: usize, pitch_m: f64| (index as f64 - 0.5 * (of - 1) as f64) * pitch_m;
        let place = |k: usize| {
            let x = along(k % self.columns, self.columns, self.pitch_m[0]);
            [x, along(k / self.columns, self.rows, self.pitch_m[1]), 0.0]
        };
        Ok((0..count).filter(|k| !self.left_out.contains(&(k + 1))).map(place).collect())
    }
}

fn refused<T>(field: &'static str, value: f64, expected: &'static str) -> Result<T, MitError> {
    Err(MitError::Value { field, value, expected })
}
