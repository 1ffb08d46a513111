//! Cells in the form that the contact finder walks. A lattice keeps cell values in slots and has coordinates of its
//! own, in units of the cell size. On a grid the unit is the pixel, which makes sums over pixels exact. The finder is
//! compiled separately for each kind, so a grid pays nothing for what surfaces need.

use super::{GridGeometry, SurfaceCells};
use std::fmt::Debug;
use std::ops::Range;
use std::sync::Arc;

/// A rectangle around cells, in lattice units: smallest and largest coordinates.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    pub first: [f64; 2],
    pub last: [f64; 2],
}

impl Bounds {
    pub(crate) fn around(at: [f64; 2]) -> Self {
        Self { first: at, last: at }
    }

    pub(crate) fn include(&mut self, at: [f64; 2]) {
        for k in 0..2 {
            self.first[k] = if at[k] < self.first[k] { at[k] } else { self.first[k] };
            self.last[k] = if at[k] > self.last[k] { at[k] } else { self.last[k] };
        }
    }
}

/// Cells stored in slots.
pub(crate) trait Lattice: Clone + Debug {
    /// Number of slots, some of which may hold no cell.
    fn slots(&self) -> usize;

    /// Number of cells.
    fn cells(&self) -> usize;

    /// Maximum number of cells that can be local peaks.
    fn most_peaks(&self) -> usize;

    /// Pairs of slot and cell ranges, in the same order.
    fn pieces(&self) -> impl Iterator<Item = (Range<usize>, Range<usize>)>;

    /// Slots next to a cell's, over edges and corners. Some may hold no cell.
    fn neighbours(&self, slot: usize) -> impl Iterator<Item = usize>;

    /// Calls `work` with working memory for one number per neighbour.
    fn with_room<R>(&mut self, work: impl FnOnce(&Self, &mut [u32]) -> R) -> R;

    /// The cell of a slot.
    fn cell(&self, slot: usize) -> usize;

    /// Unit of coordinates, metres: the side of a square with the mean cell's area.
    fn unit_m(&self) -> f64;

    /// Coordinates of a slot's cell.
    fn coordinates(&self, slot: usize) -> [f64; 2];

    /// Position in metres of a point given in coordinates; x right, y up.
    fn position_m(&self, coordinates: [f64; 2]) -> [f64; 2];

    /// Vector from one point to another, lattice units, x right and y up.
    fn offset(&self, from: [f64; 2], to: [f64; 2]) -> [f64; 2];

    /// Area of a slot's cell, square units.
    fn area(&self, slot: usize) -> f64;

    /// Slots of all cells within the bounds, and possibly of others.
    fn slots_within(&self, bounds: Bounds) -> impl Iterator<Item = usize>;

    /// Extent of the cells along each axis, lattice units.
    fn extent(&self) -> [f64; 2];

    /// Side of the blocks that cells are grouped in, lattice units, given the largest side allowed.
    fn block(&self, largest: f64) -> f64;

    /// Fits a smooth peak through a cell and its neighbours, which may be NaN. Returns its offset in units and its
    /// height.
    fn refined_peak(&self, values: &[f32], slot: usize) -> ([f64; 2], f64);
}

/// A grid with a border of one pixel, so that neighbours need no bounds checks.
#[derive(Debug, Clone)]
pub(crate) struct GridLattice {
    grid: GridGeometry,
    stride: usize,
}

impl GridLattice {
    pub(crate) fn new(grid: GridGeometry) -> Self {
        Self { grid, stride: grid.columns + 2 }
    }

    fn column_row(&self, slot: usize) -> (usize, usize) {
        (slot % self.stride - 1, slot / self.stride - 1)
    }
}

impl Lattice for GridLattice {
    fn slots(&self) -> usize {
        self.stride * (self.grid.rows + 2)
    }

    fn cells(&self) -> usize {
        self.grid.len()
    }

    fn most_peaks(&self) -> usize {
        // Any 2 x 2 block of pixels holds at most one peak.
        self.grid.columns.div_ceil(2) * self.grid.rows.div_ceil(2)
    }

    fn pieces(&self) -> impl Iterator<Item = (Range<usize>, Range<usize>)> {
        let (columns, stride) = (self.grid.columns, self.stride);
        (0..self.grid.rows).map(move |row| {
            let start = (row + 1) * stride + 1;
            (start..start + columns, row * columns..(row + 1) * columns)
        })
    }

    #[inline]
    fn neighbours(&self, slot: usize) -> impl Iterator<Item = usize> {
        let (up, down) = (slot - self.stride, slot + self.stride);
        [up - 1, up, up + 1, slot - 1, slot + 1, down - 1, down, down + 1].into_iter()
    }

