//! [`PySession`]: a source read by a separate thread, and its pipeline.

use std::path::PathBuf;
use std::sync::Mutex;
use std::time::Duration;

use dermis_cli::LivePage;
use dermis_cli::sources::{Opened, SourceOptions, TwinControl, open_of};
use dermis_device::acquire::{Acquisition, Next};
use dermis_lab::twin_source::TwinCommand;
use dermis_live::pipeline::Pipeline;
use dermis_record::RecordingHead;
use dermis_skin::Skin;
use dermis_twin::mechanics::{Indenter, Shape};
use pyo3::prelude::*;

use crate::errors::{Fault, Kind};
use crate::hints::{Exception, ExceptionClass, Named, SessionArrays, Source, Traceback};
use crate::pipeline::extent_mm;
use crate::python_source::PythonSource;
use crate::result::PyFrameResult;
use crate::skin::{PySkin, skin_of};
use crate::skin_argument::SkinLike;
use crate::twin::radius_and_load;
use crate::work::{lock, run, run_interruptibly};

/// Frames that may queue between source and pipeline, as in `dermis run`.
const QUEUE: usize = 128;
/// The same for a twin that can wait for its frames to be taken. As small as possible, so that a press shows within a
/// few frames.
const TWIN_QUEUE: usize = 2;
/// Longest wait for a frame between checks for Ctrl-C.
const PATIENCE: Duration = Duration::from_millis(50);

struct Running {
    acquisition: Acquisition,
    pipeline: Pipeline,
    twin: Option<TwinControl>,
    frames: u64,
    /// Head of recordings made from the page.
    head: RecordingHead,
    page: Option<LivePage>,
}

impl Running {
    /// Tells the page that the source has ended.
    fn end(&mut self) -> Result<Step, Fault> {
        if let Some(page) = &mut self.page {
            page.end()?;
        }
        Ok(Step::End)
    }
}

/// Result of a step of a session.
enum Step {
    Result(Box<PyFrameResult>),
    Idle,
    End,
}

/// Frames from a source, processed by a pipeline.
#[pyclass(frozen, module = "dermis", name = "Session")]
pub struct PySession {
    selector: String,
    skin: Skin,
    most: Option<u64>,
    extent_mm: [f64; 4],
    opened_in: u32,
    running: Mutex<Option<Running>>,
}

