//! A ROS 2 node, without an installation of ROS: it speaks DDS, the protocol under ROS 2, by itself. Needs the feature
//! `ros2`.
//!
//! [`Ros2Node::open`] joins the domain that `ROS_DOMAIN_ID` names and starts a thread that sends. Each patch has a
//! publisher ([`Ros2Node::publisher`]) that its pipeline hands frames and results. Messages wait in a bounded queue; if
//! it is full, they are dropped and counted, and the pipeline goes on.
//!
//! Topics of a single skin are below the node's name, as in recordings: `/dermis/touches`. Those of a body's patches are
//! below the patch's name: `/dermis/palm/touches`. Positions are metres in the patch's frame, forces act on the sensor.

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

pub use joints::JointReader;
pub use messages::NamedTransform;
pub use names::NodeName;
pub use node::{NodeHead, Ros2Node, Ros2Options, Ros2Summary, TransformPublisher};
pub use patch::{PatchHead, PatchPublisher};

pub(crate) use shape::{PatchLimits, PatchShape};

/// Errors of a node.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Ros2Error {
    /// A name that breaks the rules of ROS, or is taken.
    #[error("ROS 2 name {name:?}: {reason}")]
    Name {
        /// The name.
        name: String,
        /// The reason, with what was expected.
        reason: String,
    },
    /// A domain that doesn't exist.
    #[error("ROS_DOMAIN_ID={text:?}: expected a number from 0 to {most}")]
    Domain {
        /// The value found.
        text: String,
        /// The highest domain.
        most: u16,
    },
    /// The domain cannot be joined.
    #[error(
        "ROS 2 domain {domain}: {reason}; expected a network interface with an IPv4 address and free UDP ports from {}",
        7400 + 250 * u32::from(*domain)
    )]
    Network {
        /// The domain.
        domain: u16,
        /// The reason.
        reason: String,
    },
    /// A topic cannot be made.
    #[error("ROS 2 topic {topic}: {reason}")]
    Topic {
        /// The topic.
        topic: String,
        /// The reason.
        reason: String,
    },
    /// The operating system refused a thread.
    #[error("a thread for ROS 2: {source}")]
    Thread {
        /// Error from the operating system.
        source: std::io::Error,
    },
}
