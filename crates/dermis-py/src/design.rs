//! [`PyMaps`]: predictions of a skin's abilities before it is built, and of the cost of manufacturing errors.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use dermis_lab::design::{Maps, Noise, spread_width};
use dermis_lab::tolerances::{Extent, run as run_tolerances};
use pyo3::prelude::*;

use crate::arrays::{Array2, array2};
use crate::calibration::prepared_of;
use crate::errors::Fault;
use crate::hints::Axes;
use crate::model::SkinOrModel;
use crate::skin::{PySkin, skin_of};
use crate::skin_argument::SkinLike;
use crate::work::run_interruptibly;

/// Maps over a skin.
#[pyclass(frozen, module = "dermis", name = "Maps")]
pub struct PyMaps {
    skin: dermis_skin::Skin,
    maps: Maps,
    spread_m: Vec<f64>,
}

/// Predicts what a skin will be able to do before it is built.
///
/// Parameters
/// ----------
/// skin : Skin, Model or str
///     The skin.
/// amplitude : float
///     Relative change of conductivity of the touch that the bounds are for.
/// snr_db, noise_v : float, optional
///     Noise proportional to each reading, or the same for all readings; default: as the skin file assumes.
/// places : int
///     Places along the longer side of the maps, 4 to 128.
///
/// Returns
/// -------
/// Maps
///     Cramer-Rao bounds and related maps: no unbiased method does better at this noise.
#[pyfunction]
#[pyo3(signature = (skin, *, amplitude=0.1, snr_db=None, noise_v=None, places=32))]
pub fn design(
    py: Python<'_>,
    skin: SkinOrModel<'_>,
    amplitude: f64,
    snr_db: Option<f64>,
    noise_v: Option<f64>,
    places: usize,
) -> PyResult<PyMaps> {
    if !(4..=128).contains(&places) {
        return Err(Fault::input("places", "4 to 128 along the longer side", places).into());
    }
    let noise = match (snr_db, noise_v) {
        (None, None) => Noise::Assumed,
        (Some(db), None) => Noise::Decibels(db),
        (None, Some(volts)) => Noise::Volts(volts),
        (Some(_), Some(_)) => return Err(Fault::input("noise", "snr_db or noise_v", "both").into()),
    };
    let prepared = prepared_of(&skin)?;
    run_interruptibly(py, "design", move || {
        let maps = Maps::new(&prepared, noise, amplitude, places)?;
        let spread_m = spread_width(&prepared, &maps)?;
        Ok(PyMaps { skin: prepared.skin.clone(), maps, spread_m })
    })
}

impl PyMaps {
    fn map<'py>(&self, py: Python<'py>, values: &[f64], factor: f64) -> PyResult<Array2<'py, f64>> {
        let grid = &self.maps.grid;
        let mut image = vec![f64::NAN; grid.len()];
        for (&pixel, value) in self.maps.pixels.iter().zip(values) {
            image[pixel] = factor * value;
        }
        array2(py, image, grid.rows, grid.columns)
    }
}

#[pymethods]
impl PyMaps {
    /// The skin.
    #[getter]
    fn skin(&self) -> PySkin {
        PySkin { skin: self.skin.clone() }
    }

    /// Relative change of conductivity that the bounds are for.
    #[getter]
    fn amplitude(&self) -> f64 {
        self.maps.amplitude
    }

    /// Left, right, bottom and top, millimetres.
    #[getter]
    fn extent_mm(&self) -> [f64; 4] {
        let grid = &self.maps.grid;
        let (left, top, pixel) = (1e3 * grid.left_m, 1e3 * grid.top_m, 1e3 * grid.pixel_m);
        [left, left + pixel * grid.columns as f64, top - pixel * grid.rows as f64, top]
    }

    /// Signal-to-noise ratio of all channels together for a relative change of 1, shape (rows, columns).
    #[getter]
    fn sensitivity<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        self.map(py, &self.maps.sensitivity, 1.0)
    }

    /// Smallest detectable relative change, shape (rows, columns).
    #[getter]
    fn smallest_change<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        self.map(py, &self.maps.smallest, 1.0)
    }

    /// Cramer-Rao bound on the standard deviation of a position along its worse axis, shape (rows, columns),
    /// millimetres; NaN outside.
    #[getter]
    fn position_bound_mm<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        self.map(py, &self.maps.position_m, 1e3)
    }

    /// Relative bound on the standard deviation of the amplitude, shape (rows, columns).
    #[getter]
    fn amplitude_bound<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        self.map(py, &self.maps.amplitude_share, 1.0)
    }

    /// Width of a point's image, shape (rows, columns), millimetres.
    #[getter]
    fn spread_mm<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        self.map(py, &self.spread_m, 1e3)
    }

    /// Draws the bound on positions.
    ///
    /// Parameters
    /// ----------
    /// axes : matplotlib.axes.Axes, optional
    ///     Axes to draw on; default: a new figure's.
    ///
    /// Returns
    /// -------
    /// matplotlib.axes.Axes
    #[pyo3(signature = (axes=None))]
    fn plot<'py>(slf: &Bound<'py, Self>, axes: Option<Axes<'py>>) -> PyResult<Axes<'py>> {
        Ok(Axes(slf.py().import("dermis.plot")?.getattr("maps")?.call1((slf, axes))?))
    }

    fn __repr__(&self) -> String {
        format!("<dermis.Maps of {:?}: {} x {}>", self.skin.name, self.maps.grid.rows, self.maps.grid.columns)
    }
}

/// Estimates the cost of manufacturing errors.
#[pyfunction]
#[pyo3(signature = (skin, *, samples=200, presses=12, pokes=None, seed=1))]
pub fn tolerance_rows(
    py: Python<'_>,
    skin: SkinLike<'_>,
    samples: usize,
    presses: usize,
    pokes: Option<Vec<usize>>,
    seed: u64,
) -> PyResult<Vec<(String, usize, [f64; 2], [f64; 2], f64)>> {
    let skin = skin_of(&skin)?;
    // Without this, abandoned work would occupy all threads for minutes.
    let wanted = Arc::new(AtomicBool::new(true));
    let told = wanted.clone();
    let rows = run_interruptibly(py, "tolerances", move || {
        let pokes = pokes.unwrap_or_else(|| vec![20, 50, 200]);
        let extent = Extent { samples, presses, pokes, seed };
        let report = run_tolerances(&skin, &skin.tolerances, &extent, &|_, _| told.load(Ordering::Relaxed))?;
        let rows =
            std::iter::once(report.nominal).chain(report.causes).chain([report.together]).chain(report.calibrated);
        Ok(rows
            .map(|row| (row.name, row.samples, row.position_mm, row.amplitude_percent, row.misses_percent))
            .collect())
    });
    wanted.store(false, Ordering::Relaxed);
    rows
}
