//! Sheets bent without stretching. A cylinder is developable: lengths along its surface equal those of the sheet laid
//! flat, so fields on it are exactly the fields of the unrolled sheet. A [`Surface`] maps between the two. A mesh
//! that is bent and solved on its chords instead differs by their shortening, `(h / radius)^2 / 24` for a length h.

use serde::{Deserialize, Serialize};

use super::core::{CellKind, Electrode, ElectrodedMesh, Mesh, MeshError};
use crate::mesh::plane::Point;

/// Surface of a sheet in space.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Surface {
    /// In the plane z = 0.
    #[default]
    Flat,
    /// Around a cylinder whose axis runs along y, one radius below the line x = 0 of the sheet.
    Cylinder {
        /// Radius of the cylinder, metres.
        radius_m: f64,
    },
}

impl Surface {
    /// Position in space of a point of the unrolled sheet (x, y, metres).
    pub fn point_m(&self, sheet_m: Point) -> [f64; 3] {
        match *self {
            Self::Flat => [sheet_m[0], sheet_m[1], 0.0],
            Self::Cylinder { radius_m } => {
                let (sine, cosine) = (sheet_m[0] / radius_m).sin_cos();
                [radius_m * sine, sheet_m[1], radius_m * (cosine - 1.0)]
            }
        }
    }

    /// The point of the unrolled sheet nearest to a point in space (for a cylinder, along the radius).
    pub fn sheet_m(&self, point_m: [f64; 3]) -> Point {
        match *self {
            Self::Flat => [point_m[0], point_m[1]],
            Self::Cylinder { radius_m } => [radius_m * point_m[0].atan2(point_m[2] + radius_m), point_m[1]],
        }
    }

    /// Outward unit normal at a point of the sheet.
    pub fn normal(&self, sheet_m: Point) -> [f64; 3] {
        match *self {
            Self::Flat => [0.0, 0.0, 1.0],
            Self::Cylinder { radius_m } => {
                let (sine, cosine) = (sheet_m[0] / radius_m).sin_cos();
                [sine, 0.0, cosine]
            }
        }
    }

    /// Bends a flat sheet onto the surface; elements and electrodes keep their numbers.
    ///
    /// # Errors
    /// As [`ElectrodedMesh::bent_onto_cylinder`].
    pub fn bend(&self, flat: &ElectrodedMesh) -> Result<ElectrodedMesh, MeshError> {
        match *self {
            Self::Flat => Ok(flat.clone()),
            Self::Cylinder { radius_m } => flat.bent_onto_cylinder(radius_m),
        }
    }

    /// Lays a sheet on the surface flat, with every node at its position along the surface.
    ///
    /// # Errors
    /// Elements that lose their area, or elements other than triangles.
    pub fn unroll(&self, bent: &ElectrodedMesh) -> Result<ElectrodedMesh, MeshError> {
        let flat = |point: &[f64; 3]| {
            let [x, y] = self.sheet_m(*point);
            [x, y, 0.0]
        };
        let nodes = bent.mesh.nodes().iter().map(flat).collect();
        let elements = bent.mesh.elements().flatten().copied().collect();
        let mesh = Mesh::new(CellKind::Triangle, nodes, elements)?;
        let electrodes: Vec<Electrode> = bent.electrodes.clone();
        ElectrodedMesh::new(mesh, electrodes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cylinder_preserves_lengths_and_inverts() {
        let surface = Surface::Cylinder { radius_m: 0.095 };
        for sheet in [[0.0, 0.0], [0.075, -0.02], [-0.075, 0.075]] {
            let point = surface.point_m(sheet);
            let radius = point[0].hypot(point[2] + 0.095);
            assert!((radius - 0.095).abs() < 1e-15 && point[1] == sheet[1], "{point:?}");
            let back = surface.sheet_m(point);
            assert!(crate::mesh::distance(back, sheet) < 1e-15, "{sheet:?} {back:?}");
            let normal = surface.normal(sheet);
            assert!((normal[0] * 0.095 - point[0]).abs() < 1e-15 && normal[1] == 0.0);
        }
        assert_eq!(surface.point_m([0.0, 0.01]), [0.0, 0.01, 0.0]);
    }
}
