//! Cuts through a sheet: strips with a small share of the sheet's conductance. With f the exact share of an element's
//! area inside the strip and d the residual share of conductance, an element crossed by a cut has the conductance
//! `s / ((1 - f) + f / d)`: that of intact and cut material in series across the cut, and the same along it. (A
//! laminate that conducts along the cut would tie the potentials of its two sides together wherever elements are
//! oblique to it, because linear elements cannot jump and stay level at once. A cut of 20 mm would then act like one
//! of 14 mm, on any mesh.) Elements need not follow the cut. They are blocked as a whole, so a cut acts as if it were
//! longer by about the element size, and by more where it is oblique to them; callers who know the element size can
//! shorten it first ([`Cut::shortened`]). A sheet whose mesh can be slit along the cut needs none of this
//! ([`super::TwoSheets::with_slits`]): as a slit the cut has no width, and conducts by [`Cut::joining_per_m`].

use dermis_tomo::mesh::{Outline, Point, distance};
use serde::{Deserialize, Serialize};

use super::element::SheetConductance;
use crate::error::{TwinError, check, check_positive};

/// One straight cut.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cut {
    /// One end.
    pub from_m: Point,
    /// The other end.
    pub to_m: Point,
    /// Width of the cut. A blade's cut in a soft flat sheet is open by a few tenths of a millimetre (assumed).
    pub width_m: f64,
    /// d: conductance inside the cut relative to the intact sheet; small if open, near 1 if healed.
    pub residual: f64,
}

impl Cut {
    /// An open cut, 0.3 mm wide, whose faces hardly touch (one part in 100,000 conducts).
    pub fn open(from_m: Point, to_m: Point) -> Self {
        Self { from_m, to_m, width_m: 3e-4, residual: 1e-5 }
    }

    /// Checks the numbers.
    ///
    /// # Errors
    /// Ends that coincide or are not finite, a width that is not positive, or a residual outside 1e-9 to 1.
    pub fn check(&self) -> Result<(), TwinError> {
        for value in self.from_m.into_iter().chain(self.to_m) {
            check("cut end", value, -1e3, 1e3, "a position in metres")?;
        }
        check_positive("cut length, m", self.length_m())?;
        check_positive("cut width_m", self.width_m)?;
        check("cut residual", self.residual, 1e-9, 1.0, "a share between 1e-9 and 1")
    }

    /// Distance between its ends, metres.
    pub fn length_m(&self) -> f64 {
        distance(self.from_m, self.to_m)
    }

    /// True if another cut has the same ends, in either order.
    pub fn is_along(&self, other: &Self) -> bool {
        (self.from_m == other.from_m && self.to_m == other.to_m)
            || (self.from_m == other.to_m && self.to_m == other.from_m)
    }

    /// Refuses a cut with an end farther from a skin (its bounding box) than the skin is long.
    ///
    /// # Errors
    /// The end, and its permitted range.
    pub fn check_reach(&self, outline: &Outline) -> Result<(), TwinError> {
        let (low, high) = outline.bounds_m();
        let reach_m = (high[0] - low[0]).max(high[1] - low[1]);
        for end in [self.from_m, self.to_m] {
            if (0..2).any(|axis| end[axis] < low[axis] - reach_m || end[axis] > high[axis] + reach_m) {
                let expected = "an end no farther from the skin than the skin is long";
                return Err(TwinError::Place { what: "end of a cut", x_m: end[0], y_m: end[1], expected });
            }
        }
        Ok(())
    }

    /// The point at a share of its length, 0 at `from_m` and 1 at `to_m`.
    pub fn at(&self, share: f64) -> Point {
        let between = |axis: usize| self.from_m[axis] + share * (self.to_m[axis] - self.from_m[axis]);
        [between(0), between(1)]
    }

    /// The same cut, shortened by this length at both ends, but by at most a fifth of its length each.
    pub fn shortened(&self, by_m: f64) -> Self {
        let share = (by_m / self.length_m()).clamp(0.0, 0.2);
        Self { from_m: self.at(share), to_m: self.at(1.0 - share), ..*self }
    }

    /// Conductance across the cut per length, relative to the sheet's conductance, 1/m. As a slit without width it
    /// adds the resistance of its strip minus that of the sheet: `w (1/d - 1)` metres of sheet.
    pub fn joining_per_m(&self) -> f64 {
        // Always leaves some resistance: a joined slit is a millionth of a metre of sheet.
        1.0 / (self.width_m * (1.0 / self.residual - 1.0)).max(1e-6)
    }

    fn direction(&self) -> [f64; 2] {
        let length = self.length_m();
        [(self.to_m[0] - self.from_m[0]) / length, (self.to_m[1] - self.from_m[1]) / length]
    }

