//! Removes the presses that an explanation doesn't need.

use super::{Estimator, Explanation, Memory, SAME};
use crate::evidence::Evidence;
use crate::press::{Cost, Effort, Press};

/// Presses cannot overlap: two that are nearer than this share of the sum of their radii are one.
const LEAST_APART: f64 = 1.0;
/// A press whose own significance, or its evidence by quick fits, exceeds the threshold by this factor is kept without
/// a full refit that leaves it out.
const CLEARLY: f64 = 2.0;
/// A press that is known to be needed is tested again at the latest when it has moved by this many radii, or its
/// strength has changed by this factor of e.
const MOST_CHANGE: f64 = 1.0;
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
                support >= self.evidence.hold || self.is_still_there(&of.presses[worst])
            } else {
                let is_much_left = fewer.cost.unexplained() > LEFT_WITHOUT;
                is_much_left && support >= self.evidence.begin && self.may_be_vague(&of.presses[worst], &of)
            };
            if is_needed && overlaps.is_none() {
                if sureness >= 0.0 {
                    if !is_first {
                        self.remember_needed(worst, &of, support);
                    }
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
    /// without the worst. The full response would take several times as long. The answer holds as long as the frame is
    /// explained as well and the presses change little. The larger the evidence, the more they may change.
    fn is_clearly_needed(&mut self, worst: usize, of: &Explanation, others: &[Press]) -> bool {
        if others.is_empty() || !self.fit.has_quick_fit() {
            return false;
        }
        if self.is_known_to_be_needed(worst, of) && !self.is_worse(&of.cost) {
            return true;
        }
        self.fit.linearise_about(&of.presses);
        let costs = [&of.presses, others].map(|presses| self.fit.fit(presses, Effort::Quick));
        self.fit.linearise_about(&[]);
        let [Some(all), Some(fewer)] = costs else { return false };
        let evidence = Evidence::of(&fewer, &all, false);
        let is_needed = evidence >= CLEARLY * self.evidence.hold;
        if is_needed {
            self.remember_needed(worst, of, evidence);
        }
        is_needed
    }

    /// Remembers that a frame needed the worst of these presses, with this evidence.
    fn remember_needed(&mut self, worst: usize, of: &Explanation, evidence: f64) {
        let change = (SAME * evidence / self.evidence.hold).min(MOST_CHANGE);
        let Memory { together, needed, .. } = &mut self.memory;
        let known = counterparts(&of.presses, together, SAME).unwrap_or_else(|| {
            together.clone_from(&of.presses);
            needed.clear();
            (0..together.len()).collect()
        });
        needed.retain(|(other, _)| *other != known[worst]);
        needed.push((known[worst], change));
    }

    /// True if a frame with almost the same presses needed the worst of these.
    fn is_known_to_be_needed(&self, worst: usize, of: &Explanation) -> bool {
        let Memory { together, needed, .. } = &self.memory;
        let is_it = |&(known, change): &(usize, f64)| {
            counterparts(&of.presses, together, change).is_some_and(|places| places[worst] == known)
        };
        needed.iter().any(is_it)
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

/// Matches presses to others: for each, the index of one that is at most `change` radii away and differs by at most
/// `change` in the logarithm of the strength. `None` if any press has no match.
fn counterparts(presses: &[Press], others: &[Press], change: f64) -> Option<Vec<usize>> {
    let is_it = |press: &Press, other: &Press| {
        let ratio = press.strength() / other.strength();
        press.distance_m(other) < change * other.radius_m && ratio > 0.0 && ratio.ln().abs() < change
    };
    let place = |press: &Press| others.iter().position(|other| is_it(press, other));
    if presses.len() == others.len() { presses.iter().map(place).collect() } else { None }
}
