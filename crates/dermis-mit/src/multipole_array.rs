//! Small conducting bodies over coils. Each responds to the field around it with a complex symmetric matrix tau over
//! solid harmonics, and the change of a mutual inductance is `dM_mn = c_m' tau c_n`, where c are the coils'
//! expansions at the body. Moving a body changes only c, which is tabulated over its height.
//!
//! With Schmidt-normalised harmonics and `B = -mu0 grad(sum c_i h_i)`, the scattered potential is
//! `sum d_i Y_i/r^(l+1)` with `d = -tau c / (4 pi mu0)`, and reciprocity gives `dM_mn = -4 pi mu0 c_m' d_n`; a sphere
//! has `tau_l = 4 pi mu0 l/(l+1) T_l`. Neighbours excite each other: `d = -tau (c + sum S d) / (4 pi mu0)`, where S
//! re-expands one body's irregular harmonics about the other; solved by fixed-point sweeps.

mod coil_tables;

pub use coil_tables::CoilTables;

use dermis_tomo::mesh::distance;
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};

use crate::constants::FOUR_PI_MU0;
use crate::error::MitError;
use crate::harmonics::{MOST_DEGREE, translation};
use crate::polarizability::Polarizability;
use crate::vector::{Complex, subtract};

/// Coupling between neighbouring bodies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coupling {
    /// Maximum degree that is coupled, 1 to [`crate::MOST_DEGREE`].
    pub degree: usize,
    /// Maximum distance between coupled bodies, metres.
    pub reach_m: f64,
    /// Number of fixed-point sweeps.
    pub sweeps: usize,
}

/// Bodies at fixed places and variable heights over an array of coils.
#[derive(Clone, Debug)]
pub struct MultipoleArray {
    bodies: Vec<Polarizability>,
    tables: CoilTables,
    coupling: Option<Coupling>,
    /// Ordered pairs of bodies that excite each other.
    neighbours: Vec<[usize; 2]>,
    pairs: Vec<[usize; 2]>,
    /// Number of harmonics to which any body responds, counted from the first; the others are not computed.
    harmonics: usize,
    /// Coefficients of the tables, as in [`CoilTables::by_body`].
    coefficients: Vec<f64>,
    /// Expansions by body, harmonic and coil, like all arrays below.
    c: Vec<f64>,
    slopes: Vec<f64>,
    /// Responses d.
    d: Answers,
    /// The same without neighbours.
    alone: Answers,
    next: Answers,
}

/// Real and imaginary parts of responses.
#[derive(Clone, Debug)]
struct Answers {
    re: Vec<f64>,
    im: Vec<f64>,
}

impl Answers {
    fn new(size: usize) -> Self {
        Self { re: vec![0.0; size], im: vec![0.0; size] }
    }

    fn copy_from(&mut self, other: &Self) {
        self.re.copy_from_slice(&other.re);
        self.im.copy_from_slice(&other.im);
    }
}

impl MultipoleArray {
    /// One body for each place of the tables.
    ///
    /// # Errors
    /// A number of bodies that differs from the places, bodies that would overlap side by side, or bodies that excite
    /// each other although their surrounding spheres overlap.
    pub fn new(bodies: Vec<Polarizability>, tables: CoilTables, coupling: Option<Coupling>) -> Result<Self, MitError> {
        let count = tables.places_m.len();
        if bodies.len() != count {
            return Err(MitError::Count { what: "bodies", expected: count, got: bodies.len() });
        }
        let mut neighbours = Vec::new();
        for a in 0..count {
            for b in (0..count).filter(|b| *b != a) {
                // Bodies that excite each other need disjoint surrounding spheres, others only disjoint inscribed
                // spheres.
                let reach = |body: &Polarizability| if coupling.is_some() { body.radius_m } else { body.inner_m };
                let distance_m = distance(tables.places_m[a], tables.places_m[b]);
                let needed_m = reach(&bodies[a]) + reach(&bodies[b]);
                if distance_m < needed_m * (1.0 - 1e-9) {
                    return Err(MitError::BodiesOverlap { first: a + 1, second: b + 1, distance_m, needed_m });
                }
                if coupling.is_some_and(|coupling| distance_m <= coupling.reach_m) {
                    neighbours.push([a, b]);
                }
            }
        }
        let coils = tables.coils;
        let pairs = (0..coils).flat_map(|a| (a + 1..coils).map(move |b| [a, b])).collect();
        let entries = bodies.iter().flat_map(|body| &body.entries);
        let harmonics = entries.map(|(row, column, _)| row.max(column) + 1).max().unwrap_or(1);
        let coefficients = tables.by_body(harmonics);
        let tables = CoilTables { coefficients: Vec::new(), ..tables };
        let size = count * coils * harmonics;
        Ok(Self {
            c: vec![0.0; size],
            slopes: vec![0.0; size],
            d: Answers::new(size),
            alone: Answers::new(size),
            next: Answers::new(size),
            harmonics,
            coefficients,
            bodies,
            tables,
            coupling,
            neighbours,
            pairs,
        })
    }

