//! The linear one-step inverse in three forms of the same operator, whichever is cheapest: in model space,
//! `(J'WJ + lambda^2 R)^-1 J'W`; in data space, `P J'(J P J' + lambda^2 W^-1)^-1` with `P = R^-1`, where channels are
//! fewer than unknowns; and `(P J'WJ + lambda^2)^-1 P J'W` where they are more: no matrix of the channels squared, and
//! P, not its inverse, so that smooth covariances need not be inverted.

use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::solvers::{Llt, Solve};
use faer::{Accum, Mat, MatRef, Par, Scale, Side};

use super::reciprocity::ReciprocalColumns;
use super::{InverseError, PriorMatrix, Spectrum, Weighting, check_finite, check_hyperparameter};

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
    alike: ReciprocalColumns,
    form: Form,
}

/// A lambda^2 below this share of the trace of `S P S'` is lost in rounding: the inverse of a matrix of condition 1e14
/// has hardly a digit left.
const LEAST_SQUARE: f64 = 1e-14;
/// What lambda^2 may be at all: what is divided by it is still a number.
const DIVISIBLE: std::ops::Range<f64> = 1e-200..1e200;

/// What each form keeps.
#[derive(Debug)]
enum Form {
    /// A prior that cannot be inverted: nothing beforehand.
    Model,
    /// Channels fewer than unknowns.
    Data(DataForm),
    /// Unknowns fewer than channels.
    Unknowns(UnknownsForm),
}

/// The data form, over groups of channels that see alike: S is the whitened Jacobian with one row a group.
#[derive(Debug)]
struct DataForm {
    /// `P S'`, unknowns x groups.
    spread: Mat<f64>,
    /// `S P S'`, groups x groups; its trace is that of `W^1/2 J P J' W^1/2'`.
    gram: Mat<f64>,
}

/// The form over unknowns.
#[derive(Debug)]
struct UnknownsForm {
    /// P, unknowns x unknowns.
    covariance: Mat<f64>,
    /// `P S'S`, unknowns x unknowns; it has the trace of `S P S'`.
    information: Mat<f64>,
}

/// `(J P J' + lambda^2 W^-1)^-1`, channels x channels: the inverse covariance that prior and noise together give
/// difference data, over lambda^2.
#[derive(Clone, Debug)]
pub enum DataPrecision {
    /// The matrix.
    Whole(Mat<f64>),
    /// Rows are made when asked for, `(W - W J X) / lambda^2` with X the operator (Woodbury): channels outnumber
    /// unknowns, and the matrix would be the largest of all.
    Implied {
        /// W.
        weighting: Weighting,
        /// `J'W`, unknowns x channels.
        weighted: Mat<f64>,
    },
}

/// The operator at one hyperparameter, with what is needed to go on without channels and to say how sure it is.
#[derive(Debug, Clone)]
pub struct Operator {
    /// Unknowns x channels: `x = matrix * dv`.
    pub matrix: Mat<f64>,
    /// `(J P J' + lambda^2 W^-1)^-1`, channels x channels, or what gives its rows.
    pub data_precision: DataPrecision,
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

    /// Eigenvalues of the whitened data-space problem, from which every hyperparameter can be judged cheaply.
    ///
    /// # Errors
    /// The eigenvalue iteration did not converge, or the prior cannot be inverted.
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

    /// `S P S'`, computed anew.
    fn merged_gram(&self) -> Result<Mat<f64>, InverseError> {
        let spread = self.prior.solve(self.sensitivities.as_ref())?;
        Ok(symmetric_product(self.sensitivities.transpose(), spread.as_ref()))
    }

    /// The operator at a hyperparameter.
    ///
    /// # Errors
    /// A hyperparameter that is not positive and finite, or too small to regularise, or a system that is not positive
    /// definite.
    pub fn operator(&self, hyperparameter: f64) -> Result<Operator, InverseError> {
        check_hyperparameter(hyperparameter)?;
        self.check_regularises(hyperparameter)?;
        match &self.form {
            Form::Data(form) => self.data_space(hyperparameter, form),
            Form::Model | Form::Unknowns(_) => self.over_unknowns(hyperparameter),
        }
    }

    /// Refuses a lambda that is lost in the rounding of what it is added to.
    fn check_regularises(&self, lambda: f64) -> Result<(), InverseError> {
        let rounding = match &self.form {
            // Its trace would have to be worked out.
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

    /// By `(S'S + lambda^2 R)^-1 S'`.
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
            // Similar to a symmetric matrix whose eigenvalues are at least lambda^2: regular, though not symmetric.
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

    /// A matrix over groups of channels in whitened data (its columns) to one over channels: W^1/2 from the right,
    /// `(W^1/2' X')'`.
    fn weighted(&self, merged: MatRef<'_, f64>) -> Mat<f64> {
        let mut matrix = self.alike.expanded(merged);
        self.weighting.whiten_adjoint(matrix.transpose_mut());
        matrix
    }

    /// The operator from one over groups of channels in whitened data.
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
