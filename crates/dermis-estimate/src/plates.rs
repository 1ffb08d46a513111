//! Presses on a sheet under separate plates, by the physics of contact.
//!
//! Under a disc of radius R, pressure P reaches the sheet through a cover that spreads it over s: at distance d from
//! the centre it is `p = P Phi((R - d) / s)`, with the normal distribution Phi. Pressures of several presses add.
//! Pressure closes the gap and makes a contact of conductance `g(p)` between the sheet and the plate above it. The
//! potentials of the plates adjust ([`dermis_tomo::eit::contacts::PlatedSheet`]).

mod fit;
mod force;
mod law;
mod model;
mod pressure;
mod profile;
mod reported;
mod weighing;

pub use fit::PlateFit;
pub use law::PlateLaw;
pub use model::{PlateModel, PlateOptions};
