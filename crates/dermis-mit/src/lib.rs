//! Magnetic induction tomography: coils, the small conducting bodies that they sense, and the resulting changes of
//! mutual inductance. The only files it touches are the cache of bodies ([`catalogue`]). It can be used without the
//! skin crates.
//!
//! ```
//! use dermis_mit::{MitError, Sphere, skin_depth_m};
//!
//! // Copper at 1 MHz lets a field in no deeper than 66 um: a ball of 20 mm answers like one that lets no flux in.
//! // Its polarizability is -2 pi a^3 (Jackson, Classical Electrodynamics, 5.11 with mu = 0).
//! let (radius_m, conductivity_s_per_m, relative_permeability) = (0.01_f64, 58e6, 1.0);
//! assert!((skin_depth_m(conductivity_s_per_m, relative_permeability, 1e6)? - 66e-6).abs() < 1e-6);
//! let ball = Sphere { radius_m, conductivity_s_per_m, relative_permeability };
//! let perfect_m3 = -2.0 * std::f64::consts::PI * radius_m.powi(3);
//! // The skin depth is 0.7 % of the radius and lowers the response by three halves of that.
//! assert!((ball.polarizability_m3(1e6)?.re / perfect_m3 - 1.0).abs() < 0.015);
//! # Ok::<(), MitError>(())
//! ```
//!
//! | | |
//! |---|---|
//! | [`Coil`], [`CoilSpec`], [`CoilArray`] | coils as filaments, by description, on a grid |
//! | [`Element`], [`Polarizability`], [`Sphere`], [`RingBody`], [`ConductingPlate`] | bodies and how they respond |
//! | [`MultipoleArray`], [`LiftOff`] | readings of an array under bodies; heights from readings |
//! | [`edge`], [`sheet`] | edge elements for any body; eddy currents in sheets |
//! | [`sensitivity`] | sensitivity of each coil pair at every position |
//!
//! Conventions: `e^{+j w t}`, SI, `mu0 = 4e-7 pi`. The change of the impedance between two coils is `dZ = j w dM`.
//! `dM` (henries, complex) has a negative real part if flux is pushed out of a coil's own loop, and the imaginary
//! part of a self term is negative if power is lost. Positions are in metres, x right, y up, z out of the skin.

mod array;
pub mod catalogue;
mod coil;
mod coil_spec;
mod constants;
pub mod edge;
mod element;
mod error;
mod harmonics;
mod in_box;
mod lift_off;
mod model_choice;
mod multipole_array;
mod plate;
mod polarizability;
mod published;
mod quadrature;
mod ring;
mod ring_body;
mod segment;
pub mod sensitivity;
pub mod sheet;
mod sphere;
mod vector;

pub use array::{CoilArray, CoilOutline, MOST_COILS};
pub use coil::{Coil, CoilShape, Filament};
pub use coil_spec::{CoilGrid, CoilSpec, Conductor, MOST_TURNS};
pub use constants::MU0;
pub use element::{Element, ElementShape};
pub use error::MitError;
pub use harmonics::{HARMONICS, MOST_DEGREE, expansion, regular, regular_gradients};
pub use lift_off::{LiftOff, LiftOffFit, LiftOffOptions};
pub use model_choice::{BodyModel, body_changes_h};
pub use multipole_array::{CoilTables, Coupling, MultipoleArray};
pub use plate::{ConductingPlate, RoundWinding};
pub use polarizability::Polarizability;
pub use published::{EM_8, EM_16_CIRCULAR, EM_16_SQUARE, PublishedArray};
pub use ring::{Ring, complete_elliptic};
pub use ring_body::{RingBody, Section};
pub use segment::Segment;
pub use sphere::{Sphere, skin_depth_m};
pub use vector::Complex;
