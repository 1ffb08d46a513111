//! The inverse expert's regression on more examples than can be solved exactly: y = k(f) a with a on m landmarks
//! among the n examples. Snelson & Ghahramani (2006), with the notation of Quinonero-Candela & Rasmussen (2005),
//! section 6:
//!
//! V = L^-1 K_mn, K_mm = L L', q_i = |V_i|^2, s_i = r + t (1 - q_i), a = L^-T (I + V S^-1 V')^-1 V S^-1 y,
//!
//! where 1 - q_i is the variance of example i that the landmarks cannot explain. With t = 1 such an example has less
//! weight (FITC), so that slightly more examples than landmarks do no harm. With t = 0 all have equal weight (a
//! subset of regressors). Leaving example i out divides its residual by 1 - h_i, h_i = V_i' (I + V S^-1 V')^-1 V_i /
//! s_i.
//!
//! Memory is three matrices of m x m and two of m x 1,000; time is 2 n m^2 + 2 m^3 operations.

use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Accum, Mat, Par, Side};

use crate::locator::error::LocatorError;
use crate::locator::rows::{dot, matern52};

/// Number of examples whose correlations are computed at a time.
const BLOCK: usize = 1000;
/// Values to try adding to the diagonal of the landmarks' correlations, smallest first. Single precision leaves that
/// matrix slightly indefinite.
const JITTERS: [f64; 4] = [1e-6, 1e-5, 1e-4, 1e-3];

/// Kernel and noise of the regression.
#[derive(Debug, Clone, Copy)]
pub(super) struct Kernel {
    /// Length of the Matern 5/2 correlation.
    pub length: f64,
    /// r: noise variance, relative to the kernel's.
    pub ridge: f64,
    /// t: share of the variance unexplained by the landmarks that counts as noise.
    pub unsaid: f64,
}

/// Result of the regression on the landmarks.
#[derive(Debug)]
pub(super) struct Learnt {
    /// a, for x and y.
    pub weights: Vec<[f64; 2]>,
    /// Target of each landmark minus its prediction without it.
    pub left_out: Vec<[f64; 2]>,
}

/// Fits `targets` of all `rows`; `landmarks` are indices of rows.
pub(super) fn learn(
    rows: &[Vec<f32>],
    targets: &[[f64; 2]],
    landmarks: &[usize],
    kernel: Kernel,
) -> Result<Learnt, LocatorError> {
    let singular = LocatorError::Singular { what: "kernel between the examples" };
    let m = landmarks.len();
    let correlations = Correlations::new(rows, landmarks, kernel.length);
    let among = correlations.with(rows, landmarks);
    let factored = JITTERS.iter().find_map(|jitter| {
        let own = |i: usize, j: usize| 0.5 * (among[(i, j)] + among[(j, i)]) + if i == j { *jitter } else { 0.0 };
        Mat::from_fn(m, m, own).llt(Side::Lower).ok()
    });
    let factor = factored.ok_or_else(|| singular.clone())?.L().to_owned();
    let mut normal = Mat::<f64>::identity(m, m);
    let mut right = Mat::<f64>::zeros(m, 2);
    let all: Vec<usize> = (0..rows.len()).collect();
    for block in all.chunks(BLOCK) {
        let mut v = correlations.with(rows, block);
        solve_lower_triangular_in_place(factor.as_ref(), v.as_mut(), Par::Seq);
        let mut y = Mat::<f64>::zeros(block.len(), 2);
        for (c, &i) in block.iter().enumerate() {
            let column = v.col_as_slice_mut(c);
            let said = column.iter().map(|v| v * v).sum::<f64>();
            let scale = (kernel.ridge + kernel.unsaid * (1.0 - said).max(0.0)).sqrt().recip();
            column.iter_mut().for_each(|v| *v *= scale);
            (y[(c, 0)], y[(c, 1)]) = (targets[i][0] * scale, targets[i][1] * scale);
        }
        right += &v * &y;
        triangular::matmul(
            normal.as_mut(),
            BlockStructure::TriangularLower,
            Accum::Add,
            v.as_ref(),
            BlockStructure::Rectangular,
            v.transpose(),
            BlockStructure::Rectangular,
            1.0,
            Par::Seq,
        );
    }
    let solved = normal.llt(Side::Lower).map_err(|_| singular)?.L().to_owned();
    solve_lower_triangular_in_place(solved.as_ref(), right.as_mut(), Par::Seq);
    // V of the landmarks, and their residuals with and without each landmark.
    let mut own = factor.transpose().to_owned();
    let scales: Vec<f64> = (0..m)
        .map(|j| {
            let said = own.col_as_slice(j).iter().map(|v| v * v).sum::<f64>();
            kernel.ridge + kernel.unsaid * (1.0 - said).max(0.0)
        })
        .collect();
    solve_lower_triangular_in_place(solved.as_ref(), own.as_mut(), Par::Seq);
    let left_out = (0..m)
        .map(|j| {
            let column = own.col_as_slice(j);
            let hat = column.iter().map(|v| v * v).sum::<f64>() / scales[j];
            let fitted = |axis: usize| column.iter().zip(right.col_as_slice(axis)).map(|(v, w)| v * w).sum::<f64>();
            [0, 1].map(|axis| (targets[landmarks[j]][axis] - fitted(axis)) / (1.0 - hat).max(1e-3))
        })
        .collect();
    solve_upper_triangular_in_place(solved.transpose(), right.as_mut(), Par::Seq);
    solve_upper_triangular_in_place(factor.transpose(), right.as_mut(), Par::Seq);
    Ok(Learnt { weights: (0..m).map(|j| [right[(j, 0)], right[(j, 1)]]).collect(), left_out })
}

