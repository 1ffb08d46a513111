//! Changes of conductivity that channels do not follow in proportion: a forward model says what they do.
//!
//! A disc whose conductivity changes by the share u answers a field like a dipole `2 u / (2 + u)` (Jackson, Classical
//! Electrodynamics, 1999, section 4.4, in the plane). Amplitudes are what channels answer, so that a fit's slopes stay
//! those of the table; the largest change of a spot is the u that answers so.

use std::fmt;
use std::sync::Arc;

use faer::{Mat, MatRef};

use super::responses::Responses;

/// A change counts as no lower than this: what insulates entirely answers like -2.
const LOWEST: f64 = -0.95;
/// Changes below this share are small: channels follow them in proportion to a hundredth.
const SMALL: f64 = 0.02;
/// Exponent from which a load counts as zero.
const NOTHING: f64 = 8.0;

/// What channels change by (volts, as many as a frame has) where the conductivity of each pixel changes by these
/// shares, all above -1; `None` where that cannot be solved.
pub type ChangeResponse = dyn Fn(&[f64]) -> Option<Vec<f64>> + Send + Sync;

/// What large changes do to the combinations of a table.
#[derive(Clone)]
pub(super) struct LargeChanges {
    response: Arc<ChangeResponse>,
    /// Channels by combinations of the table, row by row: whitens and projects.
    projection: Vec<f32>,
    /// Combinations (rows) by the change of each pixel in the direction of positive spots, in proportion.
    jacobian: Mat<f32>,
    /// Change of all pixels (rows) by a load on one (columns); a load changes its own pixel alone where there is none.
    spread: Option<Mat<f32>>,
    positions_m: Vec<[f64; 2]>,
    /// 1 where positive spots raise conductivity, -1 where they lower it.
    sign: f64,
}

/// Pixels while what lies beyond proportion is worked out.
#[derive(Clone, Debug, Default)]
pub(super) struct LargeScratch {
    /// What one load changes.
    one: Vec<f32>,
    /// All changes, and what they would be in proportion.
    changes: Vec<f64>,
    linear: Vec<f64>,
    /// What lies beyond proportion, in the combinations of the table and in those of the model.
    tabulated: Vec<f32>,
    combined: Vec<f32>,
}

impl LargeChanges {
    pub(super) fn new(
        response: Arc<ChangeResponse>,
        projection: &[f32],
        jacobian: MatRef<'_, f64>,
        spread: Option<MatRef<'_, f64>>,
        positions_m: &[[f64; 2]],
        sign: f64,
    ) -> Self {
        let single = |m: MatRef<'_, f64>| Mat::from_fn(m.nrows(), m.ncols(), |row, column| m[(row, column)] as f32);
        let (projection, positions_m) = (projection.to_vec(), positions_m.to_vec());
        Self { response, projection, jacobian: single(jacobian), spread: spread.map(single), positions_m, sign }
    }

    /// Memory for a model of so many combinations.
    pub(super) fn scratch(&self, combinations: usize) -> LargeScratch {
        let pixels = self.positions_m.len();
        LargeScratch {
            one: vec![0.0; pixels],
            changes: vec![0.0; pixels],
            linear: vec![0.0; pixels],
            tabulated: vec![0.0; self.jacobian.nrows()],
            combined: vec![0.0; combinations],
        }
    }

    /// The change in the direction of spots that answers like this one in proportion.
    fn change(&self, answered: f64) -> f64 {
        answered / (1.0 - 0.5 * self.sign * answered).max(1.0 + 0.5 * LOWEST)
    }

    /// Whether any of these spots (as in [`LargeChanges::take_out`]) changes a pixel by more than little.
    pub(super) fn are_large(
        &self,
        mut spots: impl Iterator<Item = ([f64; 2], f64, f64)>,
        scratch: &mut LargeScratch,
    ) -> bool {
        spots.any(|(position_m, radius_m, amplitude)| {
            self.one(position_m, radius_m, &mut scratch.one);
            let largest = scratch.one.iter().fold(0.0_f32, |most, v| most.max(v.abs()));
            f64::from(largest) * amplitude.abs() > SMALL
        })
    }

    /// Takes out of a model's residual what these spots (place, radius in metres, amplitude as channels answer it) do
    /// beyond `amplitude` times the response of a spot of amplitude 1. `None` where the forward model has no answer.
    pub(super) fn take_out(
        &self,
        spots: impl Iterator<Item = ([f64; 2], f64, f64)>,
        responses: &Responses,
        scratch: &mut LargeScratch,
        residual: &mut [f32],
    ) -> Option<()> {
        let LargeScratch { one, changes, linear, tabulated, combined } = scratch;
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
        changes.iter_mut().for_each(|change| *change = (self.sign * *change).max(LOWEST));
        let differences = (self.response)(changes)?;
        tabulated.fill(0.0);
        for (row, value) in self.projection.chunks_exact(tabulated.len()).zip(&differences) {
            let value = *value as f32;
            tabulated.iter_mut().zip(row).for_each(|(sum, entry)| *sum += value * entry);
        }
        for (pixel, linear) in linear.iter().enumerate().filter(|(_, linear)| **linear != 0.0) {
            let (linear, column) = (*linear as f32, self.jacobian.col_as_slice(pixel));
            tabulated.iter_mut().zip(column).for_each(|(sum, entry)| *sum -= linear * entry);
        }
        responses.combine_one(tabulated, combined);
        residual.iter_mut().zip(combined.iter()).for_each(|(left, beyond)| *left -= beyond);
        Some(())
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

impl fmt::Debug for LargeChanges {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LargeChanges").field("pixels", &self.positions_m.len()).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_is_that_of_the_disc_that_answers_so() {
        for sign in [1.0, -1.0] {
            let none: Arc<ChangeResponse> = Arc::new(|_| None);
            let nothing = Mat::<f64>::zeros(1, 1);
            let large = LargeChanges::new(none, &[0.0], nothing.as_ref(), None, &[[0.0; 2]], sign);
            for spot in [0.3, -0.4, 0.01] {
                // Twice the contrast factor (s1 - s) / (s1 + s) of a concentric disc, to which its first harmonic is
                // proportional (Isaacson, IEEE TMI 5, 1986, eq. 4.9).
                let inside = 1.0 + sign * spot;
                let answered = sign * 2.0 * (inside - 1.0) / (inside + 1.0);
                assert!((large.change(answered) - spot).abs() < 1e-12);
            }
            assert!(large.change(1e9).is_finite() && large.change(-1e9).is_finite());
        }
    }
}
