//! Health of channels and electrodes, frame by frame: readings that are missing, frozen, at the converter's end, gone
//! to zero, noisy, or that contradict what the others say. Channels are judged first; an electrode (or coil) is blamed
//! when the channels that use it agree.
//!
//! The yardstick that no touch can move is reciprocity: swapping drive and measurement leaves a transfer impedance as
//! it is, pressed or not (Geselowitz, IEEE Trans. Biomed. Eng. 18 (1971) 38), so that what two reciprocal channels
//! differ by beyond their noise is a fault of the instrument. Channels without such a partner are compared with what
//! the others let expect under the linear model, far more generously, since touches are not small.
//!
//! Frames that were recorded one by one, each press with a resting frame before it, are judged by these resting frames:
//! [`RestScatter`].

mod channel_state;
mod electrode_faults;
mod fault;
mod frame_judge;
mod monitor;
mod params;
mod rest;
mod start;
mod wiring;

#[cfg(test)]
mod tests;

pub use fault::{
    ChannelFault, ChannelFaultKind, ElectrodeFault, ElectrodeFaultKind, FrameFault, FrameFaultKind, Health,
};
pub use monitor::HealthMonitor;
pub use params::{HEALTH_WINDOW, HealthParams};
pub use rest::{FEWEST_AT_REST, RestScatter};
pub use start::HealthReference;
pub use wiring::Wiring;
