//! Runs a body: every patch has a thread that takes its frames and one that turns them into touches, and none waits
//! for another. A patch that fails, stalls or is unplugged is reported in the table of health; the rest go on.

#[cfg(feature = "foxglove")]
mod foxglove;
mod joints;
mod line;
mod loads;
mod patch;
mod report;
#[cfg(feature = "ros2")]
mod ros2;
mod run;
mod watch;

#[cfg(feature = "foxglove")]
pub use foxglove::mount_pose;
pub use joints::{JointSnapshot, JointsState};
pub use loads::NetWrench;
pub use report::{PatchHealth, PatchReport, PatchState, TouchInFrames};
pub use run::{BodyRun, BodyRunOptions};
pub use watch::{BodyWatch, OpenPublisher, StartingPatch};
