//! The conjugate orthogonal conjugate gradient method (van der Vorst and Melissen, IEEE Trans. Magn. 26, 1990) for complex
//! symmetric systems, several right-hand sides at once, preconditioned by a real Cholesky factor. With `K + M` of
//! `K + j M` factored, all eigenvalues lie on an arc between 1 and j: a few dozen iterations whatever the mesh.

use super::super::{Complex, MitError};
use crate::sparse::{COMPLEX_LANES, LANES, SpdFactor, SpdStructure};

/// Norm of the residual over that of the right-hand side at which the iteration ends.
const TOLERANCE: f64 = 1e-8;
/// Iterations after which it is given up.
const MOST: usize = 200;

/// A complex symmetric matrix and the factor of a real one like it.
#[derive(Debug)]
pub(super) struct Preconditioned {
    pub(super) structure: SpdStructure,
    pub(super) real: Vec<f64>,
    pub(super) imaginary: Vec<f64>,
    pub(super) factor: SpdFactor,
}

type Lanes = [f64; LANES];

impl Preconditioned {
    /// Solves for all right-hand sides; gives the solutions and the most iterations that any took.
    pub(super) fn solve(&self, sides: &[Vec<Complex>]) -> Result<(Vec<Vec<Complex>>, usize), MitError> {
        let (mut solutions, mut most) = (Vec::with_capacity(sides.len()), 0);
        for chunk in sides.chunks(COMPLEX_LANES) {
            let mut residual = vec![[0.0; LANES]; self.structure.size()];
            for (lane, side) in chunk.iter().enumerate() {
                for (to, from) in residual.iter_mut().zip(side) {
                    (to[lane], to[lane + COMPLEX_LANES]) = (from.re, from.im);
                }
            }
            let (x, iterations) = self.solve_chunk(residual)?;
            most = most.max(iterations);
            let of_lane = |lane| x.iter().map(|x| Complex::new(x[lane], x[lane + COMPLEX_LANES])).collect();
            solutions.extend((0..chunk.len()).map(of_lane));
        }
        Ok((solutions, most))
    }

    fn solve_chunk(&self, mut residual: Vec<Lanes>) -> Result<(Vec<Lanes>, usize), MitError> {
        let size = residual.len();
        let start = norms(&residual);
        let mut x = vec![[0.0; LANES]; size];
        let mut z = residual.clone();
        self.structure.solve_lanes(&self.factor, &mut z);
        let mut direction = z.clone();
        let mut product = vec![[0.0; LANES]; size];
        let mut rho = products(&residual, &z);
        for iteration in 0..MOST {
            let now = norms(&residual);
            let live: [bool; COMPLEX_LANES] = std::array::from_fn(|lane| now[lane] > TOLERANCE * start[lane]);
            if !live.contains(&true) {
                return Ok((x, iteration));
            }
            self.structure.multiply_complex_lanes(&self.real, &self.imaginary, &direction, &mut product);
            let curvature = products(&direction, &product);
            let alpha = quotients(&rho, &curvature, &live);
            accumulate(&mut x, &alpha, &direction);
            accumulate(&mut residual, &alpha.map(|a| -a), &product);
            z.copy_from_slice(&residual);
            self.structure.solve_lanes(&self.factor, &mut z);
            let next = products(&residual, &z);
            let beta = quotients(&next, &rho, &live);
            rho = next;
            accumulate(&mut z, &beta, &direction);
            std::mem::swap(&mut z, &mut direction);
        }
        let now = norms(&residual);
        let residual = (0..COMPLEX_LANES)
            .filter(|&lane| start[lane] > 0.0)
            .map(|lane| now[lane] / start[lane])
            .fold(0.0, |worst: f64, r| if r.is_nan() { r } else { worst.max(r) });
        Err(MitError::NotConverged { iterations: MOST, residual, tolerance: TOLERANCE })
    }
}

/// Quotients where the lane is live, zero elsewhere.
fn quotients(
    a: &[Complex; COMPLEX_LANES],
    b: &[Complex; COMPLEX_LANES],
    live: &[bool; COMPLEX_LANES],
) -> [Complex; COMPLEX_LANES] {
    std::array::from_fn(|lane| if live[lane] { a[lane] / b[lane] } else { Complex::new(0.0, 0.0) })
}

/// Products without conjugation.
fn products(a: &[Lanes], b: &[Lanes]) -> [Complex; COMPLEX_LANES] {
    let mut sums = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        for lane in 0..COMPLEX_LANES {
            let imaginary = lane + COMPLEX_LANES;
            sums[lane] += a[lane] * b[lane] - a[imaginary] * b[imaginary];
            sums[imaginary] += a[lane] * b[imaginary] + a[imaginary] * b[lane];
        }
    }
    std::array::from_fn(|lane| Complex::new(sums[lane], sums[lane + COMPLEX_LANES]))
}

fn norms(a: &[Lanes]) -> [f64; COMPLEX_LANES] {
    let mut sums = [0.0; LANES];
    a.iter().for_each(|a| (0..LANES).for_each(|lane| sums[lane] += a[lane] * a[lane]));
    std::array::from_fn(|lane| (sums[lane] + sums[lane + COMPLEX_LANES]).sqrt())
}

/// `to += factor * from`.
fn accumulate(to: &mut [Lanes], factor: &[Complex; COMPLEX_LANES], from: &[Lanes]) {
    for (to, from) in to.iter_mut().zip(from) {
        for lane in 0..COMPLEX_LANES {
            let (re, im) = (from[lane], from[lane + COMPLEX_LANES]);
            to[lane] += factor[lane].re * re - factor[lane].im * im;
            to[lane + COMPLEX_LANES] += factor[lane].re * im + factor[lane].im * re;
        }
    }
}