    /// Number of bodies.
    pub fn count(&self) -> usize {
        self.bodies.len()
    }

    /// Pairs of coils, in the order of the changes.
    pub fn pairs(&self) -> &[[usize; 2]] {
        &self.pairs
    }

    /// Range of heights.
    pub fn heights_m(&self) -> [f64; 2] {
        [self.tables.low_m, self.tables.high_m]
    }

    /// Changes of mutual inductance of all pairs of coils for bodies centred at these heights, henries. Allocates
    /// only for re-expansions.
    ///
    /// # Errors
    /// The wrong number of heights or pairs, or a height outside the table.
    pub fn changes(&mut self, heights_m: &[f64], changes_h: &mut [Complex]) -> Result<(), MitError> {
        self.check(heights_m, changes_h.len())?;
        self.expand(heights_m, false);
        self.answer_alone();
        self.excite_each_other(heights_m);
        let coils = self.tables.coils;
        // dM = -4 pi mu0 sum c d' over bodies and harmonics.
        let stacked = self.c.len() / coils;
        let c = MatRef::from_row_major_slice(&self.c, stacked, coils).transpose();
        let product = |d: &[f64]| {
            let d = MatRef::from_row_major_slice(d, stacked, coils);
            let mut product = Mat::zeros(coils, coils);
            matmul(&mut product, Accum::Replace, c, d, -FOUR_PI_MU0, Par::Seq);
            product
        };
        let (re, im) = (product(&self.d.re), product(&self.d.im));
        for (change, &[m, n]) in changes_h.iter_mut().zip(&self.pairs) {
            *change = Complex::new(re[(m, n)], im[(m, n)]);
        }
        Ok(())
    }

    /// Derivatives of the changes with respect to each body's height, by pair and then body, henries per metre.
    /// Excitation by neighbours is neglected as second order: `dc_m' tau c_n + c_m' tau dc_n`.
    ///
    /// # Errors
    /// As [`MultipoleArray::changes`].
    pub fn slopes(&mut self, heights_m: &[f64], slopes_h_per_m: &mut [Complex]) -> Result<(), MitError> {
        self.check(heights_m, slopes_h_per_m.len() / self.bodies.len())?;
        self.expand(heights_m, true);
        self.answer_alone();
        let (coils, stride) = (self.tables.coils, self.stride());
        let (mut re, mut im) = (Mat::zeros(coils, coils), Mat::zeros(coils, coils));
        for body in 0..self.bodies.len() {
            let part = body * stride..(body + 1) * stride;
            let matrix = |of| MatRef::from_row_major_slice(of, stride / coils, coils);
            let slopes = matrix(&self.slopes[part.clone()]).transpose();
            for (product, d) in [(&mut re, &self.d.re), (&mut im, &self.d.im)] {
                matmul(product, Accum::Replace, slopes, matrix(&d[part.clone()]), -FOUR_PI_MU0, Par::Seq);
            }
            // tau is symmetric: c_m' tau dc_n = dc_n' tau c_m.
            let slopes_h_per_m = slopes_h_per_m.iter_mut().skip(body).step_by(self.bodies.len());
            for (slope, &[m, n]) in slopes_h_per_m.zip(&self.pairs) {
                *slope = Complex::new(re[(m, n)] + re[(n, m)], im[(m, n)] + im[(n, m)]);
            }
        }
        Ok(())
    }

    /// Number of values per body.
    fn stride(&self) -> usize {
        self.harmonics * self.tables.coils
    }

    fn check(&self, heights_m: &[f64], pairs: usize) -> Result<(), MitError> {
        if heights_m.len() != self.bodies.len() {
            let (expected, got) = (self.bodies.len(), heights_m.len());
            return Err(MitError::Count { what: "heights", expected, got });
        }
        if pairs != self.pairs.len() {
            return Err(MitError::Count { what: "changes", expected: self.pairs.len(), got: pairs });
        }
        let [low_m, high_m] = self.heights_m();
        let slack = 1e-9 * (high_m - low_m);
        let outside = |h: &f64| !(*h >= low_m - slack && *h <= high_m + slack);
        match heights_m.iter().position(outside) {
            Some(k) => Err(MitError::OutsideTable { body: k + 1, height_m: heights_m[k], low_m, high_m }),
            None => Ok(()),
        }
    }

