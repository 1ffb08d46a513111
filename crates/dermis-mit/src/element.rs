//! The conducting elements of a skin: their shapes in millimetres as in a skin file, and as bodies.

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
        /// Diameter of the ball.
        diameter_mm: f64,
    },
    /// An upright cylinder; imaging models it as a sphere of equal volume.
    Cylinder {
        /// Diameter of the cylinder.
        diameter_mm: f64,
        /// Height of the cylinder.
        height_mm: f64,
    },
    /// A horizontal square plate with sides along x and y; imaging models it as a sphere of equal volume.
    Plate {
        /// Side of the plate.
        side_mm: f64,
        /// Thickness of the plate.
        height_mm: f64,
    },
}

/// A metal body.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Element {
    /// Shape, upright.
    pub shape: ElementShape,
    /// Conductivity.
    pub conductivity_s_per_m: f64,
    /// Relative permeability, 1 if it is not magnetic.
    pub relative_permeability: f64,
}

impl ElementShape {
    /// Radius of the sphere of equal volume, metres.
    pub fn volume_radius_m(&self) -> f64 {
        match self {
            Self::Sphere { diameter_mm } => 0.5 * diameter_mm * MM,
            Self::Cylinder { diameter_mm, height_mm } => (0.1875 * diameter_mm * diameter_mm * height_mm).cbrt() * MM,
            Self::Plate { side_mm, height_mm } => {
                (0.75 / std::f64::consts::PI * side_mm * side_mm * height_mm).cbrt() * MM
            }
        }
    }

    /// Radius of the largest inscribed ball, metres.
    pub fn inner_radius_m(&self) -> f64 {
        0.5 * MM
            * match *self {
                Self::Sphere { diameter_mm } => diameter_mm,
                Self::Cylinder { diameter_mm, height_mm } => diameter_mm.min(height_mm),
                Self::Plate { side_mm, height_mm } => side_mm.min(height_mm),
            }
    }

    /// The solid, metres.
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
