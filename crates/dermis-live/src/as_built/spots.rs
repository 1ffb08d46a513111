//! Smooth spots at known positions, and their derivatives.

use dermis_tomo::inverse::SpotShape;
use faer::Mat;

use crate::Error;
use crate::prepare::Prepared;
use crate::stages::spot_model::{Membrane, smoothing_m};

/// Parameters of a spot, in this order: x, y, load, logarithm of the radius.
pub(crate) const PARAMETERS: usize = 4;
pub(crate) const LOAD: usize = 2;
pub(crate) const RADIUS: usize = 3;
/// Step of the logarithm of the radius for its derivative.
const STEP: f64 = 0.01;

/// Makes spots on the pixels of a skin.
pub(crate) struct Spots<'a> {
    prepared: &'a Prepared,
    membrane: Option<Membrane>,
    smoothing_m: Option<f64>,
}

impl<'a> Spots<'a> {
    pub(crate) fn new(prepared: &'a Prepared) -> Result<Self, Error> {
        let smoothing_m = smoothing_m(&prepared.skin.frontend.layer);
        Ok(Self { prepared, membrane: Membrane::of(prepared)?, smoothing_m })
    }

    /// Relative changes of the inside pixels by a spot of load 1 and its derivatives: [`PARAMETERS`] columns per spot.
    pub(crate) fn columns(&self, spots: &[([f64; 2], f64)]) -> Mat<f64> {
        let centres = &self.prepared.basis.positions;
        let polarity = self.prepared.skin.imaging.polarity.sign();
        let mut columns = Mat::zeros(centres.len(), PARAMETERS * spots.len());
        for (spot, (place, radius_m)) in spots.iter().enumerate() {
            let shape_of = |factor: f64| SpotShape::new(factor * radius_m, self.smoothing_m);
            let (shape, [narrow, wide]) = (shape_of(1.0), [(-STEP).exp(), STEP.exp()].map(shape_of));
            for (pixel, centre) in centres.iter().enumerate() {
                let off = [0, 1].map(|axis| centre[axis] - place[axis]);
                let square = off[0] * off[0] + off[1] * off[1];
                let inwards = -polarity * shape.slope_at(square) / square.sqrt().max(f64::MIN_POSITIVE);
                columns[(pixel, PARAMETERS * spot)] = inwards * off[0];
                columns[(pixel, PARAMETERS * spot + 1)] = inwards * off[1];
                columns[(pixel, PARAMETERS * spot + LOAD)] = polarity * shape.at(square);
                let wider = wide.at(square) - narrow.at(square);
                columns[(pixel, PARAMETERS * spot + RADIUS)] = polarity * wider / (2.0 * STEP);
            }
        }
        match &self.membrane {
            Some(membrane) => &membrane.spread * columns,
            None => columns,
        }
    }
}
