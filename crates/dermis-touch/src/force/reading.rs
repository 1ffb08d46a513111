//! The force of a touch, or the reason why there is none.

use serde::{Deserialize, Serialize};

/// A force, or the reason why there is no reliable one. Out-of-range readings carry the force at that end of the
/// curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ForceReading {
    /// Within the calibrated range, newtons.
    Valid {
        /// The force.
        force_n: f64,
        /// Its standard deviation.
        sigma_n: f64,
    },
    /// Weaker than the weakest calibrated press.
    BelowRange {
        /// The smallest calibrated force. The true force is probably smaller.
        least_n: f64,
    },
    /// Stronger than the strongest calibrated press.
    AboveRange {
        /// The largest calibrated force. The true force is probably larger.
        most_n: f64,
    },
    /// The skin hardly responds to more force.
    Saturated {
        /// Force at the onset of saturation. The true force is probably larger.
        from_n: f64,
    },
    /// The signal is not a finite number.
    NotFinite,
    /// Not calibrated, or outside the calibrated range: estimated from the layer's force law in the skin file, newtons.
    FromLaw {
        /// The force.
        force_n: f64,
        /// Its standard deviation.
        sigma_n: f64,
    },
}

impl ForceReading {
    /// The force, if it is reliable.
    #[must_use]
    pub fn valid_n(self) -> Option<f64> {
        if let Self::Valid { force_n, .. } = self { Some(force_n) } else { None }
    }

    /// The force, or the end of the range that it exceeds ([`ForceReading::range`] says which).
    #[must_use]
    pub fn nearest_n(self) -> Option<f64> {
        match self {
            Self::Valid { force_n, .. } => Some(force_n),
            Self::BelowRange { least_n } => Some(least_n),
            Self::AboveRange { most_n } => Some(most_n),
            Self::Saturated { from_n } => Some(from_n),
            Self::FromLaw { force_n, .. } => Some(force_n),
            Self::NotFinite => None,
        }
    }

    /// Standard deviation, newtons; `None` for the end of a range.
    #[must_use]
    pub fn sigma_n(self) -> Option<f64> {
        if let Self::Valid { sigma_n, .. } | Self::FromLaw { sigma_n, .. } = self { Some(sigma_n) } else { None }
    }

    /// The force by the layer's law and its standard deviation, newtons.
    #[must_use]
    pub fn by_law(self) -> Option<[f64; 2]> {
        if let Self::FromLaw { force_n, sigma_n } = self { Some([force_n, sigma_n]) } else { None }
    }

    /// Position of the signal in the calibration: `within`, `below`, `above`, `saturated` or `none`; `law` if the
    /// layer's force law gives the force beyond any calibration.
    #[must_use]
    pub fn range(self) -> &'static str {
        match self {
            Self::Valid { .. } => "within",
            Self::BelowRange { .. } => "below",
            Self::AboveRange { .. } => "above",
            Self::Saturated { .. } => "saturated",
            Self::FromLaw { .. } => "law",
            Self::NotFinite => "none",
        }
    }
}
