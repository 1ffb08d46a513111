//! Cuts through a sheet: strips that conduct only a small share of what the sheet does. With f the exact share of an
//! element's area inside the strip and d the residual share of conductance, an element crossed by a cut conducts
//! `s / ((1 - f) + f / d)`, what a series of intact and cut material conducts across the cut, and as little along it.
//! (A laminate that conducts along the cut would hold the potentials of its two sides together wherever elements are
//! oblique to it: linear elements cannot jump and stay level at once. A cut of 20 mm would then act like one of 14, on
//! any mesh.) Elements need not follow the cut. They are blocked whole, so that a cut acts as if it were longer by
//! about their size, and by more where it runs oblique to them: whoever knows their size may shorten it beforehand
//! ([`Cut::shortened`]). A sheet whose mesh can be slit along the cut needs none of this
//! ([`super::TwoSheets::with_slits`]): as a slit the cut has no width, and holds back by [`Cut::joining_per_m`].

use dermis_tomo::mesh::Outline;
use serde::{Deserialize, Serialize};

use super::element::SheetConductance;
use crate::error::{TwinError, check, check_positive};

/// One straight cut.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cut {
    /// One end.
    pub from_m: [f64; 2],
    /// The other end.
    pub to_m: [f64; 2],
    /// Across it. A blade's cut in a soft sheet that lies flat is open by a few tenths of a millimetre (assumed).
    pub width_m: f64,
    /// d: conductance inside it as a share of the intact sheet's; small when open, near 1 when healed.
    pub residual: f64,
}

impl Cut {
    /// An open cut, 0.3 mm wide, whose faces hardly touch (one part in 100,000 conducts).
    pub fn open(from_m: [f64; 2], to_m: [f64; 2]) -> Self {
        Self { from_m, to_m, width_m: 3e-4, residual: 1e-5 }
    }

    /// Checks the numbers.
    ///
    /// # Errors
    /// Ends that coincide or are not finite, a width that is not positive, a residual outside 1e-9 to 1.
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
        (self.to_m[0] - self.from_m[0]).hypot(self.to_m[1] - self.from_m[1])
    }

    /// Whether another one has the same ends, whichever comes first.
    pub fn is_along(&self, other: &Self) -> bool {
        (self.from_m == other.from_m && self.to_m == other.to_m)
            || (self.from_m == other.to_m && self.to_m == other.from_m)
    }

    /// Refuses a cut with an end farther from a skin (its bounding box) than the skin is long.
    ///
    /// # Errors
    /// The end and where it may be.
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
    pub fn at(&self, share: f64) -> [f64; 2] {
        let between = |axis: usize| self.from_m[axis] + share * (self.to_m[axis] - self.from_m[axis]);
        [between(0), between(1)]
    }

    /// The same, shorter by this at both ends; no more than a fifth of it is taken away at each.
    pub fn shortened(&self, by_m: f64) -> Self {
        let share = (by_m / self.length_m()).clamp(0.0, 0.2);
        Self { from_m: self.at(share), to_m: self.at(1.0 - share), ..*self }
    }

    /// Conductance across it per length, over the sheet's conductance, 1/m: as a slit without width it holds back what
    /// its strip does more than the sheet would, `w (1/d - 1)` metres of sheet.
    pub fn joining_per_m(&self) -> f64 {
        // Never without any resistance: a joined slit is a millionth of a metre of sheet.
        1.0 / (self.width_m * (1.0 / self.residual - 1.0)).max(1e-6)
    }

    fn direction(&self) -> [f64; 2] {
        let length = self.length_m();
        [(self.to_m[0] - self.from_m[0]) / length, (self.to_m[1] - self.from_m[1]) / length]
    }

    /// Share of a triangle's area inside the strip.
    fn share_of(&self, corners: [[f64; 2]; 3]) -> f64 {
        let [x, y] = self.direction();
        let local = corners.map(|p| {
            let (dx, dy) = (p[0] - self.from_m[0], p[1] - self.from_m[1]);
            [dx * x + dy * y, dy * x - dx * y]
        });
        let whole = area(&local);
        let mut inside = local.to_vec();
        for (axis, limit, keep_below) in [
            (0, 0.0, false),
            (0, self.length_m(), true),
            (1, -self.width_m / 2.0, false),
            (1, self.width_m / 2.0, true),
        ] {
            inside = clip(&inside, axis, limit, keep_below);
        }
        (area(&inside) / whole).clamp(0.0, 1.0)
    }
}

