//! The operations that an explanation may take.

use super::Estimator;

/// Largest number of operations spent on one frame: some 60 ms. It is counted rather than timed, so that replays
/// agree.
pub(super) const MOST_WORK: f64 = 4e8;
/// Time that an operation takes on one core, nanoseconds.
const OPERATION_NS: f64 = 0.15;

/// Operations that an explanation may take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allowance {
    /// To follow the presses of the last frame.
    pub to_follow: f64,
    /// In all, for a search for other presses to begin or go on.
    pub to_search: f64,
}

impl Allowance {
    /// This many operations in all.
    pub const fn of(operations: f64) -> Self {
        Self { to_follow: operations, to_search: operations }
    }
}

/// Operations spent, and those that may be spent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Work {
    spent: f64,
    pub allowance: Allowance,
    /// Rest of the allowance, if it bounds the current part of an explanation.
    pub left: Option<f64>,
    /// Something was left out of the explanation because of the allowance.
    pub is_cut_short: bool,
    /// Most operations of the current part.
    pub most: f64,
}

impl Work {
    /// As many operations as the estimator allows itself.
    pub fn unbounded() -> Self {
        let allowance = Allowance::of(f64::INFINITY);
        Self { spent: 0.0, allowance, left: None, is_cut_short: false, most: f64::INFINITY }
    }
}

impl Estimator {
    /// About how long the explanations since the last call took, nanoseconds; 0 if fits are quick.
    pub fn spent_ns(&mut self) -> u64 {
        let operations = std::mem::take(&mut self.work.spent) + self.fit.work();
        self.fit.set_most_work(MOST_WORK);
        (OPERATION_NS * operations) as u64
    }

    /// Allows these operations until the next call of [`Estimator::spent_ns`], if they are fewer than it allows
    /// itself. [`Estimator::is_out_of_work`] tells whether they sufficed.
    pub fn allow(&mut self, allowance: Allowance) {
        self.work.allowance = allowance;
    }

    /// True if the last explanation ended early because of [`Estimator::allow`].
    pub fn is_out_of_work(&self) -> bool {
        self.work.is_cut_short || self.work.left.is_some_and(|left| self.fit.work() > left)
    }

    /// Begins an explanation of at most this many operations, and no more than are allowed.
    pub(super) fn begin(&mut self, most: f64, allowed: f64) {
        self.begin_part(most, allowed);
        self.work.is_cut_short = false;
    }

    /// Begins the next part of an explanation.
    pub(super) fn begin_part(&mut self, most: f64, allowed: f64) {
        self.work.is_cut_short = self.is_out_of_work();
        self.work.spent += self.fit.work();
        self.work.left = Some((allowed - self.work.spent).max(0.0)).filter(|left| *left < most);
        self.work.most = self.work.left.unwrap_or(most);
        self.fit.set_most_work(self.work.most);
    }
}
