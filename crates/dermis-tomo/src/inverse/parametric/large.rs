//! Changes of conductivity that channels do not follow in proportion. A disc whose conductivity changes by the share u
//! answers a field like a dipole `2 u / (2 + u)` (Jackson, Classical Electrodynamics, 1999, section 4.4, in the plane),
//! and so does, to second order in u, any spot that looks the same from all sides: what a change of u does is what
//! `g(u) = u / (1 + u/2)` would do were channels linear. Dents that halve the conductance so look a third stronger, and
//! narrower.

use faer::{Mat, MatRef};

/// A change counts as no lower than this: what insulates entirely answers like -2.
const LOWEST: f64 = -0.9;
/// Exponent from which a load counts as zero.
const NOTHING: f64 = 8.0;

/// What large changes do to the combinations of a table.
#[derive(Clone, Debug)]
pub(super) struct LargeChanges {
    /// Combinations (rows) by the change of each pixel in the direction of positive spots.
    jacobian: Mat<f32>,
    /// Change of all pixels (rows) by a load on one (columns); a load changes its own pixel alone where there is none.
    spread: Option<Mat<f32>>,
    positions_m: Vec<[f64; 2]>,
    /// 1 where positive spots raise conductivity, -1 where they lower it.
    sign: f64,
}

/// Pixels while a correction is worked out.
#[derive(Clone, Debug, Default)]
pub(super) struct LargeScratch {
    /// What one load changes.
    one: Vec<f32>,
    /// All changes, and what they would be in proportion.
    changes: Vec<f64>,
    linear: Vec<f64>,
}

impl LargeChanges {
    pub(super) fn new(
        jacobian: MatRef<'_, f64>,
        spread: Option<MatRef<'_, f64>>,
        positions_m: &[[f64; 2]],
        sign: f64,
    ) -> Self {
        let single = |m: MatRef<'_, f64>| Mat::from_fn(m.nrows(), m.ncols(), |row, column| m[(row, column)] as f32);
        Self { jacobian: single(jacobian), spread: spread.map(single), positions_m: positions_m.to_vec(), sign }
    }

    pub(super) fn scratch(&self) -> LargeScratch {
        let pixels = self.positions_m.len();
        LargeScratch { one: vec![0.0; pixels], changes: vec![0.0; pixels], linear: vec![0.0; pixels] }
    }

    /// The change that channels answer as if it were `answered` and they were linear.
    fn change(&self, answered: f64) -> f64 {
        answered / (1.0 - 0.5 * self.sign * answered).max(1.0 + 0.5 * LOWEST)
    }

    /// What a change is answered like.
    fn answered(&self, change: f64) -> f64 {
        let change = self.sign * (self.sign * change).max(LOWEST);
        change / (1.0 + 0.5 * self.sign * change)
    }

    /// What combinations show of these spots (place, radius in metres, amplitude as channels answer it) beyond `amplitude`
    /// times the response of a spot of amplitude 1.
    pub(super) fn beyond(
        &self,
        spots: impl Iterator<Item = ([f64; 2], f64, f64)>,
        scratch: &mut LargeScratch,
        out: &mut [f32],
    ) {
        let LargeScratch { one, changes, linear } = scratch;
        changes.fill(0.0);
        linear.fill(0.0);
        for (position_m, radius_m, amplitude) in spots {
            self.one(position_m, radius_m, one);
            let largest = f64::from(one.iter().fold(0.0_f32, |most, v| most.max(v.abs())));
            if largest == 0.0 || amplitude == 0.0 {
                continue;
            }
            let change = self.change(amplitude * largest) / largest;
            for ((change_at, linear_at), one) in changes.iter_mut().zip(linear.iter_mut()).zip(one.iter()) {
                *change_at += change * f64::from(*one);
                *linear_at += amplitude * f64::from(*one);
            }
        }
        out.fill(0.0);
        for (pixel, (change, linear)) in changes.iter().zip(linear.iter()).enumerate() {
            let beyond = (self.answered(*change) - linear) as f32;
            if beyond != 0.0 {
                let column = self.jacobian.col_as_slice(pixel);
                out.iter_mut().zip(column).for_each(|(sum, entry)| *sum += beyond * entry);
            }
        }
    }

    /// What a load of amplitude 1 changes in all pixels.
    fn one(&self, [x, y]: [f64; 2], radius_m: f64, one: &mut [f32]) {
        one.fill(0.0);
        let per = 0.5 / (radius_m * radius_m);
        for (pixel, at) in self.positions_m.iter().enumerate() {
            let exponent = per * ((at[0] - x).powi(2) + (at[1] - y).powi(2));
            if exponent < NOTHING {
                let load = (-exponent).exp() as f32;
                match &self.spread {
                    None => one[pixel] = load,
                    Some(spread) => {
                        let column = spread.col_as_slice(pixel);
                        one.iter_mut().zip(column).for_each(|(sum, entry)| *sum += load * entry);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_answered_as_a_disc_in_the_plane_is() {
        // Twice the contrast factor (s1 - s) / (s1 + s) of a concentric disc, to which its first harmonic is
        // proportional (Isaacson, IEEE TMI 5, 1986, eq. 4.9).
        for sign in [1.0, -1.0] {
            let large = LargeChanges::new(Mat::<f64>::zeros(1, 1).as_ref(), None, &[[0.0; 2]], sign);
            for spot in [0.3, -0.4, 0.01] {
                let inside = 1.0 + sign * spot;
                let answered = large.answered(spot);
                assert!((sign * answered - 2.0 * (inside - 1.0) / (inside + 1.0)).abs() < 1e-12);
                assert!((large.change(answered) - spot).abs() < 1e-12);
            }
        }
        // What cannot be less than nothing is not.
        let lowering = LargeChanges::new(Mat::<f64>::zeros(1, 1).as_ref(), None, &[[0.0; 2]], -1.0);
        assert_eq!(lowering.answered(1.5), lowering.answered(0.9));
        assert!(lowering.change(1e9).is_finite() && lowering.answered(lowering.change(1e9)).is_finite());
    }
}
