//! Priors, hyperparameters and one-step operators.

use std::sync::Arc;

use dermis_tomo::inverse::{Hyperparameter, ImageBasis, LinearProblem, MOST_NESTED, Operator, Prior, Weighting};
use faer::{Mat, MatRef};
use pyo3::prelude::*;

use super::mesh::PyMesh;
use crate::arrays::{Array1, Array2, ArrayDyn, Doubles, array1, array2, shape_text};
use crate::errors::{Fault, Kind};
use crate::hints::{ArrayLike, Rule};
use crate::work::run_sized;

/// Prior knowledge of an image.
#[pyclass(frozen, module = "dermis.eit", name = "Prior")]
pub struct PyPrior {
    prior: Prior,
    /// Nesting depth of mixtures.
    depth: usize,
}

#[pymethods]
impl PyPrior {
    /// R = I.
    #[staticmethod]
    fn identity() -> Self {
        Self { prior: Prior::Identity, depth: 0 }
    }

    /// Twice the graph Laplacian over shared faces, as in EIDORS.
    #[staticmethod]
    fn laplace() -> Self {
        Self { prior: Prior::Laplace, depth: 0 }
    }

    /// R = diag(J'J)^exponent.
    #[staticmethod]
    #[pyo3(signature = (exponent=0.5))]
    fn noser(exponent: f64) -> Self {
        Self { prior: Prior::Noser { exponent }, depth: 0 }
    }

    /// Covariance exp(-d^2 / (2 l^2)) of elements at distance d, with l in metres.
    #[staticmethod]
    fn gaussian(correlation_length_m: f64) -> Self {
        Self { prior: Prior::Gaussian { correlation_length_m }, depth: 0 }
    }

    /// The covariance of :meth:`gaussian`, balanced by sensitivity.
    ///
    /// Parameters
    /// ----------
    /// correlation_length_m : float
    ///     The length l, metres.
    /// exponent : float
    ///     Strength of the balancing; 0 is none.
    ///
    /// Returns
    /// -------
    /// Prior
    #[staticmethod]
    #[pyo3(signature = (correlation_length_m, exponent=1.0))]
    fn balanced(correlation_length_m: f64, exponent: f64) -> Self {
        Self { prior: Prior::GaussianNoser { correlation_length_m, exponent }, depth: 0 }
    }

    /// A weighted sum, given as pairs of weight and prior.
    #[staticmethod]
    fn mixture(parts: Vec<(f64, Bound<'_, PyPrior>)>) -> PyResult<Self> {
        let depth = 1 + parts.iter().map(|(_, prior)| prior.get().depth).max().unwrap_or(0);
        if depth > MOST_NESTED {
            let expected = format!("mixtures of mixtures at most {MOST_NESTED} deep");
            return Err(Fault::input("parts", expected, depth).into());
        }
        let parts = parts.iter().map(|(weight, prior)| (*weight, prior.get().prior.clone())).collect();
        Ok(Self { prior: Prior::Mixture(parts), depth })
    }

    fn __repr__(&self) -> String {
        format!("<dermis.eit.Prior: {:?}>", self.prior)
    }
}

/// A number, or the name of a rule with its number.
fn rule_of(value: &Bound<'_, PyAny>, signal: Option<&Bound<'_, PyAny>>) -> PyResult<Hyperparameter> {
    if let Ok(number) = value.extract::<f64>() {
        return Ok(Hyperparameter::Number(number));
    }
    let refused = || {
        let expected = "a number, \"l-curve\", \"gcv\", (\"relative\", factor), (\"noise-figure\", target) with signal=, \
                        or (\"known-noise\", factor)";
        PyErr::from(Fault::input("hyperparameter", expected, value))
    };
    if let Ok(name) = value.extract::<String>() {
        return match name.as_str() {
            "l-curve" => Ok(Hyperparameter::LCurve),
            "gcv" => Ok(Hyperparameter::Gcv),
            _ => Err(refused()),
        };
    }
    let (name, number): (String, f64) = value.extract().map_err(|_| refused())?;
    match name.as_str() {
        "relative" => Ok(Hyperparameter::Relative(number)),
        "known-noise" => Ok(Hyperparameter::KnownNoise { factor: number }),
        "noise-figure" => {
            let signal =
                signal.ok_or_else(|| Fault::input("signal", "difference data of a small target", "nothing"))?;
            Ok(Hyperparameter::NoiseFigure {
                target: number,
                signal: Doubles::of("signal", signal)?.values()?.to_vec(),
            })
        }
        _ => Err(refused()),
    }
}

/// One-step inverse ``x = (J'WJ + lambda^2 R)^-1 J'W dv``. Called with differences, shape (k,) or (n, k), it returns
/// changes, shape (m,) or (n, m).
///
/// Parameters
/// ----------
/// jacobian : array_like
///     J, shape (k, m).
/// prior : Prior
///     R.
/// hyperparameter : float, str or tuple
///     The number lambda, which enters squared, or a rule: ``"l-curve"``, ``"gcv"``, ``("relative", factor)``,
///     ``("noise-figure", target)``, ``("known-noise", factor)``.
/// mesh : Mesh, optional
///     The elements, for priors that use neighbours or distances.
/// noise : array_like, optional
///     Standard deviations, shape (k,), or a covariance, shape (k, k); W is its inverse.
/// data : array_like, optional
///     Difference data for the rules, shape (n, k).
/// signal : array_like, optional
///     Difference data of a small target, for the noise figure, shape (k,).
#[pyclass(frozen, module = "dermis.eit", name = "Operator")]
pub struct PyOperator {
    problem: Arc<LinearProblem>,
    operator: Arc<Operator>,
}

/// Standard deviations of the channels' noise, or its covariance.
enum Noise {
    None,
    Deviations(Vec<f64>),
    Covariance(Vec<f64>),
}

/// Matrices of channels x unknowns, and square matrices of the smaller dimension, in memory at once.
const MATRICES: f64 = 6.0;
const SYSTEMS: f64 = 4.0;

/// Numbers stored for a prior over all unknowns, and operations for computing it.
fn prior_numbers(prior: &Prior, unknowns: f64) -> f64 {
    match prior {
        Prior::Identity | Prior::Noser { .. } | Prior::Laplace => 20.0 * unknowns,
        Prior::Gaussian { .. } | Prior::GaussianNoser { .. } => 2.0 * unknowns * unknowns,
        Prior::Mixture(_) => 3.0 * unknowns * unknowns,
    }
}

fn prior_operations(prior: &Prior, unknowns: f64) -> f64 {
    match prior {
        Prior::Identity | Prior::Noser { .. } | Prior::Laplace => 100.0 * unknowns,
        Prior::Gaussian { .. } | Prior::GaussianNoser { .. } => 30.0 * unknowns * unknowns,
        Prior::Mixture(_) => unknowns.powi(3),
    }
}

impl PyOperator {
    fn channels(&self) -> usize {
        self.operator.matrix.ncols()
    }

