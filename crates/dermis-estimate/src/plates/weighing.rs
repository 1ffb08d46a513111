//! The weights of the channels, and the proposed presses under them.

use super::model::PlateModel;
use crate::whitening::Whitening;

/// Weights of the channels, which do not change from frame to frame. Copies of a fit share them.
#[derive(Debug)]
pub(super) struct Weighing {
    pub whitening: Whitening,
    /// Deviations of the channels, volts; infinite for channels left out.
    pub deviations: Vec<f64>,
    /// Whitened changes by the proposed presses, of unit length.
    units: Vec<f32>,
    /// Their lengths.
    lengths: Vec<f64>,
}

impl Weighing {
    pub fn new(model: &PlateModel, deviations: &[f64], nuisances: &[Vec<f64>]) -> Self {
        let whitening = Whitening::new(deviations, nuisances);
        let (mut units, mut lengths, mut whitened) = (Vec::new(), Vec::new(), Vec::new());
        for (_, change) in &model.proposals {
            whitening.apply(change, &mut whitened);
            let length = whitened.iter().map(|v| v * v).sum::<f64>().sqrt();
            units.extend(whitened.iter().map(|v| (v / length.max(f64::MIN_POSITIVE)) as f32));
            lengths.push(length);
        }
        Self { whitening, deviations: deviations.to_vec(), units, lengths }
    }

    /// Products of a whitened residual with the proposals of unit length.
    pub fn products(&self, residual: &[f64]) -> Vec<f64> {
        let residual: Vec<f32> = residual.iter().map(|value| *value as f32).collect();
        let product = |unit: &[f32]| f64::from(unit.iter().zip(&residual).map(|(a, b)| a * b).sum::<f32>());
        self.units.chunks_exact(residual.len().max(1)).map(product).collect()
    }

    /// Length of a proposal, above 0.
    pub fn length(&self, proposal: usize) -> f64 {
        self.lengths[proposal].max(f64::MIN_POSITIVE)
    }
}
