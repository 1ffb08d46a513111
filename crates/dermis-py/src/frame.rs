//! [`PyFrame`]: one frame of readings with its time.

use dermis_device::{Frame, HostStamp};
use pyo3::prelude::*;
use pyo3::type_hint_union;
use pyo3::type_object::PyTypeInfo;

use crate::arrays::{Array1, Doubles, array1};
use crate::errors::Fault;
use crate::hints::{ARRAY_LIKE, AnyArray, ArrayLike, DTypeLike, python_types};

python_types! {
    /// A frame or its readings.
    FrameLike = type_hint_union!(PyFrame::TYPE_HINT, ARRAY_LIKE);
}

/// One frame, as delivered by a twin or an instrument.
///
/// Parameters
/// ----------
/// values : array_like
///     Shape (k,): readings, NaN where missing.
/// sequence : int
///     Sequence number; gaps are lost frames.
/// time_s : float
///     Time on the instrument's clock.
#[pyclass(frozen, module = "dermis", name = "Frame")]
pub struct PyFrame {
    /// The frame in the form that the pipeline takes.
    pub frame: Frame,
    /// Seconds on the clock of the frame's source.
    pub time_s: f64,
}

impl PyFrame {
    /// A frame timed by the device's own clock, so that a run at any pace gives the same touches.
    pub fn timed(sequence: u64, time_s: f64, values: &[f64], imaginary: &[f64]) -> Self {
        let time_ns = (time_s.max(0.0) * 1e9) as u64;
        let mut frame = Frame::with_capacity(values.len());
        frame.refill(
            sequence,
            HostStamp { monotonic_ns: time_ns, wall_ns: HostStamp::now().wall_ns },
            values,
            imaginary,
        );
        frame.device_time_ns = Some(time_ns);
        Self { frame, time_s }
    }
}

#[pymethods]
impl PyFrame {
    #[new]
    #[pyo3(signature = (values, *, sequence=0, time_s=0.0))]
    fn new(values: ArrayLike<'_>, sequence: u64, time_s: f64) -> PyResult<Self> {
        let values = Doubles::of("values", &values)?;
        if values.shape().len() != 1 {
            return Err(Fault::input("values", "shape (k,)", crate::arrays::shape_text(values.shape())).into());
        }
        if !(0.0..1e9).contains(&time_s) {
            return Err(Fault::input("time_s", "seconds, 0 or more", time_s).into());
        }
        Ok(Self::timed(sequence, time_s, values.values()?, &[]))
    }

    /// Readings, shape (k,), in the instrument's unit; NaN where missing.
    #[getter]
    fn values<'py>(&self, py: Python<'py>) -> Array1<'py, f64> {
        array1(py, self.frame.values.clone())
    }

    /// Imaginary parts, shape (k,), or none.
    #[getter]
    fn imaginary<'py>(&self, py: Python<'py>) -> Array1<'py, f64> {
        array1(py, self.frame.imaginary.clone())
    }

    /// The instrument's sequence number of the frame.
    #[getter]
    fn sequence(&self) -> u64 {
        self.frame.sequence
    }

    /// Seconds on the clock of the frame's source.
    #[getter]
    fn time_s(&self) -> f64 {
        self.time_s
    }

    fn __len__(&self) -> usize {
        self.frame.values.len()
    }

    #[pyo3(signature = (dtype=None, copy=None))]
    fn __array__<'py>(
        &self,
        py: Python<'py>,
        dtype: Option<DTypeLike<'py>>,
        copy: Option<bool>,
    ) -> PyResult<AnyArray<'py>> {
        let _ = copy;
        let values = Bound::from(self.values(py));
        Ok(AnyArray(match dtype {
            Some(dtype) => values.call_method1("astype", (dtype,))?,
            None => values.into_any(),
        }))
    }

    fn __repr__(&self) -> String {
        format!("<dermis.Frame {}: {} readings at {:.6} s>", self.frame.sequence, self.frame.values.len(), self.time_s)
    }
}
