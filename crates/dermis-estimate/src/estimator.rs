//! Decides how many presses explain a frame.

mod kept;
mod memory;
mod pause;
mod proposals;
mod superfluous;
mod work;

pub use self::memory::Memory;
use self::pause::{GROWN, Pause};
pub use self::work::Allowance;
use self::work::{MOST_WORK, Work};
use crate::evidence::Evidence;
use crate::press::{Cost, Effort, Press, PressFit};

/// Largest standard deviation of the position of a press, in typical radii.
const MOST_SIGMA: f64 = 1.0;
/// Least significance of the strength of one press among several, from the fit's own covariance.
const LEAST_SIGNIFICANT: f64 = 2.0;
/// Largest load of a press among others or at any place. An inclusion that insulates or conducts perfectly responds
/// like at most 2; twice that leaves room for gains that the file doesn't know. A stronger press is hard, or a narrow
/// one that explains the frame by chance: it has to be where the matched filter sees it.
const MOST_LOAD: f64 = 4.0;
/// The first press is looked for only if the gain of the matched filter reaches this share of the squared threshold.
const PROMISING: f64 = 0.6;
/// Largest number of operations of a search for presses that have ended.
const MOST_WORK_GONE: f64 = 2e8;
/// Share of the work within which the presses of the last frame must explain the next. If something else touches the
/// skin, fits that start from them wander, and would use up the work for a search.
const FOLLOWED: f64 = 0.5;
/// Least evidence of a quick fit, as a share of the threshold, that is worth a full one. Of 1,499 full fits of one to
/// three presses on gel, foam and liquid, the one that gained most rose from 0.72 to the threshold.
const LIKELY: f64 = 0.7;
/// Presses that differ by less than this share of their radius in place and radius lead to the same fit.
const SAME: f64 = 0.1;

/// The explanation of a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Estimate {
    /// The presses, strongest first.
    pub presses: Vec<Press>,
    /// Evidence for each press, in standard deviations.
    pub evidence: Vec<f64>,
    /// Share of the frame's energy above the noise that presses and nuisances leave unexplained, 0 to 1.
    pub unexplained: f64,
    /// True if the frame's energy is consistent with noise and a uniform change.
    pub is_at_rest: bool,
    /// Factor on the covariances of places by errors of the model, besides those in the presses' own covariances.
    pub place_scale: f64,
}

/// Explains frames one after the other by presses.
#[derive(Debug)]
pub struct Estimator {
    fit: Box<dyn PressFit>,
    evidence: Evidence,
    negative: bool,
    memory: Memory,
    is_unhurried: bool,
    work: Work,
    /// Quick fits of joint sets to the current frame, and the size of the largest set proposed so far.
    sets: Vec<Explanation>,
    searched: usize,
}

/// A set of presses and the cost of its fit.
#[derive(Clone, Debug)]
struct Explanation {
    presses: Vec<Press>,
    cost: Cost,
}

impl Estimator {
    /// An estimator with this fit and these thresholds. With `negative`, presses may also lower what they usually
    /// raise.
    pub fn new(fit: Box<dyn PressFit>, evidence: Evidence, negative: bool) -> Self {
        Self {
            fit,
            evidence,
            negative,
            memory: Memory::nothing(),
            is_unhurried: false,
            work: Work::unbounded(),
            sets: Vec::new(),
            searched: 0,
        }
    }

    /// A copy with the same weights and memory that may spend as much on a frame as it allows itself. `None` if fits
    /// are too quick to need one.
    pub fn copy(&self) -> Option<Self> {
        let fit = self.fit.copy()?;
        let memory = self.memory.clone();
        Some(Self { fit, memory, work: Work::unbounded(), sets: Vec::new(), ..*self })
    }

    /// Memory of the frames so far.
    pub fn memory(&self) -> &Memory {
        &self.memory
    }

    /// Continues from the memory of a copy, or from an earlier one.
    pub fn set_memory(&mut self, memory: Memory) {
        self.memory = memory;
    }

    /// The fit of presses.
    pub fn fit_mut(&mut self) -> &mut dyn PressFit {
        &mut *self.fit
    }

    /// Continues with another fit, which weighs the channels differently.
    pub fn set_fit(&mut self, fit: Box<dyn PressFit>) {
        self.fit = fit;
    }

