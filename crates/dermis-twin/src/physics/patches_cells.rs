//! Position of fabric patches on a sheet, and the area covered by each contact cell. Patches are squares on a regular
//! pitch with gaps between them, clipped to the sheet. Each is divided into equal square cells with constant contact:
//! a cell exchanges current with its patch in proportion to the sheet's mean potential under it.

use dermis_tomo::mesh::{Outline, Point};
use serde::{Deserialize, Serialize};

use super::cut::clip;
use crate::error::{TwinError, check, check_positive};

/// Minimum share of a cell that must be on the sheet; smaller cells are left out.
const LEAST_SHARE: f64 = 0.05;

/// Number of cells along the side of a patch, and the largest number of all cells for which it is used. With three,
/// presses on patches of 10 mm seem up to 30 % weaker than with five, and with seven up to 10 % stronger.
const FINE: usize = 5;
const MOST_FINE_CELLS: f64 = 6000.0;
/// Numbers of cells along the side of a patch on skins with more patches, and with too many for that.
const COARSE: usize = 3;
const COARSEST: usize = 2;

/// Square patches on a regular pitch, centred on the sheet's bounding box.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PatchLayout {
    /// Distance between the centres of neighbouring patches, metres, along x and along y.
    pub pitch_m: f64,
    /// Width of bare sheet between neighbouring patches, metres.
    pub gap_m: f64,
    /// Number of contact cells along the side of a patch.
    pub cells_per_side: usize,
}

impl PatchLayout {
    /// Maximum number of contact cells. Each interacts with each: 8000 cells make a matrix of 512 MB, and twice that
    /// while all are in contact.
    pub const MOST_CELLS: f64 = 8000.0;

    /// Side length of a contact cell, metres.
    pub fn cell_m(&self) -> f64 {
        (self.pitch_m - self.gap_m) / self.cells_per_side as f64
    }

    /// Number of cells along the side of a patch that a sheet with this outline affords.
    pub fn natural_cells(pitch_m: f64, gap_m: f64, outline: &Outline) -> usize {
        let cells = |cells_per_side: usize| Self { pitch_m, gap_m, cells_per_side }.cells_on(outline);
        let fine = (COARSE..=FINE).rev().find(|&count| cells(count) <= MOST_FINE_CELLS);
        fine.unwrap_or(if cells(COARSE) <= Self::MOST_CELLS { COARSE } else { COARSEST })
    }

    /// Approximate number of contact cells on a sheet, including those cut by its rim.
    pub fn cells_on(&self, outline: &Outline) -> f64 {
        let per_m2 = (self.cells_per_side as f64 / self.pitch_m).powi(2);
        (outline.area_m2() + outline.perimeter_m() * 0.5 * self.cell_m()) * per_m2
    }

    /// Checks the numbers.
    ///
    /// # Errors
    /// A pitch that is not positive, a gap that is negative or as wide as the pitch, no cells, or more than 16 per
    /// side.
    pub fn check(&self) -> Result<(), TwinError> {
        check_positive("patches pitch_m", self.pitch_m)?;
        check("patches gap_m", self.gap_m, 0.0, 0.9 * self.pitch_m, "0 to 0.9 of the pitch")?;
        check("patches cells_per_side", self.cells_per_side as f64, 1.0, 16.0, "1 to 16")
    }
}

/// A cell of contact between sheet and patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactCell {
    /// Centre on the sheet, metres.
    pub centre_m: Point,
    /// Area on the sheet, m^2.
    pub area_m2: f64,
    /// Index of its patch, from 0.
    pub patch: u32,
}

/// The cells of all patches, with the sheet's nodes under them.
#[derive(Clone, Debug)]
pub(super) struct ContactCells {
    pub cells: Vec<ContactCell>,
    /// Mean potential under each cell: nodes and weights, which sum to 1.
    pub weights: Vec<Vec<(u32, f64)>>,
    pub patch_count: usize,
}

