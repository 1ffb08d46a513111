//! Spots, as results and during a fit.

use crate::mesh::Point;

/// Number of parameters of a spot.
pub(super) const OF_SPOT: usize = 4;

/// A fitted spot.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spot {
    /// Centre, metres.
    pub position_m: Point,
    /// Height of a Gaussian with the same integral and second moment: relative change of conductivity.
    pub amplitude: f64,
    /// Radius r of that Gaussian, `exp(-d^2 / (2 r^2))`, metres.
    pub radius_m: f64,
    /// Covariance of x, y (metres), amplitude and log radius.
    pub covariance: [[f64; 4]; 4],
}

/// A spot during a fit.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct State {
    pub position_m: Point,
    pub amplitude: f64,
    pub log_radius: f64,
}

impl State {
    /// Position, radius (metres) and amplitude.
    pub(super) fn spot(&self) -> ([f64; 2], f64, f64) {
        (self.position_m, self.log_radius.exp(), self.amplitude)
    }

    /// The step to another state in the parameters of a fit: x, y, amplitude at constant `a r^2`, log radius.
    pub(super) fn step_to(&self, to: &Self) -> [f64; OF_SPOT] {
        let wider = to.log_radius - self.log_radius;
        let [x, y] = [0, 1].map(|axis| to.position_m[axis] - self.position_m[axis]);
        [x, y, to.amplitude * (2.0 * wider).exp() - self.amplitude, wider]
    }
}
