//! Rules for damping, accepting and ending steps.

/// Invalid parameters.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// A parameter is out of range.
    #[error("{name} of a least-squares fit = {value}: expected {expected}")]
    Parameter {
        /// Name of the field.
        name: &'static str,
        /// Its value.
        value: f64,
        /// The permitted range in words.
        expected: &'static str,
    },
}

/// Evolution of the damping, as a share of the diagonal of the normal equations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Damping {
    /// Initial damping, at least 0.
    pub start: f64,
    /// Minimum damping, at least 0.
    pub least: f64,
    /// The fit ends when the damping reaches this; infinite for never.
    pub most: f64,
    /// Factor after an accepted step, above 0 and at most 1.
    pub decrease: f64,
    /// Factor after a rejected step, above 1.
    pub increase: f64,
    /// Minimum damping after a rejected step, at least 0.
    pub least_after_rejection: f64,
    /// Factor (above 1) if the equations cannot be solved or a step is not allowed. If `None`, the fit then ends.
    pub refused: Option<f64>,
}

impl Default for Damping {
    fn default() -> Self {
        Self {
            start: 1e-3,
            least: 1e-9,
            most: 1e9,
            decrease: 0.2,
            increase: 8.0,
            least_after_rejection: 0.0,
            refused: Some(10.0),
        }
    }
}

/// Method that keeps steps safe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Control {
    /// Damped equations, solved again after a rejected step.
    Damping(Damping),
    /// Full steps, shortened by a factor between 0 and 1 each time they are rejected. A rejected step no longer than
    /// the tolerance settles the fit.
    Shortening {
        /// Factor between 0 and 1.
        factor: f64,
    },
}

impl Control {
    pub(super) fn start(&self) -> f64 {
        match self {
            Self::Damping(damping) => damping.start,
            Self::Shortening { .. } => 0.0,
        }
    }

    pub(super) fn most(&self) -> f64 {
        match self {
            Self::Damping(damping) => damping.most,
            Self::Shortening { .. } => f64::INFINITY,
        }
    }

    pub(super) fn after_success(&self, damping: f64) -> f64 {
        match self {
            Self::Damping(rule) => (rule.decrease * damping).max(rule.least),
            Self::Shortening { .. } => 0.0,
        }
    }

    pub(super) fn after_rejection(&self, damping: f64) -> f64 {
        match self {
            Self::Damping(rule) => (rule.increase * damping).max(rule.least_after_rejection),
            Self::Shortening { .. } => 0.0,
        }
    }

    pub(super) fn survives_refusal(&self) -> bool {
        matches!(self, Self::Damping(Damping { refused: Some(_), .. }))
    }
}

/// Condition to accept a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Acceptance {
    /// Steps that lower the cost.
    Lower,
    /// Steps that do not raise the cost.
    NotHigher,
}

impl Acceptance {
    pub(super) fn allows(self, before: f64, after: f64) -> bool {
        match self {
            Self::Lower => after < before,
            Self::NotHigher => after <= before,
        }
    }
}

/// Conditions under which a fit has settled; `None` disables a condition.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tolerances {
    /// Settled once an accepted step is no longer than this, in the problem's own measure.
    pub moved: Option<f64>,
    /// Settled once an accepted step lowers the cost by at most this share of the cost before it.
    pub gain: Option<f64>,
    /// Settled once a step is predicted to lower the cost by less than this; that step is not tried.
    pub predicted: Option<f64>,
    /// Settled once the actual drop in cost of an accepted step differs from the predicted one by less than this: the
    /// cost is then a parabola, and the step has reached its minimum.
    pub agreement: Option<f64>,
}

impl Tolerances {
    /// True if an accepted step meets one of the conditions.
    pub fn are_met(&self, progress: &Progress) -> bool {
        let Progress { before, after, predicted, moved } = *progress;
        self.moved.is_some_and(|most| moved <= most)
            || self.gain.is_some_and(|share| before - after <= share * before)
            || self.agreement.is_some_and(|most| (before - after - predicted).abs() < most)
    }
}

/// Rules of a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Method that keeps steps safe.
    pub control: Control,
    /// Condition to accept a step.
    pub acceptance: Acceptance,
    /// Conditions under which the fit has settled.
    pub tolerances: Tolerances,
    /// Maximum number of steps tried, including rejected ones.
    pub most_trials: usize,
    /// Maximum number of linearisations.
    pub most_linearisations: usize,
    /// Maximum number of consecutive rejections; the fit ends when it is reached.
    pub most_rejections: usize,
}

impl Params {
    /// Rules for a problem that decides by [`super::Problem::is_settled`] when it has converged: at most this many
    /// damped steps, none of which may raise the cost.
    pub const fn until_settled(damping: f64, most_trials: usize) -> Self {
        let damping = Damping {
            start: damping,
            least: 0.0,
            most: 1e4,
            decrease: 0.2,
            increase: 8.0,
            least_after_rejection: 1e-3,
            refused: Some(10.0),
        };
        Self {
            control: Control::Damping(damping),
            acceptance: Acceptance::NotHigher,
            tolerances: Tolerances { moved: None, gain: None, predicted: None, agreement: None },
            most_trials,
            most_linearisations: usize::MAX,
            most_rejections: usize::MAX,
        }
    }
}

impl Default for Params {
    /// Damped steps until one gains less than 1e-9 of the cost; at most 100.
    fn default() -> Self {
        Self {
            control: Control::Damping(Damping::default()),
            acceptance: Acceptance::Lower,
            tolerances: Tolerances { gain: Some(1e-9), ..Tolerances::default() },
            most_trials: 100,
            most_linearisations: usize::MAX,
            most_rejections: usize::MAX,
        }
    }
}

impl Params {
    /// Checks every number against its range.
    ///
    /// # Errors
    /// [`Error::Parameter`] with the name of the field.
    pub fn check(&self) -> Result<(), Error> {
        let require = |ok: bool, name, value, expected| match ok {
            true => Ok(()),
            false => Err(Error::Parameter { name, value, expected }),
        };
        match self.control {
            Control::Shortening { factor } => {
                require(factor > 0.0 && factor < 1.0, "factor", factor, "above 0 and below 1")
            }
            Control::Damping(rule) => {
                let least = |value: f64| value.is_finite() && value >= 0.0;
                require(least(rule.start), "start", rule.start, "finite and at least 0")?;
                require(least(rule.least), "least", rule.least, "finite and at least 0")?;
                require(rule.most > 0.0, "most", rule.most, "above 0")?;
                let falls = rule.decrease > 0.0 && rule.decrease <= 1.0;
                require(falls, "decrease", rule.decrease, "above 0 and at most 1")?;
                require(rule.increase > 1.0, "increase", rule.increase, "above 1")?;
                let rejected = rule.least_after_rejection;
                require(least(rejected), "least_after_rejection", rejected, "finite and at least 0")?;
                require(rule.refused.is_none_or(|f| f > 1.0), "refused", rule.refused.unwrap_or(1.0), "above 1")
            }
        }
    }
}

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
