//! Flat plates, fast enough for every frame: the stream function of [`super::Sheet`] reduced to vertical dipoles at a
//! few points.
//!
//! A coil's normal field over a plate is the polynomial through its values s at Gauss points (Lagrange's l_q). The
//! stream function responds with the dipole moments `m = Q s`, `Q = -j w P' (Z R + j w L)^-1 P`,
//! `P_iq = int psi_i l_q dS`, and `dM_mn = s_m' Q s_n` plus the exclusion of tangential fields. Moving a plate
//! changes only s, which is tabulated over its height. Neighbours add the field of their dipoles, in sweeps.

use std::f64::consts::PI;

use dermis_tomo::mesh::{Point, distance};
use faer::Mat;
use faer::prelude::Solve;
use rayon::prelude::*;

use super::mesh::{SheetMesh, area};
use super::stream_function::{Sheet, SheetMaterial};
use super::triangle::{place, seven_points};
use crate::array::CoilArray;
use crate::coil::Coil;
use crate::constants::MU0;
use crate::error::{MitError, positive};
use crate::quadrature::gauss_legendre;
use crate::vector::{Complex, Vector};

/// Number of Chebyshev polynomials in a table over height.
const NODES: usize = 16;
/// Number of points along a side that represent a plate in the field of its neighbours.
const COARSE: usize = 3;

/// A rectangular plate with sides along x and y, at one frequency.
#[derive(Clone, Debug, PartialEq)]
pub struct Plate {
    size_m: [f64; 2],
    thickness_m: f64,
    /// Points relative to the plate's centre, metres.
    points_m: Vec<Point>,
    /// Areas represented by the points.
    areas: Vec<f64>,
    /// Q, row by row, m^2.A/T.
    response: Vec<Complex>,
    /// `mu0 t (1 - tanh(k t/2)/(k t/2))`, H.
    odd: Complex,
    /// Value at each point of the polynomial that is 1 at one of the coarse points, for each of these.
    spread: Vec<[f64; COARSE * COARSE]>,
    coarse_m: Vec<[f64; 2]>,
}

/// Gauss-Legendre nodes in a rectangle, and their areas.
fn grid(size_m: [f64; 2], count: usize) -> (Vec<[f64; 2]>, Vec<f64>) {
    let rule = gauss_legendre(count);
    let pairs = rule.iter().flat_map(|y| rule.iter().map(move |x| (x, y)));
    let of = |(x, y): (&(f64, f64), &(f64, f64))| {
        ([0.5 * size_m[0] * x.0, 0.5 * size_m[1] * y.0], 0.25 * size_m[0] * size_m[1] * x.1 * y.1)
    };
    pairs.map(of).unzip()
}

/// Lagrange polynomials of the Gauss-Legendre nodes on [-1, 1], evaluated at a place.
fn lagrange(count: usize, at: f64) -> Vec<f64> {
    let nodes: Vec<f64> = gauss_legendre(count).into_iter().map(|(x, _)| x).collect();
    let of = |k: usize| (0..count).filter(|j| *j != k).map(|j| (at - nodes[j]) / (nodes[k] - nodes[j])).product();
    (0..count).map(of).collect()
}

