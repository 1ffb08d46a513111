//! Limits of a guard.

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
