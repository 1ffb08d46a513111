//! Presses that keep their positions and radii until they move.
//!
//! The longer they stay, the more drift might explain a frame without them. But drift is slow: it does not replace a
//! press from one frame to the next.

use super::{Estimator, Explanation};
use crate::evidence::Evidence;
use crate::press::Press;

/// Gain of a step from the position and radius that a press keeps, in squared standard deviations, above which it has
/// moved: noise exceeds it once in an hour at 25 frames per second (chi-squared with three degrees of freedom).
const MOVED: f64 = 26.0;
/// A press that keeps its position is there, whatever drift might explain, as long as its load is more than this share
/// of what it was. In twelve minutes of drift, loads on twenty skins changed by up to 5 %.
const STILL_THERE: f64 = 0.5;

impl Estimator {
    /// From the next frame on, presses near these keep their positions and radii until they move.
    pub fn keep(&mut self, kept: impl Iterator<Item = Press>) {
        self.memory.kept.clear();
        self.memory.kept.extend(kept);
    }

    /// The press whose position this one keeps.
    fn kept_by(&self, press: &Press) -> Option<&Press> {
        self.memory.kept.iter().find(|kept| kept.position_m == press.position_m)
    }

    /// True if a press keeps its position.
    pub(super) fn is_kept(&self, press: &Press) -> bool {
        self.kept_by(press).is_some()
    }

    /// True if a press keeps its position and most of its load.
    pub(super) fn is_still_there(&self, press: &Press) -> bool {
        self.kept_by(press).is_some_and(|kept| press.load / kept.load > STILL_THERE)
    }

    /// The presses near these that keep their positions and radii, with the others. `None` without any, or if one has
    /// moved.
    pub(super) fn kept(&mut self, presses: &[Press]) -> Option<Explanation> {
        let keep = |press: &Press| {
            let is_it = |kept: &&Press| press.distance_m(kept) <= kept.radius_m;
            let kept = self.memory.kept.iter().find(is_it)?;
            Some(Press { position_m: kept.position_m, radius_m: kept.radius_m, ..*press })
        };
        let kept: Vec<Option<Press>> = presses.iter().map(keep).collect();
        let fixed: Vec<bool> = kept.iter().map(Option::is_some).collect();
        let count = fixed.iter().filter(|is_fixed| **is_fixed).count() as f64;
        if count == 0.0 {
            return None;
        }
        let starts: Vec<Press> = presses.iter().zip(kept).map(|(press, kept)| kept.unwrap_or(*press)).collect();
        let (cost, gain) = self.fit.fit_fixed(&starts, &fixed)?;
        let has_moved = gain > MOVED * count * Evidence::left_scale(&cost);
        (!has_moved).then(|| Explanation { presses: self.fit.presses(), cost })
    }
}
