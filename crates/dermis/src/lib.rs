//! Tomographic tactile skins, from their file to touches: the crates of dermis under one name.
//!
//! ```
//! let skin = dermis::Skin::open("healing-square")?;
//! let body = skin.body()?;
//! assert_eq!(body.mesh.electrodes.len(), 16);
//! # Ok::<(), dermis::Error>(())
//! ```

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
