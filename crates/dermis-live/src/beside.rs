//! Background work that takes longer than a frame. The frame from which its result counts is fixed, in the frames'
//! own time, when the work starts. A replay at any speed on any machine therefore gives the same results as the live
//! run. If a frame is due before the work is done, it waits, and the wait is counted. Frames of an instrument do not
//! wait: late work takes effect with the first frame after it is done, and a log message says so. Otherwise a busy
//! machine would delay touches, and lose frames.

#[cfg(not(target_family = "wasm"))]
use crossbeam_channel::{Receiver, Sender};
#[cfg(not(target_family = "wasm"))]
use dermis_device::leave_real_time;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
#[cfg(not(target_family = "wasm"))]
use std::{
    cell::Cell,
    panic::{AssertUnwindSafe, catch_unwind, resume_unwind},
    sync::LazyLock,
    thread,
};

/// Niceness of threads for work in the background: they get a quarter of a core that others want.
#[cfg(target_os = "linux")]
const NICENESS: i32 = 5;

#[cfg(not(target_family = "wasm"))]
thread_local! {
    static IS_PATIENT: Cell<bool> = const { Cell::new(false) };
}

/// Threads for the parallel parts of patient work; `None` if the system refuses them. They are started from a patient
/// thread, and inherit its niceness.
#[cfg(not(target_family = "wasm"))]
static PATIENT: LazyLock<Option<rayon::ThreadPool>> =
    LazyLock::new(|| rayon::ThreadPoolBuilder::new().start_handler(|_| IS_PATIENT.set(true)).build().ok());

/// Work for a thread of its own.
#[cfg(not(target_family = "wasm"))]
type Job = Box<dyn FnOnce() + Send>;

/// Starts the threads for work in the background, so that they inherit its niceness. One that starts as urgent as the
/// thread of the frames interrupts it for some milliseconds.
#[cfg(not(target_family = "wasm"))]
static STARTER: LazyLock<Sender<Job>> = LazyLock::new(|| {
    let (send, jobs) = crossbeam_channel::unbounded::<Job>();
    let warn = |error| tracing::warn!("the system refuses a thread for work in the background: {error}");
    let started = thread::Builder::new().spawn(move || {
        leave_real_time();
        // On Linux, each thread has a niceness of its own.
        #[cfg(target_os = "linux")]
        let _ = rustix::process::nice(NICENESS);
        for job in jobs {
            thread::Builder::new().spawn(job).map_or_else(warn, drop);
        }
    });
    started.map_or_else(warn, drop);
    send
});

/// Does parallel work on threads as patient as the current one. The work must not wait for locks that other patient
/// work may hold.
pub(crate) fn in_parallel<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    #[cfg(not(target_family = "wasm"))]
    if let (true, Some(pool)) = (IS_PATIENT.get(), &*PATIENT) {
        return pool.install(work);
    }
    work()
}

/// Tells work whether its result is still wanted.
#[derive(Clone, Debug, Default)]
pub(crate) struct Wanted(Arc<AtomicBool>);

impl Wanted {
    /// `None` if other work has replaced this one, so that it can stop.
    pub fn go_on(&self) -> Option<()> {
        (!self.0.load(Ordering::Relaxed)).then_some(())
    }
}

/// At most one piece of work, and when its result is due.
#[derive(Debug)]
pub(crate) struct Beside<T> {
    under_way: Option<UnderWay<T>>,
    waits: u64,
    is_patient: bool,
    is_live: bool,
}

#[derive(Debug)]
struct UnderWay<T> {
    due_ns: u64,
    outcome: Outcome<T>,
    wanted: Wanted,
    is_late: bool,
}

/// Result of work: from a thread, or computed at once if there are no threads (in a page).
#[derive(Debug)]
struct Outcome<T>(
    #[cfg(not(target_family = "wasm"))] Receiver<thread::Result<Option<T>>>,
    #[cfg(target_family = "wasm")] Option<T>,
);

#[cfg(not(target_family = "wasm"))]
impl<T: Send + 'static> Outcome<T> {
    fn of(is_patient: bool, work: impl FnOnce() -> Option<T> + Send + 'static) -> Self {
        let (tell, told) = crossbeam_channel::bounded(1);
        let tell = Tell(tell);
        let job = move || {
            IS_PATIENT.set(is_patient);
            tell.tell(catch_unwind(AssertUnwindSafe(work)));
        };
        // If the system refused the starter its thread, the job is dropped, and has no result.
        let _ = STARTER.send(Box::new(job));
        Self(told)
    }

    fn is_there(&self) -> bool {
        !self.0.is_empty()
    }

    fn wait(self) -> Option<T> {
        // If the work panicked, propagate its panic.
        self.0.recv().ok()?.unwrap_or_else(|panic| resume_unwind(panic))
    }
}

/// Sends the result of work. If the work is dropped, because the system refuses a thread, sends that there is none.
#[cfg(not(target_family = "wasm"))]
struct Tell<T>(Sender<thread::Result<Option<T>>>);

#[cfg(not(target_family = "wasm"))]
impl<T> Tell<T> {
    fn tell(&self, result: thread::Result<Option<T>>) {
        // Only the first result fits, and nobody waits for that of work that is no longer wanted.
        let _ = self.0.try_send(result);
    }
}

#[cfg(not(target_family = "wasm"))]
impl<T> Drop for Tell<T> {
    fn drop(&mut self) {
        self.tell(Ok(None));
    }
}

