//! Presses on sheets, separate patches and under membranes, as smooth spots of changed conductance.

use dermis_tomo::inverse::{FitOutcome, FitScratch, Spot, SpotFilter, SpotModel, SpotProposal};
use dermis_tomo::mesh::{PixelGrid, Point};

use crate::press::{Cost, Effort, Press, PressFit};

/// Fits spots by their tabulated responses ([`SpotModel`]).
#[derive(Clone, Debug)]
pub struct SpotFit {
    model: SpotModel,
    filter: SpotFilter,
    scratch: FitScratch,
    starts: Vec<Spot>,
    uniform: f64,
    /// Relative change of the channels per uniform change of the skin, and the uniform change found by the last full
    /// fit.
    gain_of_uniform: f64,
    last_uniform: f64,
    own_error_share: f64,
    error_share: f64,
    grid: PixelGrid,
    inside: Vec<bool>,
}

impl SpotFit {
    /// A fit with this model, on the pixels of a grid (row by row) that are on the skin. In a frame with typical
    /// presses, the model leaves `error_share` of the energy unexplained. A uniform change of the skin changes all
    /// channels by `gain_of_uniform` times as much, relatively.
    pub fn new(model: SpotModel, grid: PixelGrid, inside: Vec<bool>, error_share: f64, gain_of_uniform: f64) -> Self {
        let is_inside = |place| grid.pixel_at(place).is_some_and(|pixel| inside[pixel]);
        let filter = model.filter(is_inside);
        let scratch = model.scratch();
        let (starts, own_error_share) = (Vec::new(), error_share);
        let (uniform, last_uniform) = (0.0, 0.0);
        Self {
            model,
            filter,
            scratch,
            starts,
            uniform,
            gain_of_uniform,
            last_uniform,
            own_error_share,
            error_share,
            grid,
            inside,
        }
    }

    fn cost(&self, outcome: &FitOutcome, presses: usize) -> Cost {
        let combinations = self.model.combinations() as f64;
        let freedom_with = |presses: usize| (combinations - (4 * presses + 1) as f64).max(1.0);
        let freedom = freedom_with(presses);
        let energy = outcome.energy * combinations;
        // The share is that of one press. Each further press also fits its part of the error.
        let model_error = match presses {
            0 => 0.0,
            _ => self.error_share * energy * freedom / freedom_with(1),
        };
        Cost { residual: outcome.residual * freedom, energy, freedom, model_error }
    }
}

fn spot(press: &Press) -> Spot {
    let Press { position_m, radius_m, load, covariance } = *press;
    Spot { position_m, radius_m, amplitude: load, covariance }
}

fn press(spot: &Spot) -> Press {
    let Spot { position_m, radius_m, amplitude, covariance } = *spot;
    Press { position_m, radius_m, load: amplitude, covariance }
}

fn start(found: SpotProposal) -> Press {
    let (position_m, radius_m, load) = (found.position_m, found.radius_m, found.amplitude);
    Press { position_m, radius_m, load, ..Press::default() }
}

impl PressFit for SpotFit {
    fn take_frame(&mut self, frame: &[f64]) -> Option<Cost> {
        let outcome = self.model.take_frame(frame, &mut self.scratch).ok()?;
        self.uniform = outcome.uniform;
        Some(self.cost(&outcome, 0))
    }

    fn fit(&mut self, starts: &[Press], effort: Effort) -> Option<Cost> {
        if effort == Effort::Full && self.scratch.is_out_of_work() {
            return None;
        }
        self.starts.clear();
        self.starts.extend(starts.iter().map(spot));
        let outcome = match effort {
            Effort::Quick => self.model.fit_from(&self.starts, self.uniform, &mut self.scratch)?,
            Effort::Full => {
                let outcome = self.model.fit_in_full(&self.starts, self.uniform, &mut self.scratch)?;
                self.last_uniform = outcome.uniform;
                outcome
            }
        };
        Some(self.cost(&outcome, starts.len()))
    }

    fn left_by(&mut self, presses: &[Press]) -> Option<Cost> {
        self.starts.clear();
        self.starts.extend(presses.iter().map(spot));
        let outcome = self.model.left_by(&self.starts, &mut self.scratch)?;
        Some(self.cost(&outcome, presses.len()))
    }

    fn linearise_about(&mut self, presses: &[Press]) {
        self.starts.clear();
        self.starts.extend(presses.iter().map(spot));
        self.model.linearise_about(&self.starts, &mut self.scratch);
    }

    fn fit_loads(&mut self, starts: &[Press]) -> Option<Cost> {
        self.starts.clear();
        self.starts.extend(starts.iter().map(spot));
        let outcome = self.model.fit_amplitudes(&self.starts, &mut self.scratch)?;
        Some(self.cost(&outcome, starts.len()))
    }

    fn fit_fixed(&mut self, starts: &[Press], fixed: &[bool]) -> Option<(Cost, f64)> {
        if self.scratch.is_out_of_work() {
            return None;
        }
        self.starts.clear();
        self.starts.extend(starts.iter().map(spot));
        let (outcome, gain) = self.model.fit_fixed(&self.starts, fixed, self.uniform, &mut self.scratch)?;
        self.last_uniform = outcome.uniform;
        Some((self.cost(&outcome, starts.len()), gain))
    }

    fn gain(&self) -> f64 {
        (self.gain_of_uniform * self.last_uniform).exp()
    }

    fn has_quick_fit(&self) -> bool {
        self.model.looks_beyond_proportion()
    }

    fn set_most_work(&mut self, operations: f64) {
        self.scratch.set_most_work(operations);
    }

    fn work(&self) -> f64 {
        self.scratch.work()
    }

    fn presses(&self) -> Vec<Press> {
        self.scratch.spots().iter().map(press).collect()
    }

    fn fit_nothing(&mut self) -> Option<Cost> {
        let outcome = self.model.fit_nothing(&mut self.scratch);
        Some(self.cost(&outcome, 0))
    }

    fn seek(&self, negative: bool) -> Vec<Press> {
        self.model.seek(&self.filter, negative, &self.scratch).into_iter().map(start).collect()
    }

    fn seek_together(&self) -> Vec<Press> {
        self.model.seek_together(&self.filter, &self.scratch).into_iter().map(start).collect()
    }

    fn most_gain(&self, negative: bool) -> f64 {
        self.model.most_gain(&self.filter, negative, &self.scratch)
    }

    fn is_inside(&self, position_m: Point) -> bool {
        self.grid.pixel_at(position_m).is_some_and(|pixel| self.inside[pixel])
    }

    fn typical_radius_m(&self) -> f64 {
        self.model.options().typical_radius_m
    }

    fn most_presses(&self) -> usize {
        self.model.options().most_spots
    }

    fn set_error_beyond(&mut self, share: f64) {
        self.error_share = self.own_error_share + share;
    }

    fn channels_of(&mut self, presses: &[Press], volts: &mut Vec<f64>) {
        self.starts.clear();
        self.starts.extend(presses.iter().map(spot));
        self.model.channels_of(&self.starts, &mut self.scratch, volts);
    }

    fn largest_change(&mut self, press: &Press) -> f64 {
        self.model.largest_change(press.position_m, press.radius_m, &mut self.scratch)
    }
}