    /// About how long the explanations since the last call took, nanoseconds; 0 if fits are quick.
    pub fn spent_ns(&mut self) -> u64 {
        let spent_ns = self.work.take_spent_ns(self.fit.work());
        self.fit.set_most_work(MOST_WORK);
        spent_ns
    }

    /// Allows these operations until the next call of [`Estimator::spent_ns`], if they are fewer than it allows
    /// itself. [`Estimator::is_out_of_work`] tells whether they sufficed.
    pub fn allow(&mut self, allowance: Allowance) {
        self.work.allowance = allowance;
    }

    /// True if the last explanation ended early because of [`Estimator::allow`].
    pub fn is_out_of_work(&self) -> bool {
        self.work.is_out(self.fit.work())
    }

    /// Begins an explanation of at most this many operations, and no more than are allowed.
    fn begin(&mut self, most: f64, allowed: f64) {
        self.begin_part(most, allowed);
        self.work.is_cut_short = false;
    }

    fn begin_part(&mut self, most: f64, allowed: f64) {
        self.work.begin_part(self.fit.work(), most, allowed);
        self.fit.set_most_work(self.work.most);
    }

    /// Forgets the last frame: the next is unrelated to it.
    pub fn forget(&mut self) {
        self.memory = Memory::nothing();
    }

    /// Forgets the presses of the last frame: they do not explain it. Searches that were in vain still pause.
    pub fn forget_presses(&mut self) {
        self.memory.last.clear();
        self.memory.left = 0.0;
    }

    /// From now on, every frame is searched in full, within the usual bound on operations.
    pub fn take_time(&mut self) {
        self.is_unhurried = true;
    }

    /// Forgets the joint sets of another frame, or of presses of the other sign.
    fn forget_sets(&mut self) {
        self.sets.clear();
        self.searched = 0;
    }

    /// True if a frame (model volts) is noise and a uniform change, or cannot be fitted.
    pub fn is_at_rest(&mut self, frame: &[f64]) -> bool {
        self.fit.take_frame(frame).is_none_or(|cost| cost.is_noise())
    }

    /// Explains a frame (model volts); `None` if it cannot be fitted. `hints` are presses to try first if the last
    /// frame had none.
    pub fn explain(&mut self, frame: &[f64], hints: &[Press]) -> Option<Estimate> {
        self.begin(FOLLOWED * MOST_WORK, self.work.allowance.to_follow);
        let null = self.fit.take_frame(frame)?;
        self.forget_sets();
        let nothing = || Explanation { presses: Vec::new(), cost: null };
        let mut last = std::mem::take(&mut self.memory.last);
        if self.have_gone(&last, &null) {
            last.clear();
        }
        let mut best = self.followed(&last, &null).unwrap_or_else(nothing);
        let work = self.fit.work();
        if work > self.work.most && self.work.left.is_none() && !best.cost.is_explained() {
            best = nothing();
        }
        // Something else may touch the skin now, and the presses of the last frame are a poor start for it.
        let has_jumped = best.presses.iter().any(|p| last.iter().all(|q| p.distance_m(q) > q.radius_m));
        let is_poor_start = !best.presses.is_empty() && (has_jumped || self.is_worse(&best.cost));
        if is_poor_start || self.most_supported(&best.cost, best.presses.is_empty()) > 0 {
            self.begin_part((MOST_WORK - work).max(0.0), self.work.allowance.to_search);
            // The gain of a first press is that over the whole frame, not over what the last fit left.
            self.fit.fit_nothing()?;
            let afresh = is_poor_start.then(|| self.grown(nothing(), &null, hints));
            let afresh = afresh.filter(|afresh| !afresh.presses.is_empty());
            if afresh.as_ref().is_none_or(|afresh| !afresh.cost.is_explained()) {
                best = self.grown(best, &null, hints);
            }
            best = afresh.filter(|afresh| self.score(afresh) < self.score(&best)).unwrap_or(best);
        } else if best.cost.is_explained() {
            // Further steps would have changed little.
            self.work.left = None;
        }
        if best.presses.len() != last.len() {
            best = self.kept(&best.presses).unwrap_or(best);
        }
        self.memory.left = best.cost.residual;
        // Contacts with a plate saturate: no press is too hard for the model.
        if best.presses.is_empty() && !null.is_noise() && !self.fit.is_joint() {
            best = self.roughly(&null).unwrap_or(best);
        }
        let estimate = self.estimate(best, &null);
        self.memory.last.clone_from(&estimate.presses);
        Some(estimate)
    }

