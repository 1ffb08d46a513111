//! Eigenvalues of the whitened data-space matrix `W^1/2 J P J' W^1/2'`: one decomposition serves every candidate for
//! lambda.

use faer::{Mat, MatRef, Side};

use super::InverseError;

/// Candidates per search: 10 per decade over 12 decades below the largest eigenvalue.
const CANDIDATES: usize = 121;
const DECADES: f64 = 12.0;

/// One point of the L-curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LCurvePoint {
    /// lambda.
    pub hyperparameter: f64,
    /// Norm of the whitened residual.
    pub residual: f64,
    /// `sqrt(x'Rx)`.
    pub solution: f64,
}

/// Eigenvalues and eigenvectors of the whitened data-space matrix.
#[derive(Debug)]
pub struct Spectrum {
    values: Vec<f64>,
    vectors: Mat<f64>,
}

impl Spectrum {
    pub(super) fn new(gram: MatRef<'_, f64>) -> Result<Self, InverseError> {
        let decomposition = gram.self_adjoint_eigen(Side::Lower).map_err(|_| InverseError::Singular {
            what: "the data-space matrix (its eigenvalues were not found)",
            hint: "look for channels of vastly different scale",
        })?;
        let values = decomposition.S().column_vector().iter().map(|value| value.max(0.0)).collect();
        Ok(Self { values, vectors: decomposition.U().to_owned() })
    }

    /// Components of whitened data along the eigenvectors.
    pub(super) fn components(&self, whitened: &[f64]) -> Vec<f64> {
        let column = faer::ColRef::from_slice(whitened);
        (self.vectors.transpose() * column).iter().copied().collect()
    }

    pub(super) fn candidates(&self) -> Vec<f64> {
        let largest = self.values.iter().copied().fold(0.0, f64::max);
        let step = DECADES / (CANDIDATES - 1) as f64;
        (0..CANDIDATES).map(|k| (largest * 10f64.powf(1.0 - k as f64 * step)).sqrt()).collect()
    }

    pub(super) fn residual_squared(&self, components: &[f64], lambda: f64) -> f64 {
        let l2 = lambda * lambda;
        self.values.iter().zip(components).map(|(s, c)| (l2 / (s + l2) * c).powi(2)).sum()
    }

    fn solution_squared(&self, components: &[f64], lambda: f64) -> f64 {
        let l2 = lambda * lambda;
        self.values.iter().zip(components).map(|(s, c)| s * (c / (s + l2)).powi(2)).sum()
    }

    /// The L-curve of whitened difference data.
    pub fn l_curve(&self, whitened: &[f64]) -> Vec<LCurvePoint> {
        let components = self.components(whitened);
        let point = |hyperparameter: f64| LCurvePoint {
            hyperparameter,
            residual: self.residual_squared(&components, hyperparameter).sqrt(),
            solution: self.solution_squared(&components, hyperparameter).sqrt(),
        };
        self.candidates().into_iter().map(point).collect()
    }

    /// The GCV function at lambda: `n |residual|^2 / trace(residual matrix)^2`, summed over frames by the caller.
    pub(super) fn gcv(&self, components: &[f64], lambda: f64) -> f64 {
        let l2 = lambda * lambda;
        let trace: f64 = self.values.iter().map(|s| l2 / (s + l2)).sum();
        self.values.len() as f64 * self.residual_squared(components, lambda) / (trace * trace)
    }
}
