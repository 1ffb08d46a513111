//! Tomographic tactile skins, from skin file to touches.
//!
//! A tomographic skin is a conductive sheet with a few electrodes at its rim. An instrument drives currents and
//! measures voltages there, and changes of the voltages reveal where and how hard the skin is touched. A [`Skin`] is
//! the skin's file; a [`Session`] reads its touches.
//!
//! ```
//! use dermis::{Session, Skin};
//!
//! let skin = Skin::open("healing-square")?;
//! // The skin's simulated twin. An instrument is "tcp:10.0.0.5:4000" or "serial:/dev/ttyACM0", a recording
//! // "press.mcap".
//! let session = Session::open("twin", skin)?;
//! let mut touched = 0;
//! for frame in session.take(100) {
//!     let frame = frame?;
//!     for touch in frame.touches.iter() {
//!         let [x, y] = touch.position_m.map(|m| 1e3 * m);
//!         println!("{:.2} s: touch {} at ({x:.1}, {y:.1}) mm", frame.time_s, touch.id);
//!     }
//!     touched += usize::from(!frame.touches.is_empty());
//! }
//! assert!(touched > 20, "the twin demonstrates touches by itself");
//! # Ok::<(), dermis::Error>(())
//! ```
//!
//! # Overview
//!
//! | | |
//! |---|---|
//! | [`Session`], [`SessionOptions`], [`SkinFrame`] | frames with touches, from a twin, a file, a recording, an instrument |
//! | [`Skin`], [`skin`] | a skin and its file: outline, layer, electrodes, instrument |
//! | [`Touch`], [`touch`] | touches, with forces and loads; damage, faults and verdicts next to them |
//! | [`Pipeline`], [`pipeline`] | a skin becomes an operator, frames become images and touches |
//! | [`source`] | frames from instruments and files, and sources of your own |
//! | [`Twin`], [`twin`] | simulated skins, and labelled frames of them |
//! | [`Recording`], [`record`] | recordings, replays, exports |
//! | [`Body`], [`BodyRun`], [`body`] | skins on a robot: touches and wrenches in every frame; running all of them at once |
//! | [`calibration`] | positions from pokes, forces from presses |
//! | [`design`] | a skin's performance before it is built; manufacturing tolerances |
//! | [`doctor`] | faults of an instrument, the order of its channels, the conductance of a sheet |
//! | [`offline`] | files of frames to images and touches |
//! | [`learn`] | networks that label images |
//! | [`eit`] | meshes, forward models and inverse operators, as in EIDORS and pyEIT |
//! | [`Error`] | the error of every function here |
//!
//! `examples/` has a program of less than 60 lines for each way to start: `first_touch`, `own_skin`, `own_instrument`,
//! `offline_images`, `train_and_use`.
//!
//! # Other crates
//!
//! This crate exports the types that most programs need. Each is defined in one of the crates below, which contain more
//! and can be used together with this one.
//!
//! | crate | purpose |
//! |---|---|
//! | `dermis-tomo` | the mathematics: meshes, EIT forward models, inverse operators |
//! | `dermis-mit` | magnetic induction: coils, multipole bodies, edge elements, sheets |
//! | `dermis-estimate` | number, positions and uncertainty of the presses that explain a frame |
//! | `dermis-touch` | contacts, tracks, baselines, noise and locators, for any array of taxels |
//! | `dermis-learn` | networks that label pixels, and their training |
//! | `dermis-skin` | every key of a skin file, its limits, and geometry as meshes |
//! | `dermis-device`, `dermis-wire` | formats of files and instruments; the byte protocol to firmware |
//! | `dermis-live` | the stages of the pipeline, one by one |
//! | `dermis-twin` | mechanics, fields and instruments of simulated skins |
//! | `dermis-body` | URDF files, kinematics and wrenches |
//! | `dermis-record` | sinks, publishers for Foxglove and ROS 2, the guard's socket |
//! | `dermis-lab` | published experiments, errors on measured data, training sets |

pub mod body;
mod body_run;
pub mod calibration;
pub mod design;
pub mod doctor;
pub mod eit;
mod error;
pub mod learn;
pub mod offline;
pub mod pipeline;
pub mod record;
mod session;
pub mod skin;
pub mod source;
pub mod touch;
pub mod twin;

pub use body_run::BodyRun;
/// ```
/// use dermis::FileError;
///
/// let failed = |source| FileError { file: "notes.txt".into(), source };
/// let error = std::fs::read("notes.txt").map_err(failed).unwrap_err();
/// assert!(error.to_string().starts_with("notes.txt: "));
/// ```
pub use dermis_skin::FileError;
pub use error::Error;
pub use session::{Session, SessionOptions};

/// ```
/// use dermis::{Session, Skin, SkinFrame};
///
/// let mut session = Session::open("twin", Skin::open("healing-square")?)?;
/// let Some(first) = session.next().transpose()? else { panic!("a twin has no end") };
/// let SkinFrame { sequence, raw, image, rows, columns, .. } = first;
/// assert_eq!((sequence, raw.len(), image.len()), (0, 208, rows * columns));
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_live::skin_frame::SkinFrame;

