//! The queue between a reading thread and its source, and the connection state that they share. Frames circulate
//! between two bounded queues, so nothing is allocated once they have reached their size.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use crate::{Frame, Layout};

/// Number of frames kept before the reader asks for the first one. Smaller than any queue.
const EARLY: u64 = 32;

/// Takes a [`Dialogue`](super::Dialogue)'s frames and counts losses.
#[derive(Debug)]
pub struct Inbox {
    filled: SyncSender<Frame>,
    empty: Receiver<Frame>,
    kept: Option<Frame>,
    shared: Arc<Shared>,
    taken: u64,
    /// Description of the damage to the last damaged frame.
    reason: Option<String>,
}

impl Inbox {
    /// An inbox with room for `capacity` frames, the receiver of its frames, and the sender that returns used ones.
    pub fn new(capacity: usize) -> (Self, Receiver<Frame>, SyncSender<Frame>) {
        let capacity = capacity.max(2);
        let (filled, frames) = sync_channel(capacity);
        let (spare, empty) = sync_channel(capacity);
        (Self { filled, empty, kept: None, shared: Arc::default(), taken: 0, reason: None }, frames, spare)
    }

    /// Queues a frame that `fill` fills. If the queue is full, the frame is dropped and counted as lost. Until the
    /// source is asked for its first frame, only a few are kept and the others don't count as lost.
    pub fn take(&mut self, fill: impl FnOnce(&mut Frame)) {
        let mut frame = self.kept.take().or_else(|| self.empty.try_recv().ok()).unwrap_or_default();
        fill(&mut frame);
        self.taken += 1;
        if self.taken > EARLY && self.shared.is_early() {
            self.shared.overflowed.store(true, Ordering::Release);
            self.kept = Some(frame);
            return;
        }
        if let Err(refused) = self.filled.try_send(frame) {
            self.lost(1);
            let (std::sync::mpsc::TrySendError::Full(frame) | std::sync::mpsc::TrySendError::Disconnected(frame)) =
                refused;
            self.kept = Some(frame);
        }
    }

    /// Counts frames that the device measured but that never arrived.
    pub fn lost(&self, frames: u64) {
        self.shared.lost.fetch_add(frames, Ordering::Relaxed);
    }

    /// Counts frames that arrived damaged or twice.
    pub fn bad(&self, frames: u64) {
        self.shared.bad.fetch_add(frames, Ordering::Relaxed);
    }

    /// Counts a damaged frame, and keeps the reason in plain words.
    pub fn bad_because(&mut self, reason: String) {
        self.bad(1);
        self.reason = Some(reason);
    }

    /// Description of the damage to the last damaged frame, if known.
    pub(crate) fn reason(&self) -> Option<&str> {
        self.reason.as_deref()
    }

    /// Numbers of lost and damaged frames.
    pub fn losses(&self) -> (u64, u64) {
        self.shared.losses()
    }

    /// Total number of frames taken.
    pub(super) fn taken(&self) -> u64 {
        self.taken
    }

    pub(super) fn shared(&self) -> Arc<Shared> {
        self.shared.clone()
    }
}

/// State shared by the thread and the source.
#[derive(Debug, Default)]
pub(super) struct Shared {
    stop: AtomicBool,
    lost: AtomicU64,
    bad: AtomicU64,
    connections: AtomicU64,
    /// True until the source is asked for its first frame.
    early: AtomicBool,
    /// True if frames were discarded before the source was asked for the first one.
    overflowed: AtomicBool,
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    layout: Option<Layout>,
    identity: Option<String>,
    problem: Option<String>,
}

impl Shared {
    pub(super) fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    pub(super) fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    pub(super) fn losses(&self) -> (u64, u64) {
        (self.lost.load(Ordering::Relaxed), self.bad.load(Ordering::Relaxed))
    }

    pub(super) fn is_early(&self) -> bool {
        self.early.load(Ordering::Acquire)
    }

    /// Sets whether the first frame has yet to be requested.
    pub(super) fn set_early(&self, early: bool) {
        self.early.store(early, Ordering::Release);
    }

    /// True if frames were discarded before the source was asked for the first one.
    pub(super) fn overflowed_unasked(&self) -> bool {
        self.overflowed.load(Ordering::Acquire)
    }

    pub(super) fn connections(&self) -> u64 {
        self.connections.load(Ordering::Relaxed)
    }

    pub(super) fn identity(&self) -> Option<String> {
        self.state().identity.clone()
    }

    pub(super) fn problem(&self) -> Option<String> {
        self.state().problem.clone()
    }

    pub(super) fn connected(&self) {
        self.connections.fetch_add(1, Ordering::Relaxed);
        self.state().problem = None;
    }

    /// Sets the reason why no frames arrive.
    pub(super) fn troubled(&self, problem: String) {
        self.state().problem = Some(problem);
    }

    /// Clears the reason after frames arrive again.
    pub(super) fn recovered(&self) {
        self.state().problem = None;
    }

    pub(super) fn introduced(&self, layout: Layout, identity: Option<String>) {
        let mut state = self.state();
        state.layout = Some(layout);
        state.identity = identity;
        self.changed.notify_all();
    }

    /// Waits until the layout is known. The error explains why it isn't known in time.
    pub(super) fn wait_for_layout(&self, until: Instant) -> Result<Layout, String> {
        let mut state = self.state();
        loop {
            if let Some(layout) = &state.layout {
                return Ok(layout.clone());
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                let reason = state.problem.clone();
                return Err(reason.unwrap_or_else(|| "connected, but it has sent no frame and no answer".to_owned()));
            }
            let waited = self.changed.wait_timeout(state, left);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// These are plain values, which a panic can't leave half-written.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
