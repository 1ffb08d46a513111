//! The linear one-step inverse in model space, `(J'WJ + lambda^2 R)^-1 J'W`, or in data space,
//! `P J'(J P J' + lambda^2 W^-1)^-1` with `P = R^-1`: the same operator, the second cheaper where channels are fewer
//! than unknowns.

use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::solvers::{Llt, Solve};
use faer::{Accum, Mat, MatRef, Par, Scale, Side};

use super::proportional::Proportional;
use super::{Hyperparameter, InverseError, PriorMatrix, Spectrum, Weighting, check_finite};

/// Below this many unknowns a singular prior is solved exactly, in model space.
const MODEL_SPACE_LIMIT: usize = 1500;

/// Jacobian, weights and prior, before a hyperparameter is chosen.
#[derive(Debug)]
pub struct LinearProblem {
    pub(super) weighting: Weighting,
    pub(super) prior: PriorMatrix,
    /// `S' = (W^1/2 J)'` with one column a group of channels that see alike, unknowns x groups.
    sensitivities: Mat<f64>,
    /// Channels that see alike, in whitened data. What is orthogonal to their groups sees nothing: in that basis the
    /// data-space system is one of the groups, and `lambda^2` beside it.
    alike: Proportional,
    /// What the data form is made of; `None` where the model form is used.
    pub(super) data_form: Option<DataForm>,
}

