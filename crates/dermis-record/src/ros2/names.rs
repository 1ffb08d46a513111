//! Names of ROS 2 and their counterparts in DDS (<https://design.ros2.org/articles/topic_and_service_names.html>).

use std::fmt;
use std::str::FromStr;

use super::error::Ros2Error;

/// Longest name of a topic. DDS allows 255 characters, and some are needed for prefix and suffix.
const MOST_CHARACTERS: usize = 247;

/// Name of a node with its namespace: `/robot/skin` is the node `skin` in `/robot`.
///
/// ```
/// use dermis_record::ros2::NodeName;
///
/// let node: NodeName = "/robot/skin".parse()?;
/// assert_eq!(node.topic("touches"), "/robot/skin/touches");
/// assert_eq!("skin".parse::<NodeName>()?.to_string(), "/skin");
/// assert!("healing-square".parse::<NodeName>().is_err());
/// # Ok::<(), dermis_record::ros2::Ros2Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeName {
    /// `/`, or `/robot`.
    namespace: String,
    name: String,
}

impl NodeName {
    /// The namespace: `/` or `/robot`.
    pub fn namespace(&self) -> &str {
        &self.namespace
    }

    /// The name without its namespace.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// A topic below the node's name.
    pub fn topic(&self, rest: &str) -> String {
        format!("{self}/{rest}")
    }
}

impl Default for NodeName {
    /// `/dermis`
    fn default() -> Self {
        Self { namespace: "/".to_owned(), name: "dermis".to_owned() }
    }
}

impl fmt::Display for NodeName {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}/{}", self.namespace.trim_end_matches('/'), self.name)
    }
}

impl FromStr for NodeName {
    type Err = Ros2Error;

    fn from_str(text: &str) -> Result<Self, Ros2Error> {
        let refused = |reason: &str| Ros2Error::Name { name: text.to_owned(), reason: reason.to_owned() };
        let (namespace, name) = text.rsplit_once('/').unwrap_or(("", text));
        let parts = namespace.strip_prefix('/').unwrap_or(namespace);
        if namespace.len() != parts.len() || namespace.is_empty() {
            let parts = parts.split('/').filter(|_| !parts.is_empty());
            for part in parts.chain([name]) {
                check_token(part).map_err(|reason| refused(&reason))?;
            }
        } else {
            return Err(refused("expected a / in front of the namespace, as in /robot/skin"));
        }
        if text.len() > MOST_CHARACTERS / 2 {
            return Err(refused(&format!("expected at most {} characters", MOST_CHARACTERS / 2)));
        }
        let namespace = if parts.is_empty() { "/".to_owned() } else { format!("/{parts}") };
        Ok(Self { namespace, name: name.to_owned() })
    }
}

/// Checks one part of a name.
fn check_token(token: &str) -> Result<(), String> {
    let Some(first) = token.chars().next() else { return Err("expected a name between slashes".to_owned()) };
    if let Some(odd) = token.chars().find(|c| !c.is_ascii_alphanumeric() && *c != '_') {
        return Err(format!("{odd:?} in {token:?}; expected letters, digits and _ ({})", token_of(token)));
    }
    if first.is_ascii_digit() {
        return Err(format!("{token:?} begins with a digit; expected a letter or _"));
    }
    if token.contains("__") {
        return Err(format!("{token:?} has two underscores in a row; expected one"));
    }
    Ok(())
}

/// A valid part of a name, made from any text: characters other than letters and digits become `_`.
pub(super) fn token_of(text: &str) -> String {
    let mut token = String::new();
    for c in text.chars() {
        let c = if c.is_ascii_alphanumeric() { c } else { '_' };
        if token.is_empty() && c.is_ascii_digit() {
            token.push('_');
        }
        if c != '_' || !token.ends_with('_') {
            token.push(c);
        }
    }
    if token.is_empty() { "_".to_owned() } else { token }
}

