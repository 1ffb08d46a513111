//! The linear one-step inverse in three equivalent forms; the cheapest is used. In model space:
//! `(J'WJ + lambda^2 R)^-1 J'W`. In data space, with fewer channels than unknowns: `P J'(J P J' + lambda^2 W^-1)^-1`
//! with `P = R^-1`. With more channels than unknowns: `(P J'WJ + lambda^2)^-1 P J'W`, which needs no channels x
//! channels matrix and uses P instead of its inverse, so smooth covariances need not be inverted.

use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::solvers::{Llt, Solve};
use faer::{Accum, Mat, MatRef, Par, Scale, Side};

use super::reciprocity::ReciprocalColumns;
use super::{InverseError, PriorMatrix, Spectrum, Weighting, check_finite, check_hyperparameter};

/// Below this many unknowns a singular prior is solved exactly, in model space.
const MODEL_SPACE_LIMIT: usize = 1500;

/// Jacobian, weights and prior, before the choice of a hyperparameter.
#[derive(Debug)]
pub struct LinearProblem {
    pub(super) weighting: Weighting,
    pub(super) prior: PriorMatrix,
    /// `S' = (W^1/2 J)'`, unknowns x groups, with one column per group of channels that have the same sensitivities.
    sensitivities: Mat<f64>,
    /// Groups of channels with the same whitened sensitivities. The complement orthogonal to the groups sees nothing:
    /// in that basis the data-space system is the groups' system, plus `lambda^2` for the complement.
    alike: ReciprocalColumns,
    form: Form,
}

/// Minimum lambda^2 as a share of the trace of `S P S'`. Smaller values vanish in rounding: the inverse of a matrix
/// with condition number 1e14 has hardly a digit left.
const LEAST_SQUARE: f64 = 1e-14;
/// Permitted range of lambda^2, so that quotients by it stay finite.
const DIVISIBLE: std::ops::Range<f64> = 1e-200..1e200;

/// Data stored by each form.
#[derive(Debug)]
enum Form {
    /// A prior that cannot be inverted: nothing precomputed.
    Model,
    /// Fewer channels than unknowns.
    Data(DataForm),
    /// Fewer unknowns than channels.
    Unknowns(UnknownsForm),
}

/// The data form, over groups of channels with the same sensitivities. S is the whitened Jacobian with one row per
/// group.
#[derive(Debug)]
struct DataForm {
    /// `P S'`, unknowns x groups.
    spread: Mat<f64>,
    /// `S P S'`, groups x groups; has the same trace as `W^1/2 J P J' W^1/2'`.
    gram: Mat<f64>,
}

/// The form over unknowns.
#[derive(Debug)]
struct UnknownsForm {
    /// P, unknowns x unknowns.
    covariance: Mat<f64>,
    /// `P S'S`, unknowns x unknowns; has the same trace as `S P S'`.
    information: Mat<f64>,
}

/// `(J P J' + lambda^2 W^-1)^-1`, channels x channels: the inverse covariance of difference data from prior and noise
/// together, divided by lambda^2.
#[derive(Clone, Debug)]
pub enum DataPrecision {
    /// The matrix.
    Whole(Mat<f64>),
    /// Rows are computed on demand as `(W - W J X) / lambda^2` with the operator X (Woodbury). Used if channels
    /// outnumber unknowns, where the matrix would be the largest of all.
    Implied {
        /// W.
        weighting: Weighting,
        /// `J'W`, unknowns x channels.
        weighted: Mat<f64>,
    },
}

/// The operator at one hyperparameter, with the data needed to drop channels and to estimate uncertainty.
#[derive(Debug, Clone)]
pub struct Operator {
    /// Unknowns x channels: `x = matrix * dv`.
    pub matrix: Mat<f64>,
    /// `(J P J' + lambda^2 W^-1)^-1`, channels x channels, or the means to compute its rows.
    pub data_precision: DataPrecision,
    /// lambda.
    pub hyperparameter: f64,
    /// Standard deviation of each unknown caused by noise of covariance `W^-1`.
    pub noise_deviation: Vec<f64>,
}