    /// Expansions of all coils at all bodies, and their derivatives with respect to the heights if requested.
    fn expand(&mut self, heights_m: &[f64], with_slopes: bool) {
        let (stride, low_m, high_m) = (self.stride(), self.tables.low_m, self.tables.high_m);
        let per_m = 2.0 / (high_m - low_m);
        let tables = self.coefficients.chunks_exact(self.tables.nodes * stride);
        let out = self.c.chunks_exact_mut(stride).zip(self.slopes.chunks_exact_mut(stride));
        for ((height_m, table), (c, slopes)) in heights_m.iter().zip(tables).zip(out) {
            let t = (2.0 * height_m - low_m - high_m) / (high_m - low_m);
            c.fill(0.0);
            slopes.fill(0.0);
            // T_n and n U_(n-1), the derivative of T_n.
            let (mut t0, mut t1, mut u0, mut u1) = (1.0, t, 0.0, 1.0);
            for (n, row) in table.chunks_exact(stride).enumerate() {
                add_multiple(c, t0, row);
                if with_slopes {
                    add_multiple(slopes, per_m * n as f64 * u0, row);
                }
                (t0, t1) = (t1, 2.0 * t * t1 - t0);
                (u0, u1) = (u1, 2.0 * t * u1 - u0);
            }
        }
    }

    /// `d = -tau c / (4 pi mu0)`.
    fn answer_alone(&mut self) {
        let (stride, coils) = (self.stride(), self.tables.coils);
        self.d.re.fill(0.0);
        self.d.im.fill(0.0);
        for (k, body) in self.bodies.iter().enumerate() {
            for (row, column, value) in &body.entries {
                let c = &self.c[k * stride + column * coils..][..coils];
                let to = k * stride + row * coils..k * stride + (row + 1) * coils;
                add_multiple(&mut self.d.re[to.clone()], value.re * (-1.0 / FOUR_PI_MU0), c);
                add_multiple(&mut self.d.im[to], value.im * (-1.0 / FOUR_PI_MU0), c);
            }
        }
    }

    /// Sweeps of `d = -tau (c + sum S d) / (4 pi mu0)`.
    fn excite_each_other(&mut self, heights_m: &[f64]) {
        let Some(coupling) = self.coupling else { return };
        let degree = coupling.degree.clamp(1, MOST_DEGREE);
        let count = (degree + 1) * (degree + 1) - 1;
        let (stride, coils) = (self.stride(), self.tables.coils);
        let passed_on = count.min(self.harmonics);
        let at = |body: usize| [self.tables.places_m[body][0], self.tables.places_m[body][1], heights_m[body]];
        // From the centre of the source to the centre of the excited body.
        let matrices: Vec<_> = self
            .neighbours
            .iter()
            .map(|&[target, source]| translation(subtract(at(target), at(source)), degree))
            .collect();
        self.alone.copy_from(&self.d);
        let mut field = Answers::new(count * coils);
        for _ in 0..coupling.sweeps {
            self.next.copy_from(&self.alone);
            // Neighbours are ordered by the body they excite, so each body responds once to the sum of their fields.
            let mut from = 0;
            while from < self.neighbours.len() {
                let target = self.neighbours[from][0];
                let to = from + self.neighbours[from..].iter().take_while(|pair| pair[0] == target).count();
                field.re.fill(0.0);
                field.im.fill(0.0);
                for (&[_, source], s) in self.neighbours[from..to].iter().zip(&matrices[from..to]) {
                    for (i, j) in (0..count).flat_map(|i| (0..passed_on).map(move |j| (i, j))) {
                        let (to, of) = (i * coils..(i + 1) * coils, source * stride + j * coils);
                        add_multiple(&mut field.re[to.clone()], s[i * count + j], &self.d.re[of..of + coils]);
                        add_multiple(&mut field.im[to], s[i * count + j], &self.d.im[of..of + coils]);
                    }
                }
                for (row, column, value) in self.bodies[target].entries.iter().filter(|entry| entry.1 < count) {
                    let to = target * stride + row * coils..target * stride + (row + 1) * coils;
                    let of = column * coils..(column + 1) * coils;
                    let (out_re, out_im) = (&mut self.next.re[to.clone()], &mut self.next.im[to]);
                    let [re, im] = [value.re, value.im].map(|part| part * (-1.0 / FOUR_PI_MU0));
                    add_multiple(out_re, re, &field.re[of.clone()]);
                    add_multiple(out_re, -im, &field.im[of.clone()]);
                    add_multiple(out_im, im, &field.re[of.clone()]);
                    add_multiple(out_im, re, &field.im[of]);
                }
                from = to;
            }
            std::mem::swap(&mut self.d, &mut self.next);
        }
    }
}

fn add_multiple(to: &mut [f64], factor: f64, of: &[f64]) {
    to.iter_mut().zip(of).for_each(|(to, of)| *to += factor * of);
}