    /// Follows the presses of the last frame in another frame, without a search for further ones. `None` without any,
    /// or if the frame cannot be fitted.
    pub fn follow(&mut self, frame: &[f64]) -> Option<Estimate> {
        self.begin(MOST_WORK, self.work.allowance.to_follow);
        let null = self.fit.take_frame(frame)?;
        let last = std::mem::take(&mut self.memory.last);
        let best = self.followed(&last, &null)?;
        self.memory.left = best.cost.residual;
        let estimate = self.estimate(best, &null);
        self.memory.last.clone_from(&estimate.presses);
        Some(estimate)
    }

    /// The presses of the last frame, as they explain this one; `None` without any, or if they cannot be fitted. Also
    /// `None` if they have jumped: from presses elsewhere, a full fit takes as long as a search, and mostly in vain.
    fn followed(&mut self, last: &[Press], null: &Cost) -> Option<Explanation> {
        if last.is_empty() {
            return None;
        }
        if let Some(kept) = self.kept(last) {
            return Some(self.without_superfluous(kept, null));
        }
        let has_moved = self.fit.left_by(last).is_some_and(|cost| self.is_worse(&cost));
        let moved = if has_moved {
            self.fit.linearise_about(last);
            Some(self.fitted(last, Effort::Quick)?)
        } else {
            None
        };
        if moved.as_ref().is_some_and(|moved| self.is_worse(&moved.cost)) {
            return None;
        }
        let warm = self.fitted(moved.as_ref().map_or(last, |moved| &moved.presses), Effort::Full)?;
        Some(self.without_superfluous(warm, null))
    }

    /// True if the presses of the last frame have gone: the frame is noise, and contains too little of them to hold
    /// them.
    fn have_gone(&mut self, last: &[Press], null: &Cost) -> bool {
        let little = PROMISING * self.evidence.hold.powi(2);
        let is_little = |cost: Cost| null.residual - cost.residual < little;
        let is_little = null.is_noise() && self.fit.fit_loads(last).is_some_and(is_little);
        is_little && !self.fit.presses().iter().any(|press| self.is_still_there(press))
    }

    /// True if this leaves clearly more than the last frame's explanation did.
    fn is_worse(&self, cost: &Cost) -> bool {
        !cost.is_explained() && cost.residual > GROWN * self.memory.left
    }

    fn estimate(&self, mut best: Explanation, null: &Cost) -> Estimate {
        best.presses.sort_by(|a, b| b.strength().abs().total_cmp(&a.strength().abs()));
        let evidence = match best.presses.len() {
            1 => vec![Evidence::of(null, &best.cost, true)],
            _ => best.presses.iter().map(Press::significance).collect(),
        };
        Estimate {
            evidence,
            unexplained: best.cost.unexplained(),
            is_at_rest: null.is_noise(),
            place_scale: self.fit.place_scale(&best.cost),
            presses: best.presses,
        }
    }

    /// Adds as many presses to an explanation as the frame supports.
    fn grown(&mut self, mut best: Explanation, null: &Cost, hints: &[Press]) -> Explanation {
        while best.presses.len() < self.fit.most_presses() {
            let Some(more) = self.with_more(&best, null, hints) else { break };
            best = more;
        }
        best
    }

    /// Explains the frame of the last [`Estimator::explain`] again, also allowing presses with a negative load:
    /// presses that are part of the baseline and have ended. Keeps nothing for the next frame.
    pub fn explain_with_gone(&mut self) -> Option<Estimate> {
        self.begin(MOST_WORK_GONE, self.work.allowance.to_search);
        let negative = std::mem::replace(&mut self.negative, true);
        let estimate = self.explain_from_nothing();
        self.negative = negative;
        estimate
    }

    fn explain_from_nothing(&mut self) -> Option<Estimate> {
        self.forget_sets();
        let null = self.fit.fit_nothing()?;
        let best = Explanation { presses: Vec::new(), cost: null };
        // Presses that have ended have a pause of their own.
        std::mem::swap(&mut self.memory.first, &mut self.memory.gone);
        let best = self.grown(best, &null, &[]);
        std::mem::swap(&mut self.memory.first, &mut self.memory.gone);
        Some(self.estimate(best, &null))
    }

