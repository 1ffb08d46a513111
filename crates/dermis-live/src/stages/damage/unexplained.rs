//! Tests whether something on the skin that begins no touch is a cut. A thin cut raises the image next to it almost
//! as much as it lowers it, because no isotropic conductivity has the effect of a cut. The rise then looks like a
//! touch.

use dermis_touch::damage::DamageShape;

use super::crack::CrackScratch;
use super::cuts::KnownCuts;
use super::fit::estimate_cut;
use super::frame::DamageFrame;
use super::intact::IntactReference;
use crate::Error;
use crate::prepare::Prepared;

/// Shortest and longest interval between tests whether something on the skin that begins no touch is a cut, seconds,
/// and minimum number of frames in the mean. Each negative test doubles the interval.
const UNEXPLAINED_S: [f64; 2] = [0.4, 12.8];
const FEWEST_UNEXPLAINED: u32 = 8;
/// Share of the mean's weighted energy that a cut must explain to be accepted, and share of a frame's for it to
/// remain.
const CUT_EXPLAINS: [f64; 2] = [0.9, 0.8];

/// Data collected from frames that no touch explains.
#[derive(Debug)]
pub(super) struct Unexplained {
    since_ns: u64,
    frames: u32,
    wait_s: f64,
    /// Mean change against the intact sheet with its known damage, model volts.
    mean: Vec<f64>,
    /// The response of the accepted cut.
    cut: Option<Vec<f64>>,
    scratch: CrackScratch,
}

impl Unexplained {
    pub fn new() -> Self {
        let scratch = CrackScratch::default();
        Self { since_ns: 0, frames: 0, wait_s: UNEXPLAINED_S[0], mean: Vec::new(), cut: None, scratch }
    }

    /// Restarts the collection.
    pub fn clear(&mut self) {
        (self.frames, self.wait_s, self.cut) = (0, UNEXPLAINED_S[0], None);
    }

    /// True if the object in a loaded frame that begins no touch is a cut, so that the skin is free. `lags` means
    /// that the baseline of touches does not yet include all known damage.
    pub fn is_cut(
        &mut self,
        frame: &DamageFrame<'_>,
        intact: &IntactReference,
        cuts: &KnownCuts,
        lags: bool,
        prepared: &Prepared,
    ) -> Result<bool, Error> {
        let Some(model) = cuts.model() else { return Ok(false) };
        if !frame.touches.is_empty() {
            self.clear();
            return Ok(false);
        }
        let explains = |cut: &[f64], change: &mut dyn Iterator<Item = f64>| {
            explained(change, cut, &prepared.voltages) >= CUT_EXPLAINS[1]
        };
        if lags && explains(cuts.response(), &mut intact.difference().iter().copied()) {
            return Ok(true);
        }
        let change = || intact.difference().iter().zip(cuts.response()).map(|(difference, known)| difference - known);
        if let Some(cut) = &self.cut {
            if explains(cut, &mut change()) {
                return Ok(true);
            }
            self.clear();
        }
        if self.frames == 0 {
            self.since_ns = frame.time_ns;
            self.mean.clear();
            self.mean.resize(intact.difference().len(), 0.0);
        }
        self.frames += 1;
        let share = 1.0 / f64::from(self.frames);
        self.mean.iter_mut().zip(change()).for_each(|(mean, change)| *mean += share * (change - *mean));
        let elapsed_s = frame.time_ns.saturating_sub(self.since_ns) as f64 * 1e-9;
        if elapsed_s < self.wait_s || self.frames < FEWEST_UNEXPLAINED {
            return Ok(false);
        }
        self.frames = 0;
        self.wait_s = (2.0 * self.wait_s).min(UNEXPLAINED_S[1]);
        let pixels = intact.image().iter().enumerate().filter(|(_, value)| value.is_finite());
        let Some((lowest, _)) = pixels.min_by(|a, b| a.1.total_cmp(b.1)) else { return Ok(false) };
        let centre_m = prepared.map.grid().centre_m(lowest);
        let start = DamageShape { centre_m, length_m: 0.0, width_m: 0.0, direction_rad: 0.0, deviations: None };
        let estimate = estimate_cut(prepared, model, &self.mean, frame.noise, &start)?;
        if let Some(estimate) = estimate.filter(|estimate| estimate.explained >= CUT_EXPLAINS[0]) {
            let mut response = vec![0.0; self.mean.len()];
            if model.respond(&estimate.crack, &mut self.scratch, &mut response) {
                self.cut = Some(response);
            }
        }
        Ok(self.cut.is_some())
    }
}

/// Share of a change's energy (missing channels `NaN`) explained by a cut together with a change of all resting
/// voltages by the same share.
fn explained(change: &mut dyn Iterator<Item = f64>, cut: &[f64], rest: &[f64]) -> f64 {
    let (mut energy, mut left, mut along, mut square) = (0.0, 0.0, 0.0, 0.0);
    for ((change, cut), rest) in change.zip(cut).zip(rest).filter(|((change, _), _)| change.is_finite()) {
        let difference = change - cut;
        energy += change * change;
        left += difference * difference;
        along += difference * rest;
        square += rest * rest;
    }
    if square > 0.0 && energy > 0.0 { 1.0 - (left - along * along / square) / energy } else { 0.0 }
}
