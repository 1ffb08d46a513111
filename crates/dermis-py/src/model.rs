//! [`PyModel`]: a skin's mesh and forward model, and images by its operator.

use std::sync::{Arc, OnceLock};

use dermis_live::imager::Imager;
use dermis_live::prepare::Prepared;
use dermis_live::reference::Reference;
use dermis_skin::{Imaging, Modality};
use dermis_tomo::eit::{ForwardModel, Protocol};
use dermis_tomo::mesh::PixelMap;
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::type_hint_union;
use pyo3::type_object::PyTypeInfo;
use pyo3::types::{PyDict, PyTuple};

use crate::arrays::{Array1, Array2, ArrayDyn, Doubles, array1, array2, array3, read_only, type_name};
use crate::eit::forward::{electrodes_of, voltages_of_rows};
use crate::eit::mesh::{Electrodes, elements_of, nodes_of};
use crate::eit::protocol::{channels_of, dense_patterns};
use crate::errors::Fault;
use crate::grid::PyGrid;
use crate::hints::{ArrayLike, HyperparameterChoice, PriorChoice, Restorer, python_types};
use crate::skin_argument::{PySkin, SKIN};
use crate::work::{run, run_interruptibly};

python_types! {
    /// A skin, the name of one, its file, its text, or its model.
    SkinOrModel = type_hint_union!(PyModel::TYPE_HINT, SKIN);
}

/// A skin's forward model at rest.
#[pyclass(frozen, module = "dermis", name = "Model")]
pub struct PyModel {
    /// The prepared skin, which pipelines use too.
    pub prepared: Arc<Prepared>,
    forward: OnceLock<Arc<ForwardModel>>,
    nodes: Py<PyArray2<f64>>,
    elements: Py<PyArray2<u32>>,
    sigma: Py<PyArray1<f64>>,
    map: Arc<PixelMap>,
}

impl PyModel {
    /// The model of a prepared skin.
    pub fn of(py: Python<'_>, prepared: Arc<Prepared>) -> PyResult<Self> {
        let mesh = &prepared.body.mesh.mesh;
        let sigma = vec![prepared.skin.sheet_conductance_s(); mesh.element_count()];
        Ok(Self {
            forward: OnceLock::new(),
            map: Arc::new(prepared.map.clone()),
            nodes: nodes_of(py, mesh)?.unbind(),
            elements: elements_of(py, mesh)?.unbind(),
            sigma: read_only(array1(py, sigma))?.unbind(),
            prepared,
        })
    }

    fn protocol(&self) -> &Protocol {
        &self.prepared.protocol
    }

    fn element_count(&self) -> usize {
        self.prepared.body.mesh.mesh.element_count()
    }

    /// The model of the conducting sheet, built on first use.
    fn forward(&self) -> Result<&Arc<ForwardModel>, Fault> {
        if self.prepared.skin.modality == Modality::Mit {
            let expected = "a skin with electrodes; with coils, only model.voltages() at rest and model.pixel_jacobian";
            return Err(Fault::input("conductivity", expected, format!("skin {}", self.prepared.skin.name)));
        }
        if let Some(forward) = self.forward.get() {
            return Ok(forward);
        }
        let made = ForwardModel::new(self.prepared.body.mesh.clone(), self.protocol().clone())?;
        // If another thread was faster, its model is the same.
        Ok(self.forward.get_or_init(|| Arc::new(made)))
    }

    /// Voltages as read by the skin's instrument, through its readout circuit if it has one.
    fn read(&self, sigma: &[f64]) -> Result<Vec<f64>, Fault> {
        let forward = self.forward()?;
        match self.prepared.skin.backend.circuit.as_ref().and_then(|circuit| circuit.known()) {
            None => Ok(forward.voltages(sigma)?),
            Some(circuit) => {
                let conductance = self.prepared.skin.sheet_conductance_s();
                Ok(circuit.readout().response(&forward.solve(sigma)?, conductance)?.voltages)
            }
        }
    }

