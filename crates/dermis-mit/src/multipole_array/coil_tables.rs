//! The coils' expansions, tabulated over the height of a body. Coils and places that are equivalent by symmetry share
//! a table.

use std::collections::HashMap;
use std::f64::consts::{FRAC_PI_2, PI};

use dermis_tomo::mesh::Point;
use rayon::prelude::*;

use crate::array::CoilArray;
use crate::coil::Coil;
use crate::error::{MitError, positive};
use crate::harmonics::{HARMONICS, MOST_DEGREE, index};

/// The coils' expansions at every body over a range of heights, as Chebyshev series.
#[derive(Clone, Debug)]
pub struct CoilTables {
    pub(super) coils: usize,
    pub(super) places_m: Vec<Point>,
    pub(super) low_m: f64,
    pub(super) high_m: f64,
    pub(super) nodes: usize,
    /// Indexed by coil and body, then by polynomial, with [`HARMONICS`] values each.
    pub(super) coefficients: Vec<f64>,
}

/// Number of Chebyshev polynomials in a table.
const NODES: usize = 16;

impl CoilTables {
    /// Tabulates all coils at bodies with these places (x, y), between two heights of their centres.
    ///
    /// # Errors
    /// No bodies, heights that are not in order, or wire closer to a body's centre than `clearance_m` anywhere in the
    /// range.
    pub fn new(array: &CoilArray, places_m: &[Point], heights_m: [f64; 2], clearance_m: f64) -> Result<Self, MitError> {
        let [low_m, high_m] = heights_m;
        if places_m.is_empty() {
            return Err(MitError::Count { what: "bodies", expected: 1, got: 0 });
        }
        positive("clearance_m", clearance_m)?;
        positive("range of heights (m)", high_m - low_m)?;
        check_clearance(array, places_m, heights_m, clearance_m)?;
        let mut known: HashMap<(usize, [i64; 2]), usize> = HashMap::new();
        // One coil and place for each distinct table, and the table and transformation for each coil and body.
        let mut distinct: Vec<(&Coil, [f64; 2])> = Vec::new();
        let mut found: Vec<(usize, Fold)> = Vec::with_capacity(array.coils().len() * places_m.len());
        for coil in array.coils() {
            // Heights are those of the bodies, so coils at other heights have their own tables.
            let is_level = |other: &Coil| (other.centre_m[2] - coil.centre_m[2]).abs() < 1e-12;
            let first = array.coils().iter().position(|other| is_level(other) && coil.is_moved(other)).unwrap_or(0);
            let symmetry = Symmetry::of(coil);
            for place in places_m {
                let fold = symmetry.fold([place[0] - coil.centre_m[0], place[1] - coil.centre_m[1]]);
                let key = (first, fold.place_m.map(|m| (m * 1e10).round() as i64));
                let table = *known.entry(key).or_insert_with(|| {
                    distinct.push((coil, fold.place_m));
                    distinct.len() - 1
                });
                found.push((table, fold));
            }
        }
        let tables: Vec<Vec<f64>> =
            distinct.par_iter().map(|(coil, place_m)| chebyshev(coil, *place_m, [low_m, high_m])).collect();
        let mut coefficients = Vec::with_capacity(found.len() * NODES * HARMONICS);
        found.iter().for_each(|(table, fold)| coefficients.extend(fold.unfolded(&tables[*table])));
        let coils = array.coils().len();
        Ok(Self { coils, places_m: places_m.to_vec(), low_m, high_m, nodes: NODES, coefficients })
    }

    /// The first `harmonics` harmonics of the coefficients, by body, polynomial, harmonic and coil: the order in
    /// which frames read them.
    pub(super) fn by_body(&self, harmonics: usize) -> Vec<f64> {
        let bodies = self.places_m.len();
        let mut coefficients = Vec::with_capacity(bodies * self.nodes * harmonics * self.coils);
        for body in 0..bodies {
            for (node, harmonic) in (0..self.nodes).flat_map(|n| (0..harmonics).map(move |h| (n, h))) {
                let at = |coil: usize| ((coil * bodies + body) * self.nodes + node) * HARMONICS + harmonic;
                coefficients.extend((0..self.coils).map(|coil| self.coefficients[at(coil)]));
            }
        }
        coefficients
    }
}

/// Symmetry of a coil's field around its centre.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Symmetry {
    /// All directions are equivalent.
    Round,
    /// Quarter turns and mirrors in the axes.
    Square,
    None,
}

