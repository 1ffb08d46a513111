//! The pipeline behind a session: the prepared skin, what every frame yields, and the baseline it refers to.

/// ```
/// use dermis::Skin;
/// use dermis::pipeline::Prepared;
///
/// let prepared = Prepared::new(Skin::open("healing-square")?)?;
/// assert_eq!((prepared.channels(), prepared.voltages.len()), (208, 208));
/// // Channels x pixels: volts per relative change of conductivity.
/// assert_eq!(prepared.jacobian.row(0).len(), prepared.map.inside_count());
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_live::prepare::Prepared;

/// No example: fields of [`SkinFrame`](crate::SkinFrame).
pub use dermis_live::{clock::FrameAnomalies, stages::classes::SeenClasses, stages::damage::DamageView};

/// ```
/// use dermis::pipeline::{BaselineState, ReferenceOrigin};
/// use dermis::{Session, Skin};
///
/// let mut session = Session::open("twin", Skin::open("healing-square")?)?;
/// assert!(matches!(session.pipeline().baseline_state(), BaselineState::Starting { have: 0, .. }));
/// session.by_ref().take(40).try_for_each(|frame| frame.map(|_| ()))?;
/// assert_eq!(session.pipeline().baseline_records()[0].origin, ReferenceOrigin::Startup);
/// // A tare asks for another one.
/// session.pipeline_mut().tare(true, "the skin was moved")?;
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_touch::BaselineState;
/// Shown with [`BaselineState`].
pub use dermis_touch::ReferenceOrigin;
/// No example here: [`Pipeline::baseline_records`](crate::Pipeline::baseline_records) lists them, see
/// [`BaselineState`]'s example.
pub use dermis_touch::ReferenceRecord;

/// ```
/// use dermis::{Session, Skin};
///
/// let mut session = Session::open("twin", Skin::open("healing-square")?)?;
/// session.by_ref().take(40).try_for_each(|frame| frame.map(|_| ()))?;
/// let [(first, histogram), ..] = session.pipeline().latencies().stages();
/// println!("{first}: half of the frames take less than {} us", histogram.quantile_us(0.5));
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_live::pipeline::StageLatencies;

/// No example: the argument of [`Pipeline::set_classifier`](crate::Pipeline::set_classifier).
pub use dermis_live::stages::classes::ClassPace;