/// Valid and different parts of names for these texts.
///
/// # Errors
/// Two texts give the same part.
pub(super) fn tokens_of<'a>(texts: impl Iterator<Item = &'a str>) -> Result<Vec<String>, Ros2Error> {
    let mut found: Vec<(&str, String)> = Vec::new();
    for text in texts {
        let token = token_of(text);
        if let Some((other, _)) = found.iter().find(|(_, taken)| *taken == token) {
            let reason = format!("its topics would be those of {other:?}, {token}; expected a different name");
            return Err(Ros2Error::Name { name: text.to_owned(), reason });
        }
        found.push((text, token));
    }
    Ok(found.into_iter().map(|(_, token)| token).collect())
}

/// Name in DDS of a topic: `rt/dermis/touches`.
pub(super) fn dds_topic(topic: &str) -> String {
    format!("rt{topic}")
}

/// Names in DDS of a service's requests and replies: `rq/dermis/tareRequest`, `rr/dermis/tareReply`.
pub(super) fn dds_service(service: &str) -> [String; 2] {
    [format!("rq{service}Request"), format!("rr{service}Reply")]
}

/// Name in DDS of a type: `sensor_msgs::msg::dds_::Image_` for `sensor_msgs/msg/Image`.
pub(super) fn dds_type(name: &str) -> String {
    let (package, kind) = name.rsplit_once('/').unwrap_or(("", name));
    format!("{}::dds_::{kind}_", package.replace('/', "::"))
}

/// The topic of a text such as `/joint_states`, checked.
///
/// # Errors
/// It breaks the rules for names.
pub(super) fn checked_topic(text: &str) -> Result<String, Ros2Error> {
    let refused = |reason: String| Ros2Error::Name { name: text.to_owned(), reason };
    let parts =
        text.strip_prefix('/').ok_or_else(|| refused("expected a / in front, as in /joint_states".to_owned()))?;
    parts.split('/').try_for_each(check_token).map_err(refused)?;
    if text.len() > MOST_CHARACTERS {
        return Err(refused(format!("expected at most {MOST_CHARACTERS} characters")));
    }
    Ok(text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_follow_the_rules_of_ros() {
        for (text, namespace, name) in [
            ("skin", "/", "skin"),
            ("/skin", "/", "skin"),
            ("/robot/left_hand/skin2", "/robot/left_hand", "skin2"),
            ("_hidden", "/", "_hidden"),
        ] {
            let node: NodeName = text.parse().unwrap();
            assert_eq!((node.namespace(), node.name()), (namespace, name), "{text}");
        }
        for (text, reason) in [
            ("", "between slashes"),
            ("/", "between slashes"),
            ("robot/skin", "/ in front"),
            ("/robot//skin", "between slashes"),
            ("/robot/", "between slashes"),
            ("healing-square", "'-'"),
            ("2skin", "begins with a digit"),
            ("a__b", "two underscores"),
            ("n\u{e4}me", "'\u{e4}'"),
            ("~skin", "'~'"),
        ] {
            let error = text.parse::<NodeName>().unwrap_err().to_string();
            assert!(error.contains(reason), "{text}: {error}");
        }
        assert!("x".repeat(300).parse::<NodeName>().unwrap_err().to_string().contains("at most"));
    }

    #[test]
    fn names_of_patches_become_valid_and_stay_different() {
        let found = tokens_of(["left-hand", "palm.2", "9", "__x"].into_iter()).unwrap();
        assert_eq!(found, ["left_hand", "palm_2", "_9", "_x"]);
        found.iter().for_each(|token| check_token(token).unwrap());
        let error = tokens_of(["a-b", "a.b"].into_iter()).unwrap_err().to_string();
        assert!(error.contains("\"a.b\"") && error.contains("those of \"a-b\", a_b"), "{error}");
    }

    #[test]
    fn dds_has_the_names_that_ros_2_gives_them() {
        assert_eq!(dds_topic(&NodeName::default().topic("points")), "rt/dermis/points");
        assert_eq!(dds_type("sensor_msgs/msg/PointCloud2"), "sensor_msgs::msg::dds_::PointCloud2_");
        assert_eq!(dds_service("/dermis/tare"), ["rq/dermis/tareRequest", "rr/dermis/tareReply"]);
        assert_eq!(checked_topic("/robot/joint_states").unwrap(), "/robot/joint_states");
        assert!(checked_topic("joint_states").is_err() && checked_topic("/a b").is_err());
    }
}
