//! Follows the presses of one frame in the next.

use super::{Estimate, Estimator, Explanation, MOST_WORK};
use crate::press::Effort;

impl Estimator {
    /// Follows the presses of the last frame in another frame, without a search for further ones. `None` without any,
    /// or if the frame cannot be fitted.
    pub fn follow(&mut self, frame: &[f64]) -> Option<Estimate> {
        self.allow_work(MOST_WORK);
        let null = self.fit.take_frame(frame)?;
        let last = std::mem::take(&mut self.memory.last);
        let warm = if last.is_empty() { None } else { self.fitted(&last, Effort::Full) };
        let best = self.without_superfluous(warm?, &null);
        self.memory.left = best.cost.residual;
        let estimate = self.estimate(best, &null);
        self.memory.last.clone_from(&estimate.presses);
        Some(estimate)
    }

    /// As [`Estimator::follow`], with the quick response, which lacks this much of the full one (volts) and explains
    /// what the frame shows besides. [`Estimator::is_out_of_work`] tells whether a search for further presses is due.
    pub fn follow_quickly(&mut self, frame: &[f64], lack: &[f64]) -> Option<Estimate> {
        self.allow_work(MOST_WORK);
        let rest: Vec<f64> = frame.iter().zip(lack).map(|(frame, lack)| frame - lack).collect();
        let null = self.fit.take_frame(&rest)?;
        let cost = self.fit.follow(&self.memory.last)?;
        let followed = Explanation { presses: self.fit.presses(), cost };
        if !self.is_possible(&followed) {
            return None;
        }
        self.follows_only = true;
        if followed.presses.len() < self.fit.most_presses() {
            // Only tells whether it is due.
            let _ = self.with_more(&followed, &null, &[]);
        }
        let estimate = self.estimate(followed, &null);
        self.memory.last.clone_from(&estimate.presses);
        Some(estimate)
    }
}