/// Computes correlations with landmarks.
struct Correlations {
    /// Components: rank by landmarks.
    landmarks: Mat<f32>,
    squares: Vec<f32>,
    inverse_length: f32,
}

impl Correlations {
    fn new(rows: &[Vec<f32>], landmarks: &[usize], length: f64) -> Self {
        Self {
            landmarks: columns(rows, landmarks),
            squares: landmarks.iter().map(|&i| dot(&rows[i], &rows[i])).collect(),
            inverse_length: 1.0 / length as f32,
        }
    }

    /// Correlations of the landmarks (rows) with some examples (columns).
    fn with(&self, rows: &[Vec<f32>], some: &[usize]) -> Mat<f64> {
        let mut single = self.landmarks.transpose() * columns(rows, some);
        for (c, &i) in some.iter().enumerate() {
            let (column, own) = (single.col_as_slice_mut(c), dot(&rows[i], &rows[i]));
            column.iter_mut().zip(&self.squares).for_each(|(v, square)| *v = (own + square - 2.0 * *v).max(0.0));
            matern52(column, self.inverse_length);
        }
        Mat::from_fn(self.squares.len(), some.len(), |j, c| f64::from(single[(j, c)]))
    }
}

/// Some rows as the columns of a matrix.
fn columns(rows: &[Vec<f32>], some: &[usize]) -> Mat<f32> {
    Mat::from_fn(rows[0].len(), some.len(), |r, c| rows[some[c]][r])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn made_up(n: usize) -> (Vec<Vec<f32>>, Vec<[f64; 2]>) {
        let scattered = |i: usize, k: usize| ((i * 131 + k) as f64 * 12.9898).sin() * 43_758.545_3 % 1.0;
        let rows: Vec<Vec<f32>> = (0..n).map(|i| (0..3).map(|k| scattered(i, k) as f32).collect()).collect();
        let targets = rows.iter().map(|row| [f64::from(row[0] * row[1]).sin(), f64::from(row[2]).cos()]).collect();
        (rows, targets)
    }

    fn matern52(a: &[f32], b: &[f32], length: f64) -> f64 {
        let s = (5.0 * a.iter().zip(b).map(|(x, y)| f64::from(x - y).powi(2)).sum::<f64>()).sqrt() / length;
        (1.0 + s + s * s / 3.0) * (-s).exp()
    }

    /// If every example is a landmark, this is kernel ridge regression for any t: the weights are (K + r I)^-1 y, and
    /// a left-out residual is its weight over the diagonal of the inverse (Rasmussen & Williams 2006, section 5.4.2).
    /// Any difference comes from single-precision correlations, which are accurate to about 1e-6.
    #[test]
    fn landmarks_everywhere_are_the_exact_regression() {
        let n = 40;
        let (rows, targets) = made_up(n);
        let kernel = Kernel { length: 0.8, ridge: 0.05, unsaid: 0.5 };
        let all: Vec<usize> = (0..n).collect();
        let learnt = learn(&rows, &targets, &all, kernel).expect("can be solved");
        let covariance =
            Mat::from_fn(n, n, |i, j| matern52(&rows[i], &rows[j], 0.8) + if i == j { kernel.ridge } else { 0.0 });
        let inverse = faer::linalg::solvers::DenseSolveCore::inverse(&covariance.llt(Side::Lower).expect("definite"));
        for i in 0..n {
            for axis in 0..2 {
                let weight: f64 = (0..n).map(|j| inverse[(i, j)] * targets[j][axis]).sum();
                let left_out = weight / inverse[(i, i)];
                assert!((learnt.left_out[i][axis] - left_out).abs() < 1e-4, "{i}: {:?}", learnt.left_out[i]);
                assert!((learnt.weights[i][axis] - weight).abs() < 1e-3, "{i}: {:?}", learnt.weights[i]);
            }
        }
    }

    /// Repeated examples give a kernel without full rank.
    #[test]
    fn identical_landmarks_are_tolerated() {
        let (mut rows, targets) = made_up(60);
        let first = rows[0].clone();
        rows[1..30].iter_mut().for_each(|row| row.clone_from(&first));
        let landmarks: Vec<usize> = (0..60).step_by(2).collect();
        let kernel = Kernel { length: 0.8, ridge: 1e-4, unsaid: 0.5 };
        let learnt = learn(&rows, &targets, &landmarks, kernel).expect("can be solved");
        let sound = |v: &[f64; 2]| v.iter().all(|v| v.is_finite());
        assert!(learnt.weights.iter().all(sound) && learnt.left_out.iter().all(sound), "{learnt:?}");
    }
}
