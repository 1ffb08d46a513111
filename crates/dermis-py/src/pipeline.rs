//! [`PyPipeline`]: frames to touches.

use std::path::PathBuf;
use std::sync::Mutex;

use dermis_device::{Frame, HostStamp, Layout};
use dermis_live::calibration::Calibration;
use dermis_live::forces::parse_forces;
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_live::skin_frame::SkinFrame;
use dermis_skin::Skin;
use pyo3::prelude::*;

use crate::arrays::{Array1, Doubles, array1};
use crate::calibration::CalibrationLike;
use crate::calibration::PyCalibration;
use crate::errors::Fault;
use crate::frame::FrameLike;
use crate::frame::PyFrame;
use crate::hints::ArrayLike;
use crate::model::PyModel;
use crate::model::SkinOrModel;
use crate::result::PyFrameResult;
use crate::skin::{PySkin, same_skin, skin_of};
use crate::work::{lock, run, run_briefly, run_interruptibly};

/// Number of frames in which a pipeline may build its operator; the interpreter lock is released during these.
const LEARNING: u64 = 64;

struct Running {
    pipeline: Pipeline,
    /// Reused for frames given as arrays, with their number and time.
    frame: Frame,
    next_sequence: u64,
    origin_ns: Option<u64>,
}

/// From frames to touches: baseline, image, contacts, tracks, health and damage.
///
/// Parameters
/// ----------
/// skin : Skin, Model or str
///     The skin; with its model, nothing has to be solved again.
/// calibration : Calibration or str, optional
///     Made by :func:`calibrate` or ``dermis calibrate``.
/// forces : str, optional
///     A force calibration made by ``dermis calibrate --forces``.
/// hyperparameter : float, optional
///     The number lambda, overriding the skin file's rule.
#[pyclass(frozen, module = "dermis", name = "Pipeline")]
pub struct PyPipeline {
    skin: Skin,
    channels: usize,
    extent_mm: [f64; 4],
    running: Mutex<Running>,
}

/// `left, right, bottom, top` of a skin's images.
pub fn extent_mm(prepared: &Prepared) -> [f64; 4] {
    let grid = prepared.map.grid();
    let (left, top, pixel) = (1e3 * grid.left_m, 1e3 * grid.top_m, 1e3 * grid.pixel_m);
    [left, left + pixel * grid.columns as f64, top - pixel * grid.rows as f64, top]
}

/// A calibration for any value that Python accepts as one: the object, or its file.
pub fn calibration_of(value: Option<&Bound<'_, PyAny>>) -> PyResult<Option<Calibration>> {
    let Some(value) = value else { return Ok(None) };
    if let Ok(calibration) = value.cast::<PyCalibration>() {
        return Ok(Some(calibration.get().calibration.clone()));
    }
    let path: PathBuf = value.extract().map_err(|_| {
        Fault::input("calibration", "a dermis.Calibration or the path of one", crate::arrays::type_name(value))
    })?;
    Ok(Some(Calibration::load(&path).map_err(Fault::from)?))
}

