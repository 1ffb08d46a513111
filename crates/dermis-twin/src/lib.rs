//! Digital twins of tactile skins: what presses on them ([`scene`]), how that deforms or closes their layers
//! ([`mechanics`]), the fields that follow ([`physics`], on finite elements through `dermis-tomo`) and what the
//! electronics make of it ([`instrument`]). [`Twin`] joins the four; [`HealingSquare`], [`IonicSkin`], [`PiezoSkin`]
//! and [`EmSkin`] are its skins.
//!
//! SI units throughout; frame of a flat skin: x right, y up, origin at the centroid. Pure apart from seeded random
//! numbers: no clocks, files or devices.
//!
//! ```
//! use dermis_twin::{HealingSquareOptions, Twin};
//!
//! let options = HealingSquareOptions { element_size_m: 6e-3, electrode_element_size_m: 3e-3, ..Default::default() };
//! let mut twin = Twin::healing_square(&options)?;
//! twin.scene_mut().press(1, 0.01, -0.02, 0.01, 80e3)?;
//! let mut frame = Vec::new();
//! for step in 0..10 {
//!     let truth = twin.step(0.04 * f64::from(step), &mut frame)?;
//!     assert_eq!((truth.sequence, frame.len()), (u64::from(step as u32), 208));
//! }
//! # Ok::<(), dermis_twin::TwinError>(())
//! ```

mod em;
mod error;
mod foil;
mod healing;
mod healing_square;
pub mod instrument;
mod ionic;
pub mod mechanics;
pub mod physics;
pub mod piezo;
pub mod scene;
mod twin;

pub use em::{EmArray, EmElement, EmOptions, EmSkin, NearbyMetal};
pub use error::TwinError;
pub use foil::{FoilOptions, FoilSkin};
pub use healing::{Heating, TimedTreatment, Treatment, Wear, Wound};
pub use healing_square::{HealingSquare, HealingSquareOptions};
pub use ionic::{IonicFields, IonicOptions, IonicShape, IonicSkin};
pub use piezo::{PaperP, PiezoOptions, PiezoShape, PiezoSkin, square_to_disc};
pub use twin::{Frontend, TouchTruth, Truth, Twin};