    /// A fit from these starts.
    fn fitted(&mut self, starts: &[Press], effort: Effort) -> Option<Explanation> {
        let cost = self.fit.fit(starts, effort)?;
        Some(Explanation { presses: self.fit.presses(), cost })
    }

    fn may_be(&self, press: &Press) -> bool {
        press.load.abs() <= MOST_LOAD && self.may_act(press)
    }

    /// As [`Estimator::may_be`], for a press of any load.
    fn may_act(&self, press: &Press) -> bool {
        let is_possible = self.negative || press.load > 0.0;
        is_possible && self.fit.is_inside(press.position_m)
    }

    /// True if the position of one press among `count` is determined at all. A press without a definite position
    /// compensates for drift, or for what the other presses leave unexplained. The strength of contacts that saturate
    /// is vague even where their positions are definite.
    fn is_placed(&self, press: &Press, count: usize) -> bool {
        let is_strong = || self.fit.is_joint() || press.significance() >= LEAST_SIGNIFICANT;
        let is_definite = press.place_sigma_m() <= MOST_SIGMA * self.fit.typical_radius_m();
        (is_definite || self.is_kept(press)) && (count == 1 || is_strong())
    }

    /// Significance of a press in an explanation, in standard deviations. For one press among several it comes from
    /// the fit's own covariance.
    fn sureness(&self, press: &Press, of: &Explanation, null: &Cost) -> f64 {
        match of.presses.len() {
            1 => Evidence::of(null, &of.cost, true),
            // Contacts that saturate have a vague strength, but only a press that the frame needs has a definite place.
            _ => {
                let by_place = if self.fit.is_joint() { press.radius_m / press.place_sigma_m() } else { 0.0 };
                press.significance().max(by_place) / Evidence::correlation(&of.cost).sqrt()
            }
        }
    }

    /// An explanation with more presses, if the frame supports them.
    fn with_more(&mut self, best: &Explanation, null: &Cost, hints: &[Press]) -> Option<Explanation> {
        let is_first = best.presses.is_empty();
        let most_added = self.most_supported(&best.cost, is_first);
        let residual = best.cost.residual;
        if is_first {
            // The matched filter takes longer than the evidence, so it comes second.
            if most_added == 0 || self.fit.most_gain(self.negative) < PROMISING * self.evidence.begin.powi(2) {
                return None;
            }
            // Several presses may explain what one of them does not, but that takes a long search.
            if most_added > 1 && self.memory.first.is_on(residual) && self.search(best, null, hints, 1).is_none() {
                return None;
            }
            let found = self.search(best, null, hints, most_added);
            if found.is_some() {
                self.memory.first = Pause::over();
                self.memory.further.shorten();
            } else if most_added > 1 && !self.is_unhurried && !self.fit.is_joint() {
                self.memory.first.begin(residual);
            }
            return found;
        }
        if self.memory.further.is_on(residual) {
            return None;
        }
        let found = if most_added == 0 { None } else { self.search(best, null, hints, most_added) };
        match found {
            Some(_) => self.memory.further.shorten(),
            None if !self.is_unhurried => self.memory.further.begin(residual),
            None => {}
        }
        found
    }

    /// Largest number of further presses whose evidence would exceed their threshold if they explained the frame
    /// perfectly.
    fn most_supported(&self, cost: &Cost, is_first: bool) -> usize {
        let perfect = Cost { residual: cost.freedom, ..*cost };
        (Evidence::of(cost, &perfect, is_first) / self.evidence.begin).powi(2) as usize
    }

