//! Electrical impedance tomography: the complete electrode model (CEM) on linear (P1) finite elements, in 2D, on curved
//! sheets and in 3D, with stimulation and measurement as explicit lists.
//!
//! The potential solves `div(sigma grad u) = 0`. Under electrode `l` with contact impedance `z_l` it satisfies
//! `u + z_l sigma du/dn = U_l` and `int sigma du/dn = I_l` (Somersalo, Cheney and Isaacson, SIAM J. Appl. Math. 52,
//! 1992, eqs. 2.1-2.5). Signs and units follow EIDORS: positive current enters the body, `J = dv/dsigma`.

mod channel_order;
mod circuit;
pub mod contacts;
mod error;
mod forward;
mod jacobian;
mod protocol;
mod system;

pub use channel_order::{ChannelMap, OrderFit, OrderReport, correlation, diagnose_order};
pub use circuit::{CircuitResponse, CurrentReturn, Lines, ReadoutCircuit};
pub use error::{CircuitError, EitError};
pub use forward::{ForwardModel, Solution};
pub use jacobian::Jacobian;
pub use protocol::{
    Drive, Driven, Measure, Measurement, Order, Pattern, Protocol, ProtocolError, ProtocolSpec, Reference,
};
