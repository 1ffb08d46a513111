//! The complex-symmetric system of edge elements, and its solution for many sources at once by conjugate orthogonal conjugate
//! gradients (van der Vorst and Melissen, IEEE Trans. Magn. 26, 1990, 706), preconditioned by a real sparse Cholesky factor of
//! the sum of the system's real and imaginary part.

use faer::Mat;

use crate::mit::{Complex, MitError};
use crate::sparse::{Ordering, SparseError, SpdFactor, SpdStructure};

/// `(real + j imaginary) x = b`, both matrices sparse, symmetric and positive semidefinite.
#[derive(Debug)]
pub(super) struct System {
    structure: SpdStructure,
    factor: SpdFactor,
    /// Row and column of each entry of the lower triangle.
    entries: Vec<[u32; 2]>,
    real: Vec<f64>,
    imaginary: Vec<f64>,
}

/// Entries while they are gathered.
#[derive(Debug, Default)]
pub(super) struct Gather {
    pub(super) positions: Vec<(u32, u32)>,
    pub(super) real: Vec<f64>,
    pub(super) imaginary: Vec<f64>,
}

/// Residual, relative to the right-hand side, at which a solution is taken.
const RESIDUAL: f64 = 1e-9;
/// Steps at most.
const MOST_STEPS: usize = 400;

impl System {
    pub(super) fn new(places: &[[f64; 3]], gather: Gather) -> Result<Self, SparseError> {
        let (structure, slots) = SpdStructure::new(places.len(), &gather.positions, Ordering::Dissection(places))?;
        let count = structure.value_count();
        let (mut real, mut imaginary) = (vec![0.0; count], vec![0.0; count]);
        let mut entries = vec![[0; 2]; count];
        for (k, slot) in slots.iter().enumerate() {
            let slot = *slot as usize;
            real[slot] += gather.real[k];
            imaginary[slot] += gather.imaginary[k];
            let (row, column) = gather.positions[k];
            entries[slot] = [row.max(column), row.min(column)];
        }
        let sum: Vec<f64> = real.iter().zip(&imaginary).map(|(a, b)| a + b).collect();
        let factor = structure.factor(&sum)?;
        Ok(Self { structure, factor, entries, real, imaginary })
    }

    pub(super) fn size(&self) -> usize {
        self.structure.size()
    }

    /// Bytes of the factor.
    pub(super) fn factor_bytes(&self) -> usize {
        8 * self.structure.factor_len()
    }

    /// Solves for all columns; pairs of columns are real and imaginary parts. Also the steps taken.
    pub(super) fn solve(&self, right: &Mat<f64>) -> Result<(Mat<f64>, usize), MitError> {
        let sources = right.ncols() / 2;
        let (mut x, mut r) = (Mat::zeros(right.nrows(), right.ncols()), right.clone());
        let norms: Vec<f64> = (0..sources).map(|k| column_norm(right, k)).collect();
        let mut z = r.clone();
        self.structure.solve_in_place(&self.factor, z.as_mut());
        let mut p = z.clone();
        let mut rho: Vec<Complex> = (0..sources).map(|k| product(&r, &z, k)).collect();
        for step in 1..=MOST_STEPS {
            let q = self.multiply(&p);
            let mut done = true;
            for k in 0..sources {
                let alpha = over(rho[k], product(&p, &q, k));
                add_scaled(&mut x, alpha, &p, k);
                add_scaled(&mut r, -alpha, &q, k);
                done &= column_norm(&r, k) <= RESIDUAL * norms[k];
            }
            if done {
                return Ok((x, step));
            }
            z.copy_from(&r);
            self.structure.solve_in_place(&self.factor, z.as_mut());
            for k in 0..sources {
                let next = product(&r, &z, k);
                let beta = over(next, rho[k]);
                rho[k] = next;
                // p = z + beta p.
                for row in 0..p.nrows() {
                    let old = Complex::new(p[(row, 2 * k)], p[(row, 2 * k + 1)]);
                    let new = Complex::new(z[(row, 2 * k)], z[(row, 2 * k + 1)]) + beta * old;
                    (p[(row, 2 * k)], p[(row, 2 * k + 1)]) = (new.re, new.im);
                }
            }
        }
        let worst = (0..sources).map(|k| column_norm(&r, k) / norms[k].max(f64::MIN_POSITIVE)).fold(0.0, f64::max);
        Err(MitError::Value { field: "residual of the edge-element solution", value: worst, expected: "below 1e-9" })
    }

    /// The complex matrix times all columns.
    fn multiply(&self, x: &Mat<f64>) -> Mat<f64> {
        let width = x.ncols();
        // Row by row, so that one entry meets all sources at once.
        let mut rows = vec![0.0; x.nrows() * width];
        for (column, values) in x.col_iter().enumerate() {
            values.iter().enumerate().for_each(|(row, value)| rows[row * width + column] = *value);
        }
        let mut sums = vec![0.0; rows.len()];
        for (&[row, column], (re, im)) in self.entries.iter().zip(self.real.iter().zip(&self.imaginary)) {
            let (row, column) = (row as usize * width, column as usize * width);
            for k in (0..width).step_by(2) {
                let (a, b) = (rows[column + k], rows[column + k + 1]);
                sums[row + k] += re * a - im * b;
                sums[row + k + 1] += re * b + im * a;
            }
            if row != column {
                for k in (0..width).step_by(2) {
                    let (a, b) = (rows[row + k], rows[row + k + 1]);
                    sums[column + k] += re * a - im * b;
                    sums[column + k + 1] += re * b + im * a;
                }
            }
        }
        Mat::from_fn(x.nrows(), width, |row, column| sums[row * width + column])
    }
}

/// `a / b`, zero where there is nothing left to divide.
fn over(a: Complex, b: Complex) -> Complex {
    if b.norm_sqr() > 0.0 { a / b } else { Complex::new(0.0, 0.0) }
}

/// `a' b` without conjugation, of one source.
fn product(a: &Mat<f64>, b: &Mat<f64>, source: usize) -> Complex {
    let (ar, ai) = (a.col(2 * source), a.col(2 * source + 1));
    let (br, bi) = (b.col(2 * source), b.col(2 * source + 1));
    Complex::new(ar.transpose() * br - ai.transpose() * bi, ar.transpose() * bi + ai.transpose() * br)
}

fn column_norm(a: &Mat<f64>, source: usize) -> f64 {
    a.col(2 * source).norm_l2().hypot(a.col(2 * source + 1).norm_l2())
}

fn add_scaled(x: &mut Mat<f64>, factor: Complex, p: &Mat<f64>, source: usize) {
    for row in 0..x.nrows() {
        let value = factor * Complex::new(p[(row, 2 * source)], p[(row, 2 * source + 1)]);
        x[(row, 2 * source)] += value.re;
        x[(row, 2 * source + 1)] += value.im;
    }
}
