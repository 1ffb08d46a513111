//! Instruments that speak dermis's own wire (`dermis-wire`, specified in the book): the host's side of the
//! conversation, and the device's, with which twins and tests stand behind a real port. Neither knows the port.

mod assembly;
mod count;
mod device;
mod host;
mod order;

pub use device::{DeviceInfo, WireDevice};
pub use host::WireHost;
pub use order::{Description, Order, Question, WireControl};
