//! Commands from the page of a body.

use std::collections::BTreeMap;

use serde::Deserialize;

use crate::command::Command;

/// A command from the page of a body.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum BodyCommand {
    /// A command to one patch.
    Patch(PatchCommand),
    /// Values of joints, radians or metres.
    Joints(BTreeMap<String, f64>),
}

/// A command to one patch.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PatchCommand {
    /// Number of the patch in the scene.
    pub number: usize,
    /// The command, as from the patch's own page.
    pub command: Command,
}
