//! Delaunay triangulation of a layout: interior nodes are seeded on hexagonal lattices whose pitch follows the size
//! field, smoothed by a few sweeps of Laplacian smoothing, and refined (Ruppert's algorithm, as in `spade`) until no
//! angle is below the limit. Triangles are classified (sheet, pad, hole, outside) by flooding between the layout's
//! segments.

use spade::{AngleLimit, ConstrainedDelaunayTriangulation, Point2, RefinementParameters, Triangulation};

use super::core::MeshError;
use super::layout::{Border, Layout};
use super::plane::{Point, bounds, contains, cross2, distance, minus};

/// Ratio of the pitches of successive lattices.
const LEVEL: f64 = 0.840_896_415_253_714_6; // 2^(-1/4)
/// Minimum distance between seeds, in target sizes. Far enough below 1 for a lattice one level finer to fit, and far
/// enough above sqrt(1/2) that a seed never enters the diametral circle of a rim edge of the target size.
const APART: f64 = 0.72;
/// Number of smoothing sweeps; further ones gain less than a degree.
const SWEEPS: usize = 3;

type Cdt = ConstrainedDelaunayTriangulation<Point2<f64>>;

/// The mesh of a layout.
pub(super) struct Planar {
    pub nodes: Vec<Point>,
    /// Counter-clockwise.
    pub triangles: Vec<[u32; 3]>,
    /// The pad that each triangle lies in.
    pub pad: Vec<Option<u32>>,
    /// Edges on the outer rim, each with the rim position of its midpoint.
    pub rim: Vec<([u32; 2], f64)>,
    /// New index of each of the layout's interior points and rim points.
    pub point_nodes: Vec<u32>,
    pub rim_point_nodes: Vec<u32>,
    pub refinement_complete: bool,
}

/// Meshes a layout.
pub(super) fn mesh(layout: &Layout, min_angle_deg: f64) -> Result<Planar, MeshError> {
    let mut points = layout.nodes.clone();
    points.extend(frame(layout));
    let fixed = points.len();
    points.extend(seeds(layout));
    let mut cdt = triangulate(&points, layout)?;
    for _ in 0..SWEEPS {
        smooth(&cdt, &mut points, fixed);
        cdt = triangulate(&points, layout)?;
    }
    let limit = 20 * points.len() + 10_000;
    let parameters = RefinementParameters::new()
        .with_angle_limit(AngleLimit::from_deg(min_angle_deg))
        // `spade` finds holes and outside by counting loops, which the loops of pads and lines would upset.
        .exclude_outer_faces(layout.pads.is_empty() && !layout.has_lines())
        .with_max_additional_vertices(limit);
    let refinement_complete = cdt.refine(parameters).refinement_complete;
    Ok(extract(&cdt, layout, refinement_complete))
}

/// Corners of a box well outside a polygon. Nodes on a slanted side are only approximately collinear, so without the
/// box the convex hull of the triangulation would leave slivers along that side.
fn frame(layout: &Layout) -> Vec<Point> {
    if layout.has_straight_hull() {
        return Vec::new();
    }
    let (low, high) = bounds(&layout.rim);
    let margin = distance(low, high);
    let (low, high) = ([low[0] - margin, low[1] - margin], [high[0] + margin, high[1] + margin]);
    vec![low, [high[0], low[1]], high, [low[0], high[1]]]
}

fn triangulate(points: &[Point], layout: &Layout) -> Result<Cdt, MeshError> {
    let shape =
        |value: String| MeshError::Shape { field: "sheet", value, expected: "a sheet that can be meshed".into() };
    let vertices = points.iter().map(|p| Point2::new(clean(p[0]), clean(p[1]))).collect();
    let mut conflicts = 0;
    let cdt = Cdt::try_bulk_load_cdt(vertices, layout.segments.clone(), |_| conflicts += 1)
        .map_err(|error| shape(error.to_string()))?;
    if conflicts > 0 || cdt.num_vertices() != points.len() {
        let twice = points.len() - cdt.num_vertices();
        return Err(shape(format!("outline with {conflicts} crossing sides and {twice} coinciding nodes")));
    }
    Ok(cdt)
}

/// Rounds coordinates that are negligible next to a nanometre to zero: the triangulation refuses denormal
/// coordinates.
fn clean(coordinate: f64) -> f64 {
    if coordinate.abs() < 1e-25 { 0.0 } else { coordinate }
}

