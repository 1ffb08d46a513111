//! The table `mesh` of a shape: which file, and how it is read.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::MM;

/// A flat mesh whose rim is the outline of a skin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MeshFile {
    /// Gmsh MSH file, version 2.2 or 4.1, next to the skin file.
    pub file: String,
    /// Unit of the coordinates. Default: metres, but a mesh wider than 5 m is then refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<LengthUnit>,
    /// Prefix of the groups of rim edges that are electrodes; a number follows the prefix. Used if the skin file has
    /// no electrodes itself.
    #[serde(default = "electrode")]
    pub electrodes: String,
}

fn electrode() -> String {
    "electrode".into()
}

/// A unit of lengths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LengthUnit {
    /// Metres.
    M,
    /// Centimetres.
    Cm,
    /// Millimetres.
    Mm,
}

impl LengthUnit {
    pub(crate) fn metres(self) -> f64 {
        match self {
            Self::M => 1.0,
            Self::Cm => 1e-2,
            Self::Mm => MM,
        }
    }
}