    #[inline]
    fn with_room<R>(&mut self, work: impl FnOnce(&Self, &mut [u32]) -> R) -> R {
        work(self, &mut [0; 8])
    }

    fn cell(&self, slot: usize) -> usize {
        let (column, row) = self.column_row(slot);
        row * self.grid.columns + column
    }

    fn unit_m(&self) -> f64 {
        self.grid.pixel_m
    }

    /// Column and row of the slot.
    #[inline]
    fn coordinates(&self, slot: usize) -> [f64; 2] {
        let (column, row) = self.column_row(slot);
        [column as f64, row as f64]
    }

    fn position_m(&self, [column, row]: [f64; 2]) -> [f64; 2] {
        self.grid.position_m(column, row)
    }

    #[inline]
    fn offset(&self, from: [f64; 2], to: [f64; 2]) -> [f64; 2] {
        // Rows count downwards, y upwards.
        [to[0] - from[0], from[1] - to[1]]
    }

    #[inline]
    fn area(&self, _slot: usize) -> f64 {
        1.0
    }

    fn slots_within(&self, bounds: Bounds) -> impl Iterator<Item = usize> {
        let stride = self.stride;
        let columns = bounds.first[0] as usize..=bounds.last[0] as usize;
        let rows = bounds.first[1] as usize..=bounds.last[1] as usize;
        rows.flat_map(move |row| columns.clone().map(move |column| (row + 1) * stride + column + 1))
    }

    fn extent(&self) -> [f64; 2] {
        [self.grid.columns as f64, self.grid.rows as f64]
    }

    /// A whole number of pixels.
    fn block(&self, largest: f64) -> f64 {
        (largest as usize).clamp(1, self.grid.columns.max(self.grid.rows)) as f64
    }

    /// Quadratic through the peak and its eight neighbours.
    fn refined_peak(&self, values: &[f32], slot: usize) -> ([f64; 2], f64) {
        let stride = self.stride;
        let at = |index: usize| f64::from(values[index]);
        let top = at(slot);
        let axis = |less: f64, more: f64| {
            let (slope, bend) = (0.5 * (more - less), more - 2.0 * top + less);
            // Comparisons with NaN neighbours are false.
            if bend < 0.0 { (slope, bend) } else { (0.0, -1.0) }
        };
        let (slope_x, bend_x) = axis(at(slot - 1), at(slot + 1));
        let (slope_y, bend_y) = axis(at(slot - stride), at(slot + stride));
        let twist =
            0.25 * (at(slot + stride + 1) - at(slot + stride - 1) - at(slot - stride + 1) + at(slot - stride - 1));
        let determinant = bend_x * bend_y - twist * twist;
        // Fit a saddle-like or one-sided neighbourhood along the axes only.
        let (twist, determinant) = if determinant > 0.1 * bend_x * bend_y && slope_x != 0.0 && slope_y != 0.0 {
            (twist, determinant)
        } else {
            (0.0, bend_x * bend_y)
        };
        let dx = ((twist * slope_y - bend_y * slope_x) / determinant).clamp(-0.5, 0.5);
        let dy = ((twist * slope_x - bend_x * slope_y) / determinant).clamp(-0.5, 0.5);
        let height = top + 0.5 * (slope_x * dx + slope_y * dy);
        ([dx, dy], height.max(top))
    }
}

/// Cells of any shape; slots are cells.
#[derive(Debug, Clone)]
pub(crate) struct SurfaceLattice {
    cells: Arc<SurfaceCells>,
    /// Lower left corner of the cells' bounds, metres: the origin of coordinates.
    low_m: [f64; 2],
    extent: [f64; 2],
    room: Vec<u32>,
}

impl SurfaceLattice {
    pub(crate) fn new(cells: Arc<SurfaceCells>) -> Self {
        let (mut bounds, unit_m) = (Bounds::around(cells.places_m()[0]), cells.cell_size_m());
        cells.places_m().iter().for_each(|place| bounds.include(*place));
        let most = (0..cells.len()).map(|cell| cells.neighbours(cell).len()).max().unwrap_or(0);
        let extent = [0, 1].map(|k| (bounds.last[k] - bounds.first[k]) / unit_m + 1.0);
        Self { cells, low_m: bounds.first, extent, room: vec![0; most] }
    }
}

impl Lattice for SurfaceLattice {
    fn slots(&self) -> usize {
        self.cells.len()
    }

    fn cells(&self) -> usize {
        self.cells.len()
    }

    fn most_peaks(&self) -> usize {
        self.cells.len()
    }

    fn pieces(&self) -> impl Iterator<Item = (Range<usize>, Range<usize>)> {
        std::iter::once((0..self.cells.len(), 0..self.cells.len()))
    }