impl Plate {
    /// Builds a plate from a mesh with this many cells along each side (see [`SheetMesh::rectangle`]) and this many
    /// points. A field whose wire is at distance d from the plate is represented to about
    /// `(d/h + sqrt(1 + d^2/h^2))^-points`, with h half a side.
    ///
    /// # Errors
    /// As [`SheetMesh::rectangle`] and [`Sheet::new`]; also fails for fewer than 3 or more than 12 points along a
    /// side.
    pub fn new(
        size_m: [f64; 2],
        material: &SheetMaterial,
        frequency_hz: f64,
        cells: usize,
        points: usize,
    ) -> Result<Self, MitError> {
        if !(COARSE..=12).contains(&points) {
            let expected = "3 to 12";
            return Err(MitError::Value { field: "points along a plate's side", value: points as f64, expected });
        }
        let mesh = SheetMesh::rectangle(size_m, [cells; 2])?;
        let sheet = Sheet::new(&mesh, material, frequency_hz)?;
        let (numbers, unknowns) = mesh.unknowns();
        let (points_m, areas) = grid(size_m, points);
        let count = points_m.len();
        let mut weights = Mat::<f64>::zeros(unknowns, count);
        for (t, corners) in mesh.triangles.iter().enumerate() {
            let places = mesh.corners(t);
            let area = area(places);
            for (l, w) in seven_points() {
                let p = place(places, l);
                let [x, y] = [0, 1].map(|axis| lagrange(points, 2.0 * p[axis] / size_m[axis]));
                for (corner, share) in corners.iter().zip(l) {
                    let Some(i) = numbers[*corner as usize] else { continue };
                    for q in 0..count {
                        weights[(i as usize, q)] += area * w * share * x[q % points] * y[q / points];
                    }
                }
            }
        }
        let sides = Mat::from_fn(unknowns, count, |i, q| Complex::new(0.0, -sheet.angular_frequency * weights[(i, q)]));
        let streams = sheet.factor.solve(&sides);
        let raw = |p: usize, q: usize| (0..unknowns).map(|i| streams[(i, q)] * weights[(i, p)]).sum::<Complex>();
        let raw: Vec<Complex> = (0..count * count).map(|k| raw(k / count, k % count)).collect();
        let response = (0..count * count).map(|k| (raw[k] + raw[k % count * count + k / count]) * 0.5).collect();
        let spread = points_m
            .iter()
            .map(|p| {
                let [x, y] = [0, 1].map(|axis| lagrange(COARSE, 2.0 * p[axis] / size_m[axis]));
                std::array::from_fn(|q| x[q % COARSE] * y[q / COARSE])
            })
            .collect();
        let (coarse_m, _) = grid(size_m, COARSE);
        let thickness_m = material.thickness_m;
        Ok(Self { size_m, thickness_m, points_m, areas, response, odd: sheet.odd, spread, coarse_m })
    }

    /// Positions of the points relative to the plate's centre, metres.
    pub fn points_m(&self) -> &[Point] {
        &self.points_m
    }

    /// Maximum distance of any place on the plate from the nearest point, metres; wire closer than that is not
    /// resolved.
    fn spacing_m(&self) -> f64 {
        let count = self.points_m.len().isqrt();
        let widest = |axis: usize, stride: usize| {
            let at = |k: usize| self.points_m[k * stride][axis];
            (1..count).map(|k| 0.5 * (at(k) - at(k - 1))).fold(0.0, f64::max)
        };
        widest(0, 1).hypot(widest(1, count))
    }

    /// A coil's flux density at the points of the plate when centred at a place, T/A.
    pub fn sample(&self, coil: &Coil, middle_m: Vector) -> Vec<Vector> {
        let at = |p: &Point| coil.flux_density([middle_m[0] + p[0], middle_m[1] + p[1], middle_m[2]]);
        self.points_m.iter().map(at).collect()
    }

    /// Change of the mutual inductance of two coils with these samples due to the plate alone, henries.
    pub fn change_h(&self, m: &[Vector], n: &[Vector]) -> Complex {
        let mut sum = Complex::new(0.0, 0.0);
        for (row, a) in self.response.chunks_exact(n.len()).zip(m) {
            sum += row.iter().zip(n).map(|(q, b)| *q * b[2]).sum::<Complex>() * a[2];
        }
        let along = |((a, b), area): ((&Vector, &Vector), &f64)| area * (a[0] * b[0] + a[1] * b[1]);
        sum - self.odd * (m.iter().zip(n).zip(&self.areas).map(along).sum::<f64>() / (MU0 * MU0))
    }
}

/// Coupling between plates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlateCoupling {
    /// Maximum distance between the centres of coupled plates, metres.
    pub reach_m: f64,
    /// Number of fixed-point sweeps.
    pub sweeps: usize,
}

