//! The conjugate orthogonal conjugate gradient method (van der Vorst and Melissen, IEEE Trans. Magn. 26, 1990) for
//! complex symmetric systems, for several right-hand sides at once, preconditioned by a real Cholesky factor. If the
//! system is `K + j M` and `K + M` is factored, all eigenvalues lie on an arc between 1 and j, so a few dozen
//! iterations suffice on any mesh.

use crate::error::MitError;
use crate::vector::Complex;
use dermis_tomo::sparse::{SpdFactor, SpdStructure};

/// Norm of the residual, relative to the right-hand side, at which the iteration ends.
const TOLERANCE: f64 = 1e-8;
/// Maximum number of iterations.
const MOST: usize = 200;

/// A complex symmetric matrix and the factor of a similar real one.
#[derive(Debug)]
pub(super) struct Preconditioned {
    pub(super) structure: SpdStructure,
    pub(super) real: Vec<f64>,
    pub(super) imaginary: Vec<f64>,
    pub(super) factor: SpdFactor,
}

/// Maximum number of complex right-hand sides solved together.
const TOGETHER: usize = 8;

type Solutions = (Vec<Vec<Complex>>, usize);

impl Preconditioned {
    /// Solves for all right-hand sides; returns the solutions and the largest number of iterations.
    pub(super) fn solve(&self, sides: &[Vec<Complex>]) -> Result<Solutions, MitError> {
        let (mut solutions, mut most) = (Vec::with_capacity(sides.len()), 0);
        for chunk in sides.chunks(TOGETHER) {
            let (found, iterations) = match chunk.len() {
                1 => self.solve_chunk::<2>(chunk)?,
                2 => self.solve_chunk::<4>(chunk)?,
                3 | 4 => self.solve_chunk::<8>(chunk)?,
                _ => self.solve_chunk::<16>(chunk)?,
            };
            most = most.max(iterations);
            solutions.extend(found);
        }
        Ok((solutions, most))
    }

    /// Solves up to W/2 right-hand sides. The first half of the lanes holds real parts, the second half imaginary
    /// parts.
    fn solve_chunk<const W: usize>(&self, sides: &[Vec<Complex>]) -> Result<Solutions, MitError> {
        let half = W / 2;
        let mut residual = vec![[0.0; W]; self.structure.size()];
        for (lane, side) in sides.iter().enumerate() {
            for (to, from) in residual.iter_mut().zip(side) {
                (to[lane], to[lane + half]) = (from.re, from.im);
            }
        }
        let (x, iterations) = self.iterate(residual)?;
        let of_lane = |lane: usize| x.iter().map(|x| Complex::new(x[lane], x[lane + half])).collect();
        Ok(((0..sides.len()).map(of_lane).collect(), iterations))
    }

    fn iterate<const W: usize>(&self, mut residual: Vec<[f64; W]>) -> Result<(Vec<[f64; W]>, usize), MitError> {
        let size = residual.len();
        let start = norms(&residual);
        let mut x = vec![[0.0; W]; size];
        let mut z = residual.clone();
        self.structure.solve_lanes(&self.factor, &mut z);
        let mut direction = z.clone();
        let mut product = vec![[0.0; W]; size];
        let mut rho = products(&residual, &z);
        for iteration in 0..MOST {
            let now = norms(&residual);
            let live: [bool; W] = std::array::from_fn(|lane| now[lane] > TOLERANCE * start[lane]);
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
        let residual = (0..W / 2)
            .filter(|&lane| start[lane] > 0.0)
            .map(|lane| now[lane] / start[lane])
            .fold(0.0, |worst: f64, r| if r.is_nan() { r } else { worst.max(r) });
        Err(MitError::NotConverged { iterations: MOST, residual, tolerance: TOLERANCE })
    }
}

/// Complex quotients in live lanes, zero elsewhere.
fn quotients<const W: usize>(a: &[f64; W], b: &[f64; W], live: &[bool; W]) -> [f64; W] {
    let half = W / 2;
    let mut all = [0.0; W];
    for lane in (0..half).filter(|&lane| live[lane]) {
        let quotient = Complex::new(a[lane], a[lane + half]) / Complex::new(b[lane], b[lane + half]);
        (all[lane], all[lane + half]) = (quotient.re, quotient.im);
    }
    all
}

/// Products without conjugation.
fn products<const W: usize>(a: &[[f64; W]], b: &[[f64; W]]) -> [f64; W] {
    let half = W / 2;
    let mut sums = [0.0; W];
    for (a, b) in a.iter().zip(b) {
        for lane in 0..half {
            sums[lane] += a[lane] * b[lane] - a[lane + half] * b[lane + half];
            sums[lane + half] += a[lane] * b[lane + half] + a[lane + half] * b[lane];
        }
    }
    sums
}

/// Norms of the complex vectors in the first half, zero in the second.
fn norms<const W: usize>(a: &[[f64; W]]) -> [f64; W] {
    let mut sums = [0.0; W];
    a.iter().for_each(|a| (0..W).for_each(|lane| sums[lane] += a[lane] * a[lane]));
    std::array::from_fn(|lane| if lane < W / 2 { (sums[lane] + sums[lane + W / 2]).sqrt() } else { 0.0 })
}

/// `to += factor * from`.
fn accumulate<const W: usize>(to: &mut [[f64; W]], factor: &[f64; W], from: &[[f64; W]]) {
    let half = W / 2;
    for (to, from) in to.iter_mut().zip(from) {
        for lane in 0..half {
            let (re, im) = (from[lane], from[lane + half]);
            to[lane] += factor[lane] * re - factor[lane + half] * im;
            to[lane + half] += factor[lane] * im + factor[lane + half] * re;
        }
    }
}
