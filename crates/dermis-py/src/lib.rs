//! The compiled half of the Python package `dermis`: its classes and functions, on NumPy arrays. Parts that needn't be
//! fast are written in Python, in `python/dermis`; `__init__.py` there lists every public name, and `_dermis.pyi` has
//! the types of this crate as `scripts/stubs.py` writes them.

mod arrays;
mod calibration;
mod design;
mod eit;
mod errors;
mod frame;
mod grid;
mod hints;
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
mod _dermis {
    #[pymodule_export]
    use super::{
        _panic, calibration::PyCalibration, calibration::calibrate, design::PyMaps, design::design,
        design::tolerance_rows, eit::figures::greit_figures, eit::forward::PyForwardModel, eit::mesh::PyElectrode,
        eit::mesh::PyMesh, eit::operator::PyOperator, eit::operator::PyPrior, eit::protocol::PyProtocol,
        frame::PyFrame, grid::PyGrid, learn::PyNetwork, learn::create_train_set, learn::write_shard, mit::PyBody,
        mit::PyCoils, model::PyModel, order::estimate_conductance, order::search_order, pipeline::_seconds_of_frames,
        pipeline::PyPipeline, recording::PyRecording, recording::read_frames, result::PyFrameResult, run_command,
        session::PySession, session::open, skin::PySkin, twin::PyTwin,
    };

    #[pymodule_export]
    #[allow(non_upper_case_globals)]
    const __version__: &str = env!("CARGO_PKG_VERSION");

    #[pymodule_init]
    fn remember_process() {
        super::work::remember_process();
    }
}
