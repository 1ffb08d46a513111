//! The reusable memory of the fit of spots.

use super::SpotModel;
use super::beyond::Beyond;
use super::large_changes::LargeScratch;
use super::spot::{OF_SPOT, Spot, State};
use crate::least_squares::Scratch;

/// Working memory of a fit.
#[derive(Clone, Debug, Default)]
pub struct FitScratch {
    pub(super) data: Vec<f32>,
    /// The frame that linear fits explain: less the nonlinear part of the response to the spots about which the model
    /// is linearised.
    pub(super) linear: Vec<f32>,
    /// Memory for the nonlinear part of the response to spots, and whether the fit takes it into account yet.
    pub(super) large: LargeScratch,
    pub(super) beyond: Beyond,
    pub(super) looks_beyond: bool,
    /// Spots whose positions and radii are fixed.
    pub(super) fixed: Vec<bool>,
    /// A response, in the combinations of the table.
    pub(super) tabulated: Vec<f32>,
    /// Response and derivatives of each spot.
    pub(super) rows: Vec<f32>,
    pub(super) trial_rows: Vec<f32>,
    pub(super) residual: Vec<f32>,
    pub(super) trial_residual: Vec<f32>,
    /// Weighted derivative columns, one per parameter.
    pub(super) columns: Vec<f32>,
    pub(super) solver: Scratch,
    pub(super) state: Vec<State>,
    pub(super) trial: Vec<State>,
    pub(super) spots: Vec<Spot>,
}

impl FitScratch {
    /// The spots of the last fit, in the order of the starts.
    pub fn spots(&self) -> &[Spot] {
        &self.spots
    }

    /// Operations spent on large changes since the bound was set or the frame was taken.
    pub fn work(&self) -> f64 {
        self.large.work
    }

    /// Bounds the operations spent on large changes, from now on and from each next frame on. Fits beyond the bound
    /// stay as they are.
    pub fn set_most_work(&mut self, operations: f64) {
        (self.large.work, self.large.most_work) = (0.0, operations);
    }

    /// True if more has been spent than allowed.
    pub fn is_out_of_work(&self) -> bool {
        self.large.is_out_of_work()
    }
}

impl SpotModel {
    /// Memory for fits with this model, allocated now.
    pub fn scratch(&self) -> FitScratch {
        let (length, most) = (self.combinations(), self.options().most_spots);
        let parameters = OF_SPOT * most + 1;
        FitScratch {
            data: vec![0.0; length],
            linear: vec![0.0; length],
            large: self.large.as_ref().map_or_else(LargeScratch::default, |large| large.scratch(length)),
            beyond: Beyond::new(length, most),
            looks_beyond: false,
            fixed: Vec::with_capacity(most),
            tabulated: self.responses.scratch(),
            rows: vec![0.0; OF_SPOT * length * most],
            trial_rows: vec![0.0; OF_SPOT * length * most],
            residual: vec![0.0; length],
            trial_residual: vec![0.0; length],
            columns: vec![0.0; length * parameters],
            solver: Scratch::new(parameters),
            state: Vec::with_capacity(most),
            trial: Vec::with_capacity(most),
            spots: Vec::with_capacity(most),
        }
    }
}
