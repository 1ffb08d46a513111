//! Patches looked for anew, a bounded amount of work a frame: the best set of one patch is fitted, then of two, and so
//! on, until one more explains little. All of it takes some 10 ms, which frames at a kilohertz must not wait for; slow
//! frames have the answer at once.

use dermis_tomo::eit::contacts::{
    ContactFit, ContactPatch, ContactSheet, FitOptions, FitSummary, Looked, PatchFit, PatchSearch, PatchSets,
};

use super::plausible::{BELIEVED, are_large, plausible};

/// Radii that a search starts from, relative to the typical one: radius and conductance trade with each other, and a
/// fit may settle beside the best pair.
const RADII: [f64; 2] = [1.0, 0.75];
/// One more patch must lower the cost of a fit (squared standard deviations) by this and to this share.
const WORTH: (f64, f64) = (20.0, 0.5);
/// Misfit at which no further patch is looked for.
const GOOD: f64 = 0.2;
/// Steps of a fit at most.
const STEPS: usize = 15;
/// Steps at a time where a frame's share of the work is bounded: patches that grow make a step dear, up to two hundred
/// times what the first one cost.
const STEPS_AT_ONCE: usize = 1;
/// A fit whose patches are larger than touches after so many portions of its work in a row is given up.
const MOST_LARGE: usize = 2;
/// Sets that are judged at a time, at most: what is paid for, though there may be fewer.
const PORTION: f64 = 2000.0;
/// What a set of patches costs to judge, and a step of a fit of one patch, in nanoseconds of a core; the step of a fit
/// of n patches n squared times that, n being the typical patches that would cover as much where that is more. Rough
/// figures, by which work is shared out among frames.
const SET_NS: f64 = 600.0;
const STEP_NS: f64 = 0.15e6;

/// A search under way, in one frame.
#[derive(Debug)]
pub(super) struct Seek {
    change: Vec<f64>,
    deviation: Vec<f64>,
    sets: PatchSets,
    work: Work,
    /// The best set so far, where its fit began and what it reached.
    best: Option<(Vec<ContactPatch>, FitSummary)>,
    /// The best fit from the best set.
    found: Option<(Vec<ContactFit>, FitSummary)>,
    left: Vec<f64>,
}

/// What comes next.
#[derive(Debug)]
enum Work {
    /// The best set of one patch more.
    Sets,
    /// A fit of a set.
    Fit(Fit),
    /// A fit of the best set from this one of [`RADII`].
    Scaled(usize, Fit),
}

/// A fit under way.
#[derive(Debug)]
struct Fit {
    start: Vec<ContactPatch>,
    /// The patches found so far.
    patches: Vec<ContactPatch>,
    /// `None` before the first step.
    at: Option<PatchFit>,
    steps: usize,
    /// Portions of work in a row after which a patch was larger than a touch.
    large: usize,
}

/// What the search works with.
pub(super) struct Tools<'a> {
    pub(super) sheet: &'a ContactSheet,
    pub(super) search: &'a PatchSearch,
    pub(super) options: &'a FitOptions,
    pub(super) half_width_m: f64,
}

/// What a frame's share of the work came to.
pub(super) enum Outcome {
    /// There is more to do.
    UnderWay,
    /// Nothing explains the frame.
    Nothing,
    /// These do, with this misfit.
    Found(Vec<ContactFit>, f64),
}

impl Seek {
    /// Begins; `None` where lengths disagree.
    pub(super) fn new(tools: &Tools<'_>, change: &[f64], deviation: &[f64]) -> Option<Self> {
        let sets = tools.search.begin(tools.sheet, change, deviation).ok()?;
        let (change, deviation) = (change.to_vec(), deviation.to_vec());
        Some(Self { change, deviation, sets, work: Work::Sets, best: None, found: None, left: Vec::new() })
    }

    /// Goes on for about so long.
    pub(super) fn advance(&mut self, tools: &Tools<'_>, mut nanoseconds: f64) -> Outcome {
        while nanoseconds > 0.0 {
            let work = std::mem::replace(&mut self.work, Work::Sets);
            let next = match work {
                Work::Sets => {
                    let most = (nanoseconds / SET_NS).ceil().clamp(500.0, PORTION) as usize;
                    nanoseconds -= SET_NS * most as f64;
                    match tools.search.look(&mut self.sets, most) {
                        Looked::NotDone => Some(Work::Sets),
                        Looked::Best(start) => Some(Work::Fit(Fit::new(start))),
                        Looked::NoRoom => self.scaled(0),
                    }
                }
                Work::Fit(mut fit) => match self.fit(tools, &mut fit, &mut nanoseconds) {
                    None => Some(Work::Fit(fit)),
                    Some(result) => self.judge(tools, fit.start, result),
                },
                Work::Scaled(index, mut fit) => match self.fit(tools, &mut fit, &mut nanoseconds) {
                    None => Some(Work::Scaled(index, fit)),
                    Some(result) => {
                        self.keep(tools, result);
                        self.scaled(index + 1)
                    }
                },
            };
            match next {
                Some(next) => self.work = next,
                None => {
                    return match self.found.take() {
                        Some((fits, summary)) => Outcome::Found(fits, summary.misfit),
                        None => Outcome::Nothing,
                    };
                }
            }
        }
        Outcome::UnderWay
    }