    /// Share of a triangle's area inside the strip.
    fn share_of(&self, corners: [Point; 3]) -> f64 {
        let [x, y] = self.direction();
        let local = corners.map(|p| {
            let (dx, dy) = (p[0] - self.from_m[0], p[1] - self.from_m[1]);
            [dx * x + dy * y, dy * x - dx * y]
        });
        // Shortcut: most triangles are entirely on one side of the strip.
        let (length, half) = (self.length_m(), self.width_m / 2.0);
        let beside = |axis: usize, low: f64, high: f64| {
            local.iter().all(|p| p[axis] <= low) || local.iter().all(|p| p[axis] >= high)
        };
        if beside(1, -half, half) || beside(0, 0.0, length) {
            return 0.0;
        }
        let whole = area(&local);
        let mut inside = local.to_vec();
        for (axis, limit, keep_below) in [(0, 0.0, false), (0, length, true), (1, -half, false), (1, half, true)] {
            inside = clip(&inside, axis, limit, keep_below);
        }
        (area(&inside) / whole).clamp(0.0, 1.0)
    }
}

/// Cuts sorted by place, so that a triangle only considers nearby ones: a healing sheet has thousands of pieces of
/// cuts, and its conductances change with every frame.
#[derive(Debug)]
pub(super) struct NearCuts<'a> {
    cuts: &'a [Cut],
    low: Point,
    cell_m: f64,
    counts: [usize; 2],
    /// Indices of the cuts that reach into each cell, ascending.
    cells: Vec<Vec<u32>>,
}

/// Number of cells along the longer side of the box around all cuts.
const CELLS: f64 = 64.0;

impl<'a> NearCuts<'a> {
    pub fn new(cuts: &'a [Cut]) -> Self {
        let boxes: Vec<[[f64; 2]; 2]> = cuts.iter().map(bounds).collect();
        let corner = |k: usize, pick: fn(f64, f64) -> f64, from: f64| {
            [0, 1].map(|axis| boxes.iter().map(|b| b[k][axis]).fold(from, pick))
        };
        let (low, high) = (corner(0, f64::min, f64::INFINITY), corner(1, f64::max, f64::NEG_INFINITY));
        let side_m = (high[0] - low[0]).max(high[1] - low[1]);
        if !(side_m.is_finite() && side_m > 0.0) {
            return Self { cuts, low: [0.0; 2], cell_m: 1.0, counts: [0; 2], cells: Vec::new() };
        }
        let cell_m = side_m / CELLS;
        let counts = [0, 1].map(|axis| ((high[axis] - low[axis]) / cell_m) as usize + 1);
        let mut near = Self { cuts, low, cell_m, counts, cells: vec![Vec::new(); counts[0] * counts[1]] };
        for (number, [low, high]) in (0..).zip(boxes) {
            if let Some([columns, rows]) = near.range(low, high) {
                for row in rows {
                    columns.clone().for_each(|column| near.cells[row * counts[0] + column].push(number));
                }
            }
        }
        near
    }

    /// Cells that a box overlaps.
    fn range(&self, low: Point, high: Point) -> Option<[std::ops::RangeInclusive<usize>; 2]> {
        let along = |axis: usize| {
            let place = |value: f64| (value - self.low[axis]) / self.cell_m;
            let (from, to) = (place(low[axis]), place(high[axis]));
            let last = self.counts[axis].checked_sub(1)?;
            (to >= 0.0 && from < self.counts[axis] as f64)
                .then(|| from.max(0.0) as usize..=(to.max(0.0) as usize).min(last))
        };
        Some([along(0)?, along(1)?])
    }

    /// [`damaged_conductance`] with the cuts near a triangle; more distant ones have no effect. `numbers` is scratch
    /// memory.
    pub fn damaged_conductance(&self, intact_s: f64, corners: [Point; 3], numbers: &mut Vec<u32>) -> SheetConductance {
        numbers.clear();
        let corner = |pick: fn(f64, f64) -> f64| {
            [0, 1].map(|axis| pick(pick(corners[0][axis], corners[1][axis]), corners[2][axis]))
        };
        if let Some([columns, rows]) = self.range(corner(f64::min), corner(f64::max)) {
            for row in rows {
                columns.clone().for_each(|column| numbers.extend(&self.cells[row * self.counts[0] + column]));
            }
            numbers.sort_unstable();
            numbers.dedup();
        }
        let near = numbers.iter().map(|&number| &self.cuts[number as usize]);
        SheetConductance::isotropic(near.fold(intact_s, |left, cut| left_by(left, cut, corners)))
    }
}

/// Lower left and upper right corners of the bounding box of a cut's strip.
fn bounds(cut: &Cut) -> [[f64; 2]; 2] {
    let half = cut.width_m / 2.0;
    [
        [0, 1].map(|axis| cut.from_m[axis].min(cut.to_m[axis]) - half),
        [0, 1].map(|axis| cut.from_m[axis].max(cut.to_m[axis]) + half),
    ]
}

/// Conductance of a triangle after one more cut.
fn left_by(left: f64, cut: &Cut, corners: [Point; 3]) -> f64 {
    let share = cut.share_of(corners);
    left / ((1.0 - share) + share / cut.residual)
}

