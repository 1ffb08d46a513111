//! Limits of a guard, and the comparison of a touch's force and pressure with them. A force counts only if it is known
//! to be below its limit.

use std::f64::consts::PI;

use super::report::{GuardReason, GuardReasons};
use crate::contact::LoadQuantity;
use crate::force::ForceReading;
use crate::touch::Touch;

/// Limits of a guard. Times are nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GuardLimits {
    /// Force at which a touch stops the machine, newtons.
    pub force_n: Option<f64>,
    /// Mean pressure at which a touch stops the machine, pascals: its force over its fitted area.
    pub pressure_pa: Option<f64>,
    /// True if any touch stops the machine.
    pub any_touch: bool,
    /// True if damage stops the machine.
    pub damage: bool,
    /// Age at which a frame is stale.
    pub stale_after_ns: u64,
    /// How long a verdict other than `ok` lasts after its cause has gone.
    pub hold_ns: u64,
    /// Largest share of the channels that may be left out, 0 to 1.
    pub most_left_out: f64,
}

/// Adds the reasons why a touch stops.
pub(super) fn judge_touch(touch: &Touch, limits: &GuardLimits, reasons: &mut GuardReasons) {
    if limits.any_touch {
        reasons.insert(GuardReason::Touch);
    }
    if limits.force_n.is_none() && limits.pressure_pa.is_none() {
        return;
    }
    let force_n = largest_force_n(touch);
    if let Some(limit_n) = limits.force_n {
        compare(force_n, limit_n, [GuardReason::Force, GuardReason::ForceUnknown], reasons);
    }
    if let Some(limit_pa) = limits.pressure_pa {
        // The area in the image is blurred, which would hide a sharp tip. Only a fitted radius counts.
        let radius_m = touch.radius_m.filter(|radius_m| radius_m.is_finite() && *radius_m > 0.0);
        let pressure_pa = match (force_n, radius_m) {
            (Some(force_n), Some(radius_m)) => Some(force_n / (PI * radius_m * radius_m)),
            _ => None,
        };
        compare(pressure_pa, limit_pa, [GuardReason::Pressure, GuardReason::PressureUnknown], reasons);
    }
}

fn compare(value: Option<f64>, limit: f64, [above, unknown]: [GuardReason; 2], reasons: &mut GuardReasons) {
    match value.filter(|value| value.is_finite()) {
        Some(value) if value < limit => {}
        Some(_) => reasons.insert(above),
        None => reasons.insert(unknown),
    }
}

/// Upper bound of a touch's force, newtons; `None` without one. A force below the calibrated range is at most the
/// range's lower end; one above it, or of a saturated skin, has no bound.
fn largest_force_n(touch: &Touch) -> Option<f64> {
    match touch.force {
        Some(ForceReading::Valid { force_n, .. } | ForceReading::FromLaw { force_n, .. }) => Some(force_n),
        Some(ForceReading::BelowRange { least_n }) => Some(least_n),
        Some(ForceReading::AboveRange { .. } | ForceReading::Saturated { .. } | ForceReading::NotFinite) => None,
        None => touch.load.filter(|load| load.quantity == LoadQuantity::ForceN).map(|load| load.value),
    }
}
