//! Runs a body: each patch has one thread that receives its frames and one that turns them into touches, and no patch
//! waits for another. If a patch fails, stalls or is unplugged, the health table says so and the others keep running.

#[cfg(feature = "foxglove")]
mod foxglove;
mod joints;
mod line;
mod loads;
mod patch;
mod patch_files;
mod report;
#[cfg(feature = "ros2")]
mod ros2;
mod run;
mod watch;

#[cfg(feature = "foxglove")]
pub use foxglove::mount_pose;
pub use joints::{JointSnapshot, JointsState};
pub use loads::NetWrench;
pub use patch_files::check_patch_files;
pub use report::{PatchHealth, PatchReport, PatchState, TouchInFrames};
pub use run::{BodyRun, BodyRunOptions};
pub use watch::{BodyWatch, OpenPublisher, StartingPatch};
