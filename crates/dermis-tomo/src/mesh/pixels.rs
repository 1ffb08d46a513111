//! The pixel grid of images and its exact overlap with a mesh. Elements are cut at the grid lines (triangles as
//! convex polygons, tetrahedra into smaller tetrahedra), so the weights
//! `w_kp = |element k within pixel p| / |element k|` are exact areas or volumes up to rounding, not samples. With
//! them, `J_pixel[m, p] = sum_k J[m, k] w_kp` is the Jacobian for a conductivity that is constant on each pixel.

use super::core::{CellKind, Mesh, MeshError};
use super::plane::{self, Point};

/// Minimum share of a pixel that the mesh must cover for the pixel to count as inside the skin.
pub const INSIDE_COVERAGE: f64 = 0.25;

/// Maximum number of pixels along a side.
const MOST_PIXELS: usize = 8192;

/// Square pixels in rows, row 0 at the top (+y), column 0 at the left (-x).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelGrid {
    /// Number of pixels in a row.
    pub columns: usize,
    /// Number of rows.
    pub rows: usize,
    /// x of the left edge, metres.
    pub left_m: f64,
    /// y of the top edge, metres.
    pub top_m: f64,
    /// Side of a pixel, metres.
    pub pixel_m: f64,
}

impl PixelGrid {
    /// The grid over a rectangle with `pixels` along its longer side. The shorter side gets as many as cover it; any
    /// excess is split between its two ends. For a disc, pass its full diameter ([`super::Outline::bounds_m`]): the
    /// bounds of the mesh are slightly smaller.
    ///
    /// # Errors
    /// Bounds that are not finite or in the wrong order, and pixel counts of 0 or above 8192.
    pub fn covering(low_m: [f64; 2], high_m: [f64; 2], pixels: usize) -> Result<Self, MeshError> {
        let (width, height) = (high_m[0] - low_m[0], high_m[1] - low_m[1]);
        super::shapes::check_length("grid width", width)?;
        super::shapes::check_length("grid height", height)?;
        check_count("pixels", pixels)?;
        let pixel_m = width.max(height) / pixels as f64;
        // Rounding must not add a pixel to a rectangle that is a whole number of pixels wide.
        let count = |side: f64| ((side / pixel_m - 1e-9).ceil() as usize).max(1);
        let (columns, rows) = (count(width), count(height));
        let left_m = (low_m[0] + high_m[0] - columns as f64 * pixel_m) / 2.0;
        let top_m = (low_m[1] + high_m[1] + rows as f64 * pixel_m) / 2.0;
        Ok(Self { columns, rows, left_m, top_m, pixel_m })
    }

