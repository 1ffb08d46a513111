//! Tomographic tactile skins, from skin file to touches.
//!
//! A tomographic skin is a conductive sheet with a few electrodes at its rim. Currents are driven and voltages
//! measured there, and the changes of the voltages reveal where and how hard the skin is touched. A [`Skin`] is its
//! file; a [`Session`] reads one.
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
//!     for touch in &frame.touches {
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
//! | [`Skin`], [`skin`] | a skin and its file: outline, layer, electrodes, instrument |
//! | [`Session`], [`source`] | frames with touches, from a twin, a file, a recording, an instrument |
//! | [`body`], [`body_run`] | skins on a robot: its URDF, touches and wrenches in every frame; running all of them at once |
//! | [`Pipeline`], [`live`] | a skin becomes an operator, frames become touches; calibrations |
//! | [`Touch`], [`touch`] | contacts, tracks, baselines, noise, forces |
//! | [`Twin`], [`twin`] | simulated skins: mechanics, fields, instrument |
//! | [`Recording`], [`record`] | recordings, exports, sinks |
//! | [`lab`] | design, doctor, channel order, training sets, published experiments |
//! | [`device`] | instruments, file formats |
//! | [`learn`] | networks that label images |
//! | [`tomo`], [`mit`] | the mathematics: meshes, EIT, inverse operators; magnetic induction |
//!
//! `examples/` has a program of less than 60 lines for each way in: `first_touch`, `own_skin`, `own_instrument`,
//! `offline_images`, `train_and_use`.

pub mod body_run;
mod session;
pub mod source;

pub use dermis_body as body;
pub use dermis_device as device;
pub use dermis_lab as lab;
pub use dermis_learn as learn;
pub use dermis_live as live;
pub use dermis_mit as mit;
pub use dermis_record as record;
pub use dermis_skin as skin;
pub use dermis_tomo as tomo;
pub use dermis_touch as touch;
pub use dermis_twin as twin;

pub use dermis_lab::Error;
pub use dermis_live::pipeline::Pipeline;
pub use dermis_record::Recording;
pub use dermis_skin::Skin;
pub use dermis_touch::Touch;
pub use dermis_twin::AnyTwin as Twin;
pub use session::{Session, SessionOptions, SkinFrame};

/// The code of the README compiles and runs.
#[cfg(doctest)]
#[doc = include_str!("../../../README.md")]
struct Readme;
