//! From outline and electrodes to a planar straight-line graph: the nodes and segments that a mesh must hold, and the
//! element size wanted at every place, `h(x) = min(h0, min_e(h_e + g d(x, e)))` with `d` the distance to electrode `e`.
//! Everything that could make refinement fail (crossings, overlaps, parts off the domain) is refused here.

use super::core::MeshError;
use super::plane::{self, Point, contains, distance, lerp, sides, to_segment};
use super::shapes::{Outline, check_coordinate, check_length};

/// Growth of the element size per unit distance from an electrode.
const GRADING: f64 = 0.35;
/// More elements than this are refused before any work is done.
const MOST_ELEMENTS: f64 = 4e6;
/// Edges along a line inside, and what an edge at its ends, where fields of a slit are singular, is as a share of it.
const LINE_EDGES: f64 = 10.0;
const LINE_END: f64 = 3e-3;
/// Fewest edges of a disc's rim.
const LEAST_RIM_EDGES: f64 = 24.0;

/// A stretch of the rim, metres along it counter-clockwise; `end > start`, and `end` may pass the perimeter.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    pub start: f64,
    pub end: f64,
}

impl Span {
    /// True where `position` lies between the ends, round the rim.
    pub fn holds(&self, position: f64, perimeter: f64) -> bool {
        (position - self.start).rem_euclid(perimeter) < self.end - self.start
    }
}

/// What a mesh must conform to. Indices in errors are those of the lists here, through the `_owner` lists.
#[derive(Clone, Debug, Default)]
pub(super) struct Features {
    pub spans: Vec<Span>,
    pub span_owner: Vec<usize>,
    pub rim_points: Vec<f64>,
    pub rim_point_owner: Vec<usize>,
    pub pads: Vec<Vec<Point>>,
    pub pad_owner: Vec<usize>,
    pub points: Vec<Point>,
    pub point_owner: Vec<usize>,
    /// Lines inside that edges follow.
    pub lines: Vec<[Point; 2]>,
}

/// Wanted sizes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sizes {
    pub base: f64,
    pub electrode: f64,
    pub least_segments: usize,
}

/// The rim as a curve.
pub(super) enum Border {
    Circle { radius: f64 },
    Polygon { vertices: Vec<Point>, starts: Vec<f64>, perimeter: f64 },
}

impl Border {
    pub fn new(outline: &Outline) -> Self {
        if let Outline::Disc { radius_m } = outline {
            return Border::Circle { radius: *radius_m };
        }
        let vertices = outline.rim_vertices();
        let mut perimeter = 0.0;
        let mut starts = Vec::with_capacity(vertices.len());
        for [a, b] in sides(&vertices) {
            starts.push(perimeter);
            perimeter += distance(a, b);
        }
        Border::Polygon { vertices, starts, perimeter }
    }

    pub fn perimeter(&self) -> f64 {
        match self {
            Border::Circle { radius } => std::f64::consts::TAU * radius,
            Border::Polygon { perimeter, .. } => *perimeter,
        }
    }

    pub fn at(&self, position: f64) -> Point {
        let position = position.rem_euclid(self.perimeter());
        match self {
            Border::Circle { radius } => {
                let (sine, cosine) = (position / radius).sin_cos();
                [radius * cosine, radius * sine]
            }
            Border::Polygon { vertices, starts, .. } => {
                let side = starts.partition_point(|&start| start <= position).max(1) - 1;
                let (a, b) = (vertices[side], vertices[(side + 1) % vertices.len()]);
                lerp(a, b, ((position - starts[side]) / distance(a, b)).min(1.0))
            }
        }
    }

    /// Distance to the rim, and the nearest position on it.
    pub fn project(&self, p: Point) -> (f64, f64) {
        match self {
            Border::Circle { radius } => {
                let position = radius * p[1].atan2(p[0]);
                ((radius - p[0].hypot(p[1])).abs(), position.rem_euclid(self.perimeter()))
            }
            Border::Polygon { vertices, starts, perimeter } => {
                let mut best = (f64::INFINITY, 0.0);
                for (side, [a, b]) in sides(vertices).enumerate() {
                    let (gap, t) = to_segment(p, a, b);
                    if gap < best.0 {
                        best = (gap, starts[side] + t * distance(a, b));
                    }
                }
                (best.0, best.1.rem_euclid(*perimeter))
            }
        }
    }

    fn corners(&self) -> &[f64] {
        match self {
            Border::Circle { .. } => &[],
            Border::Polygon { starts, .. } => starts,
        }
    }
}

/// Where elements must be small.
struct Source {
    segments: Vec<[Point; 2]>,
    low: Point,
    high: Point,
    size: f64,
}

impl Source {
    fn new(segments: Vec<[Point; 2]>, size: f64) -> Self {
        let ends: Vec<Point> = segments.iter().flatten().copied().collect();
        let (low, high) = plane::bounds(&ends);
        Self { segments, low, high, size }
    }