/// Interior nodes, finest lattice first.
fn seeds(layout: &Layout) -> Vec<Point> {
    let (low, high) = bounds(&layout.rim);
    let field = &layout.field;
    let mut crowd = Crowd::new(low, high, field.base / 2.0);
    layout.nodes.iter().for_each(|&p| crowd.add(p));
    let levels = ((field.smallest() / field.base).ln() / LEVEL.ln()).ceil().max(0.0) as i32;
    for level in (0..=levels).rev() {
        let pitch = field.base * LEVEL.powi(level);
        let coarser = pitch / LEVEL;
        // Boxes of nearby electrodes overlap; visit the common places only once.
        let mut visited: Vec<(Point, Point)> = Vec::new();
        let mut visit = |box_low: Point, box_high: Point| {
            let holds = |&(low, high): &(Point, Point), p: Point| (0..2).all(|k| (low[k]..=high[k]).contains(&p[k]));
            let meets = |(low, high): &(Point, Point)| (0..2).all(|k| low[k] <= box_high[k] && high[k] >= box_low[k]);
            let before: Vec<(Point, Point)> = visited.iter().filter(|other| meets(other)).copied().collect();
            visited.push((box_low, box_high));
            for p in lattice(pitch, box_low, box_high) {
                if before.iter().any(|other| holds(other, p)) {
                    continue;
                }
                let size = field.at(p);
                let belongs = size >= pitch * (1.0 - 1e-9) && (size < coarser * (1.0 - 1e-9) || level == 0);
                if (belongs || level == levels && size < pitch)
                    && crowd.is_clear(p, APART * size)
                    && is_inside(layout, p)
                {
                    crowd.add(p);
                }
            }
        };
        if level == 0 {
            visit(low, high);
        } else {
            let clip =
                |(a, b): (Point, Point)| ([a[0].max(low[0]), a[1].max(low[1])], [b[0].min(high[0]), b[1].min(high[1])]);
            field.finer_than(coarser).map(clip).for_each(|(a, b)| visit(a, b));
        }
    }
    crowd.points.split_off(layout.nodes.len())
}

fn is_inside(layout: &Layout, p: Point) -> bool {
    match layout.border {
        // There is no room for a seed between a rim edge and its arc, so testing the circle is enough.
        Border::Circle { radius } => p[0].hypot(p[1]) < radius,
        Border::Polygon { .. } => contains(&layout.rim, p) && !layout.holes.iter().any(|hole| contains(hole, p)),
    }
}

/// Points within a box of the hexagonal lattice through the origin.
fn lattice(pitch: f64, low: Point, high: Point) -> impl Iterator<Item = Point> {
    let rise = pitch * 0.75_f64.sqrt();
    let rows = (low[1] / rise).ceil() as i64..=(high[1] / rise).floor() as i64;
    rows.flat_map(move |row| {
        let shift = if row.rem_euclid(2) == 0 { 0.0 } else { 0.5 };
        let columns = (low[0] / pitch - shift).ceil() as i64..=(high[0] / pitch - shift).floor() as i64;
        columns.map(move |column| [(column as f64 + shift) * pitch, row as f64 * rise])
    })
}

/// Points in square bins, for queries whether any is near.
struct Crowd {
    points: Vec<Point>,
    low: Point,
    bin: f64,
    columns: usize,
    rows: usize,
    head: Vec<u32>,
    next: Vec<u32>,
}

const NONE: u32 = u32::MAX;

impl Crowd {
    fn new(low: Point, high: Point, bin: f64) -> Self {
        let count = |axis: usize| ((high[axis] - low[axis]) / bin) as usize + 1;
        let (columns, rows) = (count(0), count(1));
        Self { points: Vec::new(), low, bin, columns, rows, head: vec![NONE; columns * rows], next: Vec::new() }
    }

    fn column(&self, x: f64) -> usize {
        (((x - self.low[0]) / self.bin) as usize).min(self.columns - 1)
    }

    fn row(&self, y: f64) -> usize {
        (((y - self.low[1]) / self.bin) as usize).min(self.rows - 1)
    }

    fn add(&mut self, p: Point) {
        let bin = self.row(p[1]) * self.columns + self.column(p[0]);
        self.next.push(self.head[bin]);
        self.head[bin] = self.points.len() as u32;
        self.points.push(p);
    }

    fn is_clear(&self, p: Point, radius: f64) -> bool {
        for row in self.row(p[1] - radius)..=self.row(p[1] + radius) {
            for column in self.column(p[0] - radius)..=self.column(p[0] + radius) {
                let mut index = self.head[row * self.columns + column];
                while index != NONE {
                    if distance(self.points[index as usize], p) < radius {
                        return false;
                    }
                    index = self.next[index as usize];
                }
            }
        }
        true
    }
}

