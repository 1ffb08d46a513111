//! From things that press to what the layers do: indenters give a pressure field on the skin ([`Indenter`]), the
//! cover may remember it for a while ([`Memory`]), and pressure closes the gap between two layers ([`ContactLaw`]).

mod contact;
mod indenter;
mod memory;

pub use contact::ContactLaw;
pub use indenter::{Cover, Indenter, Load, Shape};
pub use memory::{Memory, PressureState};
