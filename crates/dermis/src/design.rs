//! A skin's performance before it is built: bounds on positions and forces, better protocols, manufacturing errors.

/// ```
/// use dermis::Skin;
/// use dermis::design::{Maps, Noise, Summary, verdict};
/// use dermis::pipeline::Prepared;
/// use dermis::skin::{Layer, SheetLayer};
///
/// // How well could a gel place a touch that changes its conductivity by a tenth, with 8 and with 16 electrodes?
/// let bound = |electrodes: usize| -> Result<Summary, dermis::Error> {
///     let gel = Layer::Sheet(SheetLayer::gel(5.0, 0.2));
///     let mut skin = Skin::rectangle("pad", 100.0, 100.0, gel).with_rim_electrodes(electrodes, 5.0);
///     skin.imaging.elements = 800;
///     Ok(Summary::of(&Maps::new(&Prepared::new(skin)?, Noise::Assumed, 0.1, 8)?.position_m))
/// };
/// let (eight, sixteen) = (bound(8)?, bound(16)?);
/// assert!(sixteen.worst < eight.worst && sixteen.median < 0.05);
/// println!("{}", verdict(&[("eight", eight), ("sixteen", sixteen)]).expect("two skins are compared"));
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_lab::design::Maps;
/// Shown with [`Maps`].
pub use dermis_lab::design::{Noise, Summary, verdict};

/// ```
/// use dermis::Skin;
/// use dermis::design::{Candidate, Freedom, Noise, Search, improve};
/// use dermis::skin::{Layer, SheetLayer};
///
/// let mut skin = Skin::disc("pad", 80.0, Layer::Sheet(SheetLayer::gel(5.0, 0.2))).with_rim_electrodes(6, 5.0);
/// skin.imaging.elements = 500;
/// let search = Search { freed: vec![Freedom::Drive], amplitude: 0.1, along: 6, noise: Noise::Assumed };
/// let [original, best]: [Candidate; 2] = improve(&skin, &search, |_done, _all| {})?;
/// assert!(best.position_m.worst <= original.position_m.worst);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_lab::design::improve;
/// Shown with [`improve`].
pub use dermis_lab::design::{Candidate, Freedom, Search};

/// No example: [`smallest_force`] presses a twin at every place of a map, which takes seconds. `dermis design
/// --forces` is a program around it.
pub use dermis_lab::design::{ForceMap, smallest_force};

/// No example: a study builds a skin hundreds of times, which takes a minute. `dermis design --tolerances` is a program
/// around it.
pub use dermis_lab::tolerances::{Extent as ToleranceExtent, ToleranceReport, ToleranceRow, run as study_tolerances};
