//! Runs work for Python: without the interpreter lock, with panics turned into exceptions and Ctrl-C handled. A forked
//! process has none of its parent's threads, so it gets its own.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, mpsc};
use std::time::{Duration, Instant};

use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::errors::{Fault, Kind};

/// Interval between checks for Ctrl-C.
const SIGNALS: Duration = Duration::from_millis(50);
/// Time that work may take before its progress is shown.
const QUIET: Duration = Duration::from_secs(1);

/// The process that loaded this library.
static LOADED_IN: OnceLock<u32> = OnceLock::new();

/// Records the current process; called once, when the library is loaded.
pub fn remember_process() {
    let _ = LOADED_IN.set(std::process::id());
}

/// Threads of a forked process. The parent's are left alone, because joining threads that don't exist would wait for
/// ever.
static OWN_THREADS: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// Locks a mutex even if it was poisoned by a panic elsewhere.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn own_threads() -> Result<Option<Arc<ThreadPool>>, Fault> {
    let here = std::process::id();
    if LOADED_IN.get() == Some(&here) {
        return Ok(None);
    }
    let mut kept = lock(&OWN_THREADS);
    if let Some((process, threads)) = kept.as_ref()
        && *process == here
    {
        return Ok(Some(threads.clone()));
    }
    let threads = Arc::new(pool(0)?);
    if let Some(inherited) = kept.replace((here, threads.clone())) {
        std::mem::forget(inherited);
    }
    Ok(Some(threads))
}

/// A pool with this number of threads; 0 for as many as there are processors.
pub fn pool(threads: usize) -> Result<ThreadPool, Fault> {
    let made = ThreadPoolBuilder::new().num_threads(threads).build();
    made.map_err(|error| Fault::new(Kind::Other, format!("threads: {error}")))
}

/// Turns a panic into an error with its message.
fn guarded<T>(work: impl FnOnce() -> Result<T, Fault>) -> Result<T, Fault> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let said = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
        let said = said.unwrap_or("no message");
        Err(Fault::new(Kind::Internal, format!("a bug in dermis, please report it: {said}")))
    })
}

/// Runs short work of a few milliseconds: the interpreter lock is released, and panics become exceptions.
pub fn run<T: Send>(py: Python<'_>, work: impl FnOnce() -> Result<T, Fault> + Send) -> PyResult<T> {
    let done = py.detach(|| {
        guarded(|| match own_threads()? {
            Some(threads) => threads.install(work),
            None => work(),
        })
    });
    Ok(done?)
}

/// Runs work as long as a frame. The interpreter lock is kept, which costs less than releasing it.
pub fn run_briefly<T>(work: impl FnOnce() -> Result<T, Fault>) -> PyResult<T> {
    Ok(guarded(work)?)
}

/// Progress of long work: counted by the working threads, shown by the thread that waits.
#[derive(Default)]
pub struct Progress {
    done: AtomicUsize,
    stopped: AtomicBool,
}

impl Progress {
    /// Counts one more step. Returns an error once the result is no longer wanted.
    pub fn step(&self) -> Result<(), Fault> {
        self.done.fetch_add(1, Ordering::Relaxed);
        if self.stopped.load(Ordering::Relaxed) {
            return Err(Fault::new(Kind::Other, "interrupted"));
        }
        Ok(())
    }
}

/// A tqdm bar, if tqdm is installed, shown once the work has taken a moment.
struct Bar {
    label: &'static str,
    total: Option<usize>,
    begun: Instant,
    shown: Option<Py<PyAny>>,
}

impl Bar {
    fn new(label: &'static str, total: Option<usize>) -> Self {
        Self { label, total, begun: Instant::now(), shown: None }
    }

    fn show(&mut self, py: Python<'_>, done: usize) -> PyResult<()> {
        if self.begun.elapsed() < QUIET {
            return Ok(());
        }
        let bar = match &self.shown {
            Some(bar) => bar,
            None => {
                let make = py.import("dermis._progress")?.getattr("bar")?;
                self.shown.insert(make.call1((self.label, self.total))?.unbind())
            }
        };
        bar.call1(py, (done,))?;
        Ok(())
    }

