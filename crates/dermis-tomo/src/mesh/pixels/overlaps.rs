//! The exact overlap of a pixel grid with a mesh. Elements are cut at the grid lines: triangles as convex polygons,
//! tetrahedra into smaller tetrahedra.

use super::grid::PixelGrid;
use crate::mesh::core::{self, CellKind, Mesh};
use crate::mesh::plane::{self, Point};

/// The pixels of each element (row-major), with the share of the element's measure in each. `shadow` is the same as
/// an area in the plane (or a volume).
pub(super) struct Overlaps {
    pub starts: Vec<usize>,
    pub shares: Vec<(u32, f64)>,
    pub shadow: Vec<f64>,
}

/// Cuts every element of a mesh at the lines of the grid.
pub(super) fn raw_overlaps(grid: &PixelGrid, mesh: &Mesh) -> Overlaps {
    let mut overlaps = Overlaps { starts: vec![0], shares: Vec::new(), shadow: Vec::new() };
    for element in mesh.elements() {
        let corners = element.iter().map(|&node| mesh.nodes()[node as usize]);
        match mesh.kind() {
            CellKind::Triangle => {
                let triangle: Vec<Point> = corners.map(|p| [p[0], p[1]]).collect();
                overlaps.add(grid, Shape::Polygon(triangle));
            }
            CellKind::Tetrahedron => {
                let mut cell = [[0.0; 3]; 4];
                cell.iter_mut().zip(corners).for_each(|(slot, corner)| *slot = corner);
                overlaps.add(grid, Shape::Solid(vec![cell]));
            }
        }
        overlaps.starts.push(overlaps.shares.len());
    }
    overlaps
}

impl Overlaps {
    fn add(&mut self, grid: &PixelGrid, shape: Shape) {
        let whole = shape.measure();
        for (column, strip) in slices(grid, 0, shape) {
            for (from_bottom, piece) in slices(grid, 1, strip) {
                let measure = piece.measure();
                if measure > 0.0 {
                    let pixel = (grid.rows - 1 - from_bottom) * grid.columns + column;
                    self.shares.push((pixel as u32, measure / whole));
                    self.shadow.push(measure);
                }
            }
        }
    }
}

/// Cuts a shape at the grid lines across an axis into strips; returns the number and contents of each strip.
fn slices(grid: &PixelGrid, axis: usize, shape: Shape) -> Vec<(usize, Shape)> {
    let (low, high) = shape.extent(axis);
    let origin = grid.line(axis, 0);
    let count = grid.count(axis);
    let strip = |at: f64| ((at - origin) / grid.pixel_m).floor().clamp(0.0, count as f64) as usize;
    // One spare strip at both ends, since rounding may move a corner slightly across a line.
    let (first, last) = (strip(low).saturating_sub(1), (strip(high) + 1).min(count - 1));
    let mut rest = if grid.line(axis, first) > low { shape.cut(axis, grid.line(axis, first)).1 } else { shape };
    let mut strips = Vec::with_capacity(last + 1 - first.min(last));
    for k in first..=last {
        let (below, above) = rest.cut(axis, grid.line(axis, k + 1));
        if !below.is_empty() {
            strips.push((k, below));
        }
        if above.is_empty() {
            break;
        }
        rest = above;
    }
    strips
}

/// Pieces of an element.
enum Shape {
    Polygon(Vec<Point>),
    Solid(Vec<[[f64; 3]; 4]>),
}

impl Shape {
    fn measure(&self) -> f64 {
        match self {
            Shape::Polygon(polygon) => plane::signed_area(polygon).abs(),
            Shape::Solid(cells) => cells.iter().map(volume).sum(),
        }
    }

    fn is_empty(&self) -> bool {
        match self {
            Shape::Polygon(polygon) => polygon.len() < 3,
            Shape::Solid(cells) => cells.is_empty(),
        }
    }

    fn extent(&self, axis: usize) -> (f64, f64) {
        let span = |values: &mut dyn Iterator<Item = f64>| {
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
        };
        match self {
            Shape::Polygon(polygon) => span(&mut polygon.iter().map(|p| p[axis])),
            Shape::Solid(cells) => span(&mut cells.iter().flatten().map(|p| p[axis])),
        }
    }

    fn cut(&self, axis: usize, at: f64) -> (Shape, Shape) {
        match self {
            Shape::Polygon(polygon) => {
                let (below, above) = plane::cut(polygon, axis, at);
                (Shape::Polygon(below), Shape::Polygon(above))
            }
            Shape::Solid(cells) => {
                let (mut below, mut above) = (Vec::new(), Vec::new());
                cells.iter().for_each(|cell| cut_cell(cell, axis, at, &mut below, &mut above));
                (Shape::Solid(below), Shape::Solid(above))
            }
        }
    }
}

fn volume(cell: &[[f64; 3]; 4]) -> f64 {
    use core::{cross, dot, subtract};
    let edge = |k: usize| subtract(cell[k], cell[0]);
    dot(cross(edge(1), edge(2)), edge(3)).abs() / 6.0
}

/// Cuts a tetrahedron at a plane. Cutting off one corner leaves a prism, a two-two split leaves two prisms; a prism
/// is divided into three tetrahedra.
fn cut_cell(
    cell: &[[f64; 3]; 4],
    axis: usize,
    at: f64,
    below: &mut Vec<[[f64; 3]; 4]>,
    above: &mut Vec<[[f64; 3]; 4]>,
) {
    let mut corners = *cell;
    corners.sort_by(|a, b| a[axis].total_cmp(&b[axis]));
    let [a, b, c, d] = corners;
    let meet = |p: [f64; 3], q: [f64; 3]| {
        let t = (at - p[axis]) / (q[axis] - p[axis]);
        let mut point = [0, 1, 2].map(|k| p[k] + t * (q[k] - p[k]));
        point[axis] = at;
        point
    };
    if d[axis] <= at {
        below.push(corners);
    } else if a[axis] >= at {
        above.push(corners);
    } else if b[axis] >= at {
        let cap = [meet(a, b), meet(a, c), meet(a, d)];
        below.push([a, cap[0], cap[1], cap[2]]);
        add_prism(above, cap, [b, c, d]);
    } else if c[axis] <= at {
        let cap = [meet(a, d), meet(b, d), meet(c, d)];
        above.push([d, cap[0], cap[1], cap[2]]);
        add_prism(below, cap, [a, b, c]);
    } else {
        let [ac, ad, bc, bd] = [meet(a, c), meet(a, d), meet(b, c), meet(b, d)];
        add_prism(below, [a, ac, ad], [b, bc, bd]);
        add_prism(above, [c, ac, bc], [d, ad, bd]);
    }
}

fn add_prism(cells: &mut Vec<[[f64; 3]; 4]>, [a, b, c]: [[f64; 3]; 3], [d, e, f]: [[f64; 3]; 3]) {
    cells.extend([[a, b, c, f], [a, b, e, f], [a, d, e, f]]);
}

/// Share of each pixel that the mesh covers.
pub(super) fn coverage(grid: &PixelGrid, mesh: &Mesh, overlaps: &Overlaps) -> Vec<f64> {
    let mut covered = vec![0.0; grid.len()];
    for (&(pixel, _), &shadow) in overlaps.shares.iter().zip(&overlaps.shadow) {
        covered[pixel as usize] += shadow;
    }
    let (low, high) = mesh.bounds();
    let depth = if mesh.kind() == CellKind::Tetrahedron { high[2] - low[2] } else { 1.0 };
    let whole = grid.pixel_m * grid.pixel_m * depth;
    covered.iter().map(|share| share / whole).collect()
}