impl LinearProblem {
    /// Combines Jacobian, weighting and prior.
    ///
    /// # Errors
    /// Mismatched sizes, non-finite values, negative weights, or a prior that cannot be inverted.
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
                let alike = ReciprocalColumns::of_columns(whitened.as_ref());
                let merged = alike.merged(whitened.as_ref());
                (alike, merged)
            }
            Weighting::Identity | Weighting::Diagonal(_) => {
                let alike = ReciprocalColumns::of_scaled_columns(transposed, |channel| weighting.root(channel));
                let merged = alike.merged(transposed);
                (alike, merged)
            }
        };
        let form = Form::new(&prior, &sensitivities)?;
        Ok(Self { weighting, prior, sensitivities, alike, form })
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

    /// Eigenvalues of the whitened data-space problem, which make any hyperparameter cheap to evaluate.
    ///
    /// # Errors
    /// Fails if the eigenvalue iteration does not converge or the prior cannot be inverted.
    pub fn spectrum(&self) -> Result<Spectrum, InverseError> {
        let expand = |gram: MatRef<'_, f64>| Spectrum::new(self.alike.expanded_square(gram, 0.0).as_ref());
        match &self.form {
            Form::Data(form) => expand(form.gram.as_ref()),
            Form::Model | Form::Unknowns(_) => expand(self.merged_gram()?.as_ref()),
        }
    }

    /// Trace of `S P S'`.
    pub(super) fn gram_trace(&self) -> Result<f64, InverseError> {
        let trace = |matrix: &Mat<f64>| matrix.diagonal().column_vector().iter().sum();
        Ok(match &self.form {
            Form::Data(form) => trace(&form.gram),
            Form::Unknowns(form) => trace(&form.information),
            Form::Model => trace(&self.merged_gram()?),
        })
    }

    /// `S P S'`, recomputed.
    fn merged_gram(&self) -> Result<Mat<f64>, InverseError> {
        let spread = self.prior.solve(self.sensitivities.as_ref())?;
        Ok(symmetric_product(self.sensitivities.transpose(), spread.as_ref()))
    }

    /// The operator at a hyperparameter.
    ///
    /// # Errors
    /// Fails if the hyperparameter is not positive and finite or is too small to regularise, or if the system is not
    /// positive definite.
    pub fn operator(&self, hyperparameter: f64) -> Result<Operator, InverseError> {
        check_hyperparameter(hyperparameter)?;
        self.check_regularises(hyperparameter)?;
        match &self.form {
            Form::Data(form) => self.data_space(hyperparameter, form),
            Form::Model | Form::Unknowns(_) => self.over_unknowns(hyperparameter),
        }
    }

    /// Refuses a lambda that vanishes in the rounding of the matrix it is added to.
    fn check_regularises(&self, lambda: f64) -> Result<(), InverseError> {
        let rounding = match &self.form {
            // Its trace would have to be computed.
            Form::Model => 0.0,
            Form::Data(_) | Form::Unknowns(_) => LEAST_SQUARE * self.gram_trace()?,
        };
        let square = lambda * lambda;
        if square > rounding && DIVISIBLE.contains(&square) {
            return Ok(());
        }
        let expected = match square > 1.0 {
            true => "below 1e100",
            false => "large enough to regularise: its square is lost in the rounding of J P J'",
        };
        Err(InverseError::Value { what: "hyperparameter", index: None, value: lambda, expected })
    }

    fn data_space(&self, lambda: f64, form: &DataForm) -> Result<Operator, InverseError> {
        let factor = form.factor(lambda)?;
        let merged_precision = factor.solve(Mat::<f64>::identity(form.gram.nrows(), form.gram.nrows()));
        let merged = &form.spread * &merged_precision;
        let noise_deviation = row_norms(merged.as_ref());
        Ok(self.unmerged(lambda, merged.as_ref(), merged_precision.as_ref(), noise_deviation))
    }

    /// Computes the operator as `(S'S + lambda^2 R)^-1 S'`.
    fn over_unknowns(&self, lambda: f64) -> Result<Operator, InverseError> {
        let merged = self.covariance_over_unknowns(lambda)? * &self.sensitivities;
        let noise_deviation = row_norms(merged.as_ref());
        if self.channels() > self.unknowns() {
            let matrix = self.weighted(merged.as_ref());
            let weighted = self.weighted(self.sensitivities.as_ref());
            let data_precision = DataPrecision::Implied { weighting: self.weighting.clone(), weighted };
            return Ok(Operator { matrix, data_precision, hyperparameter: lambda, noise_deviation });
        }
        // (JPJ' + l^2)^-1 = (1 - J Op) / l^2 in whitened data (Woodbury), which holds for singular R as well.
        let outside = 1.0 / (lambda * lambda);
        let mut precision = Scale(-outside) * (self.sensitivities.transpose() * &merged);
        for k in 0..precision.nrows() {
            precision[(k, k)] += outside;
        }
        Ok(self.unmerged(lambda, merged.as_ref(), precision.as_ref(), noise_deviation))
    }

    /// `(S'S + lambda^2 R)^-1`, which is `(P S'S + lambda^2)^-1 P`.
    fn covariance_over_unknowns(&self, lambda: f64) -> Result<Mat<f64>, InverseError> {
        let squared = lambda * lambda;
        if let Form::Unknowns(form) = &self.form {
            let mut system = form.information.clone();
            for k in 0..system.nrows() {
                system[(k, k)] += squared;
            }
            // Similar to a symmetric matrix with eigenvalues of at least lambda^2, so it is regular though not
            // symmetric.
            return Ok(system.partial_piv_lu().solve(&form.covariance));
        }
        let mut system = symmetric_product(self.sensitivities.as_ref(), self.sensitivities.transpose());
        system += Scale(squared) * self.prior.dense()?;
        let factor = system.llt(Side::Lower).map_err(|_| InverseError::Singular {
            what: "the model-space system",
            hint: "raise the hyperparameter or add some identity to the prior",
        })?;
        Ok(factor.solve(Mat::<f64>::identity(self.unknowns(), self.unknowns())))
    }

    /// Converts a matrix over groups of channels in whitened data (its columns) to one over channels: W^1/2 from the
    /// right, `(W^1/2' X')'`.
    fn weighted(&self, merged: MatRef<'_, f64>) -> Mat<f64> {
        let mut matrix = self.alike.expanded(merged);
        self.weighting.whiten_adjoint(matrix.transpose_mut());
        matrix
    }

    /// Converts an operator over groups of channels in whitened data to one over channels.
    fn unmerged(
        &self,
        lambda: f64,
        merged: MatRef<'_, f64>,
        merged_precision: MatRef<'_, f64>,
        noise_deviation: Vec<f64>,
    ) -> Operator {
        let matrix = self.weighted(merged);
        let mut precision = self.alike.expanded_square(merged_precision, 1.0 / (lambda * lambda));
        self.weighting.whiten_adjoint(precision.as_mut());
        let mut other_side = precision.transpose().to_owned();
        self.weighting.whiten_adjoint(other_side.as_mut());
        let data_precision = DataPrecision::Whole(other_side);
        Operator { matrix, data_precision, hyperparameter: lambda, noise_deviation }
    }

    /// Posterior standard deviation of every unknown: square roots of the diagonal of `(J'WJ + lambda^2 R)^-1`, the
    /// covariance of a Gaussian posterior with noise `W^-1` and prior precision `lambda^2 R` (Tarantola, Inverse
    /// Problem Theory, 2005, eq. 3.37-3.38).
    ///
    /// # Errors
    /// As [`LinearProblem::operator`].
    pub fn posterior_deviation(&self, hyperparameter: f64) -> Result<Vec<f64>, InverseError> {
        if let Form::Data(form) = &self.form {
            let (spread, factor) = (&form.spread, form.factor(hyperparameter)?);
            let explained = factor.solve(spread.transpose());
            let prior = self.prior_variances()?;
            let variance = |k: usize| {
                let reduction: f64 = (0..explained.nrows()).map(|row| spread[(k, row)] * explained[(row, k)]).sum();
                (prior[k] - reduction).max(0.0)
            };
            return Ok((0..self.unknowns()).map(|k| variance(k).sqrt() / hyperparameter).collect());
        }
        let covariance = self.covariance_over_unknowns(hyperparameter)?;
        Ok((0..self.unknowns()).map(|k| covariance[(k, k)].max(0.0).sqrt()).collect())
    }

    /// Diagonal of `P = R^-1`.
    fn prior_variances(&self) -> Result<Vec<f64>, InverseError> {
        Ok(match &self.prior {
            PriorMatrix::Diagonal(values) => values.iter().map(|v| 1.0 / v).collect(),
            PriorMatrix::Covariance(covariance) => (0..covariance.len()).map(|k| covariance.variance(k)).collect(),
            other => {
                let size = other.size();
                let inverse = other.solve(Mat::<f64>::identity(size, size).as_ref())?;
                (0..size).map(|k| inverse[(k, k)]).collect()
            }
        })
    }
}

