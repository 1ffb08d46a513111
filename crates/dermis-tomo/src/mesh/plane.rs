//! Plane geometry of polygons: signed areas by the shoelace formula, containment by ray crossing, distances,
//! crossings of segments, and clipping of convex polygons at axis-aligned lines. Lengths in metres.

/// A point in the plane, in metres in the frame of the skin unless the name says otherwise: x right, y up.
pub type Point = [f64; 2];

pub(super) fn minus(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

/// z component of the cross product of two vectors.
pub(super) fn cross2(a: Point, b: Point) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

pub(super) fn dot2(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// Distance between two points in the plane, in their unit.
pub fn distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

pub(super) fn lerp(a: Point, b: Point, t: f64) -> Point {
    [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]
}

/// Signed area: positive if the loop runs counter-clockwise. Computed relative to the first vertex, so that polygons
/// far from the origin lose no digits.
pub(super) fn signed_area(polygon: &[Point]) -> f64 {
    let Some(&origin) = polygon.first() else { return 0.0 };
    polygon.windows(2).map(|pair| cross2(minus(pair[0], origin), minus(pair[1], origin))).sum::<f64>() / 2.0
}

/// The sides of a closed loop.
pub(super) fn sides(polygon: &[Point]) -> impl Iterator<Item = [Point; 2]> + '_ {
    (0..polygon.len()).map(|k| [polygon[k], polygon[(k + 1) % polygon.len()]])
}

/// True inside the polygon (even-odd rule); undefined on its sides.
pub(super) fn contains(polygon: &[Point], p: Point) -> bool {
    let mut inside = false;
    for [a, b] in sides(polygon) {
        if (a[1] > p[1]) != (b[1] > p[1]) && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) {
            inside = !inside;
        }
    }
    inside
}

/// Distance from a point in the plane to the segment from `a` to `b`, and the position of the nearest point on it (0
/// at `a`, 1 at `b`).
pub fn to_segment(p: Point, a: Point, b: Point) -> (f64, f64) {
    let along = minus(b, a);
    let length2 = dot2(along, along);
    let t = if length2 > 0.0 { (dot2(minus(p, a), along) / length2).clamp(0.0, 1.0) } else { 0.0 };
    (distance(p, lerp(a, b, t)), t)
}

/// Distance from a point to the sides of a polygon.
pub(super) fn to_polygon(p: Point, polygon: &[Point]) -> f64 {
    sides(polygon).map(|[a, b]| to_segment(p, a, b).0).fold(f64::INFINITY, f64::min)
}

/// True if the segments come within `tolerance` of each other.
pub(super) fn touch(first: [Point; 2], second: [Point; 2], tolerance: f64) -> bool {
    cross_properly(first, second, 0.0)
        || first.iter().any(|&p| to_segment(p, second[0], second[1]).0 <= tolerance)
        || second.iter().any(|&p| to_segment(p, first[0], first[1]).0 <= tolerance)
}

/// True if the segments cross and every end is farther than `tolerance` from the line of the other segment.
pub(super) fn cross_properly(first: [Point; 2], second: [Point; 2], tolerance: f64) -> bool {
    let side = |[a, b]: [Point; 2], p: Point| {
        let height = cross2(minus(b, a), minus(p, a)) / distance(a, b).max(f64::MIN_POSITIVE);
        if height > tolerance { 1 } else { -i32::from(height < -tolerance) }
    };
    side(first, second[0]) * side(first, second[1]) < 0 && side(second, first[0]) * side(second, first[1]) < 0
}

/// Minimum and maximum coordinates.
pub(super) fn bounds(points: &[Point]) -> (Point, Point) {
    points.iter().fold(([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]), |(low, high), p| {
        ([low[0].min(p[0]), low[1].min(p[1])], [high[0].max(p[0]), high[1].max(p[1])])
    })
}

/// True if the polygons touch (within `tolerance`) or one contains the other.
pub(super) fn overlap(first: &[Point], second: &[Point], tolerance: f64) -> bool {
    let ((low_a, high_a), (low_b, high_b)) = (bounds(first), bounds(second));
    let apart = |axis: usize| low_a[axis] > high_b[axis] + tolerance || low_b[axis] > high_a[axis] + tolerance;
    if apart(0) || apart(1) {
        return false;
    }
    contains(first, second[0])
        || contains(second, first[0])
        || sides(first).any(|a| sides(second).any(|b| touch(a, b, tolerance)))
}

/// Smallest interior angle of a triangle, radians.
pub(super) fn smallest_angle(corners: [[f64; 3]; 3]) -> f64 {
    use super::core::{cross, dot, subtract};
    let angle = |k: usize| {
        let (to_b, to_c) = (subtract(corners[(k + 1) % 3], corners[k]), subtract(corners[(k + 2) % 3], corners[k]));
        let normal = cross(to_b, to_c);
        dot(normal, normal).sqrt().atan2(dot(to_b, to_c))
    };
    angle(0).min(angle(1)).min(angle(2))
}

/// Cuts a convex polygon at the line `axis = at` (Sutherland and Hodgman's clipping, keeping both sides). Returns the
/// parts below and above; either may be empty.
pub(super) fn cut(polygon: &[Point], axis: usize, at: f64) -> (Vec<Point>, Vec<Point>) {
    let (mut below, mut above) = (Vec::with_capacity(polygon.len() + 1), Vec::with_capacity(polygon.len() + 1));
    for [a, b] in sides(polygon) {
        if a[axis] <= at {
            below.push(a);
        }
        if a[axis] >= at {
            above.push(a);
        }
        if (a[axis] < at) != (b[axis] < at) && a[axis] != at && b[axis] != at {
            let mut point = lerp(a, b, (at - a[axis]) / (b[axis] - a[axis]));
            point[axis] = at;
            below.push(point);
            above.push(point);
        }
    }
    (below, above)
}