/// Identical plates at fixed places and variable heights over an array of coils.
#[derive(Clone, Debug)]
pub struct Plates {
    plate: Plate,
    places_m: Vec<Point>,
    heights_m: [f64; 2],
    coupling: Option<PlateCoupling>,
    neighbours: Vec<[usize; 2]>,
    pairs: Vec<[usize; 2]>,
    coils: usize,
    /// Indexed by plate and coil, then by polynomial: the three components at all points.
    tables: Vec<f64>,
    /// Indexed by plate and coil: the components at all points.
    fields: Vec<f64>,
    /// Indexed by plate and coil.
    moments: Vec<Complex>,
    alone: Vec<Complex>,
    /// Indexed by plate and coil, at the coarse points.
    gathered: Vec<Complex>,
    /// Q times the spread.
    spread_response: Vec<Complex>,
}

impl Plates {
    /// Tabulates all coils at plates in these places, between two heights of their centres. Needs
    /// `384 coils x plates x points` bytes, and evaluates the field of every coil at 16 heights of every point.
    ///
    /// # Errors
    /// No plates, overlapping plates, heights that are not in order, or wire closer to a plate than its points
    /// resolve, anywhere in the range.
    pub fn new(
        array: &CoilArray,
        plate: Plate,
        places_m: &[Point],
        heights_m: [f64; 2],
        coupling: Option<PlateCoupling>,
    ) -> Result<Self, MitError> {
        positive("plates", places_m.len() as f64)?;
        positive("range of heights (m)", heights_m[1] - heights_m[0])?;
        let neighbours = neighbours(&plate, places_m, coupling)?;
        check_clearance(array, &plate, places_m, heights_m)?;
        let (coils, count) = (array.coils().len(), plate.points_m.len());
        let of = |k: usize| chebyshev(&array.coils()[k % coils], &plate, places_m[k / coils], heights_m);
        let tables = (0..places_m.len() * coils).into_par_iter().flat_map_iter(of).collect();
        let spread_response = (0..count * COARSE * COARSE)
            .map(|k| {
                let (row, column) = (k / (COARSE * COARSE), k % (COARSE * COARSE));
                (0..count).map(|q| plate.response[row * count + q] * plate.spread[q][column]).sum()
            })
            .collect();
        let (size, zero) = (places_m.len() * coils, Complex::new(0.0, 0.0));
        Ok(Self {
            places_m: places_m.to_vec(),
            heights_m,
            coupling,
            neighbours,
            pairs: array.pairs(),
            coils,
            tables,
            fields: vec![0.0; 3 * size * count],
            moments: vec![zero; size * count],
            alone: vec![zero; size * count],
            gathered: vec![zero; size * COARSE * COARSE],
            spread_response,
            plate,
        })
    }

    /// Pairs of coils, in the order of the changes.
    pub fn pairs(&self) -> &[[usize; 2]] {
        &self.pairs
    }

    /// Number of plates.
    pub fn count(&self) -> usize {
        self.places_m.len()
    }

    /// Changes of mutual inductance of all pairs of coils for plates centred at these heights, henries.
    ///
    /// # Errors
    /// The wrong number of heights or pairs, or a height outside the table.
    pub fn changes(&mut self, heights_m: &[f64], changes_h: &mut [Complex]) -> Result<(), MitError> {
        self.check(heights_m, changes_h.len())?;
        self.evaluate(heights_m);
        self.answer();
        self.excite_each_other(heights_m);
        let count = self.plate.points_m.len();
        changes_h.fill(Complex::new(0.0, 0.0));
        for plate in 0..self.places_m.len() {
            let field = |coil: usize| &self.fields[3 * (plate * self.coils + coil) * count..][..3 * count];
            let moments = |coil: usize| &self.moments[(plate * self.coils + coil) * count..][..count];
            for (change, &[m, n]) in changes_h.iter_mut().zip(&self.pairs) {
                let (a, b) = (field(m), field(n));
                let (mut re, mut im, mut along) = (0.0, 0.0, 0.0);
                for (s, moment) in a[2 * count..].iter().zip(moments(n)) {
                    re += s * moment.re;
                    im += s * moment.im;
                }
                for (q, area) in self.plate.areas.iter().enumerate() {
                    along += area * (a[q] * b[q] + a[count + q] * b[count + q]);
                }
                *change += Complex::new(re, im) - self.plate.odd * (along / (MU0 * MU0));
            }
        }
        Ok(())
    }

