//! dermis's own wire protocol (`dermis-wire`, specified in the book): the host's side of the conversation, and the
//! device's side, which lets twins and tests act as an instrument on a real port. Neither side knows the port.

mod assembly;
mod count;
mod device;
mod host;
mod order;

pub use device::{DeviceInfo, WireDevice};
pub use host::WireHost;
pub use order::{Description, Order, Question, WireControl};
