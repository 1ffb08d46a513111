//! Effect of a step.

/// Effect of an accepted step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Cost before the step.
    pub before: f64,
    /// Cost after the step.
    pub after: f64,
    /// Predicted drop in cost: half the product of step and right-hand side.
    pub predicted: f64,
    /// As [`Trial::moved`](super::Trial::moved).
    pub moved: f64,
}
