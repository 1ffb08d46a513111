//! Total variation: `min |W^1/2 (J x - dv)|^2 + lambda^2 sum_e sqrt((x_a - x_b)^2 + beta^2)` over neighbouring
//! unknowns, by lagged diffusivity (Vogel and Oman, SIAM J. Sci. Comput. 17, 1996): each sweep is a quadratic problem
//! with the edge weights of the previous sweep. Edges stay sharp where one-step priors blur them. For recordings
//! rather than live frames.

use faer::MatRef;

use super::{ImageBasis, InverseError, LinearProblem, PriorMatrix, Weighting};

/// Parameters of the iteration.
#[derive(Clone, Debug, PartialEq)]
pub struct TotalVariation {
    /// lambda.
    pub hyperparameter: f64,
    /// Smoothing of the corner at zero, relative to the range of the first image (1e-2 is customary).
    pub relative_beta: f64,
    /// Maximum number of sweeps.
    pub max_sweeps: usize,
    /// Stop when the relative change of the image falls below this.
    pub tolerance: f64,
}

/// Result of the iteration.
#[derive(Clone, Debug, PartialEq)]
pub struct TotalVariationResult {
    /// The image, one value per unknown.
    pub image: Vec<f64>,
    /// Number of sweeps made.
    pub sweeps: usize,
    /// Relative change in the last sweep.
    pub last_change: f64,
}

impl Default for TotalVariation {
    fn default() -> Self {
        Self { hyperparameter: 1e-2, relative_beta: 1e-2, max_sweeps: 12, tolerance: 1e-3 }
    }
}

impl TotalVariation {
    /// Reconstructs one frame.
    ///
    /// # Errors
    /// As [`LinearProblem::operator`].
    pub fn solve(
        &self,
        jacobian: MatRef<'_, f64>,
        weighting: &Weighting,
        basis: &ImageBasis,
        dv: &[f64],
    ) -> Result<TotalVariationResult, InverseError> {
        let mut image = vec![0.0; jacobian.ncols()];
        let mut weights = vec![1.0; basis.neighbours.len()];
        let mut last_change = f64::INFINITY;
        let mut beta = None;
        for sweep in 0..self.max_sweeps.max(1) {
            let prior = weighted_laplacian(basis, &weights);
            let problem = LinearProblem::new(jacobian, weighting.clone(), prior)?;
            let next = problem.operator(self.hyperparameter)?.apply(dv)?;
            last_change = relative_change(&image, &next);
            image = next;
            if sweep > 0 && last_change < self.tolerance {
                return Ok(TotalVariationResult { image, sweeps: sweep + 1, last_change });
            }
            let beta = *beta.get_or_insert_with(|| (self.relative_beta * range(&image)).max(1e-300));
            for (weight, &[a, b]) in weights.iter_mut().zip(&basis.neighbours) {
                let jump = image[a as usize] - image[b as usize];
                *weight = 0.5 / (jump * jump + beta * beta).sqrt();
            }
        }
        Ok(TotalVariationResult { image, sweeps: self.max_sweeps.max(1), last_change })
    }
}

fn weighted_laplacian(basis: &ImageBasis, weights: &[f64]) -> PriorMatrix {
    let entries = basis
        .neighbours
        .iter()
        .zip(weights)
        .flat_map(|(&[a, b], &w)| [(a, a, w), (b, b, w), (a.max(b), a.min(b), -w)])
        .collect();
    PriorMatrix::Sparse { size: basis.len(), entries, positions: basis.positions.clone() }
}

fn relative_change(old: &[f64], new: &[f64]) -> f64 {
    let difference: f64 = old.iter().zip(new).map(|(a, b)| (a - b) * (a - b)).sum();
    let size: f64 = new.iter().map(|v| v * v).sum();
    (difference / size.max(1e-300)).sqrt()
}

fn range(values: &[f64]) -> f64 {
    let (low, high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &v| (l.min(v), h.max(v)));
    high - low
}
