//! `dermis run --ros2`: publishes the run as a ROS 2 node.

use dermis::body::BodyRunOptions;
use dermis_live::pipeline::Pipeline;
use dermis_record::ros2::{NodeHead, NodeName, PatchHead, Ros2Node, Ros2Options, Ros2Summary};

use super::running::Running;
use crate::exit::UsageError;

/// Example at the end of the command's help.
pub const EXAMPLE: &str = "

As a ROS 2 node:
  dermis run --headless --frames 50 --speed 0 --ros2=/robot/skin";

/// Options of the node.
#[derive(clap::Args)]
pub struct Ros2Arguments {
    /// Publish as a ROS 2 node of this name (--ros2=/robot/skin; without a name /dermis), in the domain that
    /// ROS_DOMAIN_ID names. ROS need not be installed.
    #[arg(long, value_name = "NAME", num_args = 0..=1, require_equals = true, default_missing_value = "dermis")]
    ros2: Option<NodeName>,
    /// With --ros2: images and point clouds per second, at most; 0 for none.
    #[arg(long, value_name = "N", requires = "ros2", default_value_t = Ros2Options::CLOUDS_PER_S)]
    ros2_clouds_per_s: f64,
}

/// A node, if there is one.
pub struct OpenedNode(Option<Ros2Node>);

impl Ros2Arguments {
    fn options(&self) -> Result<Option<Ros2Options>, UsageError> {
        let Some(node) = self.ros2.clone() else { return Ok(None) };
        let clouds_per_s = self.ros2_clouds_per_s;
        if !(clouds_per_s >= 0.0 && clouds_per_s.is_finite()) {
            return Err(UsageError(format!("--ros2-clouds-per-s {clouds_per_s}: expected 0 or a positive number")));
        }
        Ok(Some(Ros2Options { node, clouds_per_s }))
    }

    /// Opens the node of a single skin, if it is asked for, and publishes the run there.
    pub fn open(&self, run: &mut Running, pipeline: &Pipeline) -> anyhow::Result<OpenedNode> {
        let Some(options) = self.options()? else { return Ok(OpenedNode(None)) };
        let head = PatchHead::new(pipeline, &pipeline.prepared().skin.name, run.source());
        let mut node = Ros2Node::open(&options, NodeHead { patches: vec![head], ..NodeHead::default() })?;
        eprintln!("ros2: {}", options.node);
        if let Some(publisher) = node.publisher(0) {
            run.publish_to(Box::new(publisher));
        }
        Ok(OpenedNode(Some(node)))
    }

    /// Adds the node to the options of a body.
    pub fn add_to(&self, options: &mut BodyRunOptions) -> Result<(), UsageError> {
        options.ros2 = self.options()?;
        if let Some(options) = &options.ros2 {
            eprintln!("ros2: {}", options.node);
        }
        Ok(())
    }
}

impl OpenedNode {
    /// Sends the queued messages, leaves the domain, and prints a summary.
    pub fn close(self) {
        self.0.map(Ros2Node::close).iter().for_each(print_summary);
    }
}

/// Prints how many messages were sent, dropped and refused.
pub fn print_summary(summary: &Ros2Summary) {
    let Ros2Summary { sent, dropped, refused } = summary;
    eprintln!("ros2: {sent} messages sent, {dropped} dropped, {refused} refused because a reader had stopped");
}