    /// A step of a fit, or what the fit came to if that was the last; an error is nothing.
    fn fit(
        &mut self,
        tools: &Tools<'_>,
        fit: &mut Fit,
        nanoseconds: &mut f64,
    ) -> Option<Option<(Vec<ContactFit>, FitSummary)>> {
        let step_ns = STEP_NS * fit.typical_patches(tools.options).powi(2);
        let most = if nanoseconds.is_finite() { STEPS_AT_ONCE } else { STEPS };
        let allowed = (*nanoseconds / step_ns).ceil().clamp(1.0, most as f64) as usize;
        let options = FitOptions { most_steps: allowed.min(STEPS - fit.steps).max(1), ..*tools.options };
        let at = match &mut fit.at {
            Some(at) => at,
            place => match tools.sheet.begin_fit(&fit.start) {
                Ok(begun) => place.insert(begun),
                Err(_) => return Some(None),
            },
        };
        let result = tools.sheet.go_on(&self.change, &self.deviation, at, &options, &mut self.left);
        let Ok((fits, summary)) = result else { return Some(None) };
        fit.patches.clear();
        fit.patches.extend(fits.iter().map(|fit| fit.patch));
        let step_ns = STEP_NS * fit.typical_patches(tools.options).powi(2);
        *nanoseconds -= step_ns * summary.steps.max(1) as f64;
        fit.steps += summary.steps;
        // Patches that stay grown over the whole skin would take the time of many frames, and are not believed in the
        // end. At a desk they may shrink again.
        fit.large = if are_large(&fits, tools.half_width_m) { fit.large + 1 } else { 0 };
        if nanoseconds.is_finite() && fit.large > MOST_LARGE {
            return Some(None);
        }
        let ended = summary.settled || fit.steps >= STEPS;
        ended.then_some(Some((fits, summary)))
    }

    /// After the fit of a set: whether it is the best, and whether a larger one is worth looking for.
    fn judge(
        &mut self,
        tools: &Tools<'_>,
        start: Vec<ContactPatch>,
        result: Option<(Vec<ContactFit>, FitSummary)>,
    ) -> Option<Work> {
        let before = self.best.as_ref().map(|(_, summary)| *summary);
        let worth =
            |cost: f64| before.is_none_or(|before| cost < WORTH.1 * before.cost && cost < before.cost - WORTH.0);
        let better = result
            .filter(|(fits, summary)| plausible(fits, summary, tools.half_width_m) && worth(summary.cost))
            .map(|(_, summary)| summary);
        let ends = match (better, before) {
            (Some(better), _) => {
                self.best = Some((start, better));
                better.misfit < GOOD
            }
            // What explains a frame is not improved by one more: two more would not improve it either.
            (None, Some(before)) => before.misfit < BELIEVED,
            (None, None) => false,
        };
        if ends { self.scaled(0) } else { Some(Work::Sets) }
    }

    /// The best set from this one of the radii; `None` after the last, or where there is no set.
    fn scaled(&self, index: usize) -> Option<Work> {
        let ((best, _), share) = (self.best.as_ref()?, *RADII.get(index)?);
        let scale = |patch: &ContactPatch| ContactPatch { radius_m: share * patch.radius_m, ..*patch };
        Some(Work::Scaled(index, Fit::new(best.iter().map(scale).collect())))
    }

    fn keep(&mut self, tools: &Tools<'_>, result: Option<(Vec<ContactFit>, FitSummary)>) {
        if let Some((fits, summary)) = result
            && self.found.as_ref().is_none_or(|(_, before)| summary.cost < before.cost)
            && plausible(&fits, &summary, tools.half_width_m)
        {
            self.found = Some((fits, summary));
        }
    }
}

impl Fit {
    fn new(start: Vec<ContactPatch>) -> Self {
        Self { patches: start.clone(), start, at: None, steps: 0, large: 0 }
    }

    /// How many patches of the typical size would cover as much as these, at least as many as these are.
    fn typical_patches(&self, options: &FitOptions) -> f64 {
        let covered: f64 = self.patches.iter().map(|patch| (patch.radius_m / options.radius_m).powi(2)).sum();
        covered.max(self.patches.len() as f64)
    }
}
