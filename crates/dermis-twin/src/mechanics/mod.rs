//! From loads to the response of the layers: indenters produce a pressure field on the skin ([`Indenter`]), the cover
//! may delay it ([`Memory`]), and the pressure closes the gap between two layers ([`ContactLaw`]), deflects a
//! membrane over a liquid ([`Membrane`]), or moves rigid elements on springs ([`SpringGrid`]).

mod contact;
mod extent;
mod indenter;
mod mask;
mod membrane;
mod memory;
mod springs;

pub use contact::ContactLaw;
pub use dermis_tomo::membrane::{Membrane, MembraneSpec};
pub use extent::check_on_skin;
pub use indenter::{Cover, Indenter, Load, STANDARD_GRAVITY_M_PER_S2, Shape, normal_cdf};
pub use mask::{MOST_MASK_CELLS, Mask};
pub use membrane::{PressedMembrane, check_membrane};
pub use memory::{Memory, PressureState};
pub use springs::{SpringGrid, Springs};