impl ContactCells {
    /// Overlaps the patches with a flat sheet of triangles; exact up to rounding.
    pub fn new(triangles: &[[u32; 3]], positions: &[Point], layout: PatchLayout) -> Self {
        let lattice = Lattice::over(positions, layout);
        let mut integrals: Vec<Vec<(u32, f64)>> = vec![Vec::new(); lattice.cell_count()];
        for triangle in triangles {
            let corners = triangle.map(|node| positions[node as usize]);
            for cell in lattice.near(corners) {
                let Some((area, middle)) = lattice.overlap(cell, corners) else { continue };
                let shares = barycentric(corners, middle);
                integrals[cell].extend(triangle.iter().zip(shares).map(|(&node, share)| (node, area * share)));
            }
        }
        lattice.collect(integrals)
    }
}

/// The unclipped cells: square patches row by row from the bottom left, and the cells of each patch in the same
/// order.
struct Lattice {
    layout: PatchLayout,
    corner: Point,
    patches: [usize; 2],
}

impl Lattice {
    fn over(positions: &[Point], layout: PatchLayout) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for position in positions {
            for axis in 0..2 {
                low[axis] = low[axis].min(position[axis]);
                high[axis] = high[axis].max(position[axis]);
            }
        }
        // Rounding must not add a patch to a sheet that is a whole number of pitches wide.
        let count = |axis: usize| ((high[axis] - low[axis]) / layout.pitch_m - 1e-6).ceil().max(1.0) as usize;
        let patches = [count(0), count(1)];
        let corner = [0, 1].map(|axis| 0.5 * (low[axis] + high[axis] - patches[axis] as f64 * layout.pitch_m));
        Self { layout, corner, patches }
    }

    fn cells_of_patch(&self) -> usize {
        self.layout.cells_per_side * self.layout.cells_per_side
    }

    fn cell_count(&self) -> usize {
        self.patches[0] * self.patches[1] * self.cells_of_patch()
    }

    /// Lower left corner of a cell.
    fn low(&self, cell: usize) -> [f64; 2] {
        let (patch, within) = (cell / self.cells_of_patch(), cell % self.cells_of_patch());
        let per_side = self.layout.cells_per_side;
        let (column, row) = (patch % self.patches[0], patch / self.patches[0]);
        let along = |axis: usize, patch: usize, cell: usize| {
            let begin = self.corner[axis] + patch as f64 * self.layout.pitch_m + 0.5 * self.layout.gap_m;
            begin + cell as f64 * self.layout.cell_m()
        };
        [along(0, column, within % per_side), along(1, row, within / per_side)]
    }

    /// Cells of the patches whose pitch square intersects a triangle's bounding box.
    fn near(&self, corners: [Point; 3]) -> Vec<usize> {
        let range = |axis: usize| {
            let values = corners.map(|corner| (corner[axis] - self.corner[axis]) / self.layout.pitch_m);
            let (low, high) = values.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
            low.max(0.0) as usize..(high.max(0.0) as usize + 1).min(self.patches[axis])
        };
        let patches = range(1).flat_map(|row| range(0).map(move |column| row * self.patches[0] + column));
        patches.flat_map(|patch| (0..self.cells_of_patch()).map(move |k| patch * self.cells_of_patch() + k)).collect()
    }

    /// Area and centroid of the overlap of a cell and a triangle.
    fn overlap(&self, cell: usize, corners: [Point; 3]) -> Option<(f64, [f64; 2])> {
        let (low, side) = (self.low(cell), self.layout.cell_m());
        let misses = |axis: usize| {
            corners.iter().all(|corner| corner[axis] <= low[axis])
                || corners.iter().all(|corner| corner[axis] >= low[axis] + side)
        };
        if misses(0) || misses(1) {
            return None;
        }
        let mut polygon = corners.to_vec();
        for axis in 0..2 {
            polygon = clip(&polygon, axis, low[axis] + side, true);
            polygon = clip(&polygon, axis, low[axis], false);
        }
        area_and_middle(&polygon)
    }

    /// Keeps the cells on the sheet and numbers the patches that have any.
    fn collect(&self, integrals: Vec<Vec<(u32, f64)>>) -> ContactCells {
        let (mut cells, mut weights) = (Vec::new(), Vec::new());
        let mut number_of = vec![None; self.patches[0] * self.patches[1]];
        let mut patch_count = 0;
        let side = self.layout.cell_m();
        for (cell, mut entries) in integrals.into_iter().enumerate() {
            let area: f64 = entries.iter().map(|entry| entry.1).sum();
            if area < LEAST_SHARE * side * side {
                continue;
            }
            entries.sort_unstable_by_key(|entry| entry.0);
            entries.dedup_by(|next, kept| {
                let same = next.0 == kept.0;
                kept.1 += if same { next.1 } else { 0.0 };
                same
            });
            entries.iter_mut().for_each(|entry| entry.1 /= area);
            let patch = *number_of[cell / self.cells_of_patch()].get_or_insert_with(|| {
                patch_count += 1;
                patch_count - 1
            });
            let low = self.low(cell);
            let centre_m = [low[0] + 0.5 * side, low[1] + 0.5 * side];
            cells.push(ContactCell { centre_m, area_m2: area, patch });
            weights.push(entries);
        }
        ContactCells { cells, weights, patch_count: patch_count as usize }
    }
}