    /// The best-supported explanation that adds at most `most_added` presses to this one: a press where the residual
    /// suggests it; a few in a row, since two may be needed where one explains nothing; several that are all placed
    /// before the first fit; one press split in two; or the hints.
    fn search(&mut self, best: &Explanation, null: &Cost, hints: &[Press], most_added: usize) -> Option<Explanation> {
        let mut found: Vec<Explanation> = Vec::new();
        let mut has_ended_early = false;
        if self.fit.is_joint() {
            has_ended_early = self.propose_sets(best, most_added, &mut found);
            found.retain(|more| !self.is_hopeless(more));
        } else {
            self.fit.linearise_about(&best.presses);
            self.propose_singly(best, hints, most_added, &mut found);
            self.fit.linearise_about(&[]);
        }
        found.retain(|more| self.is_promising(more) && self.is_likely(more, best));
        found.sort_by(|a, b| self.score(a).total_cmp(&self.score(b)));
        let mut most: Option<Explanation> = None;
        let mut tried: Vec<Vec<Press>> = Vec::new();
        for more in found {
            if tried.iter().any(|other| is_same(other, &more.presses)) {
                continue;
            }
            tried.push(more.presses.clone());
            let more = if self.fit.has_quick_fit() {
                let Some(more) = self.fitted(&more.presses, Effort::Full) else { continue };
                more
            } else {
                more
            };
            let more = self.without_superfluous(more, null);
            if self.is_possible(&more) && self.is_supported(&more, best) {
                most = Some(more);
                break;
            }
        }
        self.work.is_cut_short |= has_ended_early && most.is_none() && self.work.left.is_some();
        most
    }

    /// The residual, with a penalty for each press: lower is better.
    fn score(&self, of: &Explanation) -> f64 {
        let penalty = of.presses.len() as f64 * self.evidence.begin.powi(2);
        of.cost.residual + penalty * Evidence::model_scale(&of.cost)
    }

    /// True if a quick fit may become an explanation. Only the full fit decides how definite its presses are, since the
    /// residual of strong presses under the linear response widens their covariances.
    fn is_promising(&self, of: &Explanation) -> bool {
        of.presses.iter().all(|press| self.may_be(press)) && self.overlapping(&of.presses).is_none()
    }

    /// True if all presses are possible, none overlap, and their positions are as definite as they need to be.
    fn is_possible(&self, of: &Explanation) -> bool {
        let is_placed = |press: &Press| self.is_placed(press, of.presses.len()) || self.may_be_vague(press, of);
        self.is_promising(of) && of.presses.iter().all(is_placed)
    }

    /// True if the evidence for the added presses exceeds their threshold.
    fn is_supported(&self, more: &Explanation, best: &Explanation) -> bool {
        self.support(more, best) >= 1.0
    }

    /// True if a full fit that starts from a quick one may be supported.
    fn is_likely(&self, quick: &Explanation, best: &Explanation) -> bool {
        !self.fit.has_quick_fit() || self.support(quick, best) >= LIKELY
    }

    /// Evidence for the presses that this explanation adds to the other, as a share of their threshold.
    fn support(&self, more: &Explanation, best: &Explanation) -> f64 {
        let added = more.presses.len().saturating_sub(best.presses.len()) as f64;
        let support = Evidence::of(&best.cost, &more.cost, best.presses.is_empty());
        if added > 0.0 { support / (self.evidence.begin * added.sqrt()) } else { 0.0 }
    }

    /// A single press near the maximum of the matched filter, for frames that clearly contain something but whose fits
    /// all leave the skin, or have loads that no usual press has.
    fn roughly(&mut self, null: &Cost) -> Option<Explanation> {
        self.fit.fit_nothing()?;
        let peak = *self.fit.seek(self.negative).first()?;
        let cost = self.fit.fit_loads(&[peak])?;
        let mut of = Explanation { presses: self.fit.presses(), cost };
        for press in &mut of.presses {
            (0..2).for_each(|axis| press.covariance[axis][axis] += press.radius_m.powi(2));
        }
        let near = self.fitted(&[peak], Effort::Full).filter(|near| {
            near.cost.residual < of.cost.residual && near.presses.iter().all(|p| p.distance_m(&peak) < peak.radius_m)
        });
        let of = near.unwrap_or(of);
        let is_possible = of.presses.iter().all(|press| self.may_act(press) && self.is_placed(press, 1));
        (is_possible && Evidence::of(null, &of.cost, true) >= self.evidence.begin).then_some(of)
    }
}

/// True if two sets of presses would be fitted to the same result.
fn is_same(a: &[Press], b: &[Press]) -> bool {
    a.len() == b.len() && a.iter().all(|p| b.iter().any(|q| is_near(p, q)))
}

/// True if two presses have about the same place and radius, and act in the same direction.
fn is_near(p: &Press, q: &Press) -> bool {
    let wider = (p.radius_m / q.radius_m).ln().abs();
    p.load * q.load > 0.0 && p.distance_m(q) < SAME * q.radius_m && wider < SAME
}