/// A place mapped to the place of its table, and the way back: mirror y -> -y, then rotate.
#[derive(Clone, Copy, Debug)]
struct Fold {
    place_m: Point,
    mirrored: bool,
    angle: f64,
}

impl Symmetry {
    fn of(coil: &Coil) -> Self {
        if coil.is_axisymmetric() {
            Self::Round
        } else if coil.is_of_squares() {
            Self::Square
        } else {
            Self::None
        }
    }

    fn fold(self, [x, y]: Point) -> Fold {
        match self {
            Self::Round => Fold { place_m: [x.hypot(y), 0.0], mirrored: false, angle: y.atan2(x) },
            Self::Square => {
                let quarters = (y.atan2(x) / FRAC_PI_2).round();
                let (sine, cosine) = (quarters * FRAC_PI_2).sin_cos();
                // Exact: sines and cosines of quarter turns.
                let (sine, cosine) = (sine.round(), cosine.round());
                let [along, across] = [cosine * x + sine * y, cosine * y - sine * x];
                Fold { place_m: [along, across.abs()], mirrored: across < 0.0, angle: quarters * FRAC_PI_2 }
            }
            Self::None => Fold { place_m: [x, y], mirrored: false, angle: 0.0 },
        }
    }
}

impl Fold {
    /// The table of the place itself. In a mirror through the coil's centre its current reverses, and so does the
    /// axial part of the field: the potential is even, and the sine terms change sign.
    fn unfolded(&self, table: &[f64]) -> Vec<f64> {
        let mut out = table.to_vec();
        if self.mirrored {
            for row in out.chunks_exact_mut(HARMONICS) {
                for (degree, order) in (1..=MOST_DEGREE).flat_map(|l| (1..=l).map(move |m| (l, m))) {
                    let sine = &mut row[index(degree, order) + 1];
                    *sine = -*sine;
                }
            }
        }
        if self.angle == 0.0 { out } else { turned(&out, self.angle) }
    }
}

fn check_clearance(
    array: &CoilArray,
    places_m: &[Point],
    [low_m, high_m]: [f64; 2],
    clearance_m: f64,
) -> Result<(), MitError> {
    for (coil, wire) in array.coils().iter().enumerate() {
        for (body, [x, y]) in places_m.iter().enumerate() {
            for step in 0..=8 {
                let position_m = [*x, *y, low_m + (high_m - low_m) * f64::from(step) / 8.0];
                let distance_m = wire.distance_m(position_m);
                if !distance_m.is_finite() {
                    let field = "distance of a body from wire (m)";
                    return Err(MitError::Value { field, value: distance_m, expected: "finite" });
                }
                if distance_m < clearance_m {
                    let (coil, body, radius_m) = (coil + 1, body + 1, clearance_m);
                    return Err(MitError::WireInside { body, position_m, coil, distance_m, radius_m });
                }
            }
        }
    }
    Ok(())
}

/// Chebyshev coefficients over height of a coil's expansion at a place relative to its centre.
fn chebyshev(coil: &Coil, [dx, dy]: [f64; 2], [low_m, high_m]: [f64; 2]) -> Vec<f64> {
    let angle = |k: usize| PI * (k as f64 + 0.5) / NODES as f64;
    let samples: Vec<[f64; HARMONICS]> = (0..NODES)
        .map(|k| {
            let z = 0.5 * (low_m + high_m) + 0.5 * (high_m - low_m) * angle(k).cos();
            coil.expansion([coil.centre_m[0] + dx, coil.centre_m[1] + dy, z])
        })
        .collect();
    let coefficient = |n: usize, i: usize| {
        let share = if n == 0 { 1.0 } else { 2.0 } / NODES as f64;
        share * (0..NODES).map(|k| samples[k][i] * (n as f64 * angle(k)).cos()).sum::<f64>()
    };
    (0..NODES).flat_map(|n| (0..HARMONICS).map(move |i| (n, i))).map(|(n, i)| coefficient(n, i)).collect()
}

/// Rotates the coefficients of a table computed along +x about the coil's axis.
fn turned(table: &[f64], angle: f64) -> Vec<f64> {
    let mut out = table.to_vec();
    for row in out.chunks_exact_mut(HARMONICS) {
        for (degree, order) in (1..=MOST_DEGREE).flat_map(|l| (1..=l).map(move |m| (l, m))) {
            let (s, c) = (order as f64 * angle).sin_cos();
            let at = index(degree, order);
            let (along, across) = (row[at], row[at + 1]);
            row[at] = along * c - across * s;
            row[at + 1] = along * s + across * c;
        }
    }
    out
}
