//! The parts of a skin file. Each is a struct or an enum with the keys of the file as its fields; `dermis-skin` has
//! the few that are missing here.

/// ```
/// use dermis::Skin;
/// use dermis::skin::{BUILTIN_NAMES, DEFAULT_NAME, builtin_text, json_schema};
///
/// assert!(BUILTIN_NAMES.contains(&DEFAULT_NAME));
/// let text = builtin_text(DEFAULT_NAME).expect("it is built in");
/// assert_eq!(Skin::parse(text, "my-copy.toml")?, Skin::open(DEFAULT_NAME)?);
/// // A schema for editors that complete and check skin files.
/// assert!(json_schema().to_string().contains("electrodes"));
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_skin::builtin_text;
/// Shown with [`builtin_text`].
pub use dermis_skin::{BUILTIN_NAMES, DEFAULT_NAME, json_schema};

/// ```
/// use dermis::Skin;
/// use dermis::skin::{ContactLaw, Layer, SandwichLayer, SheetLayer};
///
/// // 5 mm of gel with 0.2 S/m, which a press makes conduct better or worse.
/// let gel = Layer::Sheet(SheetLayer { gauge_factor: 2.0, ..SheetLayer::gel(5.0, 0.2) });
/// assert_eq!(gel.kind(), "sheet");
/// // Foil under a better conductor: a press connects the two.
/// let foil = Layer::Sandwich(SandwichLayer {
///     thickness_mm: 0.5,
///     conductivity_s_per_m: 10.0,
///     shortcut_s: 1.0,
///     contact: ContactLaw { threshold_kpa: 1.0, reference_kpa: 50.0, exponent: 1.0, saturation_s_per_m2: 1e4 },
///     smoothing_mm: 2.0,
///     memory: None,
/// });
/// let skin = Skin::disc("foil", 80.0, foil).checked()?;
/// assert!(skin.sheet_conductance_s() > 0.0);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_skin::Layer;
/// Shown with [`Layer`].
pub use dermis_skin::{ContactLaw, SandwichLayer, SheetLayer};
/// No example: the other layers are built like the two in [`Layer`]'s example.
pub use dermis_skin::{ElementsLayer, LiquidLayer, Memory, PatchesLayer};

/// ```
/// use dermis::Skin;
/// use dermis::skin::{Bend, Electrodes, RimElectrode, Shape};
///
/// let square = Skin::open("healing-square")?;
/// assert!(matches!(square.frontend.shape, Shape::Square { .. }));
/// // The same skin around a tube.
/// let mut tube = square.clone();
/// tube.frontend.bend = Some(Bend::Cylinder { diameter_mm: 60.0 });
/// assert_ne!(tube.checked()?.surface(), square.surface());
/// // Electrodes one by one: four of 6 mm, a quarter of the rim apart.
/// let at = |k: u32| RimElectrode { at_deg: 90.0 * f64::from(k), width_mm: 6.0 };
/// let four = square.with_electrodes(Electrodes::RimList((0..4).map(at).collect()));
/// assert_eq!(four.electrode_shapes().len(), 4);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_skin::Bend;
/// Shown with [`Bend`].
pub use dermis_skin::{Electrodes, RimElectrode, Shape};
/// No example here: [`Frontend`] is a field of the skin in [`Bend`]'s example, the others are electrodes under the
/// sheet.
pub use dermis_skin::{Frontend, Pad, PadRing, Pair};

/// ```
/// use dermis::Skin;
/// use dermis::skin::Modality;
///
/// let em = Skin::open("em-8")?;
/// assert_eq!(em.modality, Modality::Mit);
/// assert!(em.frontend.coils.is_some() && em.frontend.elements.is_some());
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_skin::Modality;
/// No example: the coils and elements of the skin in [`Modality`]'s example.
pub use dermis_skin::{Coils, Elements};

/// ```
/// use dermis::Skin;
/// use dermis::skin::{DrivePattern, MeasurePattern};
///
/// let skin = Skin::open("healing-square")?;
/// let adjacent = skin.protocol()?.channel_count();
/// // Drive across three electrodes, and measure between neighbours.
/// let skip = skin.with_patterns(DrivePattern::Skip(3), MeasurePattern::Adjacent).checked()?;
/// assert_eq!(skip.protocol()?.electrode_count(), 16);
/// assert!(skip.protocol()?.channel_count() < adjacent);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_skin::DrivePattern;
/// Shown with [`DrivePattern`].
pub use dermis_skin::MeasurePattern;
/// No example: the instrument as the skin file describes it, field by field.
pub use dermis_skin::{Backend, DrivenChannels, ListedChannel, ReadingOrder, Reads, Wiring};

/// Shown with [`PriorChoice`].
pub use dermis_skin::HyperparameterChoice;
/// ```
/// use dermis::Skin;
/// use dermis::skin::{HyperparameterChoice, PriorChoice};
///
/// let mut skin = Skin::open("healing-square")?;
/// skin.imaging.prior = PriorChoice::Noser(0.5);
/// skin.imaging.hyperparameter = HyperparameterChoice::Number(0.05);
/// assert!(skin.checked()?.to_toml().contains("noser"));
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_skin::PriorChoice;
/// No example here: [`Imaging`] is a field of the skin in [`PriorChoice`]'s example, the others are fields of it.
pub use dermis_skin::{Imaging, Polarity, Solve, WeightChoice};

/// Shown with [`Mount`].
pub use dermis_skin::GuardSettings;
/// ```
/// use dermis::Skin;
/// use dermis::skin::{GuardSettings, Mount};
///
/// let mut skin = Skin::open("healing-square")?;
/// skin.guard = Some(GuardSettings::default());
/// skin.mount = Some(Mount { link: "forearm".into(), xyz_mm: [100.0, 0.0, 30.0], rpy_deg: [0.0, 0.0, 90.0] });
/// assert!(skin.checked()?.to_toml().contains("forearm"));
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_skin::Mount;
/// No example here: set like the fields in [`Mount`]'s example.
pub use dermis_skin::{DamageSettings, Demonstration, HealthSettings, Tolerances, TouchSettings, TwinSettings};
