//! Meshes of skins and tanks: triangles (flat, or a curved surface in 3D) and tetrahedra, the electrodes that sit on
//! them, and the pixel grid that images live on.

mod core;

pub use self::core::{CellKind, Contact, Electrode, ElectrodedMesh, Mesh, MeshError};
