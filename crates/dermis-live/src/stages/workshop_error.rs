//! Covariance of touches on a skin that isn't built exactly as its file says, from an ensemble of skins.

use std::sync::Arc;

use dermis_estimate::BuiltVariance;
use dermis_tomo::mesh::Point;
use serde::{Deserialize, Serialize};

/// Largest ratio of a baseline's misfit to the ensemble's. A larger misfit means that the model is of a different
/// skin.
const MOST_MISFIT: f64 = 5.0;

/// Covariances from an ensemble of skins.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorkshopError {
    pub(crate) places_m: Vec<Point>,
    pub(crate) spacing_m: f64,
    /// Means of x^2, x y and y^2 (m^2), of the squared relative strength (load times squared radius), and of the
    /// unexplained share of the energy.
    pub(crate) squares: Vec<[f64; 5]>,
    /// Mean squared misfit of the members' baselines.
    pub(crate) misfit_2: f64,
    /// Variance of the relative change of the layer under a given pressure.
    pub(crate) law: f64,
}

/// Errors of touches on one skin, scaled by the misfit of its baseline.
#[derive(Clone, Debug)]
pub struct BuiltError {
    ensemble: Arc<WorkshopError>,
    scale: f64,
}

impl BuiltError {
    /// Scales an ensemble to a skin whose baseline has this relative misfit; NaN if there is no baseline to compare.
    pub(crate) fn new(ensemble: Arc<WorkshopError>, misfit: f64) -> Self {
        let ratio = misfit / ensemble.misfit_2.sqrt();
        let scale = if ratio.is_finite() { ratio.min(MOST_MISFIT).powi(2) } else { 1.0 };
        Self { ensemble, scale }
    }

    /// Covariance of a position, square metres.
    pub fn covariance_m2(&self, place_m: Point) -> [[f64; 2]; 2] {
        let [xx, xy, yy, ..] = self.ensemble.at(place_m).map(|value| self.scale * value);
        [[xx, xy], [xy, yy]]
    }

    /// Variances at a press.
    pub fn variance(&self, place_m: Point) -> BuiltVariance {
        BuiltVariance { gain: self.scale * self.ensemble.at(place_m)[3], law: self.ensemble.law }
    }

    /// Share of the energy of a press that the nominal model leaves unexplained, on average over the skin.
    pub fn unexplained(&self) -> f64 {
        let squares = &self.ensemble.squares;
        self.scale * squares.iter().map(|square| square[4]).sum::<f64>() / squares.len().max(1) as f64
    }
}

impl WorkshopError {
    /// Variance of a coordinate at a position, averaged over both, m^2.
    pub(crate) fn variance_m2(&self, place_m: Point) -> f64 {
        let [xx, _, yy, ..] = self.at(place_m);
        0.5 * (xx + yy)
    }

    /// The same errors with a factor on the variances of position and strength.
    pub(crate) fn scaled(mut self, factor: f64) -> Self {
        self.squares.iter_mut().flat_map(|squares| &mut squares[..4]).for_each(|square| *square *= factor);
        self
    }

    /// The same errors with this much more of a press's energy unexplained.
    pub(crate) fn leaving(mut self, share: f64) -> Self {
        self.squares.iter_mut().for_each(|squares| squares[4] += share);
        self
    }

    /// Mean squares at a position, smoothed over its neighbours.
    fn at(&self, place_m: Point) -> [f64; 5] {
        let (mut sums, mut weights) = ([0.0; 5], 0.0);
        for (at, squares) in self.places_m.iter().zip(&self.squares) {
            let distance = ((at[0] - place_m[0]).powi(2) + (at[1] - place_m[1]).powi(2)) / self.spacing_m.powi(2);
            // Far from all tabulated positions, the nearest ones count.
            let weight = (-0.5 * distance).exp() + 1e-12 / (1.0 + distance * distance);
            sums.iter_mut().zip(squares).for_each(|(sum, square)| *sum += weight * square);
            weights += weight;
        }
        sums.map(|sum| sum / weights)
    }
}
