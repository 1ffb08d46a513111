//! From outline and electrodes to a planar straight-line graph: the nodes and segments that a mesh must contain, and
//! the target element size at every point, `h(x) = min(h0, min_e(h_e + g d(x, e)))` with the distance `d` to
//! electrode `e`. Anything that could make refinement fail (crossings, overlaps, parts off the domain) is refused
//! here.

mod features;
mod size_field;

pub(super) use features::{Border, Features, Sizes, Span};
pub(super) use size_field::SizeField;

use super::core::MeshError;
use super::plane::{self, Point, contains, distance, lerp, sides, to_segment};
use super::shapes::{Outline, check_coordinate, check_length};
use size_field::size_field;

/// Maximum number of elements; larger meshes are refused before any work starts.
const MOST_ELEMENTS: f64 = 4e6;
/// Minimum number of edges of a disc's rim.
const LEAST_RIM_EDGES: f64 = 24.0;

/// The planar straight-line graph.
pub(super) struct Layout {
    pub border: Border,
    slanted: bool,
    lined: bool,
    pub tolerance: f64,
    pub nodes: Vec<Point>,
    pub segments: Vec<[usize; 2]>,
    pub rim: Vec<Point>,
    pub holes: Vec<Vec<Point>>,
    pub pads: Vec<Vec<Point>>,
    /// Node of each interior point, then of each rim point.
    pub point_nodes: Vec<usize>,
    pub rim_point_nodes: Vec<usize>,
    pub field: SizeField,
}

fn off(electrode: usize, reason: String) -> MeshError {
    MeshError::Electrode { electrode, reason }
}

/// Checks an outline's numbers, and that a polygon does not cross itself and its holes neither leave it nor meet.
pub(super) fn check_outline(outline: &Outline) -> Result<(), MeshError> {
    match outline {
        Outline::Disc { radius_m } => check_length("radius_m", *radius_m),
        Outline::Rectangle { width_m, height_m } => {
            check_length("width_m", *width_m)?;
            check_length("height_m", *height_m)
        }
        Outline::Polygon { outer, holes } => {
            check_loop("outer", outer)?;
            let tolerance = tolerance_of(outline);
            for (index, hole) in holes.iter().enumerate() {
                check_loop("hole", hole)?;
                let shape = |expected: &str| {
                    Err(MeshError::Shape { field: "holes", value: format!("hole {index}"), expected: expected.into() })
                };
                let meets_rim = sides(hole).any(|a| sides(outer).any(|b| plane::touch(a, b, tolerance)));
                if meets_rim || !contains(outer, hole[0]) {
                    return shape("strictly inside the outer polygon");
                }
                if holes[..index].iter().any(|other| plane::overlap(hole, other, tolerance)) {
                    return shape("clear of the other holes");
                }
            }
            Ok(())
        }
    }
}

fn check_loop(field: &'static str, polygon: &[Point]) -> Result<(), MeshError> {
    let shape = |value: String, expected: &str| Err(MeshError::Shape { field, value, expected: expected.into() });
    if polygon.len() < 3 {
        return shape(format!("a polygon of {} vertices", polygon.len()), "a polygon of at least 3");
    }
    polygon.iter().flatten().try_for_each(|&value| check_coordinate(field, value))?;
    let (low, high) = plane::bounds(polygon);
    let extent = distance(low, high);
    check_length(field, extent)?;
    let all: Vec<[Point; 2]> = sides(polygon).collect();
    for (first, &a) in all.iter().enumerate() {
        if distance(a[0], a[1]) <= 1e-9 * extent {
            return shape(format!("vertex {first}, which repeats the next,"), "a polygon of distinct vertices");
        }
        for second in first + 1..all.len() {
            let b = all[second];
            let adjacent = second == first + 1 || (first == 0 && second + 1 == all.len());
            let folds = || {
                let (shared, from, to) = if second == first + 1 { (b[0], a[0], b[1]) } else { (a[0], b[0], a[1]) };
                to_segment(from, shared, to).0.min(to_segment(to, shared, from).0) <= 1e-9 * extent
            };
            if (adjacent && folds()) || (!adjacent && plane::touch(a, b, 1e-9 * extent)) {
                return shape(format!("polygon whose sides {first} and {second} meet"), "a simple polygon");
            }
        }
    }
    Ok(())
}

