//! By which rules steps are damped, taken and ended.

use super::progress::Progress;

/// Parameters that make no sense.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// One of them.
    #[error("{name} of a least-squares fit = {value}: expected {expected}")]
    Parameter {
        /// Its name, as in the struct that holds it.
        name: &'static str,
        /// Its value.
        value: f64,
        /// The range in words.
        expected: &'static str,
    },
}

/// How the damping changes, as a share of the diagonal of the normal equations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Damping {
    /// At the start. At least 0.
    pub start: f64,
    /// It never falls below this. At least 0.
    pub least: f64,
    /// The fit ends where it reaches this; infinite for never.
    pub most: f64,
    /// Factor after a step that was taken. Above 0 and at most 1.
    pub decrease: f64,
    /// Factor after a step that was rejected. Above 1.
    pub increase: f64,
    /// After a rejected step it is at least this. At least 0.
    pub least_after_rejection: f64,
    /// Factor where the equations cannot be solved or a step leads nowhere (above 1); without one the fit then ends.
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

/// What makes steps safe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Control {
    /// Damping of the equations; a rejected step is solved for anew.
    Damping(Damping),
    /// Whole steps, shortened by a factor between 0 and 1 each time they are rejected. A rejected step that moves no
    /// farther than the tolerance settles the fit.
    Shortening {
        /// The factor.
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

/// Which steps are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Acceptance {
    /// Those that lower the cost.
    Lower,
    /// Those that do not raise it.
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

/// When a fit has settled; what is `None` is not asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tolerances {
    /// A step that was taken has moved no farther than this, in the problem's own measure.
    pub moved: Option<f64>,
    /// It has lowered the cost by no more than this share of what it was.
    pub gain: Option<f64>,
    /// A step would lower the cost by less than this; it is not even tried.
    pub predicted: Option<f64>,
    /// A step that was taken has lowered the cost as predicted up to less than this: it is a parabola, whose bottom
    /// this is.
    pub agreement: Option<f64>,
}

impl Tolerances {
    /// Whether a step that was taken meets one of them.
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
    /// What makes steps safe.
    pub control: Control,
    /// Which steps are taken.
    pub acceptance: Acceptance,
    /// When it has settled.
    pub tolerances: Tolerances,
    /// Steps tried at most, rejected ones included.
    pub most_trials: usize,
    /// Linearisations at most.
    pub most_linearisations: usize,
    /// The fit ends where so many steps in a row are rejected.
    pub most_rejections: usize,
}

impl Default for Params {
    /// Damped steps until they gain less than 1e-9 of the cost; at most 100.
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
    /// [`Error::Parameter`] naming the field.
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