impl Form {
    fn new(prior: &PriorMatrix, sensitivities: &Mat<f64>) -> Result<Self, InverseError> {
        let (unknowns, groups) = (sensitivities.nrows(), sensitivities.ncols());
        if prior.is_singular() && unknowns <= MODEL_SPACE_LIMIT {
            return Ok(Self::Model);
        }
        if groups > unknowns {
            let covariance = prior.solve(Mat::<f64>::identity(unknowns, unknowns).as_ref())?;
            let information = &covariance * symmetric_product(sensitivities.as_ref(), sensitivities.transpose());
            return Ok(Self::Unknowns(UnknownsForm { covariance, information }));
        }
        let spread = prior.solve(sensitivities.as_ref())?;
        let gram = symmetric_product(sensitivities.transpose(), spread.as_ref());
        Ok(Self::Data(DataForm { spread, gram }))
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
    /// Rows of [`Operator::data_precision`], rows x channels. The channels must exist.
    pub(super) fn precision_rows(&self, rows: &[u32]) -> Mat<f64> {
        match &self.data_precision {
            DataPrecision::Whole(matrix) => {
                Mat::from_fn(rows.len(), matrix.ncols(), |k, column| matrix[(rows[k] as usize, column)])
            }
            DataPrecision::Implied { weighting, weighted } => {
                let of_rows =
                    Mat::from_fn(rows.len(), weighted.nrows(), |k, unknown| weighted[(unknown, rows[k] as usize)]);
                let mut units =
                    Mat::from_fn(
                        weighted.ncols(),
                        rows.len(),
                        |channel, k| {
                            if channel == rows[k] as usize { 1.0 } else { 0.0 }
                        },
                    );
                weighting.whiten(units.as_mut());
                weighting.whiten_adjoint(units.as_mut());
                let difference = units.transpose() - of_rows * &self.matrix;
                Scale(self.hyperparameter.powi(-2)) * difference
            }
        }
    }

    /// `x = matrix * dv`. For frames with missing channels see [`super::MissingChannels`].
    ///
    /// # Errors
    /// A frame of the wrong length or with non-finite values.
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

/// `A B` for a product known to be symmetric; computes only one triangle.
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

/// Checks that every sensitivity is finite.
fn check_jacobian(jacobian: MatRef<'_, f64>) -> Result<(), InverseError> {
    for (channel, row) in jacobian.row_iter().enumerate() {
        // The sum of squares is finite unless a value is not (or is absurdly large), so the search is rarely needed.
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
