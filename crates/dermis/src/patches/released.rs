//! Touches that have gone: what a reference held that was taken while something touched the skin.

use super::PatchStage;
use super::seek::{Outcome, Seek, Tools};

impl PatchStage {
    /// How much of a change of the free skin (model volts, NaN where missing) is that of touches that have gone, which the
    /// reference holds: the share of its weighted energy that patches of the opposite sign explain, none where no patches do.
    pub(crate) fn released_share(&self, change: &[f64]) -> Option<f64> {
        let opposite: Vec<f64> = change.iter().map(|value| if value.is_finite() { -value } else { 0.0 }).collect();
        let (mut opposite, deviation) = self.weighed(&opposite);
        opposite.iter_mut().zip(change).filter(|(_, value)| !value.is_finite()).for_each(|(value, _)| *value = f64::NAN);
        let tools = Tools {
            sheet: &self.sheets.coarse,
            search: &self.sheets.search,
            options: &self.options,
            half_width_m: self.half_width_m,
        };
        let mut seek = Seek::new(&tools, &opposite, &deviation)?;
        let Outcome::Found(_, misfit) = seek.advance(&tools, f64::INFINITY) else { return None };
        let whitened = opposite.iter().zip(&deviation).map(|(change, sigma)| (change / sigma).powi(2));
        let present: Vec<f64> = whitened.filter(|square| square.is_finite()).collect();
        let energy = present.iter().sum::<f64>() / present.len().max(1) as f64;
        Some(1.0 - misfit / energy)
    }
}
