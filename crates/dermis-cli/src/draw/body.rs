//! Draws a robot and the skins on it from the front, from its left side and from above: links as boxes and cylinders,
//! a line from every link to its parent, and each patch's outline with its normal.

use dermis_body::urdf::{Geometry, Shape as UrdfShape};
use dermis_body::{Body, JointValues, Transform, Vector};

use super::picture::{Anchor, Colour, INK, Item, Picture, PixelPoint, Polyline, Shape, Text};

const LINK: Colour = Colour(150, 162, 176);
const BONE: Colour = Colour(90, 104, 120);
const PATCH: Colour = Colour(196, 98, 34);
/// Corners used to draw a circle.
const CORNERS: usize = 32;
/// Length of a drawn normal, relative to the longer side of the robot.
const NORMAL: f64 = 0.06;

/// A body in a posture.
pub struct BodyDrawing<'a> {
    /// The body.
    pub body: &'a Body,
    /// Joint values.
    pub joints: &'a JointValues,
    /// Width of the picture, pixels.
    pub width_px: u32,
}

/// A view along an axis of the root's frame.
struct View {
    title: &'static str,
    /// Axes of the root frame that point right and up, with their signs.
    right: (usize, f64),
    up: (usize, f64),
}

const VIEWS: [View; 3] = [
    View { title: "front: y to the right, z up", right: (1, 1.0), up: (2, 1.0) },
    View { title: "left side: x to the left, z up", right: (0, -1.0), up: (2, 1.0) },
    View { title: "above: y to the left, x up", right: (1, -1.0), up: (0, 1.0) },
];

impl View {
    fn flat(&self, point_m: Vector) -> [f64; 2] {
        [self.right.1 * point_m[self.right.0], self.up.1 * point_m[self.up.0]]
    }
}

/// Lines in space, metres, in the root's frame.
#[derive(Default)]
struct Lines {
    links: Vec<Vec<Vector>>,
    bones: Vec<Vec<Vector>>,
    patches: Vec<(String, Vec<Vector>)>,
    /// From the centre of each patch along its normal.
    normals: Vec<[Vector; 2]>,
}

impl Lines {
    fn points(&self) -> impl Iterator<Item = &Vector> {
        let patches = self.patches.iter().map(|(_, line)| line);
        self.links.iter().chain(&self.bones).chain(patches).flatten().chain(self.normals.iter().flatten())
    }
}

impl BodyDrawing<'_> {
    /// The picture.
    pub fn picture(&self) -> Picture {
        let lines = self.lines();
        let width = f64::from(self.width_px);
        let (cell, unit) = (width / VIEWS.len() as f64, width / 1000.0);
        let (margin, head) = (24.0 * unit, 40.0 * unit);
        let mut low = [f64::INFINITY; 3];
        let mut high = [f64::NEG_INFINITY; 3];
        for point in lines.points() {
            for axis in 0..3 {
                low[axis] = low[axis].min(point[axis]);
                high[axis] = high[axis].max(point[axis]);
            }
        }
        let extent = (0..3).map(|axis| high[axis] - low[axis]).fold(1e-6, f64::max);
        let pixels_per_m = (cell - 2.0 * margin) / extent;
        let middle: Vector = [0, 1, 2].map(|axis| 0.5 * (low[axis] + high[axis]));
        let height = head + cell;
        let mut items: Vec<Item> = Vec::new();
        for (index, view) in VIEWS.iter().enumerate() {
            let centre = [cell * (index as f64 + 0.5), head + 0.5 * cell];
            let about = view.flat(middle);
            let place = |point: &Vector| -> PixelPoint {
                let [right, up] = view.flat(*point);
                [centre[0] + pixels_per_m * (right - about[0]), centre[1] - pixels_per_m * (up - about[1])]
            };
            let drawn = |line: &Vec<Vector>| Polyline::open(line.iter().map(place).collect::<Vec<_>>());
            let all = |lines: &[Vec<Vector>]| lines.iter().map(drawn).collect::<Vec<_>>();
            items.push(Shape::stroked("links", all(&lines.links), LINK, unit).into());
            items.push(Shape::stroked("bones", all(&lines.bones), BONE, 2.0 * unit).into());
            let rims = lines.patches.iter().map(|(_, line)| drawn(line)).collect();
            items.push(Shape::stroked("patches", rims, PATCH, 2.5 * unit).into());
            let arrows = lines.normals.iter().map(|ends| Polyline::open(ends.each_ref().map(place).to_vec())).collect();
            items.push(Shape::stroked("normals", arrows, PATCH, 1.5 * unit).into());
            for ((name, _), [_, end]) in lines.patches.iter().zip(&lines.normals) {
                items.push(Item::Text(Text { halo: 2.0 * unit, ..Text::new(name.clone(), 13.0 * unit, place(end)) }));
            }
            let at = [cell * index as f64 + margin, 0.5 * head];
            let title = Text { anchor: Anchor::Start, colour: INK, ..Text::new(view.title, 14.0 * unit, at) };
            items.push(Item::Text(title));
        }
        let title = format!("{} on {}", self.body.name, self.body.root());
        Picture { title, width_px: self.width_px, height_px: height.ceil() as u32, items }
    }

    fn lines(&self) -> Lines {
        let kinematics = &self.body.kinematics;
        let places = kinematics.root_from_links(self.joints);
        let mut lines = Lines::default();
        for (link, place) in places.iter().enumerate() {
            let Some(place) = place else { continue };
            if let Some(parent) = kinematics.parent(link).and_then(|parent| places[parent]) {
                lines.bones.push(vec![parent.translation_m, place.translation_m]);
            }
            let described = self.body.urdf.as_ref().and_then(|(_, urdf)| urdf.links.get(link));
            for shape in described.iter().flat_map(|link| &link.shapes) {
                lines.links.extend(outline_of(shape).into_iter().map(|line| in_frame(place, &line)));
            }
        }
        for (number, patch) in self.body.patches.iter().enumerate() {
            let Some(place) = self.body.root_from_patch(number, self.joints) else { continue };
            let surface = patch.surface();
            let rim = rim_of(patch).into_iter().map(|sheet_m| surface.point_m(sheet_m)).collect::<Vec<_>>();
            lines.patches.push((patch.name.clone(), in_frame(&place, &rim)));
        }
        let extent = lines.points().flatten().fold(0.0f64, |most, v| most.max(v.abs()));
        for number in 0..self.body.patches.len() {
            if let Some(place) = self.body.root_from_patch(number, self.joints) {
                lines.normals.push([place.point_m([0.0; 3]), place.point_m([0.0, 0.0, NORMAL * extent.max(0.1)])]);
            }
        }
        lines
    }
}