/// Opens a source of frames and a pipeline for it.
///
/// Parameters
/// ----------
/// source : str, os.PathLike, iterable or callable
///     One of ``twin:NAME``, ``tcp:HOST:PORT``, ``serial:PORT``, or a file: a recording (.mcap), or anything that
///     ``dermis reconstruct`` reads. Or an iterable of frames, or a function that is called for each frame. A frame
///     is an array of shape (k,), real or complex, or a pair (time in seconds, array). A function returns None if
///     there is no frame yet, and raises StopIteration at the end. Both are called from a thread of the session.
/// skin : Skin or str, optional
///     Skin of the frames, if the source doesn't name it; default: healing-square.
/// frames : int, optional
///     Stop after this many frames.
/// speed : float
///     Speed of twins and files: 1 in real time, 0 as fast as frames are requested.
/// calibration, forces : str or os.PathLike, optional
///     Files made by ``dermis calibrate``.
/// as_set : bool
///     Keep the settings of an instrument on the wire.
/// as_skin : bool
///     Accept a recording and calibrations of another skin as `skin`'s.
///
/// Returns
/// -------
/// Session
///     An iterator over results, and a context manager.
///
/// Raises
/// ------
/// Error
///     A source or a skin cannot be opened.
#[pyfunction]
#[pyo3(signature = (source, skin=None, *, frames=None, speed=0.0, calibration=None, forces=None, as_set=false, as_skin=false))]
pub fn open(
    py: Python<'_>,
    source: Source<'_>,
    skin: Option<SkinLike<'_>>,
    frames: Option<u64>,
    speed: f64,
    calibration: Option<PathBuf>,
    forces: Option<PathBuf>,
    as_set: bool,
    as_skin: bool,
) -> PyResult<PySession> {
    if !(speed >= 0.0 && speed.is_finite()) {
        return Err(Fault::input("speed", "0 (as fast as possible) or a positive number", speed).into());
    }
    let given = skin.as_deref().map(skin_of).transpose()?;
    if as_skin && given.is_none() {
        return Err(Fault::input("as_skin", "a skin to read the frames as", "none").into());
    }
    let path = source.extract::<PathBuf>().ok();
    let own = match &path {
        Some(_) => None,
        None => {
            let skin = given
                .clone()
                .ok_or_else(|| Fault::input("skin", "a skin with a source of your own, for its channels", "none"))?;
            let channels = skin.protocol().map_err(Fault::from)?.channel_count();
            let made = PythonSource::new(&source, channels).map_err(|_| {
                let expected = "a text, a path, an iterable of frames, or a function that returns one";
                Fault::input("source", expected, crate::arrays::type_name(&source))
            })?;
            Some((skin, made))
        }
    };
    let selector = match (&path, &own) {
        (Some(path), _) => path.to_string_lossy().into_owned(),
        (None, Some((_, own))) => dermis_device::Source::name(own).to_owned(),
        (None, None) => String::new(),
    };
    let named = selector.clone();
    let (opened, mut pipeline, head) = run_interruptibly(py, "open", move || {
        if let Some((skin, own)) = own {
            let mut opened = Opened::of(skin, Box::new(own));
            let (pipeline, head) = opened.pipeline(calibration.as_deref(), forces.as_deref())?;
            return Ok((opened, pipeline, head));
        }
        let find = |name: Option<&str>| -> anyhow::Result<Skin> {
            match (name, &given) {
                (Some(name), _) => Ok(Skin::open(name)?),
                (None, Some(skin)) => Ok(skin.clone()),
                (None, None) => Ok(Skin::open(dermis_skin::DEFAULT_NAME)?),
            }
        };
        let options = SourceOptions { speed, as_set, as_skin, ..SourceOptions::default() };
        let mut opened = open_of(&named, &find, given.as_ref(), &options)?;
        let (pipeline, head) = opened.pipeline(calibration.as_deref(), forces.as_deref())?;
        Ok((opened, pipeline, head))
    })?;
    let Opened { skin, source, twin, wait, .. } = opened;
    pipeline.set_live(!wait);
    let extent_mm = extent_mm(pipeline.prepared());
    let queue = if (twin.is_some() || path.is_none()) && wait { TWIN_QUEUE } else { QUEUE };
    let acquisition = Acquisition::spawn(source, queue, wait);
    let running = Running { acquisition, pipeline, twin, frames: 0, head, page: None };
    Ok(PySession {
        selector,
        skin,
        most: frames,
        extent_mm,
        opened_in: std::process::id(),
        running: Mutex::new(Some(running)),
    })
}

impl PySession {
    /// Rejects a session that is closed, or whose thread is in another process.
    fn with<T>(&self, work: impl FnOnce(&mut Running) -> Result<T, Fault>) -> Result<T, Fault> {
        let here = std::process::id();
        if here != self.opened_in {
            let words = format!(
                "session of {}: expected to be used in the process that opened it ({}), got process {here}, forked from it",
                self.selector, self.opened_in
            );
            return Err(Fault::new(Kind::Session, words));
        }
        match lock(&self.running).as_mut() {
            Some(running) => work(running),
            None => {
                let words = format!("session of {}: expected an open session, got one that is closed", self.selector);
                Err(Fault::new(Kind::Session, words))
            }
        }
    }

    fn step(&self) -> Result<Step, Fault> {
        self.with(|running| {
            if self.most.is_some_and(|most| running.frames >= most) {
                return running.end();
            }
            if let Some(page) = &mut running.page {
                page.answer(&mut running.pipeline);
            }
            let frame = match running.acquisition.next(PATIENCE)? {
                Next::Frame(frame) => frame,
                Next::Idle => {
                    running.page.as_mut().map_or(Ok(()), |page| page.wait(&running.acquisition))?;
                    return Ok(Step::Idle);
                }
                Next::End => return running.end(),
            };
            running.frames += 1;
            if let Some(page) = &mut running.page {
                page.record(&frame);
            }
            let baselines = running.pipeline.baseline_records().len();
            let now_ns = dermis_device::HostStamp::now().monotonic_ns;
            let output = running.pipeline.process(&frame, now_ns)?;
            if let Some(page) = &mut running.page {
                page.show(&output);
            }
            let quantity = self.skin.modality.image_quantity();
            let result = PyFrameResult::new(output.into_owned(), self.extent_mm, quantity);
            if let Some(page) = &mut running.page {
                let is_renewed = running.pipeline.baseline_records().len() > baselines;
                page.after(&running.acquisition, &running.pipeline, is_renewed.then_some(frame.host_wall_ns))?;
            }
            running.acquisition.recycle(frame);
            Ok(Step::Result(Box::new(result)))
        })
    }

