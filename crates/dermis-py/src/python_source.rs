//! A source written in Python: an iterable of frames, or a function that is called for each.

use std::time::Duration;

use dermis_device::{Counters, DeviceError, Frame, HostStamp, Layout, Source, SourceEvent};
use numpy::{PyArray1, PyArrayMethods};
use pyo3::exceptions::PyStopIteration;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::arrays::type_name;

/// Delay before calling a function again that had no frame.
const NAP: Duration = Duration::from_millis(2);

/// Frames of a Python object, taken in the session's own thread.
pub struct PythonSource {
    /// An iterator, or a function without arguments.
    object: Py<PyAny>,
    is_function: bool,
    layout: Layout,
    name: String,
    counters: Counters,
    ended: bool,
}

impl PythonSource {
    /// A source from an iterable or a callable that yields frames with this number of channels.
    pub fn new(object: &Bound<'_, PyAny>, channels: usize) -> PyResult<Self> {
        let is_function = object.is_callable() && !object.hasattr("__iter__")?;
        let name = format!("Python {}", type_name(object));
        let object = if is_function { object.clone() } else { object.try_iter()?.into_any() };
        Ok(Self {
            object: object.unbind(),
            is_function,
            layout: Layout::Channels { count: channels },
            name,
            counters: Counters::default(),
            ended: false,
        })
    }

    /// Takes the next frame; `None` if the source has ended, `Some(false)` if there is no frame yet.
    fn take(&self, py: Python<'_>, frame: &mut Frame) -> Result<Option<bool>, String> {
        let object = self.object.bind(py);
        let said = |error: PyErr| format!("frame {}: {error}", self.counters.frames);
        let value = if self.is_function { object.call0() } else { object.call_method0("__next__") };
        let value = match value {
            Ok(value) => value,
            Err(error) if error.is_instance_of::<PyStopIteration>(py) => return Ok(None),
            Err(error) => return Err(said(error)),
        };
        if value.is_none() {
            return Ok(Some(false));
        }
        // Either (time_s, readings) or just readings.
        let is_pair = |pair: &&Bound<'_, PyTuple>| {
            pair.len() == 2 && pair.get_item(1).is_ok_and(|second| second.hasattr("__len__").unwrap_or(false))
        };
        let pair = value.cast::<PyTuple>().ok().filter(is_pair).cloned();
        let (time_s, readings) = match pair {
            Some(pair) => {
                let time_s: f64 = pair.get_item(0).and_then(|time| time.extract()).map_err(said)?;
                (Some(time_s), pair.get_item(1).map_err(said)?)
            }
            None => (None, value),
        };
        let device_time_ns = match time_s {
            Some(time_s) if (0.0..1e10).contains(&time_s) => Some((1e9 * time_s) as u64),
            Some(time_s) => {
                let number = self.counters.frames;
                return Err(format!("frame {number}: expected (time in seconds, readings), got a time of {time_s}"));
            }
            None => None,
        };
        let (real, imaginary) = numbers(&readings).map_err(said)?;
        let channels = self.layout.channels();
        if real.len() != channels {
            let number = self.counters.frames;
            return Err(format!("frame {number}: expected {channels} readings, as the skin has, got {}", real.len()));
        }
        frame.refill(self.counters.frames, HostStamp::now(), &real, &imaginary);
        frame.device_time_ns = device_time_ns;
        Ok(Some(true))
    }
}

/// Real and imaginary parts of one frame; no imaginary parts for real readings.
fn numbers(readings: &Bound<'_, PyAny>) -> PyResult<(Vec<f64>, Vec<f64>)> {
    let numpy = readings.py().import("numpy")?;
    let array = numpy.call_method1("asarray", (readings,))?.call_method0("ravel")?;
    let is_complex = array.getattr("dtype")?.getattr("kind")?.extract::<String>()? == "c";
    let part = |name: &str| -> PyResult<Vec<f64>> {
        let part = if is_complex { array.getattr(name)? } else { array.clone() };
        let part = numpy.call_method1("ascontiguousarray", (part, "float64"))?;
        Ok(part.cast_into::<PyArray1<f64>>()?.to_vec()?)
    };
    Ok((part("real")?, if is_complex { part("imag")? } else { Vec::new() }))
}

impl Source for PythonSource {
    fn layout(&self) -> &Layout {
        &self.layout
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn next_frame(&mut self, frame: &mut Frame, timeout: Duration) -> Result<SourceEvent, DeviceError> {
        if self.ended {
            return Ok(SourceEvent::End);
        }
        // An interpreter that is shutting down yields nothing more.
        let taken = Python::try_attach(|py| self.take(py, frame)).unwrap_or(Ok(None));
        match taken {
            Ok(Some(true)) => {
                self.counters.frames += 1;
                Ok(SourceEvent::Frame)
            }
            Ok(Some(false)) => {
                std::thread::sleep(NAP.min(timeout));
                Ok(SourceEvent::Idle)
            }
            Ok(None) => {
                self.ended = true;
                Ok(SourceEvent::End)
            }
            Err(reason) => {
                self.ended = true;
                Err(DeviceError::SourceFailed { name: self.name.clone(), reason })
            }
        }
    }

    fn counters(&self) -> Counters {
        self.counters
    }
}
