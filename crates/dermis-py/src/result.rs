//! [`PyFrameResult`]: the pipeline's results for one frame, as arrays made on demand.

use std::collections::BTreeMap;

use dermis_device::HostStamp;
use dermis_live::skin_frame::SkinFrame;
use dermis_record::TouchEntry;
use dermis_touch::TouchPhase;
use dermis_touch::guard::GuardReason;
use numpy::PyArray2;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyDict, PyList};

use crate::arrays::{Array1, Array2, array1, array2};
use crate::hints::{Axes, DamageWatch, Guard, Health, Touches};

/// A touch in numbers: id, phase, then x_mm, y_mm, force_n, amplitude, area_mm2, sigma_x_mm, sigma_y_mm, radius_mm,
/// other_x_mm, other_y_mm, other_probability.
pub type TouchRow = (u64, &'static str, [f64; NUMBERS]);
const NUMBERS: usize = 11;

fn phase_name(phase: TouchPhase) -> &'static str {
    match phase {
        TouchPhase::Begin => "begin",
        TouchPhase::Move => "move",
        TouchPhase::End => "end",
    }
}

/// x_mm, y_mm and probability of an alternative position, from its position (metres) and probability.
fn other_numbers(other: Option<([f64; 2], f64)>) -> [f64; 3] {
    other.map_or([f64::NAN, f64::NAN, 0.0], |([x, y], probability)| [1e3 * x, 1e3 * y, probability])
}

/// The row of a touch.
pub fn row_of(touch: &TouchEntry) -> TouchRow {
    let ([x, y], [sx, sy]) = (touch.position_m, touch.sigma_m);
    let [other_x, other_y, other_probability] =
        other_numbers(touch.other_place.map(|other| (other.position_m, other.probability)));
    let values = [
        1e3 * x,
        1e3 * y,
        touch.force_n,
        touch.amplitude,
        1e6 * touch.area_m2,
        1e3 * sx,
        1e3 * sy,
        1e3 * touch.radius_m,
        other_x,
        other_y,
        other_probability,
    ];
    (touch.id, phase_name(touch.phase), values)
}

/// Rows as the structured array of `dermis._tables.touches`.
pub fn table_of<'py>(py: Python<'py>, rows: &[TouchRow]) -> PyResult<Touches<'py>> {
    let ids = array1(py, rows.iter().map(|row| row.0).collect());
    let phases = PyList::new(py, rows.iter().map(|row| row.1))?;
    let values = array2(py, rows.iter().flat_map(|row| row.2).collect(), rows.len(), NUMBERS)?;
    Ok(Touches(py.import("dermis._tables")?.getattr("touches")?.call1((ids, phases, values))?))
}

/// Results for one frame.
#[pyclass(frozen, module = "dermis", name = "Result")]
pub struct PyFrameResult {
    frame: SkinFrame<'static>,
    extent_mm: [f64; 4],
    quantity: &'static str,
    shown: PyOnceLock<Py<PyArray2<f32>>>,
    table: PyOnceLock<Py<PyAny>>,
}

impl PyFrameResult {
    /// Results with the bounds and the quantity of their image.
    pub fn new(frame: SkinFrame<'static>, extent_mm: [f64; 4], quantity: &'static str) -> Self {
        Self { frame, extent_mm, quantity, shown: PyOnceLock::new(), table: PyOnceLock::new() }
    }
}

#[pymethods]
impl PyFrameResult {
    /// Sequence number of the frame.
    #[getter]
    fn sequence(&self) -> u64 {
        self.frame.sequence
    }

    /// Time of the frame, seconds.
    #[getter]
    fn time_s(&self) -> f64 {
        self.frame.time_s
    }

    /// The host's wall clock at the frame's first byte, nanoseconds since 1970-01-01 UTC: ``time.time_ns()``.
    #[getter]
    fn wall_ns(&self) -> u64 {
        self.frame.wall_ns
    }

    /// The system's monotonic clock at the frame's first byte, nanoseconds: ``time.monotonic_ns()`` on Linux. It is
    /// common to all processes of a machine.
    #[getter]
    fn monotonic_ns(&self) -> u64 {
        HostStamp::on_system_clock(self.frame.time_ns)
    }

    /// The device's own clock, nanoseconds, or None.
    #[getter]
    fn device_ns(&self) -> Option<u64> {
        self.frame.device_time_ns
    }

    /// True if there was a baseline.
    #[getter]
    fn ready(&self) -> bool {
        self.frame.is_ready
    }

