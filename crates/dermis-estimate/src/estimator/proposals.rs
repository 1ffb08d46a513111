//! Proposes sets of presses that may explain a frame better than an explanation does.

use std::f64::consts::TAU;
use std::ops::RangeInclusive;

use super::{Estimator, Explanation};
use crate::press::{Effort, Press};

/// Number of presses added in a row before the evidence for all of them is judged.
const LOOKAHEAD: usize = 3;
/// Largest number of times that each press of a set is moved before they are fitted together.
const MOST_ROUNDS: usize = 3;
/// Number of directions in which a press is split, and initial distance of each part from its centre, in its radii.
const DIRECTIONS: usize = 4;
const SPLIT_RADII: f64 = 1.2;
/// Once proposals have taken this share of the work, one that explains the frame is enough.
const PROPOSED: f64 = 0.25;
/// Joint sets are proposed until they have taken this share of the work. The rest is for full fits of the best.
const PROPOSED_SETS: f64 = 0.6;
/// Only the strongest presses are split, at most this many, into at most this many parts.
const MOST_SPLIT: usize = 3;
const MOST_PARTS: usize = 3;
/// A joint set that leaves more than this share of a streamed frame doesn't explain it.
const HOPELESS: f64 = 0.5;
/// A single press whose quick fit leaves less than this share is fitted in full before larger sets are tried.
const CLOSE: f64 = 0.05;
/// The search for joint sets ends at such a set of this many presses or more, if it also leaves more than this share of
/// what smaller sets leave. The change is then damage. Two of three presses at once may explain no more than one.
const MANY: usize = 3;
const NO_BETTER: f64 = 0.9;

impl Estimator {
    /// Proposes sets of presses that act together, with more presses than an explanation has: present ones, or else
    /// those that have ended. Both in one set would explain a cut as well. True if there was no time to propose all.
    pub(super) fn propose_sets(&mut self, best: &Explanation, most_added: usize, found: &mut Vec<Explanation>) -> bool {
        let sizes = best.presses.len() + 1..=best.presses.len().saturating_add(most_added);
        let mut least_left = f64::INFINITY;
        for k in 0.. {
            if k == self.sets.len() {
                if !found.is_empty() && self.fit.work() > PROPOSED_SETS * self.work.most {
                    return true;
                }
                if !self.find_set(&sizes) {
                    break;
                }
            }
            let more = self.sets[k].clone();
            if !sizes.contains(&more.presses.len()) {
                continue;
            }
            // Its sheet is coarse, so the best set may leave some per cent.
            let (count, left) = (more.presses.len(), more.cost.left());
            let full = if count == 1 && left < CLOSE { self.fitted(&more.presses, Effort::Full) } else { None };
            let is_enough = full.as_ref().unwrap_or(&more).cost.is_explained();
            let is_in_vain = count >= MANY && self.is_hopeless(&more) && left > NO_BETTER * least_left;
            found.push(full.filter(|_| is_enough).unwrap_or(more));
            if is_enough || is_in_vain {
                break;
            }
            least_left = least_left.min(left);
        }
        false
    }

    /// Adds the next larger joint set of one of these sizes. False if there is none, or it cannot be fitted.
    fn find_set(&mut self, sizes: &RangeInclusive<usize>) -> bool {
        while self.searched < *sizes.end() {
            let Some(set) = self.fit.next_joint_set(self.searched == 0, self.negative) else { return false };
            self.searched = set.len();
            if sizes.contains(&set.len()) {
                let set = self.fit.resized(set);
                let more = self.fitted(&set, Effort::Quick);
                let is_found = more.is_some();
                self.sets.extend(more);
                return is_found;
            }
        }
        false
    }

    /// True if an explanation leaves most of a streamed frame.
    pub(super) fn is_hopeless(&self, of: &Explanation) -> bool {
        !self.is_unhurried && of.cost.unexplained() > HOPELESS
    }

    /// Proposes presses that are added to an explanation one by one: where the image or the residual suggests them, or
    /// by splitting one.
    pub(super) fn propose_singly(
        &mut self,
        best: &Explanation,
        hints: &[Press],
        most_added: usize,
        found: &mut Vec<Explanation>,
    ) {
        let room = (self.fit.most_presses() - best.presses.len()).min(most_added);
        if best.presses.is_empty() && !hints.is_empty() {
            found.extend(self.fitted(&hints[..hints.len().min(room)], Effort::Quick));
        }
        for peak in self.peaks(best) {
            let mut starts: Vec<Press> = best.presses.iter().copied().chain([peak]).collect();
            for _ in 0..LOOKAHEAD.min(room) {
                let Some(more) = self.fitted(&starts, Effort::Quick) else { break };
                if self.is_promising(&more) {
                    starts.clone_from(&more.presses);
                    found.push(more);
                } else if self.fit.fit_loads(&starts).is_none() {
                    break;
                }
                if self.is_enough(found) {
                    return;
                }
                match self.fit.seek(self.negative).first() {
                    Some(next) if starts.len() < self.fit.most_presses() => starts.push(*next),
                    _ => break,
                }
            }
        }
        // The other proposals of one press alone are the same.
        if best.presses.is_empty() && room == 1 {
            return;
        }
        self.pursue(best, room, found);
        if self.is_enough(found) {
            return;
        }
        if !self.is_one_explained(found) {
            self.propose_together(best, room, found);
        }
        // With few electrodes, three presses may look like one wide one, and two explain no more than it does.
        for parts in 2..=MOST_PARTS.min(1 + room) {
            for k in 0..best.presses.len().min(MOST_SPLIT) {
                for direction in 0..DIRECTIONS {
                    if let Some(starts) = self.split(&best.presses, k, parts, direction) {
                        found.extend(self.fitted(&starts, Effort::Quick));
                    }
                }
            }
        }
    }

