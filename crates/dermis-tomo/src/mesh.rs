//! Meshes of skins and tanks: triangles (flat, or a curved surface in 3D) and tetrahedra, the electrodes on them, and
//! the pixel grid of images.

mod core;
mod import;
mod layout;
mod pixels;
mod plane;
mod shapes;
mod sheet;
mod slit;
mod solid;
mod square_to_disc;
mod surface;
mod triangulate;

pub use self::core::{CellKind, Contact, Electrode, ElectrodedMesh, Mesh, MeshError};
pub(crate) use self::core::{dot, subtract};
pub use self::import::{ElectrodeGroups, read_msh};
pub use self::pixels::{INSIDE_COVERAGE, PixelGrid, PixelMap};
pub use self::plane::{Point, distance, to_segment};
pub use self::shapes::{Direction, ElectrodeShape, Outline};
pub use self::sheet::{MeshQuality, SheetSpec};
pub use self::slit::{SlitEdge, SlitMesh, joint_entries};
pub use self::solid::{PatchShape, PrismElectrode, PrismSpec, SlabElectrode, SlabFace, SlabSpec};
pub use self::square_to_disc::square_to_disc;
pub use self::surface::Surface;
