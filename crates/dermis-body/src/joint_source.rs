//! The source of the joint values of a running body, as text: `-`, `tcp:HOST:PORT`, `ros2:/TOPIC`, `sweep`, `page`
//! or a file.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::error::Error;

/// The texts that name a source.
pub(crate) const EXPECTED: &str = "- (standard input), tcp:HOST:PORT, ros2:/TOPIC, sweep, page or a file of JSON lines";

/// A source of joint values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum JointSource {
    /// JSON lines on standard input.
    Input,
    /// JSON lines from a socket, `HOST:PORT`.
    Tcp(String),
    /// A ROS 2 topic of `sensor_msgs/JointState`.
    Ros2(String),
    /// A demonstration: every joint moves between its limits.
    Sweep,
    /// Set by hand, on the page.
    Page,
    /// A file of JSON lines, played at the pace of their `time_s`.
    File(PathBuf),
}

impl JointSource {
    /// The source with a relative file taken as relative to a folder.
    pub(crate) fn in_folder(self, folder: &Path) -> Self {
        match self {
            Self::File(file) => Self::File(folder.join(file)),
            other => other,
        }
    }
}

impl FromStr for JointSource {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let refused = || Error::Joints { message: format!("{text:?}: expected {EXPECTED}") };
        match text {
            "" => Err(refused()),
            "-" => Ok(Self::Input),
            "sweep" => Ok(Self::Sweep),
            "page" => Ok(Self::Page),
            _ => match text.split_once(':') {
                Some(("tcp", address)) if is_address(address) => Ok(Self::Tcp(address.to_owned())),
                Some(("ros2", topic)) if topic.len() > 1 && topic.starts_with('/') => Ok(Self::Ros2(topic.to_owned())),
                Some(("tcp" | "ros2", _)) => Err(refused()),
                _ => Ok(Self::File(text.into())),
            },
        }
    }
}

/// True for `HOST:PORT`.
fn is_address(text: &str) -> bool {
    text.rsplit_once(':').is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok_and(|port| port > 0))
}

impl fmt::Display for JointSource {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Input => to.write_str("-"),
            Self::Tcp(address) => write!(to, "tcp:{address}"),
            Self::Ros2(topic) => write!(to, "ros2:{topic}"),
            Self::Sweep => to.write_str("sweep"),
            Self::Page => to.write_str("page"),
            Self::File(file) => file.display().fmt(to),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_survive_printing_and_parsing() {
        for text in ["-", "tcp:10.0.0.5:7000", "tcp:[::1]:7000", "ros2:/joints", "sweep", "page", "joints.jsonl"] {
            assert_eq!(text.parse::<JointSource>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn faulty_sources_are_refused() {
        for text in ["", "tcp:robot", "tcp::7000", "tcp:robot:0", "tcp:robot:70000", "ros2:", "ros2:joint_states"] {
            let refusal = text.parse::<JointSource>().unwrap_err().to_string();
            assert!(refusal.contains(&format!("{text:?}")) && refusal.contains("tcp:HOST:PORT"), "{refusal}");
        }
    }
}
