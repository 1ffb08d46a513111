//! Replaces `ros2.rs` in builds without ROS 2: refuses the option and explains what to do.

use dermis::body::BodyRunOptions;
use dermis_live::pipeline::Pipeline;

use super::running::Running;
use crate::exit::UsageError;

/// Adds nothing to the command's help.
pub const EXAMPLE: &str = "";

/// Options of a node that this build lacks.
#[derive(clap::Args)]
pub struct Ros2Arguments {
    #[arg(long, hide = true, num_args = 0..=1, require_equals = true, default_missing_value = "")]
    ros2: Option<String>,
    #[arg(long, hide = true, requires = "ros2")]
    ros2_clouds_per_s: Option<f64>,
}

/// No node.
pub struct OpenedNode;

impl Ros2Arguments {
    fn refuse(&self) -> Result<(), UsageError> {
        if self.ros2.is_none() && self.ros2_clouds_per_s.is_none() {
            return Ok(());
        }
        let text = "--ros2: this dermis was built without ROS 2; expected one built with `--features ros2`";
        Err(UsageError(text.into()))
    }

    /// Refuses the option.
    pub fn open(&self, _run: &mut Running, _pipeline: &Pipeline) -> anyhow::Result<OpenedNode> {
        Ok(self.refuse().map(|()| OpenedNode)?)
    }

    /// Refuses the option.
    pub fn add_to(&self, _options: &mut BodyRunOptions) -> Result<(), UsageError> {
        self.refuse()
    }
}

impl OpenedNode {
    /// Does nothing.
    pub fn close(self) {}
}
