//! Parts of a frame other than the position of a touch: its load, damage of the skin, faults of its
//! channels, and the guard's verdict.

/// ```
/// use dermis::touch::{ForceReading, LoadQuantity, Observation, TouchLoad};
/// use dermis::{Session, Skin};
///
/// let frames = Session::open("twin", Skin::open("healing-square")?)?.take(80);
/// let frames = frames.collect::<Result<Vec<_>, _>>()?;
/// for touch in frames.iter().flat_map(|frame| frame.touches.iter()) {
///     assert!(matches!(touch.observation, Observation::Measured | Observation::Merged | Observation::Missed));
///     // Without a calibration nobody knows a force, or how deep a poke went.
///     assert!(touch.force.and_then(ForceReading::valid_n).is_none() && touch.load.is_none());
/// }
/// # let load = TouchLoad { quantity: LoadQuantity::ForceN, value: 1.0, sigma: 0.1 };
/// # assert_eq!(load.quantity, LoadQuantity::ForceN);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_touch::Observation;
/// No example: fields of a [`Touch`](crate::Touch).
pub use dermis_touch::{ContactSign, PlaceHypothesis};
/// Shown with [`Observation`].
pub use dermis_touch::{LoadQuantity, TouchLoad, force::ForceReading};

/// ```
/// use dermis::{Session, Skin};
///
/// let mut session = Session::open("twin", Skin::open("healing-square")?)?;
/// let output = session.next_borrowed()?.expect("a twin has no end");
/// assert!(output.damage.damages.is_empty(), "the skin is new");
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_touch::damage::Damage;
/// No example: fields of [`Damage`], and its events.
pub use dermis_touch::damage::{DamageEvent, DamageShape, DamageState};

/// ```
/// use dermis::{Session, Skin};
///
/// let mut session = Session::open("twin", Skin::open("healing-square")?)?;
/// session.by_ref().take(40).try_for_each(|frame| frame.map(|_| ()))?;
/// assert!(session.pipeline().health().is_sound(), "no channel is left out");
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_touch::health::Health;
/// No example: the entries of [`Health`].
pub use dermis_touch::health::{
    ChannelFault, ChannelFaultKind, ElectrodeFault, ElectrodeFaultKind, FrameFault, FrameFaultKind,
};

/// ```
/// use dermis::skin::GuardSettings;
/// use dermis::touch::GuardVerdict;
/// use dermis::{Session, Skin};
///
/// // With the usual limits any touch stops.
/// let skin = Skin { guard: Some(GuardSettings::default()), ..Skin::open("healing-square")? };
/// let mut session = Session::open("twin", skin)?;
/// let output = session.next_borrowed()?.expect("a twin has no end");
/// let report = output.guard.expect("the skin has a guard");
/// assert_ne!(report.verdict, GuardVerdict::Ok, "there is no baseline yet");
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_touch::guard::GuardVerdict;
/// No example here: [`GuardVerdict`] is the first field of the report, the reasons are the second.
pub use dermis_touch::guard::{GuardReason, GuardReasons, GuardReport};
