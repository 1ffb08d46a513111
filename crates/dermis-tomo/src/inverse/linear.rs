//! The linear one-step inverse in model space, `(J'WJ + lambda^2 R)^-1 J'W`, or in data space,
//! `P J'(J P J' + lambda^2 W^-1)^-1` with `P = R^-1`: the same operator, the second cheaper where channels are fewer
//! than unknowns.

use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::solvers::Solve;
use faer::{Accum, Mat, MatRef, Par, Scale, Side};

use super::{Hyperparameter, InverseError, PriorMatrix, Spectrum, Weighting, check_finite};

/// Below this many unknowns a singular prior is solved exactly, in model space.
const MODEL_SPACE_LIMIT: usize = 1500;

/// Jacobian, weights and prior, before a hyperparameter is chosen.
#[derive(Debug)]
pub struct LinearProblem {
    pub(super) weighting: Weighting,
    pub(super) prior: PriorMatrix,
    /// `(W^1/2 J)'`, unknowns x channels: what one channel sees lies together, as in [`crate::eit::Jacobian`].
    sensitivities: Mat<f64>,
    /// `P (W^1/2 J)'`, unknowns x channels; `None` where the model form is used.
    pub(super) spread: Option<Mat<f64>>,
    /// `W^1/2 J P J' W^1/2'`, channels x channels, with `spread`.
    pub(super) gram: Option<Mat<f64>>,
}

/// The operator at one hyperparameter, with what is needed to go on without channels and to say how sure it is.
#[derive(Debug, Clone)]
pub struct Operator {
    /// Unknowns x channels: `x = matrix * dv`.
    pub matrix: Mat<f64>,
    /// `(J P J' + lambda^2 W^-1)^-1`, channels x channels.
    pub data_precision: Mat<f64>,
    /// lambda.
    pub hyperparameter: f64,
    /// Standard deviation of each unknown caused by noise of covariance `W^-1`.
    pub noise_deviation: Vec<f64>,
}

impl LinearProblem {
    /// Brings the parts together.
    ///
    /// # Errors
    /// Sizes that disagree, values that are not finite, negative weights, or a prior that cannot be inverted.
    pub fn new(jacobian: MatRef<'_, f64>, weighting: Weighting, prior: PriorMatrix) -> Result<Self, InverseError> {
        if prior.size() != jacobian.ncols() {
            return Err(InverseError::Size {
                what: "size of the prior",
                expected: jacobian.ncols(),
                got: prior.size(),
            });
        }
        weighting.check(jacobian.nrows())?;
        for (channel, row) in jacobian.row_iter().enumerate() {
            if let Some(value) = row.iter().find(|value| !value.is_finite()) {
                let (what, index) = ("Jacobian", Some(channel));
                return Err(InverseError::Value { what, index, value: *value, expected: "finite" });
            }
        }
        let mut sensitivities = jacobian.transpose().to_owned();
        weighting.whiten(sensitivities.transpose_mut());
        let model_space = prior.is_singular() && jacobian.ncols() <= MODEL_SPACE_LIMIT;
        let (mut spread, mut gram) = (None, None);
        if !model_space {
            let p = prior.solve(sensitivities.as_ref())?;
            gram = Some(symmetric_product(sensitivities.transpose(), p.as_ref()));
            spread = Some(p);
        }
        Ok(Self { weighting, prior, sensitivities, spread, gram })
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.sensitivities.ncols()
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.sensitivities.nrows()
    }