/// ```
/// use dermis::Body;
/// use dermis::body::DEMO_FILES;
///
/// // An arm with four skins. Yours has a file like this one, next to its robot's URDF file.
/// let folder = std::env::temp_dir().join(format!("dermis-body-{}", std::process::id()));
/// # let failed = |source| dermis::FileError { file: folder.clone(), source };
/// # std::fs::create_dir_all(&folder).map_err(failed)?;
/// # for (name, text) in DEMO_FILES {
/// #     std::fs::write(folder.join(name), text).map_err(failed)?;
/// # }
/// let body = Body::open(&folder.join("arm.toml"))?;
/// assert_eq!(body.patches.len(), 4);
/// # std::fs::remove_dir_all(&folder).map_err(failed)?;
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_body::Body;
/// ```
/// use dermis::pipeline::Prepared;
/// use dermis::source::{Frame, HostStamp, Layout};
/// use dermis::{Pipeline, Skin};
///
/// // Once: mesh, forward model, Jacobian.
/// let prepared = Prepared::new(Skin::open("healing-square")?)?;
/// let rest = prepared.voltages.clone();
/// // For every frame: channels, baseline, image, touches. The first 32 frames make the baseline.
/// let mut pipeline = Pipeline::new(prepared, &Layout::Channels { count: rest.len() }, None)?;
/// let mut frame = Frame::default();
/// frame.refill(0, HostStamp::now(), &rest, &[]);
/// let output = pipeline.process(&frame, frame.host_monotonic_ns)?;
/// assert!(output.touches.is_empty() && output.image.iter().all(|value| value.is_nan()));
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_live::pipeline::Pipeline;
/// ```
/// use dermis::Recording;
/// use dermis::record::{Recorder, RecordingHead};
/// use dermis::source::{Frame, HostStamp, Layout};
///
/// let file = std::env::temp_dir().join(format!("dermis-recording-{}.mcap", std::process::id()));
/// let head = RecordingHead::new("name = \"mine\"", Layout::Channels { count: 2 }, "my board");
/// let mut recorder = Recorder::create(&file, &head)?;
/// let mut frame = Frame::default();
/// frame.refill(0, HostStamp::now(), &[1.0, 2.0], &[]);
/// recorder.write_frame(&frame)?;
/// recorder.finish(0)?; // No frame was dropped on the way.
///
/// let mut recording = Recording::open(&file)?;
/// let frames = recording.frames().collect::<Result<Vec<_>, _>>()?;
/// assert_eq!(frames[0].values, [1.0, 2.0]);
/// # std::fs::remove_file(&file).map_err(|source| dermis::FileError { file, source })?;
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_record::Recording;
/// ```
/// use dermis::Skin;
/// use dermis::skin::{Layer, SheetLayer};
///
/// // A built-in skin, or the path of a file.
/// let square = Skin::open("healing-square")?;
/// assert_eq!(square.protocol()?.channel_count(), 208);
/// // The same in code as in TOML.
/// let gel = Layer::Sheet(SheetLayer::gel(5.0, 0.2));
/// let pad = Skin::rectangle("gel-pad", 150.0, 60.0, gel).with_rim_electrodes(20, 5.0).checked()?;
/// assert_eq!(Skin::parse(&pad.to_toml(), "gel-pad.toml")?, pad);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_skin::Skin;
/// ```
/// use dermis::{Session, Skin, TouchPhase};
///
/// let mut begun = 0;
/// for frame in Session::open("twin", Skin::open("healing-square")?)?.take(80) {
///     let frame = frame?;
///     // A touch begins once, moves, and is listed a last time in the frame in which it ends.
///     begun += frame.touches.iter().filter(|touch| touch.phase == TouchPhase::Begin).count();
///     assert!(frame.ended.iter().all(|touch| touch.phase == TouchPhase::End));
/// }
/// assert!(begun > 0);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_touch::Touch;
/// Shown with [`Touch`].
pub use dermis_touch::TouchPhase;
/// ```
/// use dermis::{Skin, Twin};
///
/// let mut twin = Twin::from_skin(&Skin::open("healing-square")?)?;
/// let mut frame = Vec::new();
/// twin.step(0.0, &mut frame)?;
/// // A finger with a radius of 8 mm presses with 80 kPa, 10 mm to the right of the centre and 20 mm below it.
/// twin.scene_mut().press(1, 0.01, -0.02, 0.008, 80e3)?;
/// let truth = twin.step(0.2, &mut frame)?;
/// assert_eq!((truth.touches.len(), frame.len()), (1, 208));
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_twin::AnyTwin as Twin;

/// The code of the README compiles and runs.
#[cfg(doctest)]
#[doc = include_str!("../../../README.md")]
struct Readme;
