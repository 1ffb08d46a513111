//! Simulated skins: presses by commands, faults and treatments, and labelled frames of a skin that need not exist.

/// No example: the result of [`press_range`], which has one.
pub use dermis_twin::PressRange;
/// ```
/// use dermis::Skin;
/// use dermis::twin::press_range;
///
/// let usual = press_range(&Skin::open("healing-square")?);
/// assert!(usual.pressure_pa[1] > usual.initial_pressure_pa);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_twin::from_skin::press_range;

/// ```
/// use dermis::Skin;
/// use dermis::source::{OpenedSource, SourceOptions, open_source};
/// use dermis::twin::TwinCommand;
///
/// let skin = Skin::open("healing-square")?;
/// let OpenedSource { twin, source, .. } = open_source(&"twin".parse()?, &skin, &SourceOptions::default())?;
/// let control = twin.expect("the source is a twin");
/// control.commands.send(TwinCommand::Demonstrate(false))?;
/// // Once the twin is gone, commands are refused.
/// drop(source);
/// assert_eq!(control.commands.send(TwinCommand::Repair).unwrap_err().to_string(), "the twin has ended");
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_lab::twin_commands::TwinCommand;
/// No example here: [`TwinCommand`]'s example sends commands, one of which is refused.
pub use dermis_lab::twin_commands::{CommandRefused, TwinCommands};

/// No example: the heat pad on a healing skin, the content of `Treatment::Heat`.
pub use dermis_twin::Heating;
/// ```
/// use dermis::twin::{Cut, Fault, Treatment};
/// use dermis::{Skin, Twin};
///
/// let mut twin = Twin::from_skin(&Skin::open("healing-square")?)?;
/// // An electrode comes off.
/// twin.set_faults(vec![Fault::OpenElectrode { electrode: 3 }.into()])?;
/// twin.step(0.0, &mut Vec::new())?;
/// assert_eq!(twin.instrument().faults().len(), 1);
/// // A blade cuts the skin from the centre to the right.
/// twin.frontend_mut().treat(&Treatment::Cut(Cut::open([0.0, 0.0], [0.02, 0.0])))?;
/// assert_eq!(twin.frontend().wounds().len(), 1);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_twin::Treatment;
/// Shown with [`Treatment`].
pub use dermis_twin::{instrument::Fault, physics::Cut};

/// ```
/// use dermis::twin::{FrameFate, TouchTruth, Truth};
/// use dermis::{Skin, Twin};
///
/// let mut twin = Twin::from_skin(&Skin::open("healing-square")?)?;
/// twin.scene_mut().press(1, 0.01, 0.0, 0.008, 80e3)?;
/// let Truth { fate, touches, .. } = twin.step(0.0, &mut Vec::new())?;
/// assert!(*fate == FrameFate::Delivered && touches.iter().all(|TouchTruth { x_m, .. }| *x_m == 0.01));
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_twin::Truth;
/// Shown with [`Truth`].
pub use dermis_twin::{TouchTruth, instrument::FrameFate};

/// Shown with [`sample_tables`].
pub use dermis_lab::twin_sample::random_presses;
/// ```
/// use dermis::Skin;
/// use dermis::twin::{Indenter, IndenterShape, Load, press_range, random_presses, sample_tables};
///
/// let skin = Skin::open("healing-square")?;
/// let mut presses = random_presses(&skin.outline(), &press_range(&skin), 2, 7)?;
/// // A third one, with a force instead of a pressure.
/// let (shape, load) = (IndenterShape::Disc { radius_m: 0.008 }, Load::ForceN(10.0));
/// presses.push(vec![Indenter { centre_m: [0.01, 0.0], shape, load }]);
/// let [untouched, pressed] = sample_tables(&skin, &presses, None, |_done, _all| {})?;
/// assert_eq!((untouched.channels(), pressed.frames()), (208, 3));
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_lab::twin_sample::sample_tables;
/// No example here: the one of [`reconstruct`](crate::offline::reconstruct) writes the files of a sample.
pub use dermis_lab::twin_sample::{SampleRequest, sample};
/// Shown with [`sample_tables`].
pub use dermis_twin::mechanics::{Indenter, Load, Shape as IndenterShape};

/// ```
/// use dermis::twin::ServedTwin;
/// use dermis::{Session, Skin};
///
/// // The twin as an instrument on a local socket.
/// let skin = Skin::open("healing-square")?;
/// let served = ServedTwin::start(&skin)?;
/// let mut session = Session::open(&served.selector().to_string(), skin)?;
/// assert!(session.next().transpose()?.is_some());
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_lab::serve::Background as ServedTwin;