#[pymethods]
impl PyPipeline {
    #[new]
    #[pyo3(signature = (skin, *, calibration=None, forces=None, hyperparameter=None))]
    fn new(
        py: Python<'_>,
        skin: SkinOrModel<'_>,
        calibration: Option<CalibrationLike<'_>>,
        forces: Option<PathBuf>,
        hyperparameter: Option<f64>,
    ) -> PyResult<Self> {
        let of_model = skin.cast::<PyModel>().ok().map(|model| model.get().prepared.clone());
        let skin = match &of_model {
            Some(prepared) => prepared.skin.clone(),
            None => skin_of(&skin)?,
        };
        let calibration = calibration_of(calibration.as_deref())?;
        let forces = match &forces {
            Some(path) => {
                let text = dermis_device::instruments::read_bytes(path).map_err(Fault::from)?;
                Some(parse_forces(&text, path, &skin).map_err(Fault::from)?)
            }
            None => None,
        };
        if let Some(lambda) = hyperparameter {
            let mut imaging = skin.imaging.clone();
            imaging.hyperparameter = dermis_skin::HyperparameterChoice::Number(lambda);
            Skin { imaging, ..skin.clone() }.checked().map_err(Fault::from)?;
        }
        let of = skin.clone();
        let pipeline = run_interruptibly(py, "pipeline", move || {
            let mut prepared = match of_model {
                Some(prepared) => prepared.with_imaging(prepared.skin.imaging.clone())?,
                None => Prepared::new(of)?,
            };
            if let Some(lambda) = hyperparameter {
                let mut imaging = prepared.skin.imaging.clone();
                imaging.hyperparameter = dermis_skin::HyperparameterChoice::Number(lambda);
                prepared = prepared.with_imaging(imaging)?;
            }
            let layout = Layout::Channels { count: prepared.channels() };
            let mut pipeline = Pipeline::new(prepared, &layout, calibration)?;
            if let Some(forces) = forces {
                pipeline.set_forces(forces)?;
            }
            Ok(pipeline)
        })?;
        let (channels, extent_mm) = (pipeline.prepared().channels(), extent_mm(pipeline.prepared()));
        let running = Running { pipeline, frame: Frame::with_capacity(channels), next_sequence: 0, origin_ns: None };
        Ok(Self { skin, channels, extent_mm, running: Mutex::new(running) })
    }

    /// The skin.
    #[getter]
    fn skin(&self) -> PySkin {
        PySkin { skin: self.skin.clone() }
    }

    /// Number of frames processed.
    #[getter]
    fn frames(&self) -> u64 {
        lock(&self.running).pipeline.frames()
    }

    /// True once there is a baseline.
    #[getter]
    fn ready(&self) -> bool {
        lock(&self.running).pipeline.reference().is_some()
    }

    /// Current lambda, once there is a baseline.
    #[getter]
    fn hyperparameter(&self) -> Option<f64> {
        lock(&self.running).pipeline.hyperparameter()
    }

    /// Runs one frame through all stages.
    ///
    /// Parameters
    /// ----------
    /// frame : Frame or array_like
    ///     A frame, or its readings, shape (k,), NaN where missing.
    /// time_s : float, optional
    ///     Time of an array, seconds, increasing; default: now.
    ///
    /// Returns
    /// -------
    /// Result
    ///     The result; until there is a baseline (32 frames), its image is NaN and it has no touches.
    #[pyo3(signature = (frame, *, time_s=None))]
    fn process(&self, py: Python<'_>, frame: FrameLike<'_>, time_s: Option<f64>) -> PyResult<PyFrameResult> {
        if let Some(time_s) = time_s.filter(|time_s| !(0.0..1e9).contains(time_s)) {
            return Err(Fault::input("time_s", "seconds, 0 or more", time_s).into());
        }
        if let Ok(frame) = frame.cast::<PyFrame>() {
            let frame = frame.get();
            if frame.frame.values.len() != self.channels {
                let expected = format!("{} readings, of skin {}", self.channels, self.skin.name);
                return Err(Fault::input("frame", expected, format!("{} readings", frame.frame.values.len())).into());
            }
            return self.work(py, |running| self.result(&mut running.pipeline, &frame.frame, frame.time_s));
        }
        let of = format!("one reading per channel of skin {}", self.skin.name);
        let values = Doubles::vector("frame", &frame, self.channels, &of)?;
        let values = values.values()?;
        if let Some(channel) = values.iter().position(|value| value.is_infinite()) {
            let got = format!("{} at channel {channel}", values[channel]);
            return Err(Fault::input("frame", "finite readings, NaN where missing", got).into());
        }
        self.work(py, |running| {
            let now = HostStamp::now();
            let origin_ns = *running.origin_ns.get_or_insert(now.monotonic_ns);
            let Running { pipeline, frame, next_sequence, .. } = running;
            let given_ns = time_s.map(|time_s| (1e9 * time_s) as u64);
            let monotonic_ns = given_ns.unwrap_or(now.monotonic_ns);
            frame.refill(*next_sequence, HostStamp { monotonic_ns, ..now }, values, &[]);
            frame.device_time_ns = given_ns;
            *next_sequence += 1;
            let shown_s = time_s.unwrap_or(1e-9 * (now.monotonic_ns - origin_ns) as f64);
            self.result(pipeline, frame, shown_s)
        })
    }

