//! The constant properties of a running body: its links and joints, and the skins on it as triangles. Sent once to each
//! page. Poses are `[x, y, z, qx, qy, qz, qw]`: metres, and a unit quaternion.

use dermis_tomo::mesh::Point;
use serde::Serialize;

use crate::scene::{GridView, PressLimits};

/// A pose: translation in metres, then a unit quaternion x, y, z, w.
pub type Pose = [f64; 7];

/// A body as drawn by the page.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct BodyScene {
    /// Name of the body.
    pub body: String,
    /// Name of the root's frame.
    pub root: String,
    /// The links, by number.
    pub links: Vec<LinkView>,
    /// The joints that move by themselves.
    pub joints: Vec<JointView>,
    /// True if the page sets the joints; otherwise they follow their source.
    pub sets_joints: bool,
    /// The skins, by number.
    pub patches: Vec<PatchView>,
    /// Parts that the page doesn't draw, one sentence each.
    pub not_drawn: Vec<String>,
}

/// One link of the robot.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct LinkView {
    /// Its name.
    pub name: String,
    /// Number of the link that carries it; `None` for the root.
    pub parent: Option<usize>,
    /// Its shapes.
    pub shapes: Vec<ShapeView>,
}

/// A shape of a link.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ShapeView {
    /// Its pose on the link.
    pub link_from_shape: Pose,
    /// Its geometry in its own frame.
    pub geometry: GeometryView,
}

/// Geometry of a shape, metres.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum GeometryView {
    /// A box about the origin: lengths along x, y and z.
    Box([f64; 3]),
    /// A cylinder about the origin, its axis along z: radius and length.
    Cylinder([f64; 2]),
    /// A sphere about the origin: its radius.
    Sphere(f64),
    /// Triangles.
    Mesh {
        /// Address of the corners, relative to the page: x, y and z as f32, little-endian, three corners per triangle.
        address: String,
        /// Factors on x, y and z that give metres.
        scale: [f64; 3],
    },
}

/// A joint that moves by itself.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct JointView {
    /// Its name.
    pub name: String,
    /// `rad` or `m`.
    pub unit: &'static str,
    /// Lower and upper limit, if it has limits.
    pub limits: Option<[f64; 2]>,
}

/// One skin.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct PatchView {
    /// Its name on the body.
    pub name: String,
    /// Name of the skin.
    pub skin: String,
    /// Number of the link that carries it.
    pub link: usize,
    /// Its pose on the link.
    pub link_from_patch: Pose,
    /// Its surface.
    pub surface: SurfaceView,
    /// Properties of a patch that runs; `None` if it could not be started.
    pub running: Option<RunningPatchView>,
}

/// A skin's surface as triangles in the patch's frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct SurfaceView {
    /// Corners: x, y and z of each, millimetres.
    pub positions_mm: Vec<f32>,
    /// Outward unit normals of the corners.
    pub normals: Vec<f32>,
    /// The corners on the flattened sheet: x and y of each, millimetres.
    pub sheet_mm: Vec<f32>,
    /// Three corners each, counter-clockwise seen from outside.
    pub triangles: Vec<u32>,
    /// Closed outlines in space: the outer one first, then holes.
    pub rims: Vec<RimView>,
}

/// A closed outline in the patch's frame, without repeating the first point.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct RimView {
    /// Points: x, y and z of each, millimetres.
    pub positions_mm: Vec<f32>,
    /// Outward unit normals of the skin there.
    pub normals: Vec<f32>,
}

/// A skin that runs.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct RunningPatchView {
    /// Address of its own page, relative to the body's.
    pub page: String,
    /// True if it is a twin, which can be pressed from the page.
    pub is_twin: bool,
    /// The image's grid on the flattened sheet.
    pub grid: GridView,
    /// Outlines on the flattened sheet, as in the skin's own scene.
    pub outline_mm: Vec<Vec<Point>>,
    /// Quantity shown by the image.
    pub image_quantity: String,
    /// Initial colour range, as in the skin's own scene.
    pub range_hint: Option<[f32; 2]>,
    /// Limits of a press from the page.
    pub press: PressLimits,
}
