//! What fits say of presses that the baseline holds.

/// Presses that the baseline holds and that have gone.
#[derive(Debug)]
pub(crate) enum Gone<'a> {
    /// Nothing else touches the skin: the frames that come are its new baseline.
    Alone,
    /// Others touch it; these change the channels by so much, model volts.
    BesideOthers(&'a [f64]),
}