/// Area and centroid of a convex polygon; `None` if it has no area.
fn area_and_middle(polygon: &[Point]) -> Option<(f64, [f64; 2])> {
    let origin = *polygon.first()?;
    let (mut twice, mut moment) = (0.0, [0.0; 2]);
    for pair in polygon[1..].windows(2) {
        let [a, b] = [pair[0], pair[1]].map(|p| [p[0] - origin[0], p[1] - origin[1]]);
        let cross = a[0] * b[1] - a[1] * b[0];
        twice += cross;
        (0..2).for_each(|axis| moment[axis] += cross * (a[axis] + b[axis]) / 3.0);
    }
    (twice.abs() > 1e-18).then(|| (0.5 * twice.abs(), [origin[0] + moment[0] / twice, origin[1] + moment[1] / twice]))
}

/// Values of the three linear shape functions at a point.
fn barycentric(corners: [Point; 3], point: Point) -> [f64; 3] {
    let cross = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    let [a, b, c] = corners;
    let whole = cross(a, b, c);
    [cross(point, b, c) / whole, cross(a, point, c) / whole, cross(a, b, point) / whole]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The square [0, 2]^2 as two triangles.
    fn square() -> (Vec<[u32; 3]>, Vec<[f64; 2]>) {
        (vec![[0, 1, 2], [0, 2, 3]], vec![[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    }

    #[test]
    fn cells_cover_their_areas_and_average_exactly() {
        let (triangles, positions) = square();
        let layout = PatchLayout { pitch_m: 1.0, gap_m: 0.2, cells_per_side: 2 };
        let contact = ContactCells::new(&triangles, &positions, layout);
        assert_eq!((contact.cells.len(), contact.patch_count), (16, 4));
        for (cell, weights) in contact.cells.iter().zip(&contact.weights) {
            assert!((cell.area_m2 - 0.16).abs() < 1e-12, "{cell:?}");
            assert!((weights.iter().map(|entry| entry.1).sum::<f64>() - 1.0).abs() < 1e-12);
            // The mean of a linear field is its value at the centre.
            let field = |p: Point| 3.0 * p[0] - p[1];
            let mean: f64 = weights.iter().map(|entry| entry.1 * field(positions[entry.0 as usize])).sum();
            assert!((mean - field(cell.centre_m)).abs() < 1e-12, "{cell:?}: {mean}");
        }
    }

    #[test]
    fn patches_are_clipped_to_the_sheet() {
        let (triangles, positions) = (vec![[0, 1, 2]], vec![[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]]);
        let layout = PatchLayout { pitch_m: 1.0, gap_m: 0.0, cells_per_side: 4 };
        let contact = ContactCells::new(&triangles, &positions, layout);
        // The top right patch touches the sheet only in a point.
        assert_eq!(contact.patch_count, 3);
        let area: f64 = contact.cells.iter().map(|cell| cell.area_m2).sum();
        assert!((area - 2.0).abs() < 1e-12, "{area}");
    }

    #[test]
    fn bad_input_is_refused() {
        let layout = PatchLayout { pitch_m: 0.01, gap_m: 0.001, cells_per_side: 3 };
        assert!(layout.check().is_ok());
        assert!(PatchLayout { pitch_m: 0.0, ..layout }.check().is_err());
        assert!(PatchLayout { gap_m: 0.01, ..layout }.check().is_err());
        assert!(PatchLayout { cells_per_side: 0, ..layout }.check().is_err());
    }
}
