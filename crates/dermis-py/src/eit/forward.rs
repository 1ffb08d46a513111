//! Forward models: mesh, electrodes and protocol, ready to solve.

use std::sync::Arc;

use dermis_tomo::eit::{ForwardModel, Solution};
use dermis_tomo::mesh::{ElectrodedMesh, Mesh};
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use rayon::prelude::*;

use super::mesh::{Numbering, PyElectrode, PyMesh};
use super::protocol::PyProtocol;
use crate::arrays::{Array1, Array2, Doubles, array1, array2, shape_text};
use crate::eit::mesh::Electrodes;
use crate::errors::Fault;
use crate::hints::ArrayLike;
use crate::work::{run, run_sized, run_steps};

/// Operations for preparing and factoring a model, per element, and for each electrode's field.
const PER_ELEMENT: f64 = 5000.0;
const PER_FIELD: f64 = 60.0;

/// The electrodes of a mesh.
pub fn electrodes_of(body: &ElectrodedMesh) -> Vec<PyElectrode> {
    body.electrodes.iter().map(|electrode| PyElectrode { electrode: electrode.clone() }).collect()
}

/// Voltages for many conductivities, one per row, computed in parallel on this number of threads or on all.
pub fn voltages_of_rows<'py>(
    py: Python<'py>,
    sigmas: &Bound<'py, PyAny>,
    elements: usize,
    channels: usize,
    threads: Option<usize>,
    read: &(dyn Fn(&[f64]) -> Result<Vec<f64>, Fault> + Sync),
) -> PyResult<Array2<'py, f64>> {
    let sigmas = Doubles::of("sigmas", sigmas)?;
    let &[count, columns] = sigmas.shape() else {
        let expected = format!("shape (n, {elements}), one conductivity per element");
        return Err(Fault::input("sigmas", expected, shape_text(sigmas.shape())).into());
    };
    if columns != elements {
        let expected = format!("shape (n, {elements}), one conductivity per element");
        return Err(Fault::input("sigmas", expected, shape_text(sigmas.shape())).into());
    }
    if threads == Some(0) || threads.is_some_and(|threads| threads > 1024) {
        return Err(Fault::input(
            "threads",
            "1 to 1024, or None for as many as there are processors",
            "another number",
        )
        .into());
    }
    let values = sigmas.values()?;
    let mut voltages = vec![0.0; count * channels];
    run_steps(py, "voltages", count, threads, |progress| {
        let rows = values.par_chunks_exact(elements).zip(voltages.par_chunks_exact_mut(channels)).enumerate();
        rows.try_for_each(|(row, (sigma, out))| {
            out.copy_from_slice(&read(sigma).map_err(|fault| fault.at(&format!("row {row}")))?);
            progress.step()
        })
    })?;
    array2(py, voltages, count, channels)
}

/// Mesh, electrodes and protocol, ready to solve with the complete electrode model on linear elements.
///
/// Parameters
/// ----------
/// mesh : Mesh
///     The mesh.
/// electrodes : sequence of Electrode
///     The electrodes in order.
/// protocol : Protocol
///     A protocol for this number of electrodes.
#[pyclass(frozen, module = "dermis.eit", name = "ForwardModel")]
pub struct PyForwardModel {
    /// The model.
    pub model: Arc<ForwardModel>,
    numbering: Option<Arc<Numbering>>,
}

impl PyForwardModel {
    fn elements(&self) -> usize {
        self.model.body().mesh.element_count()
    }

    fn channels(&self) -> usize {
        self.model.protocol().channel_count()
    }

