//! Removes the presses that an explanation doesn't need.

use super::{Estimator, Explanation, Memory, SAME, is_near};
use crate::evidence::Evidence;
use crate::press::{Cost, Effort, Press};

/// Presses cannot overlap: two that are nearer than this share of the sum of their radii are one.
const LEAST_APART: f64 = 1.0;
/// A press whose own significance, or its evidence by quick fits, exceeds the threshold by this factor is kept without
/// a full refit that leaves it out.
const CLEARLY: f64 = 2.0;
/// A press without a definite place may stay among several if more than this share of the frame is left unexplained
/// without it. Largest standard deviation of its position, and largest radius, in typical radii: drift that is taken
/// for a press is weak beside a true one, or wide.
const MOST_SIGMA_NEEDED: f64 = 4.0;
const LEFT_WITHOUT: f64 = 0.02;
const WIDEST_NEEDED: f64 = 2.0;

impl Estimator {
    /// True if a press whose position is indefinite may stay if the frame clearly needs it. Far from the electrodes,
    /// place, radius and strength trade off, but that something presses there may be beyond doubt.
    pub(super) fn may_be_vague(&self, press: &Press, of: &Explanation) -> bool {
        let typical_m = self.fit.typical_radius_m();
        let is_near = press.place_sigma_m() <= MOST_SIGMA_NEEDED * typical_m;
        let is_local = press.radius_m <= WIDEST_NEEDED * typical_m;
        of.presses.len() > 1 && of.cost.is_explained() && is_near && is_local && self.may_be(press)
    }

    /// Removes the presses that an explanation doesn't need.
    pub(super) fn without_superfluous(&mut self, mut of: Explanation, null: &Cost) -> Explanation {
        // Indefinite presses that the frame needs.
        let mut needed: Vec<usize> = Vec::new();
        while !of.presses.is_empty() {
            let is_sound = |press: &Press| self.may_be(press) && self.is_placed(press, of.presses.len());
            let sureness = |press: &Press| if is_sound(press) { self.sureness(press, &of, null) } else { -1.0 };
            let worst = (0..of.presses.len())
                .filter(|k| !needed.contains(k))
                .map(|k| (k, sureness(&of.presses[k])))
                .min_by(|a, b| a.1.total_cmp(&b.1));
            let Some((worst, sureness)) = worst else { break };
            let overlaps = self.overlapping(&of.presses);
            if sureness > CLEARLY * self.evidence.begin && overlaps.is_none() {
                break;
            }
            let worst = if sureness < 0.0 { worst } else { overlaps.unwrap_or(worst) };
            let mut others = of.presses.clone();
            others.remove(worst);
            if sureness >= 0.0 && overlaps.is_none() && self.is_clearly_needed(worst, &of, &others) {
                break;
            }
            let is_first = others.is_empty();
            let fewer =
                if is_first { Some(Explanation { presses: others, cost: *null }) } else { self.refitted(others, &of) };
            let Some(fewer) = fewer else { break };
            let support = Evidence::of(&fewer.cost, &of.cost, is_first);
            let is_needed = if sureness >= 0.0 {
                support >= self.evidence.hold
            } else {
                let is_much_left = fewer.cost.unexplained() > LEFT_WITHOUT;
                is_much_left && support >= self.evidence.begin && self.may_be_vague(&of.presses[worst], &of)
            };
            if is_needed && overlaps.is_none() {
                if sureness >= 0.0 {
                    break;
                }
                needed.push(worst);
                continue;
            }
            needed.clear();
            of = fewer;
        }
        of
    }

    /// A fit of some presses of an explanation. If there is no work left for it, but they explain as much as they are,
    /// they are taken as they are: fitted, they would explain more.
    fn refitted(&mut self, some: Vec<Press>, of: &Explanation) -> Option<Explanation> {
        self.fitted(&some, Effort::Full).or_else(|| {
            let cost = self.fit.left_by(&some)?;
            let is_as_good = Evidence::of(&cost, &of.cost, false) < self.evidence.hold;
            is_as_good.then_some(Explanation { presses: some, cost })
        })
    }

    /// True if quick fits leave no doubt that the frame needs all presses of an explanation, not just these others
    /// without the worst. The full response would take several times as long. The answer holds for as long as the
    /// presses stay where and as strong as they are, and explain as much.
    fn is_clearly_needed(&mut self, worst: usize, of: &Explanation, others: &[Press]) -> bool {
        if others.is_empty() || !self.fit.has_quick_fit() {
            return false;
        }
        let Memory { together, needed, .. } = &self.memory;
        let is_among = |press: &Press, some: &[Press]| some.iter().any(|known| is_unchanged(press, known));
        let are_together =
            together.len() == of.presses.len() && of.presses.iter().all(|press| is_among(press, together));
        let is_known = are_together && is_among(&of.presses[worst], needed);
        if is_known && !self.is_worse(&of.cost) {
            return true;
        }
        self.fit.linearise_about(&of.presses);
        let costs = [&of.presses, others].map(|presses| self.fit.fit(presses, Effort::Quick));
        self.fit.linearise_about(&[]);
        let [Some(all), Some(fewer)] = costs else { return false };
        let is_needed = Evidence::of(&fewer, &all, false) >= CLEARLY * self.evidence.hold;
        if is_needed && !is_known {
            if !are_together {
                self.memory.together.clone_from(&of.presses);
                self.memory.needed.clear();
            }
            self.memory.needed.push(of.presses[worst]);
        }
        is_needed
    }

    /// The weaker of two presses that overlap.
    pub(super) fn overlapping(&self, presses: &[Press]) -> Option<usize> {
        for a in 1..presses.len() {
            for b in 0..a {
                let (p, q) = (&presses[a], &presses[b]);
                if p.load * q.load > 0.0 && p.distance_m(q) < LEAST_APART * (p.radius_m + q.radius_m) {
                    return Some(if p.strength().abs() < q.strength().abs() { a } else { b });
                }
            }
        }
        None
    }
}

/// True if one press is another, of about the same strength.
fn is_unchanged(press: &Press, known: &Press) -> bool {
    is_near(press, known) && (press.load / known.load).ln().abs() < SAME
}