    /// `W^1/2 J`, channels x unknowns.
    pub(super) fn whitened(&self) -> MatRef<'_, f64> {
        self.sensitivities.transpose()
    }

    /// Chooses the hyperparameter by the rule given; `data` (difference data of example frames) is needed by the rules
    /// that look at data.
    ///
    /// # Errors
    /// See [`Hyperparameter`].
    pub fn choose(&self, rule: &Hyperparameter, data: &[Vec<f64>]) -> Result<f64, InverseError> {
        rule.choose(self, data)
    }

    /// Eigenvalues of the whitened data-space problem, from which every hyperparameter can be judged cheaply.
    ///
    /// # Errors
    /// The eigenvalue iteration did not converge, or the prior cannot be inverted.
    pub fn spectrum(&self) -> Result<Spectrum, InverseError> {
        match &self.gram {
            Some(gram) => Spectrum::new(gram.as_ref()),
            None => {
                let spread = self.prior.solve(self.sensitivities.as_ref())?;
                Spectrum::new(symmetric_product(self.whitened(), spread.as_ref()).as_ref())
            }
        }
    }

    /// The operator at a hyperparameter.
    ///
    /// # Errors
    /// A hyperparameter that is not positive and finite, or a system that is not positive definite.
    pub fn operator(&self, hyperparameter: f64) -> Result<Operator, InverseError> {
        if !(hyperparameter > 0.0 && hyperparameter.is_finite()) {
            return Err(InverseError::Value {
                what: "hyperparameter",
                index: None,
                value: hyperparameter,
                expected: "positive and finite",
            });
        }
        match (&self.spread, &self.gram) {
            (Some(spread), Some(gram)) => self.data_space(hyperparameter, spread, gram),
            _ => self.model_space(hyperparameter),
        }
    }

    fn data_space(&self, lambda: f64, spread: &Mat<f64>, gram: &Mat<f64>) -> Result<Operator, InverseError> {
        let mut system = gram.clone();
        for k in 0..system.nrows() {
            system[(k, k)] += lambda * lambda;
        }
        let factor = system
            .llt(Side::Lower)
            .map_err(|_| InverseError::Singular { what: "the data-space system", hint: "raise the hyperparameter" })?;
        let mut precision = factor.solve(Mat::<f64>::identity(system.nrows(), system.nrows()));
        // Operator in whitened data, then W^1/2 from the right: (W^1/2' X')'.
        let mut matrix = spread * &precision;
        let noise_deviation = row_norms(matrix.as_ref());
        self.weighting.whiten_adjoint(matrix.transpose_mut());
        self.weighting.whiten_adjoint(precision.as_mut());
        let mut other_side = precision.transpose().to_owned();
        self.weighting.whiten_adjoint(other_side.as_mut());
        Ok(Operator { matrix, data_precision: other_side, hyperparameter: lambda, noise_deviation })
    }

    fn model_space(&self, lambda: f64) -> Result<Operator, InverseError> {
        let mut system = &self.sensitivities * self.whitened();
        system += Scale(lambda * lambda) * self.prior.dense()?;
        let factor = system.llt(Side::Lower).map_err(|_| InverseError::Singular {
            what: "the model-space system",
            hint: "raise the hyperparameter or add some identity to the prior",
        })?;
        let mut matrix = factor.solve(&self.sensitivities);
        let noise_deviation = row_norms(matrix.as_ref());
        // (JPJ' + l^2)^-1 = (1 - J Op) / l^2 in whitened data (Woodbury), which holds for singular R as well.
        let mut precision = Scale(-1.0 / (lambda * lambda)) * (self.whitened() * &matrix);
        for k in 0..precision.nrows() {
            precision[(k, k)] += 1.0 / (lambda * lambda);
        }
        self.weighting.whiten_adjoint(matrix.transpose_mut());
        self.weighting.whiten_adjoint(precision.as_mut());
        let mut other_side = precision.transpose().to_owned();
        self.weighting.whiten_adjoint(other_side.as_mut());
        Ok(Operator { matrix, data_precision: other_side, hyperparameter: lambda, noise_deviation })
    }

    /// Posterior standard deviation of every unknown: square roots of the diagonal of `(J'WJ + lambda^2 R)^-1`, the
    /// covariance of a Gaussian posterior with noise `W^-1` and prior precision `lambda^2 R` (Tarantola, Inverse
    /// Problem Theory, 2005, eq. 3.37-3.38).
    ///
    /// # Errors
    /// As [`LinearProblem::operator`].
    pub fn posterior_deviation(&self, hyperparameter: f64) -> Result<Vec<f64>, InverseError> {
        if let (Some(spread), Some(gram)) = (&self.spread, &self.gram) {
            let mut system = gram.clone();
            for k in 0..system.nrows() {
                system[(k, k)] += hyperparameter * hyperparameter;
            }
            let factor = system.llt(Side::Lower).map_err(|_| InverseError::Singular {
                what: "the data-space system",
                hint: "raise the hyperparameter",
            })?;
            let explained = factor.solve(spread.transpose());
            let prior = self.prior_variances()?;
            let variance = |k: usize| {
                let reduction: f64 = (0..explained.nrows()).map(|row| spread[(k, row)] * explained[(row, k)]).sum();
                (prior[k] - reduction).max(0.0)
            };
            return Ok((0..self.unknowns()).map(|k| variance(k).sqrt() / hyperparameter).collect());
        }
        let mut system = &self.sensitivities * self.whitened();
        system += Scale(hyperparameter * hyperparameter) * self.prior.dense()?;
        let factor = system
            .llt(Side::Lower)
            .map_err(|_| InverseError::Singular { what: "the model-space system", hint: "raise the hyperparameter" })?;
        let covariance = factor.solve(Mat::<f64>::identity(self.unknowns(), self.unknowns()));
        Ok((0..self.unknowns()).map(|k| covariance[(k, k)].max(0.0).sqrt()).collect())
    }

    /// Diagonal of `P = R^-1`.
    fn prior_variances(&self) -> Result<Vec<f64>, InverseError> {
        Ok(match &self.prior {
            PriorMatrix::Diagonal(values) => values.iter().map(|v| 1.0 / v).collect(),
            PriorMatrix::Covariance(matrix) => (0..matrix.nrows()).map(|k| matrix[(k, k)]).collect(),
            other => {
                let size = other.size();
                let inverse = other.solve(Mat::<f64>::identity(size, size).as_ref())?;
                (0..size).map(|k| inverse[(k, k)]).collect()
            }
        })
    }
}

