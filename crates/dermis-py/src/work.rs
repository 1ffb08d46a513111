//! How work is done for Python: without the interpreter's lock, with panics as exceptions, with Ctrl-C answered, and on
//! threads that are there. A process that was forked has none of its parent's threads, so that it gets some of its own.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, mpsc};
use std::time::Duration;

use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::errors::{Fault, Kind};

/// How often Ctrl-C is looked for.
const SIGNALS: Duration = Duration::from_millis(50);

/// The process that loaded this library.
static LOADED_IN: OnceLock<u32> = OnceLock::new();

/// Remembers which process this is; called once, when the library is loaded.
pub fn remember_process() {
    let _ = LOADED_IN.set(std::process::id());
}

/// Threads of a forked process. The parent's are left alone: joining threads that are not there would wait for ever.
static OWN_THREADS: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// What is locked, whatever a panic elsewhere has made of it.
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

/// So many threads; as many as there are processors for 0.
pub fn pool(threads: usize) -> Result<ThreadPool, Fault> {
    let made = ThreadPoolBuilder::new().num_threads(threads).build();
    made.map_err(|error| Fault::new(Kind::Other, format!("threads: {error}")))
}

/// A panic as an error: what it said.
fn guarded<T>(work: impl FnOnce() -> Result<T, Fault>) -> Result<T, Fault> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let said = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
        let said = said.unwrap_or("no message");
        Err(Fault::new(Kind::Internal, format!("a fault in dermis itself, which is worth a report: {said}")))
    })
}

/// Short work, a few milliseconds: the lock is given up, panics become exceptions.
pub fn run<T: Send>(py: Python<'_>, work: impl FnOnce() -> Result<T, Fault> + Send) -> PyResult<T> {
    let done = py.detach(|| {
        guarded(|| match own_threads()? {
            Some(threads) => threads.install(work),
            None => work(),
        })
    });
    Ok(done?)
}

/// Work of the length of a frame: the lock is kept, which costs less than giving it up.
pub fn run_briefly<T>(work: impl FnOnce() -> Result<T, Fault>) -> PyResult<T> {
    Ok(guarded(work)?)
}

/// Long work, on a thread of its own, while this one looks for Ctrl-C. What was interrupted runs on to its end behind, and
/// its result is discarded.
pub fn run_interruptibly<T: Send + 'static>(
    py: Python<'_>,
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
    thread.map_err(|error| Fault::new(Kind::Other, format!("thread: {error}")))?;
    let receiver = Mutex::new(receiver);
    loop {
        match py.detach(|| lock(&receiver).recv_timeout(SIGNALS)) {
            Ok(done) => return Ok(done?),
            Err(mpsc::RecvTimeoutError::Timeout) => py.check_signals()?,
            Err(mpsc::RecvTimeoutError::Disconnected) => {
                return Err(Fault::new(Kind::Internal, "a thread of dermis ended without a result").into());
            }
        }
    }
}