fn in_frame(place: &Transform, line: &[Vector]) -> Vec<Vector> {
    line.iter().map(|&point| place.point_m(point)).collect()
}

/// The closed rim of a patch's sheet, with points close enough for it to be bent.
fn rim_of(patch: &dermis_body::Patch) -> Vec<[f64; 2]> {
    use dermis_tomo::mesh::Outline;
    let corners: Vec<[f64; 2]> = match patch.skin.outline() {
        Outline::Disc { radius_m } => circle(radius_m).collect(),
        Outline::Rectangle { width_m, height_m } => {
            let (x, y) = (0.5 * width_m, 0.5 * height_m);
            vec![[-x, -y], [x, -y], [x, y], [-x, y]]
        }
        Outline::Polygon { outer, .. } => outer,
    };
    const PARTS: usize = 8;
    let mut rim = Vec::with_capacity(PARTS * corners.len() + 1);
    for (index, from) in corners.iter().enumerate() {
        let to = corners[(index + 1) % corners.len()];
        rim.extend((0..PARTS).map(|part| {
            let share = part as f64 / PARTS as f64;
            [from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1])]
        }));
    }
    rim.extend(corners.first().copied());
    rim
}

/// Corners of a circle, repeating the first at the end.
fn circle(radius_m: f64) -> impl Iterator<Item = [f64; 2]> {
    (0..=CORNERS).map(move |corner| {
        let (sine, cosine) = (corner as f64 / CORNERS as f64 * std::f64::consts::TAU).sin_cos();
        [radius_m * cosine, radius_m * sine]
    })
}

/// Lines of a shape in its link's frame. Meshes are not drawn.
fn outline_of(shape: &UrdfShape) -> Vec<Vec<Vector>> {
    let lines = match shape.geometry {
        Geometry::Box { size_m } => box_lines(size_m),
        Geometry::Cylinder { radius_m, length_m } => cylinder_lines(radius_m, length_m),
        Geometry::Sphere { radius_m } => vec![
            circle(radius_m).map(|[x, y]| [x, y, 0.0]).collect(),
            circle(radius_m).map(|[x, y]| [x, 0.0, y]).collect(),
            circle(radius_m).map(|[x, y]| [0.0, x, y]).collect(),
        ],
        Geometry::Mesh { .. } => Vec::new(),
    };
    lines.into_iter().map(|line| in_frame(&shape.link_from_shape, &line)).collect()
}

fn box_lines(size_m: Vector) -> Vec<Vec<Vector>> {
    let [x, y, z] = size_m.map(|side| 0.5 * side);
    let ring = |z: f64| vec![[-x, -y, z], [x, -y, z], [x, y, z], [-x, y, z], [-x, -y, z]];
    let posts = [[-x, -y], [x, -y], [x, y], [-x, y]].map(|[x, y]| vec![[x, y, -z], [x, y, z]]);
    [ring(-z), ring(z)].into_iter().chain(posts).collect()
}

fn cylinder_lines(radius_m: f64, length_m: f64) -> Vec<Vec<Vector>> {
    let half = 0.5 * length_m;
    let ring = |z: f64| circle(radius_m).map(move |[x, y]| [x, y, z]).collect::<Vec<_>>();
    let sides = circle(radius_m).step_by(CORNERS / 4).take(4).map(|[x, y]| vec![[x, y, -half], [x, y, half]]);
    [ring(-half), ring(half)].into_iter().chain(sides).collect()
}