    /// The grid over a mesh's bounds.
    ///
    /// # Errors
    /// As [`PixelGrid::covering`].
    pub fn over_mesh(mesh: &Mesh, pixels: usize) -> Result<Self, MeshError> {
        let (low, high) = mesh.bounds();
        Self::covering([low[0], low[1]], [high[0], high[1]], pixels)
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// True if there are no pixels.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Centre of a pixel given by its row-major index, metres.
    pub fn centre_m(&self, index: usize) -> [f64; 2] {
        let (row, column) = (index / self.columns, index % self.columns);
        [self.left_m + (column as f64 + 0.5) * self.pixel_m, self.top_m - (row as f64 + 0.5) * self.pixel_m]
    }

    /// Centres of all pixels, row-major, metres.
    pub fn centres_m(&self) -> Vec<[f64; 2]> {
        (0..self.len()).map(|index| self.centre_m(index)).collect()
    }

    /// Row-major index of the pixel that contains a point, if any.
    pub fn pixel_at(&self, point_m: [f64; 2]) -> Option<usize> {
        let column = ((point_m[0] - self.left_m) / self.pixel_m).floor();
        let row = ((self.top_m - point_m[1]) / self.pixel_m).floor();
        let inside = column >= 0.0 && row >= 0.0 && column < self.columns as f64 && row < self.rows as f64;
        inside.then(|| row as usize * self.columns + column as usize)
    }

    fn check(&self) -> Result<(), MeshError> {
        check_count("columns", self.columns)?;
        check_count("rows", self.rows)?;
        super::shapes::check_length("pixel_m", self.pixel_m)?;
        super::shapes::check_coordinate("left_m", self.left_m)?;
        super::shapes::check_coordinate("top_m", self.top_m)
    }

    /// Grid line number `k` across x (from the left) or y (from the bottom).
    fn line(&self, axis: usize, k: usize) -> f64 {
        match axis {
            0 => self.left_m + k as f64 * self.pixel_m,
            _ => self.top_m - (self.rows - k) as f64 * self.pixel_m,
        }
    }

    fn count(&self, axis: usize) -> usize {
        if axis == 0 { self.columns } else { self.rows }
    }
}

fn check_count(field: &'static str, count: usize) -> Result<(), MeshError> {
    if (1..=MOST_PIXELS).contains(&count) {
        return Ok(());
    }
    Err(MeshError::Shape { field, value: count.to_string(), expected: format!("between 1 and {MOST_PIXELS}") })
}

/// Overlap of elements and pixels.
///
/// Inside pixels are numbered 0, 1, ... in row-major order. The parts of an element in pixels that are not inside
/// (less than [`INSIDE_COVERAGE`] covered) or outside the grid are assigned to the nearest inside pixel, so the
/// weights of every element sum to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct PixelMap {
    grid: PixelGrid,
    coverage: Vec<f64>,
    inside: Vec<u32>,
    starts: Vec<usize>,
    pixels: Vec<u32>,
    weights: Vec<f64>,
    element_measures: Vec<f64>,
    pixel_measures: Vec<f64>,
}

impl PixelMap {
    /// Overlaps a grid with a mesh, seen along z. On a sheet curved in 3D an element's area counts at its projection;
    /// to unroll a bent sheet, map its flat original, whose elements have the same order.
    ///
    /// # Errors
    /// Grids with no or too many pixels, and grids of which the mesh covers no pixel.
    pub fn new(grid: PixelGrid, mesh: &Mesh) -> Result<Self, MeshError> {
        grid.check()?;
        let overlaps = raw_overlaps(&grid, mesh);
        let coverage = coverage(&grid, mesh, &overlaps);
        let inside: Vec<u32> = (0..grid.len() as u32).filter(|&p| coverage[p as usize] >= INSIDE_COVERAGE).collect();
        if inside.is_empty() {
            let value = format!("{} x {} pixels of {} m", grid.columns, grid.rows, grid.pixel_m);
            let expected = "a grid with a pixel inside the mesh".into();
            return Err(MeshError::Shape { field: "grid", value, expected });
        }
        let mut map = Self {
            grid,
            coverage,
            inside,
            starts: vec![0],
            pixels: Vec::new(),
            weights: Vec::new(),
            element_measures: mesh.measures().to_vec(),
            pixel_measures: Vec::new(),
        };
        map.gather(mesh, &overlaps);
        Ok(map)
    }

    /// Converts raw overlaps to weights on inside pixels.
    fn gather(&mut self, mesh: &Mesh, overlaps: &Overlaps) {
        const UNKNOWN: u32 = u32::MAX;
        let mut number = vec![UNKNOWN; self.grid.len()];
        for (k, &pixel) in self.inside.iter().enumerate() {
            number[pixel as usize] = k as u32;
        }
        self.pixel_measures = vec![0.0; self.inside.len()];
        for element in 0..mesh.element_count() {
            let measure = self.element_measures[element];
            let mut row: Vec<(u32, f64)> = Vec::new();
            for &(pixel, share) in &overlaps.shares[overlaps.starts[element]..overlaps.starts[element + 1]] {
                if number[pixel as usize] == UNKNOWN {
                    number[pixel as usize] = self.nearest_inside(self.grid.centre_m(pixel as usize));
                }
                row.push((number[pixel as usize], share));
            }
            let left = 1.0 - row.iter().map(|(_, share)| share).sum::<f64>();
            if left > 1e-9 {
                let centre = mesh.centroid(element);
                row.push((self.nearest_inside([centre[0], centre[1]]), left));
            }
            row.sort_by_key(|(pixel, _)| *pixel);
            let total: f64 = row.iter().map(|(_, share)| share).sum();
            for group in row.chunk_by(|a, b| a.0 == b.0) {
                let weight = group.iter().map(|(_, share)| share).sum::<f64>() / total;
                self.pixels.push(group[0].0);
                self.weights.push(weight);
                self.pixel_measures[group[0].0 as usize] += weight * measure;
            }
            self.starts.push(self.pixels.len());
        }
    }