fn tolerance_of(outline: &Outline) -> f64 {
    let (low, high) = outline.bounds_m();
    1e-9 * distance(low, high)
}

impl Layout {
    /// Lays out nodes and segments for a checked outline.
    pub fn new(outline: &Outline, features: &Features, sizes: Sizes) -> Result<Self, MeshError> {
        check_outline(outline)?;
        let border = Border::new(outline);
        let tolerance = tolerance_of(outline);
        let mut sizes = sizes;
        if let Border::Circle { .. } = border {
            sizes.base = sizes.base.min(border.perimeter() / LEAST_RIM_EDGES);
        }
        let field = size_field(&border, features, sizes);
        let expected = field.expected_elements(outline.area_m2());
        if expected.is_nan() || expected > MOST_ELEMENTS {
            return Err(MeshError::Shape {
                field: "element_size_m",
                value: format!("{} m ({} m at electrodes), about {expected:.0} elements,", sizes.base, sizes.electrode),
                expected: format!("coarse enough for {MOST_ELEMENTS:.0} elements"),
            });
        }
        let mut layout = Self {
            border,
            slanted: matches!(outline, Outline::Polygon { .. }),
            lined: !features.lines.is_empty(),
            tolerance,
            nodes: Vec::new(),
            segments: Vec::new(),
            rim: Vec::new(),
            holes: Vec::new(),
            pads: features.pads.clone(),
            point_nodes: Vec::new(),
            rim_point_nodes: Vec::new(),
            field,
        };
        layout.add_rim(features, sizes);
        if let Outline::Polygon { holes, .. } = outline {
            holes.iter().for_each(|hole| layout.add_hole(hole));
        }
        layout.add_pads(features)?;
        layout.add_points(features)?;
        layout.add_lines(features)?;
        Ok(layout)
    }

    fn add_rim(&mut self, features: &Features, sizes: Sizes) {
        let perimeter = self.border.perimeter();
        let mut breaks: Vec<f64> = self.border.corners().to_vec();
        let ends = features.spans.iter().flat_map(|span| [span.start, span.end]);
        breaks.extend(ends.chain(features.rim_points.iter().copied()).map(|s| s.rem_euclid(perimeter)));
        for &vertex in features.pads.iter().flatten() {
            let (gap, position) = self.border.project(vertex);
            if gap <= self.tolerance {
                breaks.push(position);
            }
        }
        if breaks.is_empty() {
            breaks.push(0.0);
        }
        // Corners come first in the list and the sort is stable, so the corner survives among coinciding breaks.
        breaks.sort_by(f64::total_cmp);
        breaks.dedup_by(|later, earlier| *later - *earlier <= self.tolerance);
        if breaks.len() > 1 && breaks[0] + perimeter - breaks[breaks.len() - 1] <= self.tolerance {
            breaks.pop();
        }
        let mut positions = Vec::new();
        for (k, &from) in breaks.iter().enumerate() {
            let to = if k + 1 < breaks.len() { breaks[k + 1] } else { breaks[0] + perimeter };
            let middle = (from + to) / 2.0;
            let inside = features.spans.iter().filter(|span| span.holds(middle, perimeter));
            let share =
                |span: &Span| (sizes.least_segments as f64 * (to - from) / (span.end - span.start) - 1e-6).ceil();
            let least = inside.map(share).fold(1.0, f64::max);
            let least = match self.border {
                Border::Circle { .. } => least.max((LEAST_RIM_EDGES * (to - from) / perimeter).ceil()),
                Border::Polygon { .. } => least,
            };
            let curve = |t: f64| self.border.at(from + t * (to - from));
            positions.extend(divide(&self.field, to - from, least as usize, curve).map(|t| from + t * (to - from)));
        }
        self.rim = positions.iter().map(|&s| self.border.at(s)).collect();
        let first = self.add_loop(self.rim.clone());
        self.rim_point_nodes =
            features.rim_points.iter().map(|&s| first + self.nearest_rim(self.border.at(s))).collect();
    }

