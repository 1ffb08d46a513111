//! Arrays of coils: identical coils at many places, or coils of any kind next to and above each other.

use std::collections::HashMap;

use rayon::prelude::*;

use crate::coil::{Coil, CoilShape};
use crate::coil_spec::CoilSpec;
use crate::error::MitError;
use crate::vector::{Vector, norm, subtract};

/// Displacements between coils that differ by less than this are equal, metres.
const SAME_M: f64 = 1e-10;
/// Maximum number of coils in an array.
pub const MOST_COILS: usize = 64;

/// Coils next to each other, or stacked in layers.
#[derive(Clone, Debug, PartialEq)]
pub struct CoilArray {
    coils: Vec<Coil>,
}

/// Data for drawing a coil.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoilOutline {
    /// Outline of its turns.
    pub shape: CoilShape,
    /// Centre, metres.
    pub centre_m: [f64; 3],
    /// Outer width, metres: diameter or side.
    pub outer_m: f64,
}

impl CoilArray {
    /// Identical coils with their centres at these places, metres, numbered in this order. [`crate::CoilGrid`]
    /// generates places.
    ///
    /// # Errors
    /// As [`CoilSpec::coil`] and [`CoilArray::of_coils`].
    pub fn new(spec: &CoilSpec, places_m: &[[f64; 3]]) -> Result<Self, MitError> {
        let coil = spec.coil([0.0; 3])?;
        Self::of_coils(places_m.iter().map(|place| coil.clone().moved(*place)).collect())
    }

    /// An array of coils of any kind.
    ///
    /// # Errors
    /// Fewer than 2 coils or more than [`MOST_COILS`], non-finite positions, or overlapping coils. Coils may lie
    /// above each other only if their heights differ by at least the sum of their half heights.
    pub fn of_coils(coils: Vec<Coil>) -> Result<Self, MitError> {
        for (k, coil) in coils.iter().enumerate() {
            if let Some(value) = coil.centre_m.into_iter().find(|x| !x.is_finite()) {
                return Err(MitError::CoilPlace { coil: k + 1, value });
            }
        }
        if !(2..=MOST_COILS).contains(&coils.len()) {
            return Err(MitError::Value { field: "number of coils", value: coils.len() as f64, expected: "2 to 64" });
        }
        for (k, a) in coils.iter().enumerate() {
            for (n, b) in coils.iter().enumerate().skip(k + 1) {
                let layers_m = a.half_height_m + b.half_height_m;
                let over = (a.centre_m[2] - b.centre_m[2]).abs() >= layers_m * (1.0 - 1e-9);
                if !over && overlap_in_plan(a, b) {
                    return Err(MitError::CoilsOverlap {
                        first: k + 1,
                        second: n + 1,
                        distance_m: norm(subtract(a.centre_m, b.centre_m)),
                        needed_m: a.half_width_m + b.half_width_m,
                        layers_m,
                    });
                }
            }
        }
        Ok(Self { coils })
    }

    /// The same array above a perfectly conducting plane at height `z_m`.
    ///
    /// # Errors
    /// A height that is not finite or not below all wire.
    pub fn with_shield(self, z_m: f64) -> Result<Self, MitError> {
        let lowest_m =
            self.coils.iter().map(|coil| coil.centre_m[2] - coil.half_height_m).fold(f64::INFINITY, f64::min);
        if !(z_m.is_finite() && z_m < lowest_m) {
            return Err(MitError::ShieldNotBelow { z_m, lowest_m });
        }
        Ok(Self { coils: self.coils.into_iter().map(|coil| coil.with_shield(z_m)).collect() })
    }

    /// The coils.
    pub fn coils(&self) -> &[Coil] {
        &self.coils
    }

    /// Shape, centre and outer width of every coil, for drawing.
    pub fn outlines(&self) -> Vec<CoilOutline> {
        let outline = |coil: &Coil| CoilOutline {
            shape: coil.shape(),
            centre_m: coil.centre_m,
            outer_m: 2.0 * coil.half_width_m,
        };
        self.coils.iter().map(outline).collect()
    }

    /// All pairs of coils, (0, 1), (0, 2), ... (n-2, n-1): N(N-1)/2 channels.
    pub fn pairs(&self) -> Vec<[usize; 2]> {
        let count = self.coils.len();
        (0..count).flat_map(|a| (a + 1..count).map(move |b| [a, b])).collect()
    }

    /// Mutual inductance of every pair without bodies, henries. Pairs of identical coils with the same displacement
    /// share one computation: a grid of 4 x 4 coils has 120 pairs but only 24 displacements.
    pub fn mutuals_h(&self) -> Vec<f64> {
        let pairs = self.pairs();
        let kinds: Vec<usize> = (0..self.coils.len())
            .map(|k| (0..k).find(|&first| self.coils[k].is_moved(&self.coils[first])).unwrap_or(k))
            .collect();
        let mut known: HashMap<[i64; 5], usize> = HashMap::new();
        let mut distinct: Vec<[usize; 2]> = Vec::new();
        let places: Vec<usize> = pairs
            .iter()
            .map(|&[a, b]| {
                *known.entry(self.how_they_lie([a, b], &kinds)).or_insert_with(|| {
                    distinct.push([a, b]);
                    distinct.len() - 1
                })
            })
            .collect();
        let values: Vec<f64> = distinct.par_iter().map(|&[a, b]| self.coils[a].mutual_h(&self.coils[b])).collect();
        places.into_iter().map(|place| values[place]).collect()
    }

    /// Key that determines the mutual inductance of a pair: the kinds of both coils and their displacement, rounded
    /// far below any effect. A shield is at the same distance below all coils of a kind.
    fn how_they_lie(&self, [a, b]: [usize; 2], kinds: &[usize]) -> [i64; 5] {
        let steps = subtract(self.coils[b].centre_m, self.coils[a].centre_m).map(|m| (m / SAME_M).round() as i64);
        let ([from, to], [x, y, z]) = ([kinds[a], kinds[b]].map(|kind| kind as i64), steps);
        // Mutual inductance is symmetric in the two coils.
        if (from, [x, y, z]) > (to, [-x, -y, -z]) { [to, from, -x, -y, -z] } else { [from, to, x, y, z] }
    }
}

/// True if two coils overlap seen from above; touching coils do not.
fn overlap_in_plan(a: &Coil, b: &Coil) -> bool {
    let [dx, dy, _]: Vector = subtract(a.centre_m, b.centre_m).map(f64::abs);
    let (needed_m, apart_m) = match (a.shape(), b.shape()) {
        (CoilShape::Round, CoilShape::Round) => (a.half_width_m + b.half_width_m, dx.hypot(dy)),
        (CoilShape::Square, CoilShape::Square) => (a.half_width_m + b.half_width_m, dx.max(dy)),
        (CoilShape::Round, CoilShape::Square) => (a.half_width_m, outside_square(b, [dx, dy])),
        (CoilShape::Square, CoilShape::Round) => (b.half_width_m, outside_square(a, [dx, dy])),
    };
    apart_m < needed_m * (1.0 - 1e-9)
}

/// Distance of a point from a square coil, given its distances from the coil's centre along x and y; 0 inside.
fn outside_square(square: &Coil, distances_m: [f64; 2]) -> f64 {
    let [x, y] = distances_m.map(|distance| (distance - square.half_width_m).max(0.0));
    x.hypot(y)
}
