//! [`PyCalibration`]: a calibration learnt from pokes at known places.

use std::path::PathBuf;
use std::sync::Arc;

use dermis_live::calibrate::calibrate as fit_calibration;
use dermis_live::calibration::{Calibration, CalibrationOptions, LoadQuantity, PokeFrames, Pokes};
use dermis_live::prepare::Prepared;
use pyo3::prelude::*;
use pyo3::type_hint_union;
use pyo3::type_object::PyTypeInfo;

use crate::arrays::{Array1, Array2, Doubles, array1, array2};
use crate::errors::Fault;
use crate::hints::{ArrayLike, PATH, python_types};
use crate::model::{PyModel, SkinOrModel};
use crate::skin::skin_of;
use crate::work::{run, run_interruptibly};

python_types! {
    /// A calibration or its file.
    CalibrationLike = type_hint_union!(PyCalibration::TYPE_HINT, PATH);
}

/// A calibration by pokes.
#[pyclass(frozen, module = "dermis", name = "Calibration")]
pub struct PyCalibration {
    /// The calibration in the form that the pipeline takes.
    pub calibration: Calibration,
}

/// The prepared skin for any value that Python accepts as a skin: the object, its model, a name, a path, or text.
pub fn prepared_of(value: &Bound<'_, PyAny>) -> PyResult<Arc<Prepared>> {
    if let Ok(model) = value.cast::<PyModel>() {
        return Ok(model.get().prepared.clone());
    }
    let skin = skin_of(value)?;
    run_interruptibly(value.py(), "model", move || Ok(Arc::new(Prepared::new(skin)?)))
}

/// Fits a calibration to pokes at known places.
///
/// Parameters
/// ----------
/// skin : Skin, Model or str
///     The skin that was poked.
/// baselines : array_like
///     Shape (k,) or (n, k): the untouched skin, one frame or several for all pokes, or one before each poke.
/// frames : array_like
///     Shape (n, k): the pressed skin, one frame per poke.
/// positions_m : array_like
///     Shape (n, 2): position of each poke, metres from the skin's centre.
/// depths_m, forces_n : array_like, optional
///     Shape (n,): depth or force of each poke; give at most one of them.
/// groups : array_like, optional
///     Shape (m,): for frames with several touches. Then `positions_m` (and loads) have a row for each touch; touches
///     with the same number belong to one frame, and frames are in the order in which numbers first appear.
/// start : Calibration, optional
///     An earlier calibration, of this skin or of another of its family. The new pokes decide how it is used.
///
/// Returns
/// -------
/// Calibration
///     The calibration, for :class:`Pipeline` and the command.
#[pyfunction]
#[pyo3(signature = (skin, baselines, frames, positions_m, *, depths_m=None, forces_n=None, groups=None, start=None))]
pub fn calibrate(
    py: Python<'_>,
    skin: SkinOrModel<'_>,
    baselines: ArrayLike<'_>,
    frames: ArrayLike<'_>,
    positions_m: ArrayLike<'_>,
    depths_m: Option<ArrayLike<'_>>,
    forces_n: Option<ArrayLike<'_>>,
    groups: Option<ArrayLike<'_>>,
    start: Option<PyRef<'_, PyCalibration>>,
) -> PyResult<PyCalibration> {
    let prepared = prepared_of(&skin)?;
    let channels = prepared.channels();
    let of = format!("one reading per channel of skin {}", prepared.skin.name);
    let baselines = Doubles::rows("baselines", &baselines, channels, &of)?.0.to_rows()?;
    let frames = Doubles::rows("frames", &frames, channels, &of)?.0.to_rows()?;
    let positions = Doubles::rows("positions_m", &positions_m, 2, "x and y of a poke")?.0.finite("positions_m")?;
    let positions_m: Vec<[f64; 2]> = positions.values()?.chunks_exact(2).map(|p| [p[0], p[1]]).collect();
    let loads = match (depths_m, forces_n) {
        (Some(_), Some(_)) => return Err(Fault::input("loads", "depths_m or forces_n", "both").into()),
        (Some(depths), None) => Some(("depths_m", LoadQuantity::DepthM, depths)),
        (None, Some(forces)) => Some(("forces_n", LoadQuantity::ForceN, forces)),
        (None, None) => None,
    };
    let loads = match loads {
        Some((what, quantity, values)) => {
            let values = Doubles::vector(what, &values, positions_m.len(), "one per poke")?.finite(what)?;
            Some((quantity, values.values()?.to_vec()))
        }
        None => None,
    };
    let touches = positions_m.len();
    let mut pokes = Pokes { positions_m, further_m: Vec::new(), loads };
    if let Some(groups) = groups {
        let groups = Doubles::vector("groups", &groups, touches, "one per touch")?.finite("groups")?;
        pokes = pokes.grouped(groups.values()?);
    }
    let earlier: Vec<Calibration> = start.iter().map(|start| start.calibration.clone()).collect();
    let fit = move || {
        let measured = PokeFrames::Readings { baselines: &baselines, frames: &frames };
        let options = CalibrationOptions { start: &earlier, ..CalibrationOptions::default() };
        Ok(fit_calibration(&prepared, measured, &pokes, &options)?)
    };
    let calibration = run_interruptibly(py, "calibrate", fit)?;
    Ok(PyCalibration { calibration })
}

#[pymethods]
impl PyCalibration {
    /// Reads a calibration's file.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        Ok(Self { calibration: Calibration::load(&path).map_err(Fault::from)? })
    }

    /// Writes it as JSON, completely or not at all.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        run(py, || Ok(self.calibration.save(&path)?))
    }

    /// Number of pokes.
    #[getter]
    fn pokes(&self) -> usize {
        self.calibration.pokes()
    }

    /// True if touches are located by the skin's model, corrected by the pokes, and by the pokes only where the model
    /// sees nothing; False if the pokes alone locate left-out pokes clearly better.
    #[getter]
    fn by_model(&self) -> bool {
        self.calibration.correction().is_some()
    }

    /// Median distance of a poke from the position predicted by the others, millimetres.
    #[getter]
    fn leave_one_out_mm(&self) -> f64 {
        1e3 * self.calibration.leave_one_out().median_error_m
    }

    /// 90th percentile of these distances, millimetres.
    #[getter]
    fn leave_one_out_p90_mm(&self) -> f64 {
        1e3 * self.calibration.leave_one_out().p90_error_m
    }

    /// These distances for every poke, shape (pokes,), millimetres.
    #[getter]
    fn leave_one_out_errors_mm<'py>(&self, py: Python<'py>) -> Array1<'py, f64> {
        let examples = &self.calibration.leave_one_out().examples;
        array1(py, examples.iter().map(|left| 1e3 * left.error_m).collect())
    }

    /// Share of pokes within one predicted standard deviation, in x and y.
    #[getter]
    fn coverage(&self) -> [f64; 2] {
        self.calibration.leave_one_out().coverage
    }

    /// Positions at which further pokes would help most, shape (count, 2), metres.
    #[pyo3(signature = (count=5))]
    fn suggest_pokes<'py>(&self, py: Python<'py>, count: usize) -> PyResult<Array2<'py, f64>> {
        let pokes = run(py, || Ok(self.calibration.suggest_pokes(count)?))?;
        array2(py, pokes.iter().flat_map(|poke| poke.position_m).collect(), pokes.len(), 2)
    }

    fn __repr__(&self) -> String {
        format!("<dermis.Calibration: {} pokes, {:.2} mm left out>", self.pokes(), self.leave_one_out_mm())
    }
}
