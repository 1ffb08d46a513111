//! Errors of a node.

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
