//! The conducting elements of a skin: their shapes in a skin file's millimetres, and as bodies.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::edge::Shape as Solid;

const MM: f64 = 1e-3;

/// Shape of an element.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum ElementShape {
    /// A ball.
    Sphere {
        /// Its diameter.
        diameter_mm: f64,
    },
    /// An upright cylinder; in the model of images the sphere of its volume.
    Cylinder {
        /// Its diameter.
        diameter_mm: f64,
        /// Its height.
        height_mm: f64,
    },
    /// A square plate that lies, sides along x and y; in the model of images the sphere of its volume.
    Plate {
        /// Its side.
        side_mm: f64,
        /// Its thickness.
        height_mm: f64,
    },
}

/// A body of metal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Element {
    /// Its shape, upright.
    pub shape: ElementShape,
    /// Its conductivity.
    pub conductivity_s_per_m: f64,
    /// Its permeability over that of vacuum, 1 where it is not magnetic.
    pub relative_permeability: f64,
}

impl ElementShape {
    /// Radius of the sphere of its volume, metres.
    pub fn volume_radius_m(&self) -> f64 {
        match self {
            Self::Sphere { diameter_mm } => 0.5 * diameter_mm * MM,
            Self::Cylinder { diameter_mm, height_mm } => (0.1875 * diameter_mm * diameter_mm * height_mm).cbrt() * MM,
            Self::Plate { side_mm, height_mm } => {
                (0.75 / std::f64::consts::PI * side_mm * side_mm * height_mm).cbrt() * MM
            }
        }
    }

    /// Radius of the largest ball within it, metres.
    pub fn inner_radius_m(&self) -> f64 {
        0.5 * MM
            * match *self {
                Self::Sphere { diameter_mm } => diameter_mm,
                Self::Cylinder { diameter_mm, height_mm } => diameter_mm.min(height_mm),
                Self::Plate { side_mm, height_mm } => side_mm.min(height_mm),
            }
    }

    /// The body, metres.
    pub fn solid(&self) -> Solid {
        match *self {
            Self::Sphere { diameter_mm } => Solid::Sphere { radius_m: 0.5 * diameter_mm * MM },
            Self::Cylinder { diameter_mm, height_mm } => {
                Solid::Cylinder { radius_m: 0.5 * diameter_mm * MM, height_m: height_mm * MM }
            }
            Self::Plate { side_mm, height_mm } => Solid::Plate { size_m: [side_mm * MM, side_mm * MM, height_mm * MM] },
        }
    }
}