impl Operator {
    /// `x = matrix * dv`. Frames with missing channels: see [`super::MissingChannels`].
    ///
    /// # Errors
    /// A frame of the wrong length or with values that are not finite.
    pub fn apply(&self, dv: &[f64]) -> Result<Vec<f64>, InverseError> {
        if dv.len() != self.matrix.ncols() {
            return Err(InverseError::Size {
                what: "channels of the frame",
                expected: self.matrix.ncols(),
                got: dv.len(),
            });
        }
        check_finite("channel", dv)?;
        let column = faer::ColRef::from_slice(dv);
        Ok((&self.matrix * column).iter().copied().collect())
    }
}

/// `A B` for a product known to be symmetric: only one triangle is computed.
fn symmetric_product(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Mat<f64> {
    let mut product = Mat::zeros(a.nrows(), b.ncols());
    triangular::matmul(
        product.as_mut(),
        BlockStructure::TriangularLower,
        Accum::Replace,
        a,
        BlockStructure::Rectangular,
        b,
        BlockStructure::Rectangular,
        1.0,
        Par::Seq,
    );
    for column in 0..product.ncols() {
        for row in 0..column {
            product[(row, column)] = product[(column, row)];
        }
    }
    product
}

fn row_norms(matrix: MatRef<'_, f64>) -> Vec<f64> {
    let mut sums = vec![0.0; matrix.nrows()];
    for column in matrix.col_iter() {
        sums.iter_mut().zip(column.iter()).for_each(|(sum, value)| *sum += value * value);
    }
    sums.into_iter().map(f64::sqrt).collect()
}