/// Sheet conductance of a triangle in a sheet of conductance `intact_s` (siemens) with these cuts. Several cuts in
/// one element act in series.
pub fn damaged_conductance(intact_s: f64, cuts: &[Cut], corners: [Point; 3]) -> SheetConductance {
    SheetConductance::isotropic(cuts.iter().fold(intact_s, |left, cut| left_by(left, cut, corners)))
}

/// The part of a convex polygon on one side of `axis = limit` (Sutherland and Hodgman).
pub(super) fn clip(polygon: &[Point], axis: usize, limit: f64, keep_below: bool) -> Vec<Point> {
    let keeps = |p: Point| if keep_below { p[axis] <= limit } else { p[axis] >= limit };
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    for (k, &a) in polygon.iter().enumerate() {
        let b = polygon[(k + 1) % polygon.len()];
        if keeps(a) {
            kept.push(a);
        }
        if keeps(a) != keeps(b) {
            let t = (limit - a[axis]) / (b[axis] - a[axis]);
            kept.push([a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]);
        }
    }
    kept
}

fn area(polygon: &[Point]) -> f64 {
    let cross = |k: usize| {
        let (a, b) = (polygon[k], polygon[(k + 1) % polygon.len()]);
        a[0] * b[1] - a[1] * b[0]
    };
    (0..polygon.len()).map(cross).sum::<f64>().abs() / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    const CORNERS: [[f64; 2]; 3] = [[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]];

    #[test]
    fn share_is_the_exact_overlap() {
        let strip = |from_m, to_m| Cut { from_m, to_m, width_m: 0.2, residual: 1e-3 };
        // Along x at height 0.5, through the whole triangle, which is 1.5 wide on average between 0.4 and 0.6.
        let whole = strip([-1.0, 0.5], [3.0, 0.5]);
        assert!((whole.share_of(CORNERS) - 0.2 * 1.5 / 2.0).abs() < 1e-12);
        let half = strip([-1.0, 0.5], [0.5, 0.5]);
        assert!((half.share_of(CORNERS) - 0.2 * 0.5 / 2.0).abs() < 1e-12);
        assert_eq!(strip([3.0, 3.0], [4.0, 3.0]).share_of(CORNERS), 0.0);
    }

    #[test]
    fn an_open_cut_blocks_current_and_a_healed_one_does_not() {
        let cut = Cut { from_m: [-1.0, 0.5], to_m: [3.0, 0.5], width_m: 0.2, residual: 1e-6 };
        let s = damaged_conductance(5e-3, &[cut], CORNERS);
        // A share of 0.15 in series: 1 / (0.85 + 0.15e6).
        let expected = 5e-3 / (0.85 + 0.15e6);
        assert!((s.xx - expected).abs() < 1e-12 && (s.yy - expected).abs() < 1e-12 && s.xy == 0.0, "{s:?}");
        let healed = damaged_conductance(5e-3, &[Cut { residual: 1.0, ..cut }], CORNERS);
        assert!((healed.xx - 5e-3).abs() < 1e-15 && (healed.yy - 5e-3).abs() < 1e-15);
    }

    #[test]
    fn looking_at_near_cuts_gives_the_same_as_looking_at_all() {
        let mut state = 7_u64;
        let mut next = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        };
        for count in [0, 1, 7, 300] {
            let cuts: Vec<Cut> = (0..count)
                .map(|_| Cut { residual: 0.5 + 0.4 * next(), ..Cut::open([next(), next()], [next(), next()]) })
                .collect();
            let (near, mut numbers) = (NearCuts::new(&cuts), Vec::new());
            for _ in 0..500 {
                let middle = [1.5 * next(), 1.5 * next()];
                let corners = [0, 1, 2].map(|_| [middle[0] + 0.1 * next(), middle[1] + 0.1 * next()]);
                let expected = damaged_conductance(2.0, &cuts, corners);
                assert_eq!(near.damaged_conductance(2.0, corners, &mut numbers).xx.to_bits(), expected.xx.to_bits());
            }
        }
    }

    #[test]
    fn cuts_are_shortened_at_both_ends_but_not_away() {
        let cut = Cut::open([0.0, 0.0], [0.02, 0.0]);
        let shorter = cut.shortened(1e-3);
        assert!((shorter.from_m[0] - 1e-3).abs() < 1e-12 && (shorter.to_m[0] - 0.019).abs() < 1e-12);
        assert!((cut.shortened(1.0).length_m() - 0.012).abs() < 1e-12);
    }

    #[test]
    fn bad_input_is_refused() {
        assert!(Cut::open([0.0; 2], [0.0; 2]).check().is_err());
        assert!(Cut { residual: 0.0, ..Cut::open([0.0; 2], [0.01, 0.0]) }.check().is_err());
        assert!(Cut::open([0.0; 2], [0.01, 0.0]).check().is_ok());
    }
}
