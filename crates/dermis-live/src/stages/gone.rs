//! Result of fits about presses that are part of the baseline but have ended.

/// Presses that are part of the baseline but have ended.
#[derive(Debug)]
pub(crate) enum Gone<'a> {
    /// Nothing else touches the skin: the next frames are its new baseline.
    Alone,
    /// Other presses touch the skin. The ended ones account for this change of the channels, model volts.
    BesideOthers(&'a [f64]),
}