#[cfg(target_family = "wasm")]
impl<T> Outcome<T> {
    fn of(_is_patient: bool, work: impl FnOnce() -> Option<T>) -> Self {
        Self(work())
    }

    fn is_there(&self) -> bool {
        true
    }

    fn wait(self) -> Option<T> {
        self.0
    }
}

impl<T: Send + 'static> Beside<T> {
    /// Without any work.
    pub fn new() -> Self {
        Self { under_way: None, waits: 0, is_patient: false, is_live: false }
    }

    /// Without any work, for work that is due seconds later: frames, and work that is due sooner, go first.
    pub fn patient() -> Self {
        Self { under_way: None, waits: 0, is_patient: true, is_live: false }
    }

    /// States whether frames come from an instrument, which doesn't wait.
    pub fn set_live(&mut self, is_live: bool) {
        self.is_live = is_live;
    }

    /// True if frames come from an instrument.
    pub fn is_live(&self) -> bool {
        self.is_live
    }

    /// Number of frames that had to wait for a result.
    pub fn waits(&self) -> u64 {
        self.waits
    }

    /// True from the start of work until its result is taken, or the work cancelled.
    pub fn is_under_way(&self) -> bool {
        self.under_way.is_some()
    }

    /// Starts work whose result counts from a given frame time on, replacing any in progress. The work may end
    /// without a result only if it is no longer wanted.
    pub fn begin(&mut self, due_ns: u64, work: impl FnOnce(&Wanted) -> Option<T> + Send + 'static) {
        self.cancel();
        let wanted = Wanted::default();
        let told = wanted.clone();
        let outcome = Outcome::of(self.is_patient, move || work(&told));
        self.under_way = Some(UnderWay { due_ns, outcome, wanted, is_late: false });
    }

    /// The result, in the first frame at or after its due time.
    pub fn take(&mut self, time_ns: u64) -> Option<T> {
        let is_late = |work: &&mut UnderWay<T>| time_ns >= work.due_ns && !work.outcome.is_there();
        if let Some(work) = self.under_way.as_mut().filter(|_| self.is_live).filter(is_late) {
            if !std::mem::replace(&mut work.is_late, true) {
                tracing::info!("work in the background is late, and takes effect later than in a replay");
            }
            return None;
        }
        let UnderWay { outcome, .. } = self.under_way.take_if(|work| time_ns >= work.due_ns)?;
        if !outcome.is_there() {
            self.waits += 1;
        }
        outcome.wait()
    }

    /// Drops the work in progress, if any.
    pub fn cancel(&mut self) {
        if let Some(UnderWay { wanted, .. }) = self.under_way.take() {
            wanted.0.store(true, Ordering::Relaxed);
        }
    }
}

impl<T> Drop for Beside<T> {
    fn drop(&mut self) {
        if let Some(UnderWay { wanted, .. }) = &self.under_way {
            wanted.0.store(true, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn a_result_counts_from_its_time_on_however_long_it_took() {
        let mut quick = Beside::new();
        quick.begin(100, |_| Some(1));
        while !quick.under_way.as_ref().unwrap().outcome.is_there() {
            std::thread::yield_now();
        }
        assert_eq!((quick.take(99), quick.take(100), quick.take(101)), (None, Some(1), None));
        assert_eq!(quick.waits(), 0);
        let (send, receive) = channel::<()>();
        let mut slow = Beside::new();
        slow.begin(100, move |_| receive.recv().ok().map(|()| 2));
        assert_eq!(slow.take(99), None);
        let done = std::thread::spawn(move || {
            std::thread::sleep(std::time::Duration::from_millis(50));
            send.send(())
        });
        assert_eq!(slow.take(100), Some(2));
        assert_eq!(slow.waits(), 1);
        done.join().unwrap().unwrap();
    }

    #[test]
    fn frames_of_an_instrument_do_not_wait() {
        let (send, receive) = channel::<()>();
        let mut late = Beside::new();
        late.set_live(true);
        late.begin(100, move |_| receive.recv().ok().map(|()| 1));
        assert_eq!((late.take(100), late.take(101), late.waits()), (None, None, 0));
        send.send(()).unwrap();
        while !late.under_way.as_ref().unwrap().outcome.is_there() {
            std::thread::yield_now();
        }
        assert_eq!((late.take(99), late.take(102)), (None, Some(1)));
    }

    #[test]
    fn dropped_work_has_no_result() {
        let (tell, told) = crossbeam_channel::bounded(1);
        let wanted = Wanted::default();
        let under_way = UnderWay { due_ns: 100, outcome: Outcome(told), wanted, is_late: false };
        let mut beside = Beside::<i32>::new();
        beside.under_way = Some(under_way);
        beside.set_live(true);
        assert!(beside.take(100).is_none() && beside.is_under_way());
        drop(Tell(tell));
        assert!(beside.take(100).is_none() && !beside.is_under_way());
    }

    #[test]
    fn new_work_replaces_and_cancels_running_work() {
        let (tell, told) = channel();
        let mut beside = Beside::new();
        beside.begin(100, move |wanted| {
            while wanted.go_on().is_some() {
                std::thread::yield_now();
            }
            tell.send(()).ok().map(|()| 1)
        });
        beside.begin(200, |_| Some(2));
        assert_eq!((beside.take(150), beside.take(200)), (None, Some(2)));
        told.recv().unwrap();
    }
}