    fn neighbours(&self, slot: usize) -> impl Iterator<Item = usize> {
        self.cells.neighbours(slot).iter().map(|&cell| cell as usize)
    }

    fn with_room<R>(&mut self, work: impl FnOnce(&Self, &mut [u32]) -> R) -> R {
        let mut room = std::mem::take(&mut self.room);
        let result = work(self, &mut room);
        self.room = room;
        result
    }

    fn cell(&self, slot: usize) -> usize {
        slot
    }

    fn unit_m(&self) -> f64 {
        self.cells.cell_size_m()
    }

    fn coordinates(&self, slot: usize) -> [f64; 2] {
        let [x, y] = self.cells.places_m()[slot];
        [(x - self.low_m[0]) / self.unit_m(), (y - self.low_m[1]) / self.unit_m()]
    }

    fn position_m(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [self.low_m[0] + x * self.unit_m(), self.low_m[1] + y * self.unit_m()]
    }

    fn offset(&self, from: [f64; 2], to: [f64; 2]) -> [f64; 2] {
        [to[0] - from[0], to[1] - from[1]]
    }

    fn area(&self, slot: usize) -> f64 {
        self.cells.relative_area(slot)
    }

    fn slots_within(&self, bounds: Bounds) -> impl Iterator<Item = usize> {
        (0..self.cells.len()).filter(move |&slot| {
            let [x, y] = self.coordinates(slot);
            (bounds.first[0]..=bounds.last[0]).contains(&x) && (bounds.first[1]..=bounds.last[1]).contains(&y)
        })
    }

    fn extent(&self) -> [f64; 2] {
        self.extent
    }

    /// At least half a cell, since smaller blocks would be empty.
    fn block(&self, largest: f64) -> f64 {
        largest.clamp(0.5, self.extent[0].max(self.extent[1]))
    }

    /// Least-squares quadratic through the peak.
    fn refined_peak(&self, values: &[f32], slot: usize) -> ([f64; 2], f64) {
        let (here, top) = (self.coordinates(slot), f64::from(values[slot]));
        let none = ([0.0; 2], top);
        let mut equations = [[0.0; TERMS + 1]; TERMS];
        let (mut count, mut reach) = (0, 0.0_f64);
        for neighbour in self.neighbours(slot) {
            let drop = f64::from(values[neighbour]) - top;
            if drop.is_nan() {
                continue;
            }
            let [x, y] = self.offset(here, self.coordinates(neighbour));
            let terms = [x, y, 0.5 * x * x, x * y, 0.5 * y * y];
            for (row, a) in equations.iter_mut().zip(terms) {
                row[..TERMS].iter_mut().zip(terms).for_each(|(entry, b)| *entry += a * b);
                row[TERMS] += a * drop;
            }
            count += 1;
            reach = reach.max(x.hypot(y));
        }
        if count < TERMS {
            return none;
        }
        let Some([slope_x, slope_y, bend_x, twist, bend_y]) = solved(equations) else { return none };
        let determinant = bend_x * bend_y - twist * twist;
        // A saddle or valley has no maximum to move to.
        if !(bend_x < 0.0 && determinant > 0.0) {
            return none;
        }
        let dx = (twist * slope_y - bend_y * slope_x) / determinant;
        let dy = (twist * slope_x - bend_x * slope_y) / determinant;
        let share = (0.5 * reach / dx.hypot(dy)).min(1.0);
        let (dx, dy) = (share * dx, share * dy);
        let curved = 0.5 * (bend_x * dx * dx + 2.0 * twist * dx * dy + bend_y * dy * dy);
        let height = top + slope_x * dx + slope_y * dy + curved;
        ([dx, dy], height.max(top))
    }
}

/// Unknowns of a quadratic through a given point: two slopes and three second derivatives.
const TERMS: usize = 5;

/// Solves a small symmetric system by elimination; the right-hand side is the last column. `None` if a pivot is too
/// small.
fn solved(mut rows: [[f64; TERMS + 1]; TERMS]) -> Option<[f64; TERMS]> {
    let largest = (0..TERMS).map(|k| rows[k][k]).fold(0.0, f64::max);
    for pivot in 0..TERMS {
        if rows[pivot][pivot] <= 1e-9 * largest {
            return None;
        }
        let pivot_row = rows[pivot];
        for row in &mut rows[pivot + 1..] {
            let factor = row[pivot] / pivot_row[pivot];
            row.iter_mut().zip(pivot_row).for_each(|(entry, above)| *entry -= factor * above);
        }
    }
    let mut solution = [0.0; TERMS];
    for k in (0..TERMS).rev() {
        let known: f64 = (k + 1..TERMS).map(|j| rows[k][j] * solution[j]).sum();
        solution[k] = (rows[k][TERMS] - known) / rows[k][k];
    }
    Some(solution)
}