    /// Approximate number of operations for one solution.
    fn operations(&self) -> f64 {
        let (rows, columns) = (self.operator.matrix.nrows() as f64, self.operator.matrix.ncols() as f64);
        4.0 * rows * columns * rows.min(columns)
    }
}

#[pymethods]
impl PyOperator {
    #[new]
    #[pyo3(signature = (jacobian, prior, hyperparameter, *, mesh=None, noise=None, data=None, signal=None))]
    fn new(
        py: Python<'_>,
        jacobian: ArrayLike<'_>,
        prior: &Bound<'_, PyPrior>,
        hyperparameter: Rule<'_>,
        mesh: Option<&Bound<'_, PyMesh>>,
        noise: Option<ArrayLike<'_>>,
        data: Option<ArrayLike<'_>>,
        signal: Option<ArrayLike<'_>>,
    ) -> PyResult<Self> {
        let jacobian = Doubles::of("jacobian", &jacobian)?.finite("jacobian")?;
        let &[channels, unknowns] = jacobian.shape() else {
            return Err(Fault::input("jacobian", "shape (channels, elements)", shape_text(jacobian.shape())).into());
        };
        if channels == 0 || unknowns == 0 {
            return Err(
                Fault::input("jacobian", "at least one channel and element", shape_text(jacobian.shape())).into()
            );
        }
        let noise = match noise {
            None => Noise::None,
            Some(noise) => {
                let noise = Doubles::of("noise", &noise)?;
                match noise.shape() {
                    [length] if *length == channels => Noise::Deviations(noise.values()?.to_vec()),
                    [rows, columns] if *rows == channels && *columns == channels => {
                        Noise::Covariance(noise.values()?.to_vec())
                    }
                    shape => {
                        let expected = format!(
                            "deviations of shape ({channels},) or a covariance of shape ({channels}, {channels})"
                        );
                        return Err(Fault::input("noise", expected, shape_text(shape)).into());
                    }
                }
            }
        };
        let mesh = match mesh {
            Some(mesh) => Some(Arc::clone(&mesh.get().mesh)),
            None if matches!(prior.get().prior, Prior::Identity | Prior::Noser { .. }) => None,
            None => return Err(Fault::input("mesh", "the mesh of the elements, which this prior needs", "None").into()),
        };
        let data = match data {
            Some(data) => Doubles::rows("data", &data, channels, "one difference per channel")?.0.to_rows()?,
            None => Vec::new(),
        };
        let rule = rule_of(&hyperparameter, signal.as_deref())?;
        let (prior, values) = (prior.get().prior.clone(), jacobian.values()?.to_vec());
        let (rows, columns) = (channels as f64, unknowns as f64);
        let smaller = rows.min(columns);
        let operations = 4.0 * rows * columns * smaller + prior_operations(&prior, columns) + rows.powi(2);
        let (problem, operator) = run_sized(py, "operator", operations, move || {
            let bytes =
                8.0 * (MATRICES * rows * columns + SYSTEMS * smaller * smaller + prior_numbers(&prior, columns));
            dermis_tomo::memory::check(bytes, || format!("an operator of {channels} channels x {unknowns} unknowns"))
                .map_err(|error| Fault::new(Kind::Input, error.to_string()))?;
            let weighting = match noise {
                Noise::None => Weighting::Identity,
                Noise::Deviations(deviations) => Weighting::from_standard_deviations(&deviations)?,
                Noise::Covariance(values) => {
                    Weighting::from_covariance(MatRef::from_row_major_slice(&values, channels, channels))?
                }
            };
            let basis = match mesh {
                Some(mesh) => ImageBasis::of_elements(&mesh),
                None => ImageBasis { positions: vec![[0.0; 3]; unknowns], neighbours: Vec::new() },
            };
            let matrix = MatRef::from_row_major_slice(&values, channels, unknowns);
            let prior = prior.matrix(matrix, &weighting, &basis)?;
            let problem = LinearProblem::new(matrix, weighting, prior)?;
            let lambda = problem.choose(&rule, &data)?;
            let operator = problem.operator(lambda)?;
            Ok((Arc::new(problem), Arc::new(operator)))
        })?;
        Ok(Self { problem, operator })
    }

