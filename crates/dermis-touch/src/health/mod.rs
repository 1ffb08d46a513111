//! Health of channels and electrodes, frame by frame: readings that are missing, frozen, at the converter's limit,
//! gone to zero, noisy, or inconsistent with other channels. Channels are judged first; an electrode (or coil) is
//! blamed if the channels that use it agree.
//!
//! The test that no touch can disturb is reciprocity: swapping drive and measurement leaves a transfer impedance
//! unchanged, pressed or not (Geselowitz, IEEE Trans. Biomed. Eng. 18 (1971) 38). A difference between two reciprocal
//! channels beyond their noise is therefore a fault of the instrument. Channels without a reciprocal partner are
//! compared with the value that the linear model expects from the others, with far wider tolerance, since touches are
//! not small.
//!
//! Frames recorded one by one, each press with its own resting frame, are judged by these resting frames:
//! [`RestScatter`].

mod channel_state;
mod electrode_faults;
mod fault;
mod frame_judge;
mod monitor;
mod params;
mod rest_scatter;
mod start;
mod wiring;

#[cfg(test)]
mod tests;

pub use fault::{
    ChannelFault, ChannelFaultKind, ElectrodeFault, ElectrodeFaultKind, FrameFault, FrameFaultKind, Health,
};
pub use monitor::{HealthMonitor, JudgedFrame};
pub use params::{HEALTH_WINDOW, HealthParams};
pub use rest_scatter::{FEWEST_AT_REST, RestScatter};
pub use start::HealthReference;
pub use wiring::Wiring;
