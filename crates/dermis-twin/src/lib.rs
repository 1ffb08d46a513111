//! Digital twins of tactile skins: the loads on them ([`scene`]), the resulting deformation or contact of their
//! layers ([`mechanics`]), the fields ([`physics`], with finite elements from `dermis-tomo`), and the readings of the
//! electronics ([`instrument`]). [`Twin`] joins the four.
//!
//! The material of a skin decides its physics: a bare conductor ([`SheetSkin`]), a sheet under a continuous shortcut
//! layer ([`Sandwich`]) or under separate patches ([`PatchedSkin`]), a liquid ([`LiquidSkin`]), or conducting
//! elements over coils ([`ElementSkin`], and a foil over coils, [`FoilSkin`]). Each is built from options that
//! describe it completely.
//!
//! SI units throughout; frame of a flat skin: x right, y up. Pure apart from seeded random numbers: no clocks, files or
//! devices.
//!
//! ```
//! use dermis_tomo::eit::{Drive, Driven, Measure, Order, Protocol, ProtocolSpec};
//! use dermis_tomo::mesh::{Direction, Outline};
//! use dermis_twin::mechanics::Cover;
//! use dermis_twin::{ElectrodedLayer, SheetOptions, SheetSkin, Twin, TwinOptions};
//!
//! // A strip of conductive gel with 12 electrodes of 8 mm round its rim.
//! let outline = Outline::Rectangle { width_m: 0.12, height_m: 0.06 };
//! let protocol = Protocol::generate(&ProtocolSpec {
//!     electrode_count: 12,
//!     drive: Drive::Adjacent,
//!     measure: Measure::Adjacent,
//!     order: Order::Absolute,
//!     driven: Driven::Drop,
//!     amplitude_a: 1e-3,
//! })?;
//! let skin = SheetSkin::new(SheetOptions {
//!     layer: ElectrodedLayer {
//!         electrodes: outline.rim_segments(12, 8e-3, 0.015, Direction::CounterClockwise),
//!         outline,
//!         contact_impedances_ohm_m2: vec![1e-3],
//!         protocol,
//!         conductance: Default::default(),
//!         element_size_m: 6e-3,
//!         electrode_element_size_m: 3e-3,
//!     },
//!     sheet_s: 1e-3,
//!     pressure_coefficient_per_pa: 0.0,
//!     gauge_factor: 1.0,
//!     modulus_pa: 100e3,
//!     cover: Cover { smoothing_m: 2e-3 },
//!     memory: None,
//! })?;
//! let mut twin = Twin::of(skin, &TwinOptions::default())?;
//! twin.scene_mut().press(1, 0.01, -0.02, 0.01, 20e3)?;
//! let mut frame = Vec::new();
//! for step in 0..10 {
//!     let truth = twin.step(0.04 * f64::from(step), &mut frame)?;
//!     assert_eq!((truth.sequence, frame.len()), (u64::from(step as u32), 108));
//! }
//! # Ok::<(), dermis_twin::TwinError>(())
//! ```

mod circuit;
mod electroded_layer;
mod elements;
mod error;
mod foil;
pub mod from_skin;
mod gap;
mod healing;
pub mod instrument;
mod liquid;
pub mod mechanics;
mod patched;
pub mod physics;
pub mod piezo;
mod sandwich;
pub mod scene;
mod sheet;
mod twin;
mod wiring;

pub use electroded_layer::ElectrodedLayer;
pub use elements::{Conductor, ElementOptions, ElementSkin, NearbyMetal};
pub use error::TwinError;
pub use foil::{FoilOptions, FoilSkin};
pub use from_skin::{AnyTwin, AsBuilt, PressRange, TwinKit, TypicalPress};
pub use healing::{HealingLaw, Heating, MOST_CUTS, MOST_PADS, TimedTreatment, Treatment, Wear, Wound};
pub use liquid::{LiquidOptions, LiquidSkin, LiquidSolver};
pub use patched::{PatchedOptions, PatchedSkin};
pub use piezo::PaperP;
pub use sandwich::{Sandwich, SandwichOptions};
pub use sheet::{SheetOptions, SheetSkin};
pub use twin::{Frontend, Preparation, TouchTruth, Truth, Twin, TwinOptions};
