//! Smooth spots at known positions, and their derivatives.

use faer::Mat;

use crate::Error;
use crate::prepare::Prepared;
use crate::stages::spot_model::Membrane;

/// Parameters of a spot, in this order: x, y, load, logarithm of the radius.
pub(crate) const PARAMETERS: usize = 4;
pub(crate) const LOAD: usize = 2;
pub(crate) const RADIUS: usize = 3;

/// Makes spots on the pixels of a skin.
pub(crate) struct Spots<'a> {
    prepared: &'a Prepared,
    membrane: Option<Membrane>,
}

impl<'a> Spots<'a> {
    pub(crate) fn new(prepared: &'a Prepared) -> Result<Self, Error> {
        Ok(Self { prepared, membrane: Membrane::of(prepared)? })
    }

    /// Relative changes of the inside pixels by a spot of load 1 and its derivatives: [`PARAMETERS`] columns per spot.
    pub(crate) fn columns(&self, spots: &[([f64; 2], f64)]) -> Mat<f64> {
        let centres = &self.prepared.basis.positions;
        let polarity = self.prepared.skin.imaging.polarity.sign();
        let mut columns = Mat::zeros(centres.len(), PARAMETERS * spots.len());
        for (spot, (place, radius_m)) in spots.iter().enumerate() {
            for (pixel, centre) in centres.iter().enumerate() {
                let off = [0, 1].map(|axis| (centre[axis] - place[axis]) / radius_m);
                let square = off[0] * off[0] + off[1] * off[1];
                let value = polarity * (-0.5 * square).exp();
                columns[(pixel, PARAMETERS * spot)] = value * off[0] / radius_m;
                columns[(pixel, PARAMETERS * spot + 1)] = value * off[1] / radius_m;
                columns[(pixel, PARAMETERS * spot + LOAD)] = value;
                columns[(pixel, PARAMETERS * spot + RADIUS)] = value * square;
            }
        }
        match &self.membrane {
            Some(membrane) => &membrane.spread * columns,
            None => columns,
        }
    }
}