    fn sigma<'py>(&self, sigma: &Bound<'py, PyAny>) -> PyResult<Doubles<'py>> {
        Doubles::vector("sigma", sigma, self.elements(), "one conductivity per element")
    }

    /// Computes something from the solution at a conductivity.
    fn solved<T: Send>(
        &self,
        py: Python<'_>,
        sigma: &Bound<'_, PyAny>,
        read: impl FnOnce(Solution<'_>) -> Result<T, Fault> + Send,
    ) -> PyResult<T> {
        let sigma = self.sigma(sigma)?;
        let sigma = sigma.values()?;
        run(py, || read(self.model.solve(sigma)?))
    }

    /// Approximate number of operations for a solution.
    fn operations(&self) -> f64 {
        let fields = self.model.protocol().electrode_count() as f64;
        (PER_ELEMENT + PER_FIELD * fields) * self.elements() as f64
    }

    fn stimulation(&self, stimulation: usize) -> Result<usize, Fault> {
        let count = self.model.protocol().stimulations().len();
        if stimulation < count {
            return Ok(stimulation);
        }
        Err(Fault::input("stimulation", format!("0 to {}", count - 1), stimulation))
    }
}

#[pymethods]
impl PyForwardModel {
    #[new]
    fn new(
        py: Python<'_>,
        mesh: &Bound<'_, PyMesh>,
        electrodes: Vec<Bound<'_, PyElectrode>>,
        protocol: &Bound<'_, PyProtocol>,
    ) -> PyResult<Self> {
        let PyMesh { mesh, numbering } = mesh.get();
        let electrode = |(index, electrode): (usize, &Bound<'_, PyElectrode>)| match numbering {
            Some(numbering) => numbering.to_mesh(index, &electrode.get().electrode),
            None => Ok(electrode.get().electrode.clone()),
        };
        let electrodes = electrodes.iter().enumerate().map(electrode).collect::<Result<Vec<_>, Fault>>()?;
        let (mesh, protocol) = (Arc::clone(mesh), protocol.get().protocol.clone());
        let operations = PER_ELEMENT * mesh.element_count() as f64;
        let model = run_sized(py, "forward model", operations, move || {
            let body = ElectrodedMesh::new(Mesh::clone(&mesh), electrodes)?;
            Ok(Arc::new(ForwardModel::new(body, protocol)?))
        })?;
        Ok(Self { model, numbering: numbering.clone() })
    }

    /// The mesh.
    #[getter]
    fn mesh(&self) -> PyMesh {
        PyMesh { mesh: Arc::new(self.model.body().mesh.clone()), numbering: self.numbering.clone() }
    }

