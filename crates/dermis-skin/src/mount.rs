//! Position of a skin on a robot.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::Checker;
use crate::error::Error;

/// Position of a skin on a robot: the frame of the skin patch relative to a link of the robot description.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Mount {
    /// Name of the link that carries the skin, as in the robot's URDF file.
    pub link: String,
    /// Origin of the skin in the link's frame, mm.
    #[serde(default)]
    pub xyz_mm: [f64; 3],
    /// Roll, pitch and yaw of the skin in the link's frame, degrees: rotations about the link's x, y and z axes, in
    /// this order.
    #[serde(default)]
    pub rpy_deg: [f64; 3],
}

impl Mount {
    pub(crate) fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        if self.link.is_empty() || self.link.len() > 200 || self.link.chars().any(char::is_control) {
            let expected = "the name of a link, 1 to 200 characters without control characters";
            return Err(checker.refused("mount.link", self.link.escape_debug(), expected));
        }
        checker.place_mm("mount.xyz_mm", &self.xyz_mm)?;
        self.rpy_deg.iter().try_for_each(|&angle| checker.within("mount.rpy_deg", angle, -360.0, 360.0))
    }
}