    fn close(&mut self, py: Python<'_>) -> PyResult<()> {
        self.shown.take().map_or(Ok(()), |bar| bar.call1(py, (py.None(),)).map(|_| ()))
    }
}

/// Waits for a thread's result, checks for Ctrl-C and shows progress meanwhile. Called without the interpreter lock.
fn wait<T>(receiver: &mpsc::Receiver<Result<T, Fault>>, progress: &Progress, mut bar: Bar) -> PyResult<T> {
    let done = loop {
        match receiver.recv_timeout(SIGNALS) {
            Ok(done) => break Ok(done?),
            Err(mpsc::RecvTimeoutError::Timeout) => {}
            Err(mpsc::RecvTimeoutError::Disconnected) => {
                break Err(Fault::new(Kind::Internal, "a thread of dermis ended without a result").into());
            }
        }
        let is_going_on = Python::attach(|py| {
            py.check_signals()?;
            bar.show(py, progress.done.load(Ordering::Relaxed))
        });
        if let Err(error) = is_going_on {
            break Err(error);
        }
    };
    progress.stopped.store(true, Ordering::Relaxed);
    if bar.shown.is_some() {
        let closed = Python::attach(|py| bar.close(py));
        return done.and_then(|done| closed.map(|()| done));
    }
    done
}

fn no_thread(error: std::io::Error) -> Fault {
    Fault::new(Kind::Other, format!("thread: {error}"))
}

/// Runs long work in a separate thread, while this one checks for Ctrl-C. Interrupted work continues in the
/// background, and its result is discarded. `label` names it in the progress display.
pub fn run_interruptibly<T: Send + 'static>(
    py: Python<'_>,
    label: &'static str,
    work: impl FnOnce() -> Result<T, Fault> + Send + 'static,
) -> PyResult<T> {
    let (sender, receiver) = mpsc::channel();
    let threads = own_threads()?;
    let thread = std::thread::Builder::new().name("dermis-work".into()).spawn(move || {
        // Nobody listens after an interruption.
        let _ = sender.send(guarded(|| match threads {
            Some(threads) => threads.install(work),
            None => work(),
        }));
    });
    thread.map_err(no_thread)?;
    let receiver = Mutex::new(receiver);
    py.detach(|| wait(&lock(&receiver), &Progress::default(), Bar::new(label, None)))
}

/// Operations per second on one core: a low estimate for any current machine.
const OPERATIONS_PER_S: f64 = 1e9;
/// Work that takes longer than this, in seconds, runs where Ctrl-C is handled; starting a thread costs a hundredth of
/// it.
const SHORT_S: f64 = 0.01;

/// Chooses by the number of operations: [`run`] for short work, [`run_interruptibly`] for long work.
pub fn run_sized<T: Send + 'static>(
    py: Python<'_>,
    label: &'static str,
    operations: f64,
    work: impl FnOnce() -> Result<T, Fault> + Send + 'static,
) -> PyResult<T> {
    if operations > SHORT_S * OPERATIONS_PER_S { run_interruptibly(py, label, work) } else { run(py, work) }
}

/// Runs long work in `steps` equal steps, on the given number of threads or as many as there are processors. It
/// counts its steps, and stops at the next one when interrupted.
pub fn run_steps<T: Send>(
    py: Python<'_>,
    label: &'static str,
    steps: usize,
    threads: Option<usize>,
    work: impl FnOnce(&Progress) -> Result<T, Fault> + Send,
) -> PyResult<T> {
    let threads = match threads {
        // Existing threads already have their memory.
        Some(threads) if threads != rayon::current_num_threads() => Some(Arc::new(pool(threads)?)),
        _ => own_threads()?,
    };
    let progress = &Progress::default();
    py.detach(|| {
        std::thread::scope(|scope| {
            let (sender, receiver) = mpsc::channel();
            let thread = std::thread::Builder::new().name("dermis-work".into()).spawn_scoped(scope, move || {
                // Nobody listens after an interruption.
                let _ = sender.send(guarded(|| match threads {
                    Some(threads) => threads.install(|| work(progress)),
                    None => work(progress),
                }));
            });
            thread.map_err(no_thread)?;
            wait(&receiver, progress, Bar::new(label, Some(steps)))
        })
    })
}
