//! Priors, hyperparameters and one-step operators.

use std::sync::Arc;

use dermis::tomo::inverse::{Hyperparameter, ImageBasis, LinearProblem, Operator, Prior, Weighting};
use faer::{Mat, MatRef};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

use super::mesh::PyMesh;
use crate::arrays::{Doubles, array1, array2, shape_text};
use crate::errors::Fault;
use crate::work::run;

/// What is known of an image beforehand.
#[pyclass(frozen, module = "dermis.eit", name = "Prior")]
pub struct PyPrior {
    prior: Prior,
}

#[pymethods]
impl PyPrior {
    /// R = I.
    #[staticmethod]
    fn identity() -> Self {
        Self { prior: Prior::Identity }
    }

    /// Twice the graph Laplacian over shared faces, as EIDORS has it.
    #[staticmethod]
    fn laplace() -> Self {
        Self { prior: Prior::Laplace }
    }

    /// R = diag(J'J)^exponent.
    #[staticmethod]
    #[pyo3(signature = (exponent=0.5))]
    fn noser(exponent: f64) -> Self {
        Self { prior: Prior::Noser { exponent } }
    }

    /// Covariance exp(-d^2 / (2 l^2)) of elements a distance d apart, with l in metres.
    #[staticmethod]
    fn gaussian(correlation_length_m: f64) -> Self {
        Self { prior: Prior::Gaussian { correlation_length_m } }
    }

    /// The covariance of :meth:`gaussian`, balanced by sensitivity.
    ///
    /// Parameters
    /// ----------
    /// correlation_length_m : float
    ///     The length l, metres.
    /// exponent : float
    ///     How far: 0 is none.
    ///
    /// Returns
    /// -------
    /// Prior
    #[staticmethod]
    #[pyo3(signature = (correlation_length_m, exponent=1.0))]
    fn balanced(correlation_length_m: f64, exponent: f64) -> Self {
        Self { prior: Prior::GaussianNoser { correlation_length_m, exponent } }
    }