    /// Readings, shape (k,), in the skin's order.
    #[getter]
    fn raw<'py>(&self, py: Python<'py>) -> Array1<'py, f64> {
        array1(py, self.frame.raw.to_vec())
    }

    /// Readings minus the baseline, shape (k,).
    #[getter]
    fn compensated<'py>(&self, py: Python<'py>) -> Array1<'py, f64> {
        array1(py, self.frame.compensated.to_vec())
    }

    /// The image, shape (rows, columns), float32, row 0 at the top, NaN outside the skin.
    #[getter]
    fn image<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f32>> {
        let SkinFrame { image, rows, columns, .. } = &self.frame;
        let make = || Ok::<_, PyErr>(array2(py, image.to_vec(), *rows, *columns)?.unbind());
        Ok(self.shown.get_or_try_init(py, make)?.bind(py).clone().into())
    }

    /// Left, right, bottom and top of the image, millimetres.
    #[getter]
    fn extent_mm(&self) -> [f64; 4] {
        self.extent_mm
    }

    /// Quantity of the image's values.
    #[getter]
    fn image_quantity(&self) -> &'static str {
        self.quantity
    }

    /// Touches as a structured array of ``dermis.touch_dtype``: ``id``, ``phase``, ``x_mm``, ``y_mm``, ``force_n``,
    /// ``amplitude``, ``area_mm2``, ``sigma_x_mm``, ``sigma_y_mm``, ``radius_mm``; NaN where unknown. Touches that
    /// have just ended have the phase ``end``.
    #[getter]
    fn touches<'py>(&self, py: Python<'py>) -> PyResult<Touches<'py>> {
        let SkinFrame { touches, ended, .. } = &self.frame;
        let rows = || touches.iter().chain(ended.iter()).map(|touch| row_of(&touch.into())).collect::<Vec<_>>();
        let make = || Ok::<_, PyErr>(table_of(py, &rows())?.0.unbind());
        Ok(Touches(self.table.get_or_try_init(py, make)?.bind(py).clone()))
    }

    /// ``sound``; ``frame`` (fault of the frames as a whole: ``"frozen"``, ``"saturated"``, ``"flipped"``,
    /// ``"out-of-range"``, ``"blank"``, or None); the ``channels`` left out, with their faults; and the faulty
    /// ``electrodes``, from 0.
    #[getter]
    fn health<'py>(&self, py: Python<'py>) -> PyResult<Health<'py>> {
        let health = PyDict::new(py);
        let known = &self.frame.health;
        let channels: BTreeMap<_, _> = known.channels.iter().map(|fault| (fault.channel, fault.kind.name())).collect();
        let electrodes: Vec<u32> = known.electrodes.iter().map(|fault| fault.electrode).collect();
        health.set_item("sound", known.is_sound())?;
        health.set_item("frame", known.frame.map(|fault| fault.kind.name()))?;
        health.set_item("channels", channels)?;
        health.set_item("electrodes", electrodes)?;
        Ok(Health(health.into_any()))
    }

    /// The guard's ``verdict`` (``"ok"``, ``"stale"`` or ``"stop"``), its ``reasons``, and ``safety_rated``, which is
    /// False; None if the skin file has no ``[guard]``.
    #[getter]
    fn guard<'py>(&self, py: Python<'py>) -> PyResult<Option<Guard<'py>>> {
        let Some(report) = self.frame.guard else { return Ok(None) };
        let guard = PyDict::new(py);
        guard.set_item("verdict", report.verdict.name())?;
        guard.set_item("reasons", report.reasons.iter().map(GuardReason::name).collect::<Vec<_>>())?;
        guard.set_item("safety_rated", false)?;
        Ok(Some(Guard(guard.into_any())))
    }

    /// ``watched``, a list of ``damages``, and a ``proposal`` of a new baseline, or None.
    #[getter]
    fn damage<'py>(&self, py: Python<'py>) -> PyResult<DamageWatch<'py>> {
        let list = PyList::empty(py);
        for damage in self.frame.damage.damages.iter() {
            let shape = &damage.shape;
            let row = PyDict::new(py);
            row.set_item("id", damage.id)?;
            row.set_item("state", damage.state.name())?;
            row.set_item("x_mm", 1e3 * shape.centre_m[0])?;
            row.set_item("y_mm", 1e3 * shape.centre_m[1])?;
            row.set_item("length_mm", 1e3 * shape.length_m)?;
            row.set_item("width_mm", 1e3 * shape.width_m)?;
            row.set_item("direction_deg", shape.direction_rad.to_degrees())?;
            row.set_item("depth", damage.depth)?;
            row.set_item("share", damage.share)?;
            list.append(row)?;
        }
        let seen = PyDict::new(py);
        seen.set_item("watched", self.frame.damage.watched)?;
        seen.set_item("damages", list)?;
        seen.set_item("proposal", self.frame.damage.proposal.map(|_| "a new baseline is proposed"))?;
        Ok(DamageWatch(seen.into_any()))
    }

    /// Draws image and touches.
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
        Ok(Axes(slf.py().import("dermis.plot")?.getattr("result")?.call1((slf, axes))?))
    }

    fn _repr_html_(slf: &Bound<'_, Self>) -> PyResult<String> {
        slf.py().import("dermis._tables")?.getattr("result_html")?.call1((slf,))?.extract()
    }

    fn __repr__(&self) -> String {
        let SkinFrame { sequence, time_s, is_ready, touches, ended, .. } = &self.frame;
        let learns = if *is_ready { "" } else { ", learning its baseline" };
        format!("<dermis.Result {sequence} at {time_s:.3} s: {} touches{learns}>", touches.len() + ended.len())
    }
}