    /// The model that has the Jacobian of the readings at a conductivity: with a circuit, the one with the effective
    /// patterns.
    fn effective(&self, sigma: &[f64]) -> Result<Arc<ForwardModel>, Fault> {
        let forward = self.forward()?;
        match self.prepared.skin.backend.circuit.as_ref().and_then(|circuit| circuit.known()) {
            None => Ok(forward.clone()),
            Some(circuit) => {
                let conductance = self.prepared.skin.sheet_conductance_s();
                let effective = circuit.readout().response(&forward.solve(sigma)?, conductance)?.effective;
                Ok(Arc::new(ForwardModel::new(self.prepared.body.mesh.clone(), effective)?))
            }
        }
    }

    fn sigma_of<'py>(&self, py: Python<'py>, sigma: Option<&Bound<'py, PyAny>>) -> PyResult<Doubles<'py>> {
        match sigma {
            Some(sigma) => Doubles::vector("sigma", sigma, self.element_count(), "one conductivity per element"),
            None => Doubles::of("sigma", self.sigma.bind(py).as_any()),
        }
    }

    /// The prepared skin with another prior or hyperparameter.
    fn with_choices(
        &self,
        prior: Option<&Bound<'_, PyAny>>,
        hyperparameter: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Arc<Prepared>> {
        if prior.is_none() && hyperparameter.is_none() {
            return Ok(self.prepared.clone());
        }
        let mut imaging: Imaging = self.prepared.skin.imaging.clone();
        if let Some(prior) = prior {
            imaging.prior = written("prior", prior)?.parse().map_err(Fault::from)?;
        }
        if let Some(hyperparameter) = hyperparameter {
            imaging.hyperparameter = written("hyperparameter", hyperparameter)?.parse().map_err(Fault::from)?;
        }
        Ok(Arc::new(self.prepared.with_imaging(imaging).map_err(Fault::from)?))
    }
}

/// Nesting depth allowed for dictionaries in a skin file's value.
const MOST_NESTED: usize = 32;

/// A word, a number or a dictionary, as written in a skin file.
fn written(what: &str, value: &Bound<'_, PyAny>) -> PyResult<String> {
    written_within(what, value, MOST_NESTED)
}

fn written_within(what: &str, value: &Bound<'_, PyAny>, depth: usize) -> PyResult<String> {
    if let Ok(text) = value.extract::<String>() {
        return Ok(text);
    }
    if let Ok(number) = value.extract::<f64>() {
        return Ok(format!("{number:e}"));
    }
    if let Ok(table) = value.cast::<PyDict>() {
        let mut entries = Vec::new();
        for (key, value) in table {
            let left = depth.checked_sub(1).ok_or_else(|| {
                Fault::input(what, format!("dictionaries nested at most {MOST_NESTED} deep"), "deeper ones")
            })?;
            entries.push(format!("{} = {}", key.extract::<String>()?, written_within(what, &value, left)?));
        }
        return Ok(format!("{{ {} }}", entries.join(", ")));
    }
    let expected = "a word, a number, or a dictionary as in a skin file";
    Err(Fault::input(what, expected, type_name(value)).into())
}

#[pymethods]
impl PyModel {
    /// The skin.
    #[getter]
    fn skin(&self) -> PySkin {
        PySkin { skin: self.prepared.skin.clone() }
    }

