//! The compiled half of the Python package `dermis`: its classes and functions, on NumPy arrays. Parts that needn't be
//! fast are written in Python, in `python/dermis`; `_dermis.pyi` and `__init__.py` there list every name in this crate.

mod arrays;
mod calibration;
mod design;
mod eit;
mod errors;
mod frame;
mod grid;
mod learn;
mod mit;
mod model;
mod order;
mod pipeline;
mod python_source;
mod recording;
mod result;
mod session;
mod skin;
mod skin_argument;
mod twin;
mod work;

use std::ffi::OsString;

use pyo3::prelude::*;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Runs the `dermis` command with these arguments, the program's name first, and returns its exit code. Commands that
/// record or serve take over the process's signal handling for good, so run them in a separate process.
#[pyfunction]
fn run_command(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<u8> {
    work::run(py, || Ok(dermis_cli::run_command(arguments)))
}

/// Panics, for tests of how panics are handled.
#[pyfunction]
fn _panic(py: Python<'_>) -> PyResult<()> {
    work::run(py, || panic!("a test asked for this"))
}

/// The compiled half of the package `dermis`.
#[pymodule(gil_used = true)]
fn _dermis(module: &Bound<'_, PyModule>) -> PyResult<()> {
    work::remember_process();
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<skin::PySkin>()?;
    module.add_class::<model::PyModel>()?;
    module.add_class::<grid::PyGrid>()?;
    module.add_class::<frame::PyFrame>()?;
    module.add_class::<twin::PyTwin>()?;
    module.add_class::<pipeline::PyPipeline>()?;
    module.add_class::<result::PyFrameResult>()?;
    module.add_class::<session::PySession>()?;
    module.add_class::<recording::PyRecording>()?;
    module.add_class::<calibration::PyCalibration>()?;
    module.add_class::<design::PyMaps>()?;
    module.add_class::<learn::PyNetwork>()?;
    module.add_class::<eit::mesh::PyMesh>()?;
    module.add_class::<eit::mesh::PyElectrode>()?;
    module.add_class::<eit::protocol::PyProtocol>()?;
    module.add_class::<eit::forward::PyForwardModel>()?;
    module.add_class::<eit::operator::PyPrior>()?;
    module.add_class::<eit::operator::PyOperator>()?;
    module.add_class::<mit::PyCoils>()?;
    module.add_class::<mit::PyBody>()?;
    module.add_function(wrap_pyfunction!(session::open, module)?)?;
    module.add_function(wrap_pyfunction!(recording::read_frames, module)?)?;
    module.add_function(wrap_pyfunction!(order::search_order, module)?)?;
    module.add_function(wrap_pyfunction!(order::estimate_conductance, module)?)?;
    module.add_function(wrap_pyfunction!(calibration::calibrate, module)?)?;
    module.add_function(wrap_pyfunction!(design::design, module)?)?;
    module.add_function(wrap_pyfunction!(design::tolerance_rows, module)?)?;
    module.add_function(wrap_pyfunction!(learn::create_train_set, module)?)?;
    module.add_function(wrap_pyfunction!(learn::write_shard, module)?)?;
    module.add_function(wrap_pyfunction!(eit::figures::greit_figures, module)?)?;
    module.add_function(wrap_pyfunction!(pipeline::_seconds_of_frames, module)?)?;
    module.add_function(wrap_pyfunction!(run_command, module)?)?;
    module.add_function(wrap_pyfunction!(_panic, module)?)?;
    Ok(())
}