    fn command(&self, command: TwinCommand) -> Result<(), Fault> {
        self.with(|running| match &running.twin {
            Some(twin) => {
                let sent = twin.commands.send(command);
                sent.map_err(|error| Fault::new(Kind::Source, format!("session of {}: {error}", self.selector)))
            }
            None => Err(Fault::input("press", "the session of a twin", format!("one of {}", self.selector))),
        })
    }
}

#[pymethods]
impl PySession {
    fn __iter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<PyFrameResult>> {
        loop {
            match run(py, || self.step())? {
                Step::Result(result) => return Ok(Some(*result)),
                Step::End => return Ok(None),
                Step::Idle => py.check_signals()?,
            }
        }
    }

    fn __enter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    #[pyo3(signature = (_class=None, _error=None, _traceback=None))]
    fn __exit__(
        &self,
        py: Python<'_>,
        _class: Option<ExceptionClass<'_>>,
        _error: Option<Exception<'_>>,
        _traceback: Option<Traceback<'_>>,
    ) -> PyResult<()> {
        self.close(py)
    }

    /// Stops reading, ends a recording started from the page, and closes the page. Closing a closed session has no
    /// effect.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        run(py, || {
            if std::process::id() != self.opened_in {
                return Ok(());
            }
            let running = lock(&self.running).take();
            if let Some(Running { page: Some(page), acquisition, .. }) = running {
                drop(acquisition);
                page.close();
            }
            Ok(())
        })
    }

    /// Runs to the end, and returns times (n,), readings (n, k) and images (n, rows, columns).
    fn asnumpy<'py>(slf: &Bound<'py, Self>) -> PyResult<SessionArrays<'py>> {
        Ok(SessionArrays(slf.py().import("dermis._tables")?.getattr("session_arrays")?.call1((slf,))?))
    }

    /// Opens the live page of this session's own frames in a browser.
    ///
    /// The page is served by this process and shows every frame taken from the session, so it moves while a loop runs
    /// over the session. Requests from the page (tare, lambda, presses on a twin, recordings) are carried out before
    /// the next frame. The page closes with the session.
    ///
    /// Parameters
    /// ----------
    /// port : int
    ///     Port on this machine's own address; default: any free one.
    /// browser : bool
    ///     Ask a browser to open it.
    ///
    /// Returns
    /// -------
    /// str
    ///     The page's address, which is the same at every call.
    #[pyo3(signature = (*, port=0, browser=true))]
    fn show(&self, py: Python<'_>, port: u16, browser: bool) -> PyResult<String> {
        run(py, || {
            self.with(|running| {
                let page = match &running.page {
                    Some(page) => page,
                    None => {
                        let (twin, head) = (running.twin.clone(), running.head.clone());
                        running.page.insert(LivePage::serve(port, twin, head, &running.pipeline)?)
                    }
                };
                if browser {
                    page.open_browser();
                }
                Ok(page.url())
            })
        })
    }

    /// True once closed, and in a process forked from the one that opened it.
    #[getter]
    fn closed(&self) -> bool {
        // After a fork a lock held by another thread stays locked for ever.
        std::process::id() != self.opened_in || lock(&self.running).is_none()
    }

    /// The opened source.
    #[getter]
    fn source(&self) -> &str {
        &self.selector
    }

    /// The skin.
    #[getter]
    fn skin(&self) -> PySkin {
        PySkin { skin: self.skin.clone() }
    }

    /// Numbers of frames delivered, and dropped, lost, damaged and repeated on the way.
    #[getter]
    fn counters<'py>(&self, py: Python<'py>) -> PyResult<Named<'py, u64>> {
        let (frames, counters) = run(py, || self.with(|running| Ok((running.frames, running.acquisition.counters()))))?;
        Named::of(
            py,
            [
                ("frames", frames),
                ("dropped", counters.dropped),
                ("lost", counters.lost),
                ("damaged", counters.bad),
                ("repeated", counters.repeated),
            ],
        )
    }

    /// Takes a new baseline, like :meth:`Pipeline.tare`.
    #[pyo3(signature = (*, force=false))]
    fn tare(&self, py: Python<'_>, force: bool) -> PyResult<usize> {
        run(py, || self.with(|running| Ok(running.pipeline.tare(force, "requested")?)))
    }

    /// Requests another lambda, which takes effect 0.3 seconds of frame time later.
    fn set_hyperparameter(&self, py: Python<'_>, hyperparameter: f64) -> PyResult<()> {
        run(py, || self.with(|running| Ok(running.pipeline.set_hyperparameter(hyperparameter)?)))
    }

    /// Presses a session's twin, starting with one of its next frames.
    ///
    /// Parameters
    /// ----------
    /// x_mm, y_mm : float
    ///     Position, from the skin's centre.
    /// radius_mm, force_n : float, optional
    ///     Radius and force; default: the skin's usual press.
    /// pressure_kpa : float, optional
    ///     Mean pressure, instead of a force.
    /// pointer : int
    ///     Identifies the press, since several are possible at once.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The position is off the skin, a number is invalid, or the session's source is not a twin.
    #[pyo3(signature = (x_mm, y_mm, radius_mm=None, force_n=None, *, pressure_kpa=None, pointer=1))]
    fn press(
        &self,
        py: Python<'_>,
        x_mm: f64,
        y_mm: f64,
        radius_mm: Option<f64>,
        force_n: Option<f64>,
        pressure_kpa: Option<f64>,
        pointer: u64,
    ) -> PyResult<()> {
        run(py, || {
            let range = self.with(|running| Ok(running.twin.as_ref().map(|twin| twin.press)))?;
            let usual = range.map_or((5e-3, 5e4), |range| (range.initial_radius_m, range.initial_pressure_pa));
            let (radius_m, load) = radius_and_load(radius_mm, force_n, pressure_kpa, usual)?;
            let position_m = [1e-3 * x_mm, 1e-3 * y_mm];
            let pressure_pa = Indenter { centre_m: position_m, shape: Shape::Disc { radius_m }, load }.pressure_pa();
            // Check here, because the twin's thread cannot report an invalid press.
            if !self.skin.outline().contains(position_m) {
                return Err(Fault::input("press", "a place on the skin", format!("({x_mm}, {y_mm}) mm")));
            }
            if !(radius_m > 0.0 && radius_m.is_finite()) {
                return Err(Fault::input("radius_mm", "a positive number", 1e3 * radius_m));
            }
            if !(pressure_pa >= 0.0 && pressure_pa.is_finite()) {
                return Err(Fault::input("press", "a pressure or force of 0 or above", format!("{pressure_pa} Pa")));
            }
            self.command(TwinCommand::Press { pointer, position_m, radius_m, pressure_pa })
        })
    }

    /// Ends a press on a session's twin.
    #[pyo3(signature = (pointer=1))]
    fn release(&self, py: Python<'_>, pointer: u64) -> PyResult<()> {
        run(py, || self.command(TwinCommand::Release { pointer }))
    }

    fn __repr__(&self) -> String {
        let state = if self.closed() { "closed" } else { "open" };
        format!("<dermis.Session of {}: {state}>", self.selector)
    }
}

impl Drop for PySession {
    fn drop(&mut self) {
        if std::process::id() != self.opened_in {
            // The threads to join are in the parent, and so may be the holder of the lock.
            let running = std::mem::replace(&mut self.running, Mutex::new(None));
            std::mem::forget(running);
            return;
        }
        // The thread to join may be waiting for the interpreter lock, which is held here.
        let running = std::mem::replace(&mut self.running, Mutex::new(None));
        let mut running = Some(running);
        Python::try_attach(|py| py.detach(|| drop(running.take())));
    }
}
