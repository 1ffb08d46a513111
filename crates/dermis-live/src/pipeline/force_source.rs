//! Sources of the forces that touches report.

/// Source of the touches' forces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ForceSource {
    /// A force calibration.
    Calibration {
        /// Root mean square of its errors, newtons.
        residual_n: f64,
    },
    /// A calibration with pokes of known force.
    Pokes,
    /// The law of the layer in the skin file.
    Law,
}

impl ForceSource {
    /// The source in one word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Calibration { .. } => "calibration",
            Self::Pokes => "pokes",
            Self::Law => "law",
        }
    }

    /// Root mean square of the errors of a force calibration, newtons.
    pub fn residual_n(self) -> Option<f64> {
        if let Self::Calibration { residual_n } = self { Some(residual_n) } else { None }
    }
}