    fn nearest_rim(&self, p: Point) -> usize {
        let order = |a: &usize, b: &usize| distance(self.rim[*a], p).total_cmp(&distance(self.rim[*b], p));
        (0..self.rim.len()).min_by(order).unwrap_or(0)
    }

    /// Adds a closed loop of nodes and returns the index of its first node.
    fn add_loop(&mut self, nodes: Vec<Point>) -> usize {
        let (first, count) = (self.nodes.len(), nodes.len());
        self.nodes.extend(nodes);
        self.segments.extend((0..count).map(|k| [first + k, first + (k + 1) % count]));
        first
    }

    fn add_hole(&mut self, hole: &[Point]) {
        let mut nodes = Vec::new();
        let mut hole = hole.to_vec();
        if plane::signed_area(&hole) < 0.0 {
            hole[1..].reverse();
        }
        for [a, b] in sides(&hole) {
            let along = |t: f64| lerp(a, b, t);
            nodes.extend(divide(&self.field, distance(a, b), 1, along).map(along));
        }
        self.add_loop(nodes);
        self.holes.push(hole);
    }

    fn add_pads(&mut self, features: &Features) -> Result<(), MeshError> {
        for (index, pad) in features.pads.iter().enumerate() {
            let owner = features.pad_owner[index];
            self.check_pad(pad, owner)?;
            for other in 0..index {
                if plane::overlap(pad, &features.pads[other], self.tolerance) {
                    return Err(off(owner, format!("overlaps or touches electrode {}", features.pad_owner[other])));
                }
            }
            let on_rim: Vec<bool> = pad.iter().map(|&p| self.border.project(p).0 <= self.tolerance).collect();
            let corners: Vec<usize> = (0..pad.len())
                .map(|k| {
                    if on_rim[k] {
                        return self.nearest_rim(pad[k]);
                    }
                    self.nodes.push(pad[k]);
                    self.nodes.len() - 1
                })
                .collect();
            for k in 0..pad.len() {
                let next = (k + 1) % pad.len();
                let (_, middle) = self.border.project(lerp(pad[k], pad[next], 0.5));
                let flush = distance(self.border.at(middle), lerp(pad[k], pad[next], 0.5)) <= self.tolerance;
                if on_rim[k] && on_rim[next] && flush {
                    let perimeter = self.border.perimeter();
                    if let Some(s) = features.spans.iter().position(|span| span.holds(middle, perimeter)) {
                        return Err(off(owner, format!("lies on rim electrode {}", features.span_owner[s])));
                    }
                    continue;
                }
                self.add_side(corners[k], corners[next], if pad.len() == 4 { 2 } else { 1 });
            }
        }
        Ok(())
    }

    fn add_side(&mut self, from: usize, to: usize, least: usize) {
        let (a, b) = (self.nodes[from], self.nodes[to]);
        let along = |t: f64| lerp(a, b, t);
        let inner: Vec<Point> = divide(&self.field, distance(a, b), least, along).skip(1).map(along).collect();
        let mut last = from;
        for p in inner {
            self.nodes.push(p);
            self.segments.push([last, self.nodes.len() - 1]);
            last = self.nodes.len() - 1;
        }
        self.segments.push([last, to]);
    }

    fn check_pad(&self, pad: &[Point], owner: usize) -> Result<(), MeshError> {
        let on_rim = |p: Point| self.border.project(p).0 <= self.tolerance && self.flat_rim();
        for [a, b] in sides(pad) {
            for p in [a, lerp(a, b, 0.5)] {
                if !on_rim(p) && !contains(&self.rim, p) {
                    return Err(off(owner, format!("reaches off the sheet at ({}, {}) m", p[0], p[1])));
                }
            }
        }
        let crosses = |side: [Point; 2]| sides(&self.rim).any(|rim| plane::cross_properly(side, rim, self.tolerance));
        if sides(pad).any(crosses) {
            return Err(off(owner, "crosses the rim".into()));
        }
        if self.holes.iter().any(|hole| plane::overlap(pad, hole, self.tolerance)) {
            return Err(off(owner, "reaches into a hole or touches its edge".into()));
        }
        Ok(())
    }

    /// True if the rim is convex and stays convex after rounding of its nodes.
    pub fn has_straight_hull(&self) -> bool {
        !self.slanted
    }

