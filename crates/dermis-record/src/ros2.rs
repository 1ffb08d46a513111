//! A ROS 2 node that needs no installation of ROS: it speaks DDS, the protocol under ROS 2, directly. Needs the feature
//! `ros2`.
//!
//! [`Ros2Node::open`] joins the domain in `ROS_DOMAIN_ID` and starts a sending thread. Each patch has a publisher
//! ([`Ros2Node::publisher`]) that takes frames and results from its pipeline. Messages wait in a bounded queue; if it
//! is full, they are dropped and counted, and the pipeline goes on.
//!
//! Topics of a single skin are below the node's name, as in recordings: `/dermis/touches`. Those of a body's patches
//! are below the patch's name: `/dermis/palm/touches`. Positions are metres in the patch's frame, forces act on the
//! sensor.

mod error;
mod joints;
mod messages;
mod names;
mod node;
mod participant;
mod patch;
mod shape;
mod status;
mod tare;
mod topics;

pub use error::Ros2Error;
pub use joints::JointReader;
pub use messages::NamedTransform;
pub use names::NodeName;
pub use node::{NodeHead, Ros2Node, Ros2Options, Ros2Summary, TransformPublisher};
pub use patch::{PatchHead, PatchPublisher};
