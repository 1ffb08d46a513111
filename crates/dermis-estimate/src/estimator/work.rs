//! The operations that an explanation may take.

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

    /// True if the explanation left something out because of the allowance. `operations` are those of the current part.
    pub fn is_out(&self, operations: f64) -> bool {
        self.is_cut_short || self.left.is_some_and(|left| operations > left)
    }

    /// Begins the next part of an explanation, of at most `most` operations, and no more than the rest of those
    /// `allowed`. `operations` are those of the part that ends.
    pub fn begin_part(&mut self, operations: f64, most: f64, allowed: f64) {
        self.is_cut_short = self.is_out(operations);
        self.spent += operations;
        self.left = Some((allowed - self.spent).max(0.0)).filter(|left| *left < most);
        self.most = self.left.unwrap_or(most);
    }

    /// About how long the operations since the last call took, nanoseconds. `operations` are those of the current part.
    pub fn take_spent_ns(&mut self, operations: f64) -> u64 {
        (OPERATION_NS * (std::mem::take(&mut self.spent) + operations)) as u64
    }
}
