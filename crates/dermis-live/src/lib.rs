//! From a skin file to an operator ([`prepare`]), and from frames to touches ([`pipeline`]).
//!
//! ```
//! use dermis_device::{Frame, HostStamp, Layout};
//! use dermis_live::pipeline::Pipeline;
//! use dermis_live::prepare::Prepared;
//! use dermis_skin::Skin;
//!
//! // Once: mesh, forward model, Jacobian.
//! let prepared = Prepared::new(Skin::open("healing-square")?)?;
//! let (rest, pressed) = (prepared.voltages.clone(), prepared.signatures(&[[0.01, -0.02]]));
//! // For every frame: channels, baseline, image, touches. The first 32 frames make the baseline.
//! let mut pipeline = Pipeline::new(prepared, &Layout::Channels { count: rest.len() }, None)?;
//! let mut frame = Frame::default();
//! for n in 0..40_u64 {
//!     let share = if n < 32 { 0.0 } else { 0.3 };
//!     // Readings in volts; a thousandth of a thousandth of noise.
//!     let noise = |channel: usize| 1e-6 * rest[0] * ((n * 37 + channel as u64 * 101) % 17) as f64;
//!     let values: Vec<f64> = (0..rest.len()).map(|k| rest[k] + share * pressed[k] + noise(k)).collect();
//!     frame.refill(n, HostStamp::now(), &values, &[]);
//!     frame.device_time_ns = Some(n * 20_000_000);
//!     let output = pipeline.process(&frame, frame.host_monotonic_ns)?;
//!     assert!(n < 36 || output.touches.len() == 1, "frame {n}: {:?}", output.touches);
//! }
//! # Ok::<(), dermis_live::Error>(())
//! ```
//!
//! | module | |
//! |---|---|
//! | [`prepare`], [`magnetic_model`] | a skin file to its forward model on the image grid |
//! | [`channels`], [`reference`](mod@reference) | an instrument's readings to the skin's channels; baselines to the model's volts |
//! | [`imager`], [`reconstructor`] | differences to images; images to touches |
//! | [`pipeline`], [`stages`], [`skin_frame`] | all of this for every frame, in memory that does not grow; the results |
//! | [`driver`], [`clock`], [`latency`], [`instant`] | the loop over frames; their times; their durations |
//! | [`mod@calibrate`], [`calibration`], [`forces`], [`network`] | learning from pokes, presses and training |

pub mod as_built;
mod beside;
pub mod calibrate;
pub mod calibration;
mod channel_noise;
pub mod channels;
pub mod clock;
pub mod driver;
mod error;
pub mod forces;
pub mod frame_noise;
pub mod imager;
pub mod instant;
pub mod label_checks;
pub mod latency;
pub mod magnetic_model;
pub mod network;
pub mod pipeline;
pub mod prepare;
pub mod reconstructor;
pub mod reference;
pub mod same_skin;
pub mod skin_frame;
pub mod stages;

pub use error::Error;