/// The data form, over groups of channels that see alike: S is the whitened Jacobian with one row a group.
#[derive(Debug)]
pub(super) struct DataForm {
    /// `P S'`, unknowns x groups.
    spread: Mat<f64>,
    /// `S P S'`, groups x groups; its trace is that of `W^1/2 J P J' W^1/2'`.
    pub(super) gram: Mat<f64>,
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
        check_jacobian(jacobian)?;
        let transposed = jacobian.transpose();
        let (alike, sensitivities) = match &weighting {
            Weighting::Full(_) => {
                let mut whitened = transposed.to_owned();
                weighting.whiten(whitened.transpose_mut());
                let alike = Proportional::of_columns(whitened.as_ref());
                let merged = alike.merged(whitened.as_ref());
                (alike, merged)
            }
            Weighting::Identity | Weighting::Diagonal(_) => {
                let alike = Proportional::of_scaled_columns(transposed, |channel| weighting.root(channel));
                let merged = alike.merged(transposed);
                (alike, merged)
            }
        };
        let model_space = prior.is_singular() && jacobian.ncols() <= MODEL_SPACE_LIMIT;
        let data_form = if model_space {
            None
        } else {
            let spread = prior.solve(sensitivities.as_ref())?;
            let gram = symmetric_product(sensitivities.transpose(), spread.as_ref());
            Some(DataForm { spread, gram })
        };
        Ok(Self { weighting, prior, sensitivities, alike, data_form })
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.alike.columns()
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.sensitivities.nrows()
    }

    /// `W^1/2 J`, channels x unknowns.
    pub(super) fn whitened(&self) -> Mat<f64> {
        self.alike.expanded(self.sensitivities.as_ref()).transpose().to_owned()
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
        let expand = |gram: MatRef<'_, f64>| Spectrum::new(self.alike.expanded_square(gram, 0.0).as_ref());
        match &self.data_form {
            Some(form) => expand(form.gram.as_ref()),
            None => expand(self.merged_gram()?.as_ref()),
        }
    }

    /// `S P S'`, computed anew.
    pub(super) fn merged_gram(&self) -> Result<Mat<f64>, InverseError> {
        let spread = self.prior.solve(self.sensitivities.as_ref())?;
        Ok(symmetric_product(self.sensitivities.transpose(), spread.as_ref()))
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
        match &self.data_form {
            Some(form) => self.data_space(hyperparameter, form),
            None => self.model_space(hyperparameter),
        }
    }

    fn data_space(&self, lambda: f64, form: &DataForm) -> Result<Operator, InverseError> {
        let factor = form.factor(lambda)?;
        let merged_precision = factor.solve(Mat::<f64>::identity(form.gram.nrows(), form.gram.nrows()));
        let merged = &form.spread * &merged_precision;
        let noise_deviation = row_norms(merged.as_ref());
        Ok(self.unmerged(lambda, merged.as_ref(), merged_precision.as_ref(), noise_deviation))
    }

    fn model_space(&self, lambda: f64) -> Result<Operator, InverseError> {
        let mut system = &self.sensitivities * self.sensitivities.transpose();
        system += Scale(lambda * lambda) * self.prior.dense()?;
        let factor = system.llt(Side::Lower).map_err(|_| InverseError::Singular {
            what: "the model-space system",
            hint: "raise the hyperparameter or add some identity to the prior",
        })?;
        let merged = factor.solve(&self.sensitivities);
        let noise_deviation = row_norms(merged.as_ref());
        // (JPJ' + l^2)^-1 = (1 - J Op) / l^2 in whitened data (Woodbury), which holds for singular R as well.
        let outside = 1.0 / (lambda * lambda);
        let mut precision = Scale(-outside) * (self.sensitivities.transpose() * &merged);
        for k in 0..precision.nrows() {
            precision[(k, k)] += outside;
        }
        Ok(self.unmerged(lambda, merged.as_ref(), precision.as_ref(), noise_deviation))
    }

    /// The operator from one over groups of channels in whitened data.
    fn unmerged(
        &self,
        lambda: f64,
        merged: MatRef<'_, f64>,
        merged_precision: MatRef<'_, f64>,
        noise_deviation: Vec<f64>,
    ) -> Operator {
        // W^1/2 from the right: (W^1/2' X')'.
        let mut matrix = self.alike.expanded(merged);
        self.weighting.whiten_adjoint(matrix.transpose_mut());
        let mut precision = self.alike.expanded_square(merged_precision, 1.0 / (lambda * lambda));
        self.weighting.whiten_adjoint(precision.as_mut());
        let mut data_precision = precision.transpose().to_owned();
        self.weighting.whiten_adjoint(data_precision.as_mut());
        Operator { matrix, data_precision, hyperparameter: lambda, noise_deviation }
    }

    /// Posterior standard deviation of every unknown: square roots of the diagonal of `(J'WJ + lambda^2 R)^-1`, the
    /// covariance of a Gaussian posterior with noise `W^-1` and prior precision `lambda^2 R` (Tarantola, Inverse
    /// Problem Theory, 2005, eq. 3.37-3.38).
    ///
    /// # Errors
    /// As [`LinearProblem::operator`].
    pub fn posterior_deviation(&self, hyperparameter: f64) -> Result<Vec<f64>, InverseError> {
        if let Some(form) = &self.data_form {
            let (spread, factor) = (&form.spread, form.factor(hyperparameter)?);
            let explained = factor.solve(spread.transpose());
            let prior = self.prior_variances()?;
            let variance = |k: usize| {
                let reduction: f64 = (0..explained.nrows()).map(|row| spread[(k, row)] * explained[(row, k)]).sum();
                (prior[k] - reduction).max(0.0)
            };
            return Ok((0..self.unknowns()).map(|k| variance(k).sqrt() / hyperparameter).collect());
        }
        let mut system = &self.sensitivities * self.sensitivities.transpose();
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

impl DataForm {
    /// Cholesky factor of `S P S' + lambda^2`.
    fn factor(&self, lambda: f64) -> Result<Llt<f64>, InverseError> {
        let mut system = self.gram.clone();
        for k in 0..system.nrows() {
            system[(k, k)] += lambda * lambda;
        }
        system
            .llt(Side::Lower)
            .map_err(|_| InverseError::Singular { what: "the data-space system", hint: "raise the hyperparameter" })
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

/// Every sensitivity a finite number.
fn check_jacobian(jacobian: MatRef<'_, f64>) -> Result<(), InverseError> {
    for (channel, row) in jacobian.row_iter().enumerate() {
        // The square is finite unless a value is not (or is absurd); the value is looked for only then.
        let square = row * row.transpose();
        if let (false, Some(value)) = (square.is_finite(), row.iter().find(|value| !value.is_finite())) {
            let (what, index) = ("Jacobian", Some(channel));
            return Err(InverseError::Value { what, index, value: *value, expected: "finite" });
        }
    }
    Ok(())
}

fn row_norms(matrix: MatRef<'_, f64>) -> Vec<f64> {
    let mut sums = vec![0.0; matrix.nrows()];
    for column in matrix.col_iter() {
        sums.iter_mut().zip(column.iter()).for_each(|(sum, value)| *sum += value * value);
    }
    sums.into_iter().map(f64::sqrt).collect()
}
