//! A body being read: every patch has a thread that takes its frames and one that makes touches of them, and none of
//! them waits for another. A patch that fails, stalls or is unplugged is told in the table of health; the rest goes on.

mod error;
mod joints;
mod line;
mod loads;
mod patch;
mod report;
mod run;

pub use error::BodyRunError;
pub use joints::{JointSnapshot, JointsState};
pub use loads::NetWrench;
pub use report::{PatchHealth, PatchReport, PatchState, TouchInFrames};
pub use run::{BodyRun, BodyRunOptions};
