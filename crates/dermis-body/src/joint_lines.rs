//! Joint values as JSON lines: `{"joints": {"elbow": 0.7}}`, or the two lists of `sensor_msgs/JointState`, `{"name":
//! ["elbow"], "position": [0.7]}`; radians, or metres for sliding joints. Both may have `time_s`.

use std::collections::BTreeMap;

use serde::Deserialize;

use crate::error::Error;
use crate::kinematics::{Assigned, JointValues, Kinematics};

/// Longest line, bytes: two thousand joints.
pub const MOST_LINE_BYTES: usize = 1 << 17;

/// One line.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    time_s: Option<f64>,
    joints: Option<BTreeMap<String, f64>>,
    name: Option<Vec<String>>,
    position: Option<Vec<f64>>,
    // Other fields of JointState, which are not needed.
    #[serde(default, rename = "header")]
    _header: serde::de::IgnoredAny,
    #[serde(default, rename = "velocity")]
    _velocity: serde::de::IgnoredAny,
    #[serde(default, rename = "effort")]
    _effort: serde::de::IgnoredAny,
}

/// Content of a line.
#[derive(Clone, Debug, PartialEq)]
pub struct JointLine {
    /// Time, seconds, if given.
    pub time_s: Option<f64>,
    /// Number of joints set.
    pub taken: usize,
    /// Names of joints that the robot does not have.
    pub unknown: Vec<String>,
}

/// Applies a line's values. If the line has an error, none is applied.
///
/// # Errors
/// [`Error::Joints`] if the line is not such an object, the numbers of names and positions differ, or a value is not
/// finite.
pub fn take_line(text: &str, kinematics: &Kinematics, values: &mut JointValues) -> Result<JointLine, Error> {
    let fail = |message: String| Error::Joints { message };
    if text.len() > MOST_LINE_BYTES {
        return Err(fail(format!("a line of {} bytes: expected at most {MOST_LINE_BYTES}", text.len())));
    }
    let line: Line = serde_json::from_str(text).map_err(|error| {
        fail(format!("{error}: expected {{\"joints\": {{\"NAME\": RADIANS}}}} or lists \"name\" and \"position\""))
    })?;
    if let Some(time_s) = line.time_s.filter(|time_s| !time_s.is_finite()) {
        return Err(fail(format!("time_s = {time_s}: expected a finite number")));
    }
    let pairs: Vec<(String, f64)> = match (line.joints, line.name, line.position) {
        (Some(joints), None, None) => joints.into_iter().collect(),
        (None, Some(names), Some(positions)) if names.len() == positions.len() => {
            names.into_iter().zip(positions).collect()
        }
        (None, Some(names), Some(positions)) => {
            return Err(fail(format!("{} names and {} positions: expected as many", names.len(), positions.len())));
        }
        _ => return Err(fail("expected either \"joints\", or \"name\" and \"position\"".to_owned())),
    };
    let mut new = values.clone();
    let (mut taken, mut unknown) = (0, Vec::new());
    for (name, value) in pairs {
        match kinematics.assign(&mut new, &name, value)? {
            Assigned::Taken => taken += 1,
            Assigned::NotItsOwn => {}
            Assigned::Unknown => unknown.push(name),
        }
    }
    *values = new;
    Ok(JointLine { time_s: line.time_s, taken, unknown })
}