    fn nearest_inside(&self, p: Point) -> u32 {
        let PixelGrid { columns, rows, left_m, top_m, pixel_m } = self.grid;
        let place = |offset_m: f64, count: usize| ((offset_m / pixel_m).max(0.0) as usize).min(count - 1);
        let (column, row) = (place(p[0] - left_m, columns), place(top_m - p[1], rows));
        let mut best: Option<(f64, u32)> = None;
        // Search in square rings around the pixel that contains the point. Pixels of the next ring are at least this
        // far away.
        for ring in 0..columns.max(rows) {
            if best.is_some_and(|(distance, _)| (ring as f64 - 0.5) * pixel_m > distance) {
                break;
            }
            let (low, high) = (row.saturating_sub(ring), (row + ring).min(rows - 1));
            for y in low..=high {
                let whole = y.abs_diff(row) == ring;
                let (left, right) = (column.saturating_sub(ring), (column + ring).min(columns - 1));
                let step = if whole { 1 } else { (2 * ring).max(1) };
                let first = if whole { left } else { column.wrapping_sub(ring) };
                for x in (0..).map(|k| first.wrapping_add(k * step)).take(if whole { right - left + 1 } else { 2 }) {
                    // Left of the first column the index has wrapped.
                    if x >= columns {
                        continue;
                    }
                    let pixel = y * columns + x;
                    if self.coverage[pixel] >= INSIDE_COVERAGE {
                        let distance = plane::distance(self.grid.centre_m(pixel), p);
                        let is_nearer =
                            |(least, old): (f64, u32)| distance < least || (distance == least && (pixel as u32) < old);
                        if best.is_none_or(is_nearer) {
                            best = Some((distance, pixel as u32));
                        }
                    }
                }
            }
        }
        let nearest = best.map_or(0, |(_, pixel)| pixel);
        self.inside.binary_search(&nearest).unwrap_or(0) as u32
    }

    /// The grid.
    pub fn grid(&self) -> &PixelGrid {
        &self.grid
    }

    /// Share of each pixel covered by the mesh, row-major, 0 to 1. For solids, the share of the column under the
    /// pixel over the mesh's whole extent in z.
    pub fn coverage(&self) -> &[f64] {
        &self.coverage
    }

    /// True for each pixel with at least [`INSIDE_COVERAGE`] covered, row-major.
    pub fn inside_mask(&self) -> Vec<bool> {
        self.coverage.iter().map(|&share| share >= INSIDE_COVERAGE).collect()
    }

    /// Row-major indices of the inside pixels, ascending.
    pub fn inside_pixels(&self) -> &[u32] {
        &self.inside
    }

    /// Number of inside pixels.
    pub fn inside_count(&self) -> usize {
        self.inside.len()
    }

    /// Centres of the inside pixels, metres.
    pub fn inside_centres_m(&self) -> Vec<[f64; 2]> {
        self.inside.iter().map(|&pixel| self.grid.centre_m(pixel as usize)).collect()
    }

    /// Number of elements of the mesh.
    pub fn element_count(&self) -> usize {
        self.element_measures.len()
    }

