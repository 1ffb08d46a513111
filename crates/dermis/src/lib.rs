//! Tomographic tactile skins: skin files, forward models and operators prepared from them, the live pipeline from frames
//! to touches, calibration, recordings.
//!
//! ```
//! let skin = dermis::skin::Skin::open("healing-square")?;
//! let body = skin.body()?;
//! assert_eq!(body.mesh.electrodes.len(), 16);
//! # Ok::<(), dermis::Error>(())
//! ```

pub mod acquire;
pub mod bodies;
pub mod calibrate;
pub mod case;
pub mod channels;
pub mod classes;
mod clock;
pub mod damage;
pub mod design;
pub mod doctor;
mod error;
pub mod experiments;
pub mod forces;
mod health;
pub mod imager;
pub mod latency;
pub mod learning;
pub mod measured_list;
mod patches;
pub mod pipeline;
pub mod prepare;
pub mod reconstruct;
pub mod record;
pub mod reference;
pub mod serve;
pub mod sink;
pub mod skin;
pub mod solve;
mod spots;
pub mod touches;
pub mod twin_source;
pub mod twins;

pub use clock::Marks;
pub use error::Error;
pub use health::{HealthChange, HealthWatch};