    /// True if edges follow lines in the interior.
    pub fn has_lines(&self) -> bool {
        self.lined
    }

    /// The rim nodes of a disc lie on the circle but its edges do not, so nothing can be flush with it.
    fn flat_rim(&self) -> bool {
        matches!(self.border, Border::Polygon { .. })
    }

    fn add_points(&mut self, features: &Features) -> Result<(), MeshError> {
        for (index, &p) in features.points.iter().enumerate() {
            let owner = features.point_owner[index];
            let near_rim = plane::to_polygon(p, &self.rim) <= self.tolerance;
            let near_hole =
                self.holes.iter().any(|hole| contains(hole, p) || plane::to_polygon(p, hole) <= self.tolerance);
            if near_rim || near_hole || !contains(&self.rim, p) {
                return Err(off(owner, format!("point ({}, {}) m is not strictly inside the sheet", p[0], p[1])));
            }
            let under = |pad: &Vec<Point>| contains(pad, p) || plane::to_polygon(p, pad) <= self.tolerance;
            if let Some(pad) = self.pads.iter().position(under) {
                return Err(off(owner, format!("overlaps electrode {}", features.pad_owner[pad])));
            }
            if let Some(other) = (0..index).find(|&o| distance(features.points[o], p) <= self.tolerance) {
                return Err(off(owner, format!("overlaps electrode {}", features.point_owner[other])));
            }
            self.nodes.push(p);
            self.point_nodes.push(self.nodes.len() - 1);
        }
        Ok(())
    }

    fn add_lines(&mut self, features: &Features) -> Result<(), MeshError> {
        for (index, &line) in features.lines.iter().enumerate() {
            let [a, b] = line;
            let refuse = |expected: &str| {
                let value = format!("line from ({}, {}) to ({}, {}) m,", a[0], a[1], b[0], b[1]);
                Err(MeshError::Shape { field: "lines", value, expected: expected.into() })
            };
            let meets = |polygon: &Vec<Point>| sides(polygon).any(|side| plane::touch(line, side, self.tolerance));
            if meets(&self.rim) || !contains(&self.rim, a) {
                return refuse("a line strictly inside the sheet");
            }
            if self.holes.iter().chain(&self.pads).any(|polygon| meets(polygon) || contains(polygon, a)) {
                return refuse("a line clear of holes and electrodes");
            }
            let points = features.points.iter().any(|&p| plane::to_segment(p, a, b).0 <= self.tolerance);
            if points || features.lines[..index].iter().any(|&other| plane::touch(line, other, self.tolerance)) {
                return refuse("a line clear of point electrodes and other lines");
            }
            self.nodes.extend(line);
            self.add_side(self.nodes.len() - 2, self.nodes.len() - 1, 2);
        }
        Ok(())
    }
}

/// Divides a curve of the given length (parameter 0 to 1) so that its steps follow the size field. Returns the
/// parameters of the nodes at equal shares of the integral of ds/h, starting at 0, without 1.
fn divide(field: &SizeField, length: f64, least: usize, curve: impl Fn(f64) -> Point) -> std::vec::IntoIter<f64> {
    let mut marks = vec![(0.0, 0.0)];
    let (mut t, mut sum) = (0.0, 0.0);
    while t < 1.0 {
        let size = field.at(curve(t));
        let step = (0.2 * size / length).min(1.0 - t).max(1e-7);
        // Use the size at half a step, so that steps towards and away from an electrode are the same.
        let size = field.at(curve((t + step / 2.0).min(1.0)));
        t = if t + step > 1.0 - 1e-9 { 1.0 } else { t + step };
        sum += step * length / size;
        marks.push((t, sum));
    }
    let count = (sum.round() as usize).max(least).max(1);
    let mut mark = 0;
    let mut parameters = Vec::with_capacity(count);
    for k in 0..count {
        let target = sum * k as f64 / count as f64;
        while mark + 2 < marks.len() && marks[mark + 1].1 < target {
            mark += 1;
        }
        let ((t0, s0), (t1, s1)) = (marks[mark], marks[mark + 1]);
        parameters.push(if k == 0 { 0.0 } else { t0 + (t1 - t0) * (target - s0) / (s1 - s0) });
    }
    parameters.into_iter()
}