    /// lambda.
    #[getter]
    fn hyperparameter(&self) -> f64 {
        self.operator.hyperparameter
    }

    /// The matrix, shape (elements, channels).
    #[getter]
    fn matrix<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        let matrix: &Mat<f64> = &self.operator.matrix;
        let (rows, columns) = (matrix.nrows(), matrix.ncols());
        let mut values = Vec::with_capacity(rows * columns);
        for row in 0..rows {
            values.extend((0..columns).map(|column| matrix[(row, column)]));
        }
        array2(py, values, rows, columns)
    }

    /// Standard deviation of every unknown due to the noise, shape (elements,).
    #[getter]
    fn noise_deviation<'py>(&self, py: Python<'py>) -> Array1<'py, f64> {
        array1(py, self.operator.noise_deviation.clone())
    }

    /// Posterior standard deviation of every unknown, shape (elements,).
    fn posterior_deviation<'py>(&self, py: Python<'py>) -> PyResult<Array1<'py, f64>> {
        let (lambda, problem) = (self.operator.hyperparameter, Arc::clone(&self.problem));
        let operations = self.operations();
        let work = move || Ok(problem.posterior_deviation(lambda)?);
        Ok(array1(py, run_sized(py, "deviations", operations, work)?))
    }

    /// The same problem with another hyperparameter.
    ///
    /// Parameters
    /// ----------
    /// hyperparameter : float, str or tuple
    ///     A number or a rule.
    /// data : array_like, optional
    ///     Shape (n, k): difference data for the rules.
    /// signal : array_like, optional
    ///     Shape (k,): difference data of a small target, for the noise figure.
    ///
    /// Returns
    /// -------
    /// Operator
    #[pyo3(signature = (hyperparameter, *, data=None, signal=None))]
    fn at(
        &self,
        py: Python<'_>,
        hyperparameter: Rule<'_>,
        data: Option<ArrayLike<'_>>,
        signal: Option<ArrayLike<'_>>,
    ) -> PyResult<Self> {
        let data = match data {
            Some(data) => Doubles::rows("data", &data, self.channels(), "one difference per channel")?.0.to_rows()?,
            None => Vec::new(),
        };
        let rule = rule_of(&hyperparameter, signal.as_deref())?;
        let (problem, operations) = (Arc::clone(&self.problem), self.operations());
        let work = move || Ok(problem.operator(problem.choose(&rule, &data)?)?);
        let operator = run_sized(py, "operator", operations, work)?;
        Ok(Self { problem: self.problem.clone(), operator: Arc::new(operator) })
    }

    fn __call__<'py>(&self, py: Python<'py>, differences: ArrayLike<'py>) -> PyResult<ArrayDyn<'py, f64>> {
        let (rows, single) = Doubles::rows("differences", &differences, self.channels(), "one difference per channel")?;
        let rows = rows.finite("differences")?;
        let (channels, unknowns) = (self.channels(), self.operator.matrix.nrows());
        let (values, operator) = (rows.values()?.to_vec(), Arc::clone(&self.operator));
        let count = values.len() / channels.max(1);
        let operations = 2.0 * count as f64 * channels as f64 * unknowns as f64;
        let images = run_sized(py, "images", operations, move || {
            let data = MatRef::from_row_major_slice(&values, count, channels);
            let images = &operator.matrix * data.transpose();
            Ok((0..count * unknowns).map(|at| images[(at % unknowns, at / unknowns)]).collect::<Vec<f64>>())
        })?;
        if single {
            return Ok(array1(py, images).into_dyn());
        }
        Ok(array2(py, images, count, unknowns)?.into_dyn())
    }

    fn __repr__(&self) -> String {
        let matrix = &self.operator.matrix;
        format!(
            "<dermis.eit.Operator: {} channels to {} unknowns, lambda {:.6e}>",
            matrix.ncols(),
            matrix.nrows(),
            self.operator.hyperparameter
        )
    }
}