    fn check(&self, heights_m: &[f64], pairs: usize) -> Result<(), MitError> {
        if heights_m.len() != self.places_m.len() {
            let (expected, got) = (self.places_m.len(), heights_m.len());
            return Err(MitError::Count { what: "heights", expected, got });
        }
        if pairs != self.pairs.len() {
            return Err(MitError::Count { what: "changes", expected: self.pairs.len(), got: pairs });
        }
        let [low_m, high_m] = self.heights_m;
        let slack = 1e-9 * (high_m - low_m);
        match heights_m.iter().position(|h| !(*h >= low_m - slack && *h <= high_m + slack)) {
            Some(k) => Err(MitError::OutsideTable { body: k + 1, height_m: heights_m[k], low_m, high_m }),
            None => Ok(()),
        }
    }

    fn evaluate(&mut self, heights_m: &[f64]) {
        let [low_m, high_m] = self.heights_m;
        let width = 3 * self.plate.points_m.len();
        for (k, field) in self.fields.chunks_exact_mut(width).enumerate() {
            let t = (2.0 * heights_m[k / self.coils] - low_m - high_m) / (high_m - low_m);
            let (mut t0, mut t1) = (1.0, t);
            field.fill(0.0);
            for row in self.tables[k * NODES * width..(k + 1) * NODES * width].chunks_exact(width) {
                field.iter_mut().zip(row).for_each(|(b, a)| *b += t0 * a);
                (t0, t1) = (t1, 2.0 * t * t1 - t0);
            }
        }
    }

    /// `m = Q s`.
    fn answer(&mut self) {
        let count = self.plate.points_m.len();
        for (moments, field) in self.moments.chunks_exact_mut(count).zip(self.fields.chunks_exact(3 * count)) {
            for (moment, row) in moments.iter_mut().zip(self.plate.response.chunks_exact(count)) {
                let (mut re, mut im) = (0.0, 0.0);
                for (q, s) in row.iter().zip(&field[2 * count..]) {
                    re += q.re * s;
                    im += q.im * s;
                }
                *moment = Complex::new(re, im);
            }
        }
    }

    /// Sweeps of `m = Q (s + field of the neighbours' moments)`.
    fn excite_each_other(&mut self, heights_m: &[f64]) {
        let Some(coupling) = self.coupling else { return };
        let (few, count) = (COARSE * COARSE, self.plate.points_m.len());
        let kernels: Vec<Vec<f64>> = self
            .neighbours
            .iter()
            .map(|&[to, from]| {
                let dz = heights_m[to] - heights_m[from];
                let shift = [0, 1].map(|k| self.places_m[to][k] - self.places_m[from][k]);
                kernel(&self.plate.coarse_m, shift, dz)
            })
            .collect();
        self.alone.copy_from_slice(&self.moments);
        let zero = Complex::new(0.0, 0.0);
        let mut field = vec![zero; self.coils * few];
        for _ in 0..coupling.sweeps {
            for (gathered, moments) in self.gathered.chunks_exact_mut(few).zip(self.moments.chunks_exact(count)) {
                gathered.fill(zero);
                for (moment, spread) in moments.iter().zip(&self.plate.spread) {
                    gathered.iter_mut().zip(spread).for_each(|(sum, share)| *sum += *moment * *share);
                }
            }
            self.moments.copy_from_slice(&self.alone);
            // Neighbours are ordered by the plate they excite.
            let mut at = 0;
            for plate in 0..self.places_m.len() {
                field.fill(zero);
                while at < self.neighbours.len() && self.neighbours[at][0] == plate {
                    let source = &self.gathered[self.neighbours[at][1] * self.coils * few..][..self.coils * few];
                    for (field, source) in field.chunks_exact_mut(few).zip(source.chunks_exact(few)) {
                        for (field, row) in field.iter_mut().zip(kernels[at].chunks_exact(few)) {
                            let (mut re, mut im) = (0.0, 0.0);
                            for (g, m) in row.iter().zip(source) {
                                re += g * m.re;
                                im += g * m.im;
                            }
                            *field += Complex::new(re, im);
                        }
                    }
                    at += 1;
                }
                let moments = &mut self.moments[plate * self.coils * count..][..self.coils * count];
                for (moments, field) in moments.chunks_exact_mut(count).zip(field.chunks_exact(few)) {
                    for (moment, row) in moments.iter_mut().zip(self.spread_response.chunks_exact(few)) {
                        *moment += row.iter().zip(field).map(|(q, f)| *q * *f).sum::<Complex>();
                    }
                }
            }
        }
    }
}