    fn length(&self) -> f64 {
        self.segments.iter().map(|[a, b]| distance(*a, *b)).sum()
    }
}

/// The element size wanted at every place.
pub(super) struct SizeField {
    pub base: f64,
    sources: Vec<Source>,
}

impl SizeField {
    pub fn at(&self, p: Point) -> f64 {
        let mut size = self.base;
        for source in &self.sources {
            let beside = |axis: usize| (source.low[axis] - p[axis]).max(p[axis] - source.high[axis]).max(0.0);
            if source.size + GRADING * beside(0).hypot(beside(1)) >= size {
                continue;
            }
            for [a, b] in &source.segments {
                size = size.min(source.size + GRADING * to_segment(p, *a, *b).0);
            }
        }
        size
    }

    pub fn smallest(&self) -> f64 {
        self.sources.iter().map(|source| source.size).fold(self.base, f64::min)
    }

    /// Boxes outside which every wanted size is at least `size`.
    pub fn finer_than(&self, size: f64) -> impl Iterator<Item = (Point, Point)> + '_ {
        self.sources.iter().filter(move |source| source.size < size).map(move |source| {
            let reach = (size - source.size) / GRADING;
            ([source.low[0] - reach, source.low[1] - reach], [source.high[0] + reach, source.high[1] + reach])
        })
    }

    /// Roughly how many elements the field asks for: the integral of `4 / (sqrt(3) h^2)`.
    fn expected_elements(&self, area: f64) -> f64 {
        let near = |source: &Source| {
            let ratio = (self.base / source.size).max(1.0);
            2.0 * source.length() / (GRADING * source.size) * (1.0 - 1.0 / ratio)
                + std::f64::consts::TAU * ratio.ln() / (GRADING * GRADING)
        };
        2.31 * (area / (self.base * self.base) + self.sources.iter().map(near).sum::<f64>())
    }
}

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

/// Checks an outline's numbers, and that a polygon neither crosses itself nor has holes that leave it or meet.
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
        // Corners come first in the list and the sort is stable, so of two coinciding breaks the corner stays.
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

    /// Adds a closed loop of nodes and returns the index of its first.
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

    /// True where the rim is convex and its nodes, rounded, still are.
    pub fn has_straight_hull(&self) -> bool {
        !self.slanted
    }

    /// True where edges follow lines inside.
    pub fn has_lines(&self) -> bool {
        self.lined
    }

    /// A disc's rim nodes lie on the circle but its edges do not, so that nothing can be flush with it.
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

fn size_field(border: &Border, features: &Features, sizes: Sizes) -> SizeField {
    let electrode = sizes.electrode.min(sizes.base);
    let mut sources = Vec::new();
    for span in &features.spans {
        let length = span.end - span.start;
        let pieces = match border {
            Border::Circle { radius } => (length / radius / 0.1).ceil().max(1.0) as usize,
            Border::Polygon { vertices, .. } => 4 * vertices.len(),
        };
        let at = |k: usize| border.at(span.start + length * k as f64 / pieces as f64);
        let segments = (0..pieces).map(|k| [at(k), at(k + 1)]).collect();
        sources.push(Source::new(segments, electrode.min(length / sizes.least_segments.max(1) as f64)));
    }
    for pad in &features.pads {
        let shortest = sides(pad).map(|[a, b]| distance(a, b)).fold(f64::INFINITY, f64::min);
        let feature = if pad.len() == 4 { shortest / 2.0 } else { shortest };
        sources.push(Source::new(sides(pad).collect(), electrode.min(feature)));
    }
    let rim_points = features.rim_points.iter().map(|&s| border.at(s));
    sources.extend(features.points.iter().copied().chain(rim_points).map(|p| Source::new(vec![[p, p]], electrode)));
    for &[a, b] in &features.lines {
        let length = distance(a, b);
        sources.push(Source::new(vec![[a, b]], length / LINE_EDGES));
        sources.extend([a, b].map(|end| Source::new(vec![[end, end]], LINE_END * length)));
    }
    SizeField { base: sizes.base, sources }
}

/// Divides a curve of the given length (parameter 0 to 1) so that its steps follow the size field: parameters of the
/// nodes, beginning with 0 and without 1, at equal shares of the integral of ds/h.
fn divide(field: &SizeField, length: f64, least: usize, curve: impl Fn(f64) -> Point) -> std::vec::IntoIter<f64> {
    let mut marks = vec![(0.0, 0.0)];
    let (mut t, mut sum) = (0.0, 0.0);
    while t < 1.0 {
        let size = field.at(curve(t));
        let step = (0.2 * size / length).min(1.0 - t).max(1e-7);
        // The size half a step on, so that steps toward and away from an electrode are alike.
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