    /// The electrodes.
    #[getter]
    fn electrodes<'py>(&self, py: Python<'py>) -> PyResult<Electrodes<'py>> {
        let mut electrodes = electrodes_of(self.model.body());
        if let Some(numbering) = &self.numbering {
            electrodes.iter_mut().for_each(|own| own.electrode = numbering.to_caller(&own.electrode));
        }
        Ok(Electrodes(PyTuple::new(py, electrodes)?.into_any()))
    }

    /// The protocol.
    #[getter]
    fn protocol(&self) -> PyProtocol {
        PyProtocol { protocol: self.model.protocol().clone() }
    }

    /// Voltages of all channels.
    ///
    /// Parameters
    /// ----------
    /// sigma : array_like
    ///     Shape (m,): one conductivity per element, positive.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     Shape (k,), volts.
    fn voltages<'py>(&self, py: Python<'py>, sigma: ArrayLike<'py>) -> PyResult<Array1<'py, f64>> {
        let sigma = self.sigma(&sigma)?.values()?.to_vec();
        let (model, operations) = (Arc::clone(&self.model), self.operations());
        Ok(array1(py, run_sized(py, "voltages", operations, move || Ok(model.voltages(&sigma)?))?))
    }

    /// Voltages for many conductivities, in parallel.
    ///
    /// Parameters
    /// ----------
    /// sigmas : array_like
    ///     Shape (n, m): one set of conductivities per row.
    /// threads : int, optional
    ///     Number of threads; default: all processors.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     Shape (n, k), volts.
    #[pyo3(signature = (sigmas, threads=None))]
    fn voltages_many<'py>(
        &self,
        py: Python<'py>,
        sigmas: ArrayLike<'py>,
        threads: Option<usize>,
    ) -> PyResult<Array2<'py, f64>> {
        let read = |sigma: &[f64]| Ok(self.model.voltages(sigma)?);
        voltages_of_rows(py, &sigmas, self.elements(), self.channels(), threads, &read)
    }

    /// Sensitivity of every channel to every element, with EIDORS' sign and units.
    ///
    /// Parameters
    /// ----------
    /// sigma : array_like
    ///     Shape (m,): one conductivity per element, positive.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     Shape (k, m), dv/dsigma.
    fn jacobian<'py>(&self, py: Python<'py>, sigma: ArrayLike<'py>) -> PyResult<Array2<'py, f64>> {
        let jacobian = self.solved(py, &sigma, |solution| Ok(solution.jacobian()))?;
        array2(py, jacobian.values, jacobian.rows, jacobian.columns)
    }

    /// ``jacobian(sigma).T @ cotangent`` without forming the Jacobian.
    ///
    /// Parameters
    /// ----------
    /// sigma : array_like
    ///     Shape (m,): one conductivity per element, positive.
    /// cotangent : array_like
    ///     Shape (k,): weight of every channel.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     Shape (m,).
    fn vjp<'py>(
        &self,
        py: Python<'py>,
        sigma: ArrayLike<'py>,
        cotangent: ArrayLike<'py>,
    ) -> PyResult<Array1<'py, f64>> {
        let cotangent = Doubles::vector("cotangent", &cotangent, self.channels(), "one weight per channel")?;
        let cotangent = cotangent.finite("cotangent")?;
        let cotangent = cotangent.values()?;
        Ok(array1(py, self.solved(py, &sigma, |solution| Ok(solution.vjp(cotangent)?))?))
    }

    /// Potentials of all nodes during a stimulation.
    ///
    /// Parameters
    /// ----------
    /// sigma : array_like
    ///     Shape (m,): one conductivity per element, positive.
    /// stimulation : int
    ///     Index of the protocol's stimulation, from 0.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     Shape (n,), volts, relative to the last electrode; NaN at nodes of no element.
    fn node_potentials<'py>(
        &self,
        py: Python<'py>,
        sigma: ArrayLike<'py>,
        stimulation: usize,
    ) -> PyResult<Array1<'py, f64>> {
        let stimulation = self.stimulation(stimulation)?;
        let potentials = self.solved(py, &sigma, |solution| Ok(solution.node_potentials(stimulation)))?;
        Ok(array1(
            py,
            match &self.numbering {
                Some(numbering) => numbering.values_to_caller(&potentials),
                None => potentials,
            },
        ))
    }

    /// Potentials of the electrodes during a stimulation.
    ///
    /// Parameters
    /// ----------
    /// sigma : array_like
    ///     Shape (m,): one conductivity per element, positive.
    /// stimulation : int
    ///     Index of the protocol's stimulation, from 0.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     Shape (electrodes,), volts, shifted to sum to zero.
    fn electrode_potentials<'py>(
        &self,
        py: Python<'py>,
        sigma: ArrayLike<'py>,
        stimulation: usize,
    ) -> PyResult<Array1<'py, f64>> {
        let stimulation = self.stimulation(stimulation)?;
        Ok(array1(py, self.solved(py, &sigma, |solution| Ok(solution.electrode_potentials(stimulation)))?))
    }

    /// Potentials of the electrodes for currents into them.
    ///
    /// Parameters
    /// ----------
    /// sigma : array_like
    ///     Shape (m,): one conductivity per element, positive.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     Shape (electrodes, electrodes), ohm: potential of the row's electrode relative to the last one, for 1 A
    ///     into the column's.
    fn transfer_impedance<'py>(&self, py: Python<'py>, sigma: ArrayLike<'py>) -> PyResult<Array2<'py, f64>> {
        let (values, size) = self.solved(py, &sigma, |solution| {
            let impedance = solution.transfer_impedance();
            let size = impedance.nrows();
            let values = (0..size * size).map(|at| impedance[(at / size, at % size)]).collect::<Vec<f64>>();
            Ok((values, size))
        })?;
        array2(py, values, size, size)
    }

    fn __repr__(&self) -> String {
        format!("<dermis.eit.ForwardModel: {} elements, {} channels>", self.elements(), self.channels())
    }
}