/// Normal field at the coarse points of one plate due to vertical unit dipoles at those of another:
/// `mu0/(4 pi) (3 z^2/r^2 - 1)/r^3`.
fn kernel(points_m: &[Point], shift_m: [f64; 2], dz_m: f64) -> Vec<f64> {
    let of = |to: &[f64; 2], from: &[f64; 2]| {
        let (x, y) = (shift_m[0] + to[0] - from[0], shift_m[1] + to[1] - from[1]);
        let squared = x * x + y * y + dz_m * dz_m;
        1e-7 * (3.0 * dz_m * dz_m / squared - 1.0) / (squared * squared.sqrt())
    };
    points_m.iter().flat_map(|to| points_m.iter().map(move |from| of(to, from))).collect()
}

/// Ordered pairs of plates within reach, sorted by the excited plate.
fn neighbours(plate: &Plate, places_m: &[Point], coupling: Option<PlateCoupling>) -> Result<Vec<[usize; 2]>, MitError> {
    let mut neighbours = Vec::new();
    for (a, p) in places_m.iter().enumerate() {
        for (b, q) in places_m.iter().enumerate().filter(|(b, _)| *b != a) {
            let (dx, dy) = ((p[0] - q[0]).abs(), (p[1] - q[1]).abs());
            let distance_m = distance(*p, *q);
            if dx < plate.size_m[0] && dy < plate.size_m[1] {
                let needed_m = plate.size_m[0].max(plate.size_m[1]);
                return Err(MitError::BodiesOverlap { first: a + 1, second: b + 1, distance_m, needed_m });
            }
            if coupling.is_some_and(|coupling| distance_m <= coupling.reach_m) {
                neighbours.push([a, b]);
            }
        }
    }
    Ok(neighbours)
}

fn check_clearance(
    array: &CoilArray,
    plate: &Plate,
    places_m: &[Point],
    [low_m, high_m]: [f64; 2],
) -> Result<(), MitError> {
    let radius_m = plate.spacing_m().max(0.5 * plate.thickness_m);
    for (coil, wire) in array.coils().iter().enumerate() {
        for (body, [x, y]) in places_m.iter().enumerate() {
            for point in &plate.points_m {
                for step in 0..=8 {
                    let position_m = [x + point[0], y + point[1], low_m + (high_m - low_m) * f64::from(step) / 8.0];
                    let distance_m = wire.distance_m(position_m);
                    if distance_m < radius_m {
                        let (coil, body) = (coil + 1, body + 1);
                        return Err(MitError::WireInside { body, position_m, coil, distance_m, radius_m });
                    }
                }
            }
        }
    }
    Ok(())
}

/// Chebyshev coefficients over height of a coil's field at the points of a plate.
fn chebyshev(coil: &Coil, plate: &Plate, [x, y]: Point, [low_m, high_m]: [f64; 2]) -> Vec<f64> {
    let angle = |k: usize| PI * (k as f64 + 0.5) / NODES as f64;
    let samples: Vec<Vec<Vector>> = (0..NODES)
        .map(|k| {
            let z = 0.5 * (low_m + high_m) + 0.5 * (high_m - low_m) * angle(k).cos();
            plate.sample(coil, [x, y, z])
        })
        .collect();
    let mut table = Vec::with_capacity(NODES * 3 * plate.points_m.len());
    for n in 0..NODES {
        let share = if n == 0 { 1.0 } else { 2.0 } / NODES as f64;
        for axis in 0..3 {
            for q in 0..plate.points_m.len() {
                let sum: f64 = (0..NODES).map(|k| samples[k][q][axis] * (n as f64 * angle(k)).cos()).sum();
                table.push(share * sum);
            }
        }
    }
    table
}