/// Moves every free node to the mean of its neighbours, unless that flips a triangle or enters a constraint's
/// diametral circle (which refinement would answer by splitting the constraint).
fn smooth(cdt: &Cdt, points: &mut [Point], fixed: usize) {
    let mut ring: Vec<(Point, Point, bool)> = Vec::new();
    for vertex in cdt.vertices().skip(fixed) {
        ring.clear();
        ring.extend(vertex.out_edges().map(|edge| {
            let opposite = edge.next();
            let [a, b] = opposite.positions();
            ([a.x, a.y], [b.x, b.y], opposite.is_constraint_edge())
        }));
        let share = 1.0 / ring.len() as f64;
        let mean = ring.iter().fold([0.0; 2], |sum, (a, _, _)| [sum[0] + share * a[0], sum[1] + share * a[1]]);
        let stays_sound = ring.iter().all(|&(a, b, constraint)| {
            let (to_a, to_b) = (minus(a, mean), minus(b, mean));
            let side2 = distance(a, b).powi(2);
            let clear = !constraint || super::plane::dot2(to_a, to_b) > 0.05 * side2;
            clear && cross2(to_a, to_b) > 1e-3 * side2
        });
        if stays_sound {
            points[vertex.fix().index()] = mean;
        }
    }
}

/// Floods the faces between constraints. Each flooded part is outside (`None`), sheet (`Some(None)`) or a pad.
fn regions(cdt: &Cdt, layout: &Layout) -> Vec<Option<Option<u32>>> {
    let mut part = vec![u32::MAX; cdt.num_all_faces()];
    let mut kinds = Vec::new();
    for start in cdt.inner_faces() {
        if part[start.fix().index()] != u32::MAX {
            continue;
        }
        let mut largest = start;
        let mut stack = vec![start];
        part[start.fix().index()] = kinds.len() as u32;
        while let Some(face) = stack.pop() {
            if face.area() > largest.area() {
                largest = face;
            }
            for edge in face.adjacent_edges() {
                let beyond = edge.rev().face().as_inner().filter(|_| !edge.is_constraint_edge());
                if let Some(neighbour) = beyond.filter(|n| part[n.fix().index()] == u32::MAX) {
                    part[neighbour.fix().index()] = kinds.len() as u32;
                    stack.push(neighbour);
                }
            }
        }
        let centre = largest.center();
        kinds.push(kind_of(layout, [centre.x, centre.y]));
    }
    part.iter().map(|&part| kinds.get(part as usize).copied().flatten()).collect()
}

fn kind_of(layout: &Layout, p: Point) -> Option<Option<u32>> {
    if !contains(&layout.rim, p) || layout.holes.iter().any(|hole| contains(hole, p)) {
        return None;
    }
    Some(layout.pads.iter().position(|pad| contains(pad, p)).map(|pad| pad as u32))
}

fn extract(cdt: &Cdt, layout: &Layout, refinement_complete: bool) -> Planar {
    let regions = regions(cdt, layout);
    let mut new_index = vec![NONE; cdt.num_vertices()];
    let mut used = vec![false; cdt.num_vertices()];
    let kept: Vec<_> =
        cdt.inner_faces().filter_map(|face| regions[face.fix().index()].map(|pad| (face, pad))).collect();
    kept.iter().flat_map(|(face, _)| face.vertices()).for_each(|vertex| used[vertex.fix().index()] = true);
    let mut nodes = Vec::with_capacity(cdt.num_vertices());
    for vertex in cdt.vertices().filter(|vertex| used[vertex.fix().index()]) {
        new_index[vertex.fix().index()] = nodes.len() as u32;
        nodes.push([vertex.position().x, vertex.position().y]);
    }
    let index = |vertex: usize| new_index[vertex];
    let mut rim = Vec::new();
    for edge in kept.iter().flat_map(|(face, _)| face.adjacent_edges()).filter(|edge| edge.is_constraint_edge()) {
        let outside = edge.rev().face().as_inner().is_none_or(|face| regions[face.fix().index()].is_none());
        let [a, b] = edge.positions();
        let (gap, position) = layout.border.project([(a.x + b.x) / 2.0, (a.y + b.y) / 2.0]);
        // A disc has no holes; on other outlines the rim is straight and holes keep clear of it.
        if outside && (matches!(layout.border, Border::Circle { .. }) || gap <= layout.tolerance) {
            rim.push((edge.vertices().map(|vertex| index(vertex.fix().index())), position));
        }
    }
    rim.sort_by(|a, b| a.1.total_cmp(&b.1));
    Planar {
        nodes,
        triangles: kept.iter().map(|(face, _)| face.vertices().map(|vertex| index(vertex.fix().index()))).collect(),
        pad: kept.iter().map(|(_, pad)| *pad).collect(),
        rim,
        point_nodes: layout.point_nodes.iter().map(|&node| index(node)).collect(),
        rim_point_nodes: layout.rim_point_nodes.iter().map(|&node| index(node)).collect(),
        refinement_complete,
    }
}
