//! Changes of conductivity too large for a linear model. A forward model computes the response of the channels.
//!
//! A disc whose conductivity changes by the share u responds to a field like a dipole of strength `2 u / (2 + u)`
//! (Jackson, Classical Electrodynamics, 1999, section 4.4, in the plane). Amplitudes are defined by that response, so
//! the derivatives of a fit stay those of the table. The largest change under a spot is the u that gives this
//! response.

use std::fmt;
use std::sync::Arc;

use faer::{Mat, MatRef};
use pulp::Arch;

use super::responses::Responses;
use super::shape::SpotShape;
use crate::mesh::Point;

/// Lowest change used. A perfect insulator responds like -2.
const LOWEST: f64 = -0.95;
/// Changes below this share are small: the channels' response to them is linear to 1 %.
const SMALL: f64 = 0.02;
/// Loads below this share count as zero.
const NOTHING: f64 = 3e-4;

/// A forward model's response to changes of conductivity.
#[derive(Clone)]
pub struct ChangeResponse {
    respond: Arc<Respond>,
    operations: f64,
}

type Respond = dyn Fn(&[f64]) -> Option<Vec<f64>> + Send + Sync;

impl ChangeResponse {
    /// A response by this function, which takes about this number of operations. Its argument is the relative change of
    /// each pixel, all above -1, and its result the change of each channel of a frame, volts; `None` if that cannot be
    /// solved.
    pub fn new(operations: f64, respond: impl Fn(&[f64]) -> Option<Vec<f64>> + Send + Sync + 'static) -> Self {
        Self { respond: Arc::new(respond), operations }
    }

    /// Change of the channels, volts, for these relative changes of the pixels. `None` if it cannot be solved.
    pub fn to(&self, changes: &[f64]) -> Option<Vec<f64>> {
        (self.respond)(changes)
    }

    /// About the number of operations that a response takes.
    pub fn operations(&self) -> f64 {
        self.operations
    }
}

impl fmt::Debug for ChangeResponse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ChangeResponse").field("operations", &self.operations).finish_non_exhaustive()
    }
}

/// The nonlinear response to large changes, in the combinations of a table.
#[derive(Clone)]
pub(super) struct LargeChanges {
    response: ChangeResponse,
    /// Channels by combinations of the table, row by row: whitens and projects.
    projection: Vec<f32>,
    /// Combinations (rows) by pixels: the linear response to a change of each pixel in the direction of positive
    /// spots.
    jacobian: Mat<f32>,
    /// Change of all pixels (rows) by a load on one (columns). Without it, a load changes only its own pixel.
    spread: Option<Mat<f32>>,
    positions_m: Vec<Point>,
    /// 1 if positive spots raise conductivity, -1 if they lower it.
    sign: f64,
    /// As in [`super::SpotOptions`].
    smoothing_m: Option<f64>,
}

/// Working memory for the nonlinear response.
#[derive(Clone, Debug, Default)]
pub(super) struct LargeScratch {
    /// Changes caused by one load.
    one: Vec<f32>,
    /// All changes, and their linear approximation.
    changes: Vec<f64>,
    linear: Vec<f64>,
    /// The nonlinear part of the response, in the combinations of the table and in those of the model.
    tabulated: Vec<f32>,
    combined: Vec<f32>,
    /// Operations spent on responses.
    pub(super) work: f64,
    /// Once more than this has been spent, no response is computed.
    pub(super) most_work: f64,
}

impl LargeScratch {
    pub(super) fn is_out_of_work(&self) -> bool {
        self.work > self.most_work
    }
}

impl LargeChanges {
    pub(super) fn new(
        response: ChangeResponse,
        projection: &[f32],
        jacobian: MatRef<'_, f64>,
        spread: Option<MatRef<'_, f64>>,
        positions_m: &[Point],
        smoothing_m: Option<f64>,
        sign: f64,
    ) -> Self {
        let single = |m: MatRef<'_, f64>| Mat::from_fn(m.nrows(), m.ncols(), |row, column| m[(row, column)] as f32);
        let (projection, positions_m) = (projection.to_vec(), positions_m.to_vec());
        let (jacobian, spread) = (single(jacobian), spread.map(single));
        Self { response, projection, jacobian, spread, positions_m, sign, smoothing_m }
    }