/// Sheet conductance of a triangle of a sheet of conductance `intact_s` (siemens) with these cuts. Several cuts in one
/// element act one after the other.
pub fn damaged_conductance(intact_s: f64, cuts: &[Cut], corners: [[f64; 2]; 3]) -> SheetConductance {
    let left = |left: f64, cut: &Cut| {
        let share = cut.share_of(corners);
        left / ((1.0 - share) + share / cut.residual)
    };
    SheetConductance::isotropic(cuts.iter().fold(intact_s, left))
}

/// The part of a convex polygon on one side of `axis = limit` (Sutherland and Hodgman).
pub(super) fn clip(polygon: &[[f64; 2]], axis: usize, limit: f64, keep_below: bool) -> Vec<[f64; 2]> {
    let keeps = |p: [f64; 2]| if keep_below { p[axis] <= limit } else { p[axis] >= limit };
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

fn area(polygon: &[[f64; 2]]) -> f64 {
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
        // Along x at height 0.5, through the whole triangle: between 0.4 and 0.6 the triangle is 1.5 wide on average.
        let whole = strip([-1.0, 0.5], [3.0, 0.5]);
        assert!((whole.share_of(CORNERS) - 0.2 * 1.5 / 2.0).abs() < 1e-12);
        let half = strip([-1.0, 0.5], [0.5, 0.5]);
        assert!((half.share_of(CORNERS) - 0.2 * 0.5 / 2.0).abs() < 1e-12);
        assert_eq!(strip([3.0, 3.0], [4.0, 3.0]).share_of(CORNERS), 0.0);
    }

    #[test]
    fn an_open_cut_blocks_what_it_crosses_and_a_healed_one_nothing() {
        let cut = Cut { from_m: [-1.0, 0.5], to_m: [3.0, 0.5], width_m: 0.2, residual: 1e-6 };
        let s = damaged_conductance(5e-3, &[cut], CORNERS);
        // A share of 0.15 in series: 1 / (0.85 + 0.15e6).
        let expected = 5e-3 / (0.85 + 0.15e6);
        assert!((s.xx - expected).abs() < 1e-12 && (s.yy - expected).abs() < 1e-12 && s.xy == 0.0, "{s:?}");
        let healed = damaged_conductance(5e-3, &[Cut { residual: 1.0, ..cut }], CORNERS);
        assert!((healed.xx - 5e-3).abs() < 1e-15 && (healed.yy - 5e-3).abs() < 1e-15);
    }

    #[test]
    fn cuts_are_shortened_at_both_ends_but_not_away() {
        let cut = Cut::open([0.0, 0.0], [0.02, 0.0]);
        let shorter = cut.shortened(1e-3);
        assert!((shorter.from_m[0] - 1e-3).abs() < 1e-12 && (shorter.to_m[0] - 0.019).abs() < 1e-12);
        assert!((cut.shortened(1.0).length_m() - 0.012).abs() < 1e-12);
    }

    #[test]
    fn nonsense_is_refused() {
        assert!(Cut::open([0.0; 2], [0.0; 2]).check().is_err());
        assert!(Cut { residual: 0.0, ..Cut::open([0.0; 2], [0.01, 0.0]) }.check().is_err());
        assert!(Cut::open([0.0; 2], [0.01, 0.0]).check().is_ok());
    }
}
