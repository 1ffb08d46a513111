//! Handles signals that ask the command to end. While nothing needs finishing, the first signal ends the process at
//! once. Otherwise the first lets it finish, and the second ends it within a second; recordings are completed even if
//! the rest of the process is busy or stuck.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Mutex, Once, PoisonError};
use std::time::Duration;

use dermis_record::RecordingStop;

/// Exit code of an interrupted command, as shells expect.
const INTERRUPTED: i32 = 130;
/// Time for completing recordings after the second signal.
const LAST_WORDS: Duration = Duration::from_millis(800);

static INSTALLED: Once = Once::new();
static RAISED: AtomicBool = AtomicBool::new(false);
static IS_UNDER_WAY: AtomicBool = AtomicBool::new(false);
static SIGNALS: AtomicU32 = AtomicU32::new(0);
static RECORDINGS: Mutex<Vec<RecordingStop>> = Mutex::new(Vec::new());

/// Resets the state, so that a second command in the same process starts like the first.
pub fn reset() {
    IS_UNDER_WAY.store(false, Ordering::SeqCst);
    RAISED.store(false, Ordering::SeqCst);
    SIGNALS.store(0, Ordering::SeqCst);
}

/// From here on the first signal only sets the returned flag, which the caller has to check. A command that never
/// calls this leaves signals to the process. If the operating system refuses the handler, signals end the process as
/// usual.
pub fn begin() -> &'static AtomicBool {
    IS_UNDER_WAY.store(true, Ordering::SeqCst);
    INSTALLED.call_once(|| {
        if let Err(error) = ctrlc::set_handler(on_signal) {
            tracing::debug!("signals end the process at once: {error}");
        }
    });
    &RAISED
}

/// Registers a recording that must be completed whatever happens.
pub fn protect(recording: RecordingStop) {
    let mut recordings = RECORDINGS.lock().unwrap_or_else(PoisonError::into_inner);
    recordings.retain(|other| !other.has_ended());
    recordings.push(recording);
}

fn on_signal() {
    let signals = SIGNALS.fetch_add(1, Ordering::SeqCst) + 1;
    if !IS_UNDER_WAY.load(Ordering::SeqCst) {
        // Nothing incomplete has been written.
        std::process::exit(INTERRUPTED);
    }
    RAISED.store(true, Ordering::SeqCst);
    if signals < 2 {
        return;
    }
    // A lock held by a stuck thread must not delay the end.
    let recordings = RECORDINGS.try_lock().map(|all| all.clone()).unwrap_or_default();
    recordings.iter().for_each(RecordingStop::ask);
    let until = std::time::Instant::now() + LAST_WORDS;
    for recording in &recordings {
        if !recording.wait(until.saturating_duration_since(std::time::Instant::now())) {
            eprintln!("error: a recording was not completed in time; `dermis recover` completes it");
        }
    }
    std::process::exit(INTERRUPTED);
}
