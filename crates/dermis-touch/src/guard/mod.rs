//! A guard: one verdict per frame for a machine that must stop when its skin is pressed too hard, or when its state is
//! unknown. It is a plain state machine. The caller gives the frame's touches, faults and times; nothing is read here.
//!
//! The verdict is `ok` only if the frame is recent, its image is its own, the baseline is trusted, enough channels
//! work, and no touch exceeds a limit. Whatever is unknown counts as exceeded. The guard is not safety-rated: it is
//! software on a general-purpose computer.

mod judge;
mod limits;
mod report;
#[cfg(test)]
mod tests;

pub use judge::{Guard, GuardFrame, LagMeter};
pub use limits::GuardLimits;
pub use report::{GuardReason, GuardReasons, GuardReport, GuardVerdict};
