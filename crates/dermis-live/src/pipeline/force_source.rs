//! Sources of the forces that touches report.

/// Source of the touches' forces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ForceSource {
    /// A force calibration.
    Calibration,
    /// A calibration with pokes of known force.
    Pokes,
    /// The law of the layer in the skin file.
    Law,
}

impl ForceSource {
    /// The source in one word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Calibration => "calibration",
            Self::Pokes => "pokes",
            Self::Law => "law",
        }
    }
}
