//! A frame as damage is looked for in it, and what follows from it.

use dermis_touch::{Baseline, Contact, Touch};

use crate::stages::sandwich_contacts::PatchStage;

/// One frame with what touches are made of it.
#[derive(Clone, Copy)]
pub(crate) struct DamageFrame<'a> {
    /// Its time on the frames' axis, nanoseconds.
    pub time_ns: u64,
    /// The baseline of touches, with the readings of the frame.
    pub baseline: &'a Baseline,
    /// Difference data against that baseline, model volts, NaN where channels are left out.
    pub difference: &'a [f64],
    /// Factors from readings to model volts.
    pub scale: &'a [f64],
    /// Standard deviations of the channels, model volts.
    pub noise: &'a [f64],
    /// Touches on the skin.
    pub touches: &'a [Touch],
    /// What touches are made of, and what is not enough to begin one.
    pub contacts: &'a [Contact],
    /// What touches are fitted by, where they are.
    pub patches: Option<&'a PatchStage>,
    /// Anything lies on the skin.
    pub loaded: bool,
}

/// What follows from one frame for the baseline of touches.
#[derive(Clone, Debug, Default)]
pub(crate) struct DamageDecision {
    /// A baseline to adopt in place of the one in use.
    pub adopt: Option<Adoption>,
    /// Something is suspected: the baseline must not follow it as drift.
    pub hold_drift: bool,
    /// Damage is in the baseline, which has to follow the resting skin as it heals.
    pub follow_rest: bool,
    /// Nothing lies on the skin: what begins no touch is in the baseline alone.
    pub is_free: bool,
}

/// Readings to adopt as a baseline.
#[derive(Clone, Debug)]
pub(crate) struct Adoption {
    /// Mean readings, one a channel.
    pub readings: Vec<f64>,
    /// Frames that they are the mean of.
    pub frames: usize,
    /// Why, for the baseline's record.
    pub reason: String,
}