    fn is_one_explained(&self, found: &[Explanation]) -> bool {
        found.iter().any(|more| more.cost.is_explained() && self.is_promising(more))
    }

    /// True if one of these explains the frame, and the search for others has taken long enough.
    fn is_enough(&self, found: &[Explanation]) -> bool {
        self.fit.work() > PROPOSED * self.work.most && self.is_one_explained(found)
    }

    /// Adds one press after the other to an explanation, and moves all of them after each addition. They are fitted
    /// only then: one press fitted to the frame of two becomes wide and ends up between them, and no second press
    /// added to it gets it away from there.
    fn pursue(&mut self, best: &Explanation, room: usize, found: &mut Vec<Explanation>) {
        let mut starts = best.presses.clone();
        let begun = if starts.is_empty() { self.fit.fit_nothing() } else { self.fit.fit_loads(&starts) };
        if begun.is_none() {
            return;
        }
        for _ in 0..LOOKAHEAD.min(room) {
            let Some(next) = self.fit.seek(self.negative).first().copied() else { return };
            starts.push(next);
            self.rearrange(&mut starts);
            let more = self.fitted(&starts, Effort::Quick);
            let is_enough = more.as_ref().is_some_and(|more| more.cost.is_noise());
            found.extend(more);
            if is_enough || self.fit.fit_loads(&starts).is_none() {
                return;
            }
        }
    }

    /// Proposes the strongest of the presses that explain the whole frame together. With few electrodes, the presses
    /// that explain most one by one may be far from any of those that do together.
    fn propose_together(&mut self, best: &Explanation, room: usize, found: &mut Vec<Explanation>) {
        if self.fit.fit_nothing().is_none() {
            return;
        }
        let set = self.fit.seek_together();
        let least = best.presses.len() + 1;
        let most = set.len().min(best.presses.len() + LOOKAHEAD.min(room));
        for count in least..=most {
            let more = self.fitted(&set[..count], Effort::Quick);
            let is_enough = more.as_ref().is_some_and(|more| more.cost.is_noise());
            found.extend(more);
            if is_enough {
                return;
            }
        }
    }

    /// Moves each press in turn to the best place given the others, as long as that lowers the residual.
    fn rearrange(&mut self, presses: &mut Vec<Press>) {
        if presses.len() < 2 {
            return;
        }
        let Some(mut least) = self.fit.fit_loads(presses) else { return };
        for _ in 0..MOST_ROUNDS {
            let before = least.residual;
            for k in 0..presses.len() {
                let mut moved = presses.clone();
                moved.remove(k);
                if self.fit.fit_loads(&moved).is_none() {
                    continue;
                }
                let Some(place) = self.fit.seek(self.negative).first().copied() else { continue };
                moved.insert(k, place);
                if let Some(cost) = self.fit.fit_loads(&moved).filter(|cost| cost.residual < least.residual) {
                    (*presses, least) = (moved, cost);
                }
            }
            if least.residual >= before {
                return;
            }
        }
    }

    /// Presses suggested by the residual of an explanation.
    fn peaks(&mut self, best: &Explanation) -> Vec<Press> {
        if !best.presses.is_empty() && self.fit.fit(&best.presses, Effort::Quick).is_none() {
            return Vec::new();
        }
        if best.presses.is_empty() && self.fit.fit_nothing().is_none() {
            return Vec::new();
        }
        self.fit.seek(self.negative)
    }

    /// Splits one press into equal parts around its centre, the first in a direction; `None` if a part would be off the
    /// skin.
    fn split(&self, presses: &[Press], k: usize, parts: usize, direction: usize) -> Option<Vec<Press>> {
        let press = presses[k];
        let reach = SPLIT_RADII * press.radius_m;
        let part = |number: usize| {
            // Directions that differ by a turn of one part are the same.
            let turns = (number as f64 + direction as f64 / DIRECTIONS as f64) / parts as f64;
            let (sine, cosine) = (TAU * turns).sin_cos();
            let position_m = [press.position_m[0] + reach * cosine, press.position_m[1] + reach * sine];
            // Together, they have the area of the press.
            Press { position_m, radius_m: press.radius_m / (parts as f64).sqrt(), ..press }
        };
        let mut starts = presses.to_vec();
        starts[k] = part(0);
        starts.extend((1..parts).map(part));
        let is_possible = starts.len() <= self.fit.most_presses();
        (is_possible && starts.iter().all(|start| self.fit.is_inside(start.position_m))).then_some(starts)
    }
}