    /// Node coordinates, shape (n, 2) for flat meshes, otherwise (n, 3), metres. Read-only.
    #[getter]
    fn nodes<'py>(&self, py: Python<'py>) -> Array2<'py, f64> {
        self.nodes.bind(py).clone().into()
    }

    /// Node indices of the elements, shape (m, 3) or (m, 4), from 0. Read-only.
    #[getter]
    fn elements<'py>(&self, py: Python<'py>) -> Array2<'py, u32> {
        self.elements.bind(py).clone().into()
    }

    /// Sheet conductance of every element in the skin file, shape (m,), siemens. Read-only.
    #[getter]
    fn sigma<'py>(&self, py: Python<'py>) -> Array1<'py, f64> {
        self.sigma.bind(py).clone().into()
    }

    /// The electrodes in order.
    #[getter]
    fn electrodes<'py>(&self, py: Python<'py>) -> PyResult<Electrodes<'py>> {
        Ok(Electrodes(PyTuple::new(py, electrodes_of(&self.prepared.body.mesh))?.into_any()))
    }

    /// Electrodes of every channel, shape (k, 4), from 0: the drive's first and second (current enters at the
    /// second), and the measured first and second (the reading is the first's potential minus the second's); -1 if a
    /// pattern has no such electrode, or several.
    #[getter]
    fn channels<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, i32>> {
        channels_of(py, self.protocol())
    }

    /// A label for every channel, with electrodes counted from 1: ``1-2 > 5-6``.
    #[getter]
    fn channel_labels(&self) -> Vec<String> {
        (0..self.protocol().channel_count()).map(|channel| self.protocol().channel_label(channel)).collect()
    }

    /// Currents into the body, shape (s, electrodes), amperes.
    #[getter]
    fn stimulations<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        dense_patterns(py, self.protocol().electrode_count(), self.protocol().stimulations().iter())
    }

    /// Weights of the potentials in every channel's reading, shape (k, electrodes).
    #[getter]
    fn measurements<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        let protocol = self.protocol();
        let patterns = (0..protocol.channel_count()).map(|channel| protocol.pattern_of(channel));
        dense_patterns(py, protocol.electrode_count(), patterns)
    }

    /// The stimulation of every channel, shape (k,).
    #[getter]
    fn stimulation_of<'py>(&self, py: Python<'py>) -> Array1<'py, u32> {
        array1(py, self.protocol().measurements().iter().map(|measurement| measurement.stimulation).collect())
    }

    /// The pixel grid of images.
    #[getter]
    fn grid(&self) -> PyGrid {
        PyGrid { map: self.map.clone() }
    }

    /// Voltages of all channels, as read by the skin's instrument.
    ///
    /// Parameters
    /// ----------
    /// sigma : array_like, optional
    ///     Shape (m,): sheet conductance of every element, siemens, positive; default: the file's own.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     Shape (k,), volts.
    #[pyo3(signature = (sigma=None))]
    fn voltages<'py>(&self, py: Python<'py>, sigma: Option<ArrayLike<'py>>) -> PyResult<Array1<'py, f64>> {
        if sigma.is_none() {
            return Ok(array1(py, self.prepared.voltages.clone()));
        }
        let sigma = self.sigma_of(py, sigma.as_deref())?;
        let values = sigma.values()?;
        Ok(array1(py, run(py, || self.read(values))?))
    }

    /// Sensitivity of every channel to every element, with EIDORS' sign and units.
    ///
    /// Parameters
    /// ----------
    /// sigma : array_like, optional
    ///     Shape (m,): sheet conductance to linearise at, siemens; default: the file's own.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     Shape (k, m), dv/dsigma in volts per siemens. With a readout circuit, the Jacobian of its patterns at
    ///     sigma.
    #[pyo3(signature = (sigma=None))]
    fn jacobian<'py>(&self, py: Python<'py>, sigma: Option<ArrayLike<'py>>) -> PyResult<Array2<'py, f64>> {
        let sigma = self.sigma_of(py, sigma.as_deref())?;
        let values = sigma.values()?;
        let jacobian = run(py, || Ok(self.effective(values)?.solve(values)?.jacobian()))?;
        array2(py, jacobian.values, jacobian.rows, jacobian.columns)
    }

    /// ``jacobian(sigma).T @ cotangent`` without forming the Jacobian.
    ///
    /// Parameters
    /// ----------
    /// sigma : array_like
    ///     Shape (m,): sheet conductance of every element, siemens.
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
        let sigma = self.sigma_of(py, Some(&sigma))?;
        let cotangent = Doubles::vector("cotangent", &cotangent, self.prepared.channels(), "one weight per channel")?;
        let (sigma, cotangent) = (sigma.values()?, cotangent.finite("cotangent")?);
        let cotangent = cotangent.values()?;
        Ok(array1(py, run(py, || Ok(self.effective(sigma)?.solve(sigma)?.vjp(cotangent)?))?))
    }

    /// Voltages for many conductivities, in parallel.
    ///
    /// Parameters
    /// ----------
    /// sigmas : array_like
    ///     Shape (n, m): one set of sheet conductances per row, siemens.
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
        voltages_of_rows(py, &sigmas, self.element_count(), self.prepared.channels(), threads, &|sigma: &[f64]| {
            self.read(sigma)
        })
    }

    /// Sensitivity to relative changes of the inside pixels, shape (k, pixels), volts; for coils, to the elements'
    /// travel.
    #[getter]
    fn pixel_jacobian<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        let jacobian = &self.prepared.jacobian;
        array2(py, jacobian.values.clone(), jacobian.rows, jacobian.columns)
    }

    /// Images of frames relative to a baseline.
    ///
    /// Parameters
    /// ----------
    /// baseline : array_like
    ///     Shape (k,) or (n, k): the untouched skin; from 8 frames on, their scatter gives the noise.
    /// frames : array_like
    ///     Shape (n, k) or (k,): readings in the skin's order, NaN where missing.
    /// prior : str or dict, optional
    ///     As in a skin file: ``identity``, ``laplace``, ``noser=0.5``, ``{"gaussian-mm": 4.0}``.
    /// hyperparameter : float, str or dict, optional
    ///     A number, or a rule as in a skin file: ``l-curve``, ``gcv``, ``relative=0.02``, ``noise-figure=0.5``.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     Shape (n, rows, columns), or (rows, columns) of one frame, float32, row 0 at the top, NaN outside the skin.
    #[pyo3(signature = (baseline, frames, *, prior=None, hyperparameter=None))]
    fn image<'py>(
        &self,
        py: Python<'py>,
        baseline: ArrayLike<'py>,
        frames: ArrayLike<'py>,
        prior: Option<PriorChoice<'py>>,
        hyperparameter: Option<HyperparameterChoice<'py>>,
    ) -> PyResult<ArrayDyn<'py, f32>> {
        let channels = self.prepared.channels();
        let baseline = Doubles::rows("baseline", &baseline, channels, "one reading per channel")?.0.to_rows()?;
        let (frames, single) = Doubles::rows("frames", &frames, channels, "one reading per channel")?;
        let frames = frames.to_rows()?;
        let prepared = self.with_choices(prior.as_deref(), hyperparameter.as_deref())?;
        let grid = prepared.map.grid();
        let (count, rows, columns) = (frames.len(), grid.rows, grid.columns);
        let images = run_interruptibly(py, "images", move || {
            let reference = Reference::of(&prepared, &baseline)?;
            let differences: Vec<Vec<f64>> = frames.iter().map(|frame| reference.difference(frame, None)).collect();
            let mut imager = Imager::new(&prepared, &reference, &differences)?;
            let pixels = prepared.map.grid().len();
            let mut images = vec![f32::NAN; pixels * differences.len()];
            for (index, (difference, image)) in differences.iter().zip(images.chunks_exact_mut(pixels)).enumerate() {
                let imaged = imager.image(difference, image).map_err(Fault::from);
                imaged.map_err(|fault| fault.at(&format!("frame {index}")))?;
            }
            Ok(images)
        })?;
        if single {
            return Ok(array2(py, images, rows, columns)?.into_dyn());
        }
        Ok(array3(py, images, [count, rows, columns])?.into_dyn())
    }

    fn __repr__(&self) -> String {
        let mesh = &self.prepared.body.mesh.mesh;
        format!(
            "<dermis.Model of {:?}: {} nodes, {} elements, {} channels>",
            self.prepared.skin.name,
            mesh.nodes().len(),
            mesh.element_count(),
            self.prepared.channels()
        )
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Restorer<'py>, (Py<PySkin>,))> {
        let make = slf.py().import("dermis")?.getattr("_model_of")?;
        Ok((Restorer(make), (Py::new(slf.py(), slf.get().skin())?,)))
    }
}
