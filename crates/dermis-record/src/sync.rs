//! Makes the operating system sync a recording to disk at intervals, to limit the data lost in a power failure. A
//! separate thread waits for the disk; the writer never does.

use std::io;
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use dermis_device::leave_real_time;

/// Calls a sync function at a limited rate.
#[derive(Debug)]
pub(super) struct Syncer {
    interval: Duration,
    asked: Instant,
    /// `None` once it is ending.
    ask: Option<SyncSender<()>>,
    /// The last error, until it has been reported.
    failed: Arc<Mutex<Option<io::Error>>>,
    thread: Option<JoinHandle<()>>,
}

impl Syncer {
    /// Starts the thread that runs `sync`.
    pub(super) fn spawn(
        interval: Duration,
        mut sync: impl FnMut() -> io::Result<()> + Send + 'static,
    ) -> io::Result<Self> {
        // One request may wait while another is in progress.
        let (ask, asked) = sync_channel(1);
        let failed = Arc::new(Mutex::new(None));
        let told = failed.clone();
        let thread = thread::Builder::new().name("sync recording".to_owned()).spawn(move || {
            leave_real_time();
            for () in asked {
                if let Err(error) = sync() {
                    told.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
                }
            }
        })?;
        Ok(Self { interval, asked: Instant::now(), ask: Some(ask), failed, thread: Some(thread) })
    }

    /// Call this whenever more data has been handed to the operating system.
    ///
    /// # Errors
    /// Any error of the disk since the last call; returned once.
    pub(super) fn written(&mut self) -> io::Result<()> {
        if self.asked.elapsed() >= self.interval
            && let Some(ask) = &self.ask
            // If the disk is still busy with the previous request, try again at the next call.
            && !matches!(ask.try_send(()), Err(TrySendError::Full(())))
        {
            self.asked = Instant::now();
        }
        self.failed.lock().unwrap_or_else(PoisonError::into_inner).take().map_or(Ok(()), Err)
    }
}

impl Drop for Syncer {
    fn drop(&mut self) {
        self.ask = None;
        if let Some(thread) = self.thread.take() {
            // The runtime has already printed its panic.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn the_disk_is_asked_again_after_the_interval_and_not_before() {
        let calls = Arc::new(AtomicU64::new(0));
        let (done, wait) = channel();
        let count = calls.clone();
        let sync = move || {
            count.fetch_add(1, Ordering::Relaxed);
            done.send(()).map_err(io::Error::other)
        };
        let mut often = Syncer::spawn(Duration::ZERO, sync).unwrap();
        for _ in 0..3 {
            often.written().unwrap();
            wait.recv().unwrap();
        }
        drop(often);
        assert_eq!(calls.load(Ordering::Relaxed), 3);
        let mut seldom = Syncer::spawn(Duration::from_secs(3600), || Err(io::Error::other("never asked"))).unwrap();
        (0..100).for_each(|_| seldom.written().unwrap());
    }

    #[test]
    fn disk_errors_reach_the_writer_once_and_never_block_it() {
        let (go, wait) = channel::<()>();
        let (done, ended) = channel();
        let sync = move || {
            let _ = wait.recv();
            done.send(()).map_err(io::Error::other)?;
            Err(io::Error::other("no space"))
        };
        let mut syncer = Syncer::spawn(Duration::ZERO, sync).unwrap();
        // The disk hangs in the first request, one more waits, and all further calls return at once.
        (0..1000).for_each(|_| syncer.written().unwrap());
        drop(go);
        ended.recv().unwrap();
        let error = loop {
            if let Err(error) = syncer.written() {
                break error;
            }
            thread::yield_now();
        };
        assert_eq!(error.to_string(), "no space");
    }
}
