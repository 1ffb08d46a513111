//! What a step did.

/// What a step has done.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Cost before it.
    pub before: f64,
    /// Cost after it.
    pub after: f64,
    /// By how much the cost should have fallen: half of step times right-hand side.
    pub predicted: f64,
    /// As [`Trial::moved`](super::Trial::moved).
    pub moved: f64,
}
