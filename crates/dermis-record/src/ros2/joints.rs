//! Joint values from a topic with `sensor_msgs/JointState`.

use super::error::Ros2Error;
use super::messages::read_joints;
use super::names::{checked_topic, dds_topic, dds_type};
use super::participant::{Participant, Quality, Reader, domain};

/// Reads joint values from a topic.
pub struct JointReader {
    reader: Reader,
    /// Keeps the reader in its domain.
    _participant: Participant,
}

impl std::fmt::Debug for JointReader {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("JointReader").finish_non_exhaustive()
    }
}

impl JointReader {
    /// Subscribes to a topic, such as `/joint_states`, in the domain that `ROS_DOMAIN_ID` names.
    ///
    /// # Errors
    /// A name that ROS doesn't allow; a domain that doesn't exist or cannot be joined.
    pub fn open(topic: &str) -> Result<Self, Ros2Error> {
        let topic = checked_topic(topic)?;
        let participant = Participant::join(domain()?)?;
        // Best effort is compatible with every publisher, and the next values come soon.
        let kind = dds_type("sensor_msgs/msg/JointState");
        let reader = participant.dds_reader(&dds_topic(&topic), &kind, Quality::Sensor)?;
        Ok(Self { reader, _participant: participant })
    }

    /// The next message, if there is one: names and values of joints, radians or metres. A message that isn't such a
    /// list is an error.
    pub fn take(&mut self) -> Option<Result<Vec<(String, f64)>, &'static str>> {
        let received = self.reader.take()?;
        Some(read_joints(&received.message).ok_or("expected a sensor_msgs/JointState with as many names as positions"))
    }
}