    /// A weighted sum: pairs of weight and prior.
    #[staticmethod]
    fn mixture(parts: Vec<(f64, Bound<'_, PyPrior>)>) -> Self {
        let parts = parts.iter().map(|(weight, prior)| (*weight, prior.get().prior.clone())).collect();
        Self { prior: Prior::Mixture(parts) }
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

/// One-step inverse ``x = (J'WJ + lambda^2 R)^-1 J'W dv``; called with differences, shape (k,) or (n, k), it gives
/// changes, shape (m,) or (n, m).
///
/// Parameters
/// ----------
/// jacobian : array_like
///     J, shape (k, m).
/// prior : Prior
///     R.
/// hyperparameter : float, str or tuple
///     The number lambda, which enters squared, or a rule: ``"l-curve"``, ``"gcv"``, ``("relative", factor)``, ``("noise-figure",
///     target)``, ``("known-noise", factor)``.
/// mesh : Mesh, optional
///     The elements, for priors that know neighbours or distances.
/// noise : array_like, optional
///     Standard deviations, shape (k,), or a covariance, shape (k, k): W is its inverse.
/// data : array_like, optional
///     Difference data that rules look at, shape (n, k).
/// signal : array_like, optional
///     Difference data of a small target, for the noise figure, shape (k,).
#[pyclass(frozen, module = "dermis.eit", name = "Operator")]
pub struct PyOperator {
    problem: Arc<LinearProblem>,
    operator: Operator,
}

impl PyOperator {
    fn channels(&self) -> usize {
        self.operator.matrix.ncols()
    }
}

#[pymethods]
impl PyOperator {
    #[new]
    #[pyo3(signature = (jacobian, prior, hyperparameter, *, mesh=None, noise=None, data=None, signal=None))]
    fn new(
        py: Python<'_>,
        jacobian: &Bound<'_, PyAny>,
        prior: &Bound<'_, PyPrior>,
        hyperparameter: &Bound<'_, PyAny>,
        mesh: Option<&Bound<'_, PyMesh>>,
        noise: Option<&Bound<'_, PyAny>>,
        data: Option<&Bound<'_, PyAny>>,
        signal: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let jacobian = Doubles::of("jacobian", jacobian)?.finite("jacobian")?;
        let &[channels, unknowns] = jacobian.shape() else {
            return Err(Fault::input("jacobian", "shape (channels, elements)", shape_text(jacobian.shape())).into());
        };
        if channels == 0 || unknowns == 0 {
            return Err(
                Fault::input("jacobian", "at least one channel and element", shape_text(jacobian.shape())).into()
            );
        }
        let weighting = match noise {
            None => Weighting::Identity,
            Some(noise) => {
                let noise = Doubles::of("noise", noise)?;
                match noise.shape() {
                    [length] if *length == channels => {
                        Weighting::from_standard_deviations(noise.values()?).map_err(Fault::from)?
                    }
                    [rows, columns] if *rows == channels && *columns == channels => {
                        let covariance = MatRef::from_row_major_slice(noise.values()?, channels, channels);
                        Weighting::from_covariance(covariance).map_err(Fault::from)?
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
        let basis = match mesh {
            Some(mesh) => ImageBasis::of_elements(&mesh.get().mesh),
            None if matches!(prior.get().prior, Prior::Identity | Prior::Noser { .. }) => {
                ImageBasis { positions: vec![[0.0; 3]; unknowns], neighbours: Vec::new() }
            }
            None => return Err(Fault::input("mesh", "the mesh of the elements, which this prior needs", "None").into()),
        };
        let data = match data {
            Some(data) => Doubles::rows("data", data, channels, "one difference a channel")?.0.to_rows()?,
            None => Vec::new(),
        };
        let rule = rule_of(hyperparameter, signal)?;
        let (prior, values) = (&prior.get().prior, jacobian.values()?);
        let (problem, operator) = run(py, || {
            let matrix = MatRef::from_row_major_slice(values, channels, unknowns);
            let prior = prior.matrix(matrix, &weighting, &basis)?;
            let problem = LinearProblem::new(matrix, weighting, prior)?;
            let lambda = problem.choose(&rule, &data)?;
            let operator = problem.operator(lambda)?;
            Ok((Arc::new(problem), operator))
        })?;
        Ok(Self { problem, operator })
    }

    /// lambda.
    #[getter]
    fn hyperparameter(&self) -> f64 {
        self.operator.hyperparameter
    }

    /// Shape (elements, channels).
    #[getter]
    fn matrix<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let matrix: &Mat<f64> = &self.operator.matrix;
        let (rows, columns) = (matrix.nrows(), matrix.ncols());
        let mut values = Vec::with_capacity(rows * columns);
        for row in 0..rows {
            values.extend((0..columns).map(|column| matrix[(row, column)]));
        }
        array2(py, values, rows, columns)
    }

    /// Deviation of every unknown caused by the noise, shape (elements,).
    #[getter]
    fn noise_deviation<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        array1(py, self.operator.noise_deviation.clone())
    }

    /// Deviation of every unknown given the data, shape (elements,).
    fn posterior_deviation<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let lambda = self.operator.hyperparameter;
        Ok(array1(py, run(py, || Ok(self.problem.posterior_deviation(lambda)?))?))
    }

    /// The same problem at another hyperparameter.
    ///
    /// Parameters
    /// ----------
    /// hyperparameter : float, str or tuple
    ///     A number or a rule.
    /// data : array_like, optional
    ///     Shape (n, k): difference data that rules look at.
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
        hyperparameter: &Bound<'_, PyAny>,
        data: Option<&Bound<'_, PyAny>>,
        signal: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let data = match data {
            Some(data) => Doubles::rows("data", data, self.channels(), "one difference a channel")?.0.to_rows()?,
            None => Vec::new(),
        };
        let rule = rule_of(hyperparameter, signal)?;
        let operator = run(py, || Ok(self.problem.operator(self.problem.choose(&rule, &data)?)?))?;
        Ok(Self { problem: self.problem.clone(), operator })
    }

    fn __call__<'py>(&self, py: Python<'py>, differences: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let (rows, single) = Doubles::rows("differences", differences, self.channels(), "one difference a channel")?;
        let rows = rows.finite("differences")?;
        let values = rows.values()?;
        let (channels, unknowns) = (self.channels(), self.operator.matrix.nrows());
        let count = values.len() / channels.max(1);
        let images = run(py, || {
            let data = MatRef::from_row_major_slice(values, count, channels);
            let images = &self.operator.matrix * data.transpose();
            Ok((0..count * unknowns).map(|at| images[(at % unknowns, at / unknowns)]).collect::<Vec<f64>>())
        })?;
        if single {
            return Ok(array1(py, images).into_any());
        }
        Ok(array2(py, images, count, unknowns)?.into_any())
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