    /// Area (m^2) or volume (m^3) assigned to each inside pixel.
    pub fn pixel_measures(&self) -> &[f64] {
        &self.pixel_measures
    }

    /// The inside pixels that an element overlaps, in ascending order, each with its share of the element; the shares
    /// sum to 1.
    pub fn overlaps_of_element(&self, element: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let range = self.starts[element]..self.starts[element + 1];
        self.pixels[range.clone()].iter().map(|&pixel| pixel as usize).zip(self.weights[range].iter().copied())
    }

    /// Averages per-element values over inside pixels, weighted by overlap.
    ///
    /// # Errors
    /// The number of values is not the number of elements.
    pub fn to_inside(&self, per_element: &[f64]) -> Result<Vec<f64>, MeshError> {
        self.expect("values per element", self.element_count(), per_element.len())?;
        let mut sums = vec![0.0; self.inside.len()];
        for (element, value) in per_element.iter().enumerate() {
            for (pixel, weight) in self.overlaps_of_element(element) {
                sums[pixel] += weight * self.element_measures[element] * value;
            }
        }
        sums.iter_mut().zip(&self.pixel_measures).for_each(|(sum, measure)| *sum /= measure);
        Ok(sums)
    }

    /// The same as a row-major image, `NaN` outside.
    ///
    /// # Errors
    /// As [`PixelMap::to_inside`].
    pub fn to_pixels(&self, per_element: &[f64]) -> Result<Vec<f64>, MeshError> {
        self.image(&self.to_inside(per_element)?)
    }

    /// A row-major image from values of the inside pixels, `NaN` outside.
    ///
    /// # Errors
    /// The number of values is not the number of inside pixels.
    pub fn image(&self, inside_values: &[f64]) -> Result<Vec<f64>, MeshError> {
        self.expect("values of inside pixels", self.inside.len(), inside_values.len())?;
        let mut image = vec![f64::NAN; self.grid.len()];
        self.inside.iter().zip(inside_values).for_each(|(&pixel, &value)| image[pixel as usize] = value);
        Ok(image)
    }

    /// Value of each element from values of the inside pixels: their mean weighted by overlap. The transpose converts
    /// a Jacobian per element to one per pixel.
    ///
    /// # Errors
    /// The number of values is not the number of inside pixels.
    pub fn to_elements(&self, inside_values: &[f64]) -> Result<Vec<f64>, MeshError> {
        self.expect("values of inside pixels", self.inside.len(), inside_values.len())?;
        let mean =
            |element: usize| self.overlaps_of_element(element).map(|(p, weight)| weight * inside_values[p]).sum();
        Ok((0..self.element_count()).map(mean).collect())
    }

    fn expect(&self, what: &'static str, wanted: usize, got: usize) -> Result<(), MeshError> {
        if wanted == got {
            return Ok(());
        }
        Err(MeshError::Count { what, expected: wanted.to_string(), got })
    }
}

/// The pixels of each element (row-major), with the share of the element's measure in each. `shadow` is the same as
/// an area in the plane (or a volume).
struct Overlaps {
    starts: Vec<usize>,
    shares: Vec<(u32, f64)>,
    shadow: Vec<f64>,
}

fn raw_overlaps(grid: &PixelGrid, mesh: &Mesh) -> Overlaps {
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
    use super::core::{cross, dot, subtract};
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

fn coverage(grid: &PixelGrid, mesh: &Mesh, overlaps: &Overlaps) -> Vec<f64> {
    let mut covered = vec![0.0; grid.len()];
    for (&(pixel, _), &shadow) in overlaps.shares.iter().zip(&overlaps.shadow) {
        covered[pixel as usize] += shadow;
    }
    let (low, high) = mesh.bounds();
    let depth = if mesh.kind() == CellKind::Tetrahedron { high[2] - low[2] } else { 1.0 };
    let whole = grid.pixel_m * grid.pixel_m * depth;
    covered.iter().map(|share| share / whole).collect()
}

#[cfg(test)]
mod tests;
