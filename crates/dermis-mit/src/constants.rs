//! Constants of free space.

use std::f64::consts::PI;

/// Magnetic constant, H/m, with the value used by all references here.
pub const MU0: f64 = 4e-7 * PI;

/// `4 pi mu0`, henries per metre.
pub(crate) const FOUR_PI_MU0: f64 = 4.0 * PI * MU0;
