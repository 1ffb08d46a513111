//! Diagnosis: faults of an instrument and its skin, the order of channels in an unknown file, a sheet's conductance.

/// ```
/// use std::time::Duration;
///
/// use dermis::Skin;
/// use dermis::doctor::{Answer, Check, FEWEST_FRAMES, examine};
/// use dermis::skin::Demonstration;
/// use dermis::source::{SourceOptions, open_source};
///
/// let mut skin = Skin::open("healing-square")?;
/// skin.twin.demonstration = Some(Demonstration::None);
/// let mut opened = open_source(&"twin".parse()?, &skin, &SourceOptions::default())?;
/// let checks = examine(skin, &mut *opened.source, FEWEST_FRAMES, Duration::from_secs(5), None)?;
/// for Check { name, answer, found, advice } in &checks {
///     println!("{name}: {found} {advice}");
///     assert_ne!(*answer, Answer::Bad, "{name}");
/// }
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_lab::doctor::examine;
/// Shown with [`examine`].
pub use dermis_lab::doctor::{Answer, Check, FEWEST_FRAMES};

/// Shown with [`find_order`].
pub use dermis_lab::channel_search::FoundOrder;
/// No example: one of the candidates of [`FoundOrder`].
pub use dermis_lab::channel_search::OrderCandidate;
/// ```
/// use dermis::Skin;
/// use dermis::doctor::{FoundOrder, find_order};
/// use dermis::twin::{press_range, random_presses, sample_tables};
///
/// // Frames of an untouched skin, in an order that a skin file should state.
/// let skin = Skin::open("healing-square")?;
/// let presses = random_presses(&skin.outline(), &press_range(&skin), 1, 7)?;
/// let [untouched, _] = sample_tables(&skin, &presses, None, |_done, _all| {})?;
/// let found: FoundOrder = find_order(&untouched, Some(&skin))?;
/// let best = found.fitting().expect("the twin reads what the model predicts");
/// println!("{}\n{}", best.description, best.lines());
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_lab::channel_search::find_order;

/// ```
/// use dermis::Skin;
/// use dermis::doctor::conductance;
/// use dermis::skin::{Layer, SheetLayer};
/// use dermis::twin::{press_range, random_presses, sample_tables};
///
/// let skin = Skin::disc("pad", 80.0, Layer::Sheet(SheetLayer::gel(5.0, 0.2))).checked()?;
/// let presses = random_presses(&skin.outline(), &press_range(&skin), 1, 7)?;
/// let [untouched, _] = sample_tables(&skin, &presses, None, |_done, _all| {})?;
/// let found = conductance(&skin, &untouched)?;
/// // 5 mm of 0.2 S/m.
/// assert!((found.sheet_s - 1e-3).abs() < 5e-5, "{}", found.sheet_s);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_lab::conductance::conductance;
/// No example: results of [`conductance`], which has one.
pub use dermis_lab::conductance::{Conductance, Region};