    /// Takes the mean of the next frames as the baseline, and returns their number.
    ///
    /// Parameters
    /// ----------
    /// force : bool
    ///     Take it even while something touches the skin.
    #[pyo3(signature = (*, force=false))]
    fn tare(&self, py: Python<'_>, force: bool) -> PyResult<usize> {
        run(py, || Ok(lock(&self.running).pipeline.tare(force, "requested")?))
    }

    /// Requests another lambda, which takes effect 0.3 seconds of frame time later.
    fn set_hyperparameter(&self, py: Python<'_>, hyperparameter: f64) -> PyResult<()> {
        run(py, || Ok(lock(&self.running).pipeline.set_hyperparameter(hyperparameter)?))
    }

    /// The baseline, shape (k,), as measured.
    #[getter]
    fn baseline<'py>(&self, py: Python<'py>) -> Array1<'py, f64> {
        array1(py, lock(&self.running).pipeline.baseline().0.to_vec())
    }

    /// Rejects a model of another skin.
    fn check_model(&self, model: &Bound<'_, PyModel>) -> PyResult<()> {
        Ok(same_skin("model", &self.skin, &model.get().prepared.skin)?)
    }

    fn __repr__(&self) -> String {
        format!("<dermis.Pipeline of {:?}: {} frames>", self.skin.name, self.frames())
    }
}

impl PyPipeline {
    /// Keeps the interpreter lock for fast frames: once the operator is built they take microseconds, which releasing
    /// the lock would double.
    fn work<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut Running) -> Result<T, Fault> + Send) -> PyResult<T> {
        if let Ok(mut running) = self.running.try_lock()
            && running.pipeline.frames() > LEARNING
            && !self.is_slow()
        {
            return run_briefly(|| work(&mut running));
        }
        run(py, || work(&mut lock(&self.running)))
    }

    /// True for skins that take longer than 50 us per frame, because touches are fitted or elements solved for.
    fn is_slow(&self) -> bool {
        self.skin.fits_touches() || self.skin.damage.watch || self.skin.imaging.solve != dermis_skin::Solve::Pixels
    }

    fn result(&self, pipeline: &mut Pipeline, frame: &Frame, time_s: f64) -> Result<PyFrameResult, Fault> {
        let result = pipeline.process(frame, frame.host_monotonic_ns)?.into_owned();
        let result = SkinFrame { time_s, ..result };
        Ok(PyFrameResult::new(result, self.extent_mm, self.skin.modality.image_quantity()))
    }
}

/// Seconds that a pipeline takes for this many frames, cycling through those given, shape (n, k), without using the
/// results; anything beyond it in :meth:`Pipeline.process` is due to Python.
#[pyfunction]
pub fn _seconds_of_frames(
    py: Python<'_>,
    pipeline: &Bound<'_, PyPipeline>,
    frames: ArrayLike<'_>,
    count: usize,
) -> PyResult<f64> {
    let pipeline = pipeline.get();
    let of = format!("one reading per channel of skin {}", pipeline.skin.name);
    let frames = Doubles::rows("frames", &frames, pipeline.channels, &of)?.0;
    let values = frames.values()?;
    run(py, || {
        let mut running = lock(&pipeline.running);
        let Running { pipeline: frames_to_touches, frame, next_sequence, .. } = &mut *running;
        let begun = std::time::Instant::now();
        for row in values.chunks_exact(pipeline.channels).cycle().take(count) {
            let now = HostStamp::now();
            frame.refill(*next_sequence, now, row, &[]);
            frame.device_time_ns = None;
            *next_sequence += 1;
            std::hint::black_box(frames_to_touches.process(frame, now.monotonic_ns)?.touches.len());
        }
        Ok(begun.elapsed().as_secs_f64())
    })
}
