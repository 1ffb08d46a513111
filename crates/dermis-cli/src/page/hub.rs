//! Connects the pipeline to the pages. The pipeline leaves its latest update here and continues; the server takes it
//! when it can. Three buffers are exchanged under a lock that is held only for swapping pointers, so neither side waits
//! for the other. An update that isn't taken in time is overwritten and counted.

use std::mem;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use dermis_page::message::{HubStats, Level, Notice};
use dermis_page::{Update, UpdateError};
use tokio::sync::{Notify, broadcast, watch};

/// Notices that a page may leave unread before it loses the oldest.
const NOTICE_BACKLOG: usize = 64;

/// The place where the pipeline publishes. Clones share it.
#[derive(Debug, Clone)]
pub struct Hub {
    pub(super) inner: Arc<Inner>,
}

#[derive(Debug)]
pub(super) struct Inner {
    back: Mutex<Update>,
    middle: Mutex<Middle>,
    pub(super) published: Notify,
    pub(super) noise: watch::Sender<Arc<Vec<f32>>>,
    pub(super) notices: broadcast::Sender<Notice>,
    pub(super) counts: Counts,
}

#[derive(Debug, Default)]
struct Middle {
    update: Update,
    is_fresh: bool,
}

#[derive(Debug, Default)]
pub(super) struct Counts {
    pub(super) clients: AtomicUsize,
    pub(super) published: AtomicU64,
    pub(super) coalesced: AtomicU64,
    pub(super) dropped: AtomicU64,
}

impl Default for Hub {
    fn default() -> Self {
        Self::new()
    }
}

impl Hub {
    /// An empty hub. Publishing works with or without a server.
    pub fn new() -> Self {
        let inner = Inner {
            back: Mutex::default(),
            middle: Mutex::default(),
            published: Notify::new(),
            noise: watch::channel(Arc::default()).0,
            notices: broadcast::channel(NOTICE_BACKLOG).0,
            counts: Counts::default(),
        };
        Self { inner: Arc::new(inner) }
    }

    /// Shows `update` on every page as soon as the page can take it. Copies the update and returns; never waits for a
    /// page, and allocates only while its buffers grow.
    ///
    /// # Errors
    /// [`UpdateError`] if the update contradicts itself; it is then not shown.
    pub fn publish(&self, update: &Update) -> Result<(), UpdateError> {
        update.check()?;
        let inner = &self.inner;
        let mut back = lock(&inner.back);
        back.copy_from(update);
        let mut middle = lock(&inner.middle);
        mem::swap(&mut *back, &mut middle.update);
        let was_taken = !mem::replace(&mut middle.is_fresh, true);
        drop(middle);
        inner.counts.published.fetch_add(1, Ordering::Relaxed);
        if !was_taken && inner.counts.clients.load(Ordering::Relaxed) > 0 {
            inner.counts.coalesced.fetch_add(1, Ordering::Relaxed);
        }
        inner.published.notify_one();
        Ok(())
    }

    /// Publishes the noise (standard deviation) of every channel, in the scene's channel unit. Sent only when it
    /// changes.
    pub fn publish_noise(&self, noise: &[f32]) {
        self.inner.noise.send_replace(Arc::new(noise.to_vec()));
    }

    /// Sends a notice to every page once.
    pub fn announce(&self, level: Level, text: impl Into<String>) {
        // Without a page it has no receiver, which is not a failure.
        let _ = self.inner.notices.send(Notice { level, text: text.into() });
    }

    /// Statistics on how well the pages keep up.
    pub fn stats(&self) -> HubStats {
        let counts = &self.inner.counts;
        HubStats {
            clients: counts.clients.load(Ordering::Relaxed),
            published: counts.published.load(Ordering::Relaxed),
            coalesced: counts.coalesced.load(Ordering::Relaxed),
            dropped: counts.dropped.load(Ordering::Relaxed),
        }
    }

    /// Swaps `front` for the latest update; returns false if there is no new one.
    pub(super) fn take(&self, front: &mut Update) -> bool {
        let mut middle = lock(&self.inner.middle);
        if !mem::take(&mut middle.is_fresh) {
            return false;
        }
        mem::swap(front, &mut middle.update);
        true
    }
}

/// A panic elsewhere may leave an update half written, but the next one overwrites it, so a poisoned lock is usable.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbered(frame: u64) -> Update {
        Update { frame, ..Update::default() }
    }

    #[test]
    fn the_latest_update_wins_and_is_taken_once() {
        let hub = Hub::new();
        for frame in 1..=5 {
            hub.publish(&numbered(frame)).expect("well formed");
        }
        let mut front = Update::default();
        assert!(hub.take(&mut front));
        assert_eq!(front.frame, 5);
        assert!(!hub.take(&mut front));
        assert_eq!(hub.stats().published, 5);
    }

    #[test]
    fn an_image_of_the_wrong_size_is_refused_with_both_sizes() {
        let mut update = numbered(12);
        update.image.rows = 3;
        update.image.cols = 4;
        update.image.values = vec![0.0; 11];
        let refusal = Hub::new().publish(&update).expect_err("one value is missing").to_string();
        assert!(
            refusal.contains("frame 12") && refusal.contains("11 values") && refusal.contains("3 x 4"),
            "{refusal}"
        );
    }
}
