//! Touches that have gone: what a reference held that was taken while something touched the skin.

use super::PatchStage;
use super::seek::{Outcome, Seek};

impl PatchStage {
    /// How much of a change of the free skin (model volts, NaN where missing) is that of touches that have gone, which the
    /// reference holds: the share of its weighted energy that patches of the opposite sign explain, none where no patches do.
    /// The patches of the last frame stay as they are.
    pub(crate) fn released_share(&mut self, change: &[f64]) -> Option<f64> {
        let missing = |(value, absent): (&f64, &bool)| !value.is_finite() && !absent;
        if change.len() != self.absent.len() || change.iter().zip(&self.absent).any(missing) {
            return None;
        }
        // Channels that are left out have no part in what follows.
        let opposite = change.iter().map(|value| if value.is_finite() { -value } else { 0.0 }).collect();
        let kept = std::mem::replace(&mut self.left, opposite);
        self.weigh();
        self.left = kept;
        let tools = self.tools();
        let found = match Seek::new(&tools, &self.change, &self.deviation)?.advance(&tools, f64::INFINITY) {
            Outcome::Found(_, misfit) => misfit,
            Outcome::UnderWay | Outcome::Nothing => return None,
        };
        let whitened = |(change, sigma): (&f64, &f64)| (change / sigma).powi(2);
        let present = || self.change.iter().zip(&self.deviation).filter(|(change, _)| change.is_finite());
        let energy = present().map(whitened).sum::<f64>() / present().count().max(1) as f64;
        Some(1.0 - found / energy)
    }
}
