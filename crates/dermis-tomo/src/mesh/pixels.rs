//! The pixel grid of images and its exact overlap with a mesh. Elements are cut at the grid lines (triangles as
//! convex polygons, tetrahedra into smaller tetrahedra), so the weights
//! `w_kp = |element k within pixel p| / |element k|` are exact areas or volumes up to rounding, not samples. With
//! them, `J_pixel[m, p] = sum_k J[m, k] w_kp` is the Jacobian for a conductivity that is constant on each pixel.

mod grid;
mod overlaps;

pub use grid::PixelGrid;
use overlaps::{Overlaps, coverage, raw_overlaps};

use super::core::{Mesh, MeshError};
use super::plane::{self, Point};

/// Minimum share of a pixel that the mesh must cover for the pixel to count as inside the skin.
pub const INSIDE_COVERAGE: f64 = 0.25;

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
    pub fn inside_centres_m(&self) -> Vec<Point> {
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

#[cfg(test)]
mod tests;