    /// Memory for a model with this number of combinations.
    pub(super) fn scratch(&self, combinations: usize) -> LargeScratch {
        let pixels = self.positions_m.len();
        LargeScratch {
            one: vec![0.0; pixels],
            changes: vec![0.0; pixels],
            linear: vec![0.0; pixels],
            tabulated: vec![0.0; self.jacobian.nrows()],
            combined: vec![0.0; combinations],
            work: 0.0,
            most_work: f64::INFINITY,
        }
    }

    /// The change, in the direction of spots, whose response is `answered`.
    fn change(&self, answered: f64) -> f64 {
        answered / (1.0 - 0.5 * self.sign * answered).max(1.0 + 0.5 * LOWEST)
    }

    /// True if any of these spots (as in [`LargeChanges::compute`]) changes a pixel by more than `SMALL`.
    pub(super) fn are_large(
        &self,
        mut spots: impl Iterator<Item = (Point, f64, f64)>,
        scratch: &mut LargeScratch,
    ) -> bool {
        spots.any(|(position_m, radius_m, amplitude)| {
            self.one(position_m, radius_m, &mut scratch.one);
            let largest = scratch.one.iter().fold(0.0_f32, |most, v| most.max(v.abs()));
            f64::from(largest) * amplitude.abs() > SMALL
        })
    }

    /// The nonlinear part of the response to these spots, in the combinations of a model: the difference between their
    /// full response and `amplitude` times the response of a spot of amplitude 1. Spots are position, radius (metres)
    /// and amplitude, the latter as defined by the response. `None` if the forward model fails, or if no more work is
    /// allowed.
    pub(super) fn compute<'a>(
        &self,
        spots: impl Iterator<Item = (Point, f64, f64)>,
        responses: &Responses,
        scratch: &'a mut LargeScratch,
    ) -> Option<&'a [f32]> {
        if scratch.is_out_of_work() {
            return None;
        }
        scratch.work += self.response.operations;
        let LargeScratch { one, changes, linear, tabulated, combined, .. } = scratch;
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
        let differences = self.response.to(changes)?;
        tabulated.fill(0.0);
        Arch::new().dispatch(|| {
            for (row, value) in self.projection.chunks_exact(tabulated.len()).zip(&differences) {
                add(*value as f32, row, tabulated);
            }
            for (pixel, linear) in linear.iter().enumerate().filter(|(_, linear)| **linear != 0.0) {
                add(-*linear as f32, self.jacobian.col_as_slice(pixel), tabulated);
            }
        });
        responses.combine_one(tabulated, combined);
        Some(combined)
    }

    /// Largest change by a load of amplitude 1, which is 1 without a spread.
    pub(super) fn largest(&self, position_m: Point, radius_m: f64, scratch: &mut LargeScratch) -> f64 {
        if self.spread.is_none() {
            return 1.0;
        }
        scratch.one.resize(self.positions_m.len(), 0.0);
        self.one(position_m, radius_m, &mut scratch.one);
        f64::from(scratch.one.iter().fold(0.0_f32, |most, v| most.max(v.abs())))
    }

    /// Changes of all pixels by a load of amplitude 1.
    fn one(&self, [x, y]: Point, radius_m: f64, one: &mut [f32]) {
        one.fill(0.0);
        let shape = SpotShape::new(radius_m, self.smoothing_m);
        Arch::new().dispatch(|| {
            for (pixel, at) in self.positions_m.iter().enumerate() {
                let load = shape.at((at[0] - x).powi(2) + (at[1] - y).powi(2));
                if load > NOTHING {
                    let load = load as f32;
                    match &self.spread {
                        None => one[pixel] = load,
                        Some(spread) => add(load, spread.col_as_slice(pixel), one),
                    }
                }
            }
        });
    }
}

/// Adds a multiple of a column. Must be inlined to be vectorised.
#[inline(always)]
fn add(factor: f32, column: &[f32], sum: &mut [f32]) {
    sum.iter_mut().zip(column).for_each(|(sum, entry)| *sum += factor * entry);
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
            let none = ChangeResponse::new(0.0, |_| None);
            let nothing = Mat::<f64>::zeros(1, 1);
            let large = LargeChanges::new(none, &[0.0], nothing.as_ref(), None, &[[0.0; 2]], None, sign);
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
