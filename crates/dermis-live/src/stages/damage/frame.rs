//! A frame as input for damage detection, and the resulting decisions.

use dermis_touch::{Baseline, Contact, Touch};

use crate::stages::refinement::Refinement;

/// One frame with its touches.
#[derive(Clone, Copy)]
pub(crate) struct DamageFrame<'a> {
    /// Time of the frame, nanoseconds on the frames' axis.
    pub time_ns: u64,
    /// The baseline of touches, with the frame's readings.
    pub baseline: &'a Baseline,
    /// Difference data against that baseline, model volts, NaN in excluded channels.
    pub difference: &'a [f64],
    /// Factors from readings to model volts.
    pub scale: &'a [f64],
    /// Standard deviations of the channels, model volts.
    pub noise: &'a [f64],
    /// Touches on the skin.
    pub touches: &'a [Touch],
    /// Contacts, both those of touches and those too weak to begin one.
    pub contacts: &'a [Contact],
    /// The stage that fits touches.
    pub refinement: &'a Refinement,
    /// True if anything lies on the skin.
    pub loaded: bool,
}

/// Decisions from one frame for the baseline of touches.
#[derive(Clone, Debug, Default)]
pub(crate) struct DamageDecision {
    /// A baseline to adopt in place of the current one.
    pub adopt: Option<Adoption>,
    /// Something is suspected, so the baseline must not follow it as drift.
    pub hold_drift: bool,
    /// The baseline includes damage, and must follow the resting skin as it heals.
    pub follow_rest: bool,
    /// Nothing lies on the skin; contacts that begin no touch come from the baseline alone.
    pub is_free: bool,
}

/// Readings to adopt as a baseline.
#[derive(Clone, Debug)]
pub(crate) struct Adoption {
    /// Mean readings, one per channel.
    pub readings: Vec<f64>,
    /// Number of frames averaged.
    pub frames: usize,
    /// Reason, for the baseline's record.
    pub reason: String,
}
