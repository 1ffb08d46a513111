//! Counts operations instead of time, so that replays agree.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Time that an operation takes on one core, nanoseconds.
const OPERATION_NS: f64 = 0.25;

/// The operations of a search, for whoever waits for its result in another thread.
#[derive(Clone, Debug, Default)]
pub struct Meter(Arc<AtomicU64>);

impl Meter {
    /// About how long the operations so far take on one core, nanoseconds.
    pub fn spent_ns(&self) -> u64 {
        time_ns(self.0.load(Ordering::Acquire) as f64)
    }

    pub(crate) fn count(&self, operations: f64) {
        self.0.fetch_add(operations as u64, Ordering::Release);
    }
}

/// About how long operations take on one core, nanoseconds.
pub fn time_ns(operations: f64) -> u64 {
    (OPERATION_NS * operations) as u64
}

/// About how many operations one core does in this time.
pub fn operations_in(time_ns: u64) -> f64 {
    time_ns as f64 / OPERATION_NS
}

/// Operations spent on a frame, and the most that may be.
#[derive(Clone, Debug)]
pub(crate) struct Budget {
    pub spent: f64,
    pub most: f64,
    pub meter: Meter,
}

impl Default for Budget {
    fn default() -> Self {
        Self { spent: 0.0, most: f64::INFINITY, meter: Meter::default() }
    }
}

impl Budget {
    /// Counts operations as spent, and tells whether they may be done.
    pub fn spend(&mut self, operations: f64) -> bool {
        self.spent += operations;
        self.meter.count(operations);
        self.spent <= self.most
    }
}
