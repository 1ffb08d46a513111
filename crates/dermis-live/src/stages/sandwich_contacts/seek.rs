//! A search for patches with a bounded amount of work per frame. It fits the best set of one patch, then of two, and
//! so on until one more patch explains little. In all this takes some 10 ms, too long for frames at a kilohertz to
//! wait for; slow frames get the answer at once.

use dermis_tomo::eit::contacts::{
    ContactFit, ContactPatch, ContactSheet, FitOptions, FitSummary, Looked, PatchFit, PatchSearch, PatchSets,
};

use super::plausible::{BELIEVED, are_large, plausible};

/// Radii from which the final fits start, relative to those of the best set. Radius and conductance trade off, and a
/// fit may end in a local optimum.
const RADII: [f64; 2] = [1.0, 0.75];
/// One more patch must lower the cost of a fit (squared standard deviations) by at least the first value, and to less
/// than the second as a share of the cost before.
const WORTH: (f64, f64) = (20.0, 0.5);
/// Misfit below which no further patch is looked for.
const GOOD: f64 = 0.2;
/// Largest number of steps of a fit.
const STEPS: usize = 15;
/// Steps per call if the work per frame is bounded: growing patches make a step expensive, up to two hundred times
/// the first one.
const STEPS_AT_ONCE: usize = 1;
/// A fit is given up if a patch is larger than a touch after more than this many consecutive calls.
const MOST_LARGE: usize = 2;
/// Largest number of sets judged at a time. The full number is charged, even if there are fewer.
const PORTION: f64 = 2000.0;
/// Approximate costs by which work is divided among frames, in nanoseconds of one core: judging a set of patches, and
/// a step of a fit of one patch. A step of a fit of n patches takes n squared times as long, where n is at least the
/// number of typical patches that would cover the same area.
const SET_NS: f64 = 600.0;
const STEP_NS: f64 = 0.15e6;

/// A search in progress, in one frame.
#[derive(Debug)]
pub(super) struct Seek {
    change: Vec<f64>,
    deviation: Vec<f64>,
    sets: PatchSets,
    work: Work,
    /// The best set until now: the start of its fit and the result.
    best: Option<(Vec<ContactPatch>, FitSummary)>,
    /// The best fit from the best set.
    found: Option<(Vec<ContactFit>, FitSummary)>,
    left: Vec<f64>,
}

/// The next piece of work.
#[derive(Debug)]
enum Work {
    /// Find the best set with one more patch.
    Sets,
    /// Fit a set.
    Fit(Fit),
    /// Fit the best set, starting from this factor of [`RADII`].
    Scaled(usize, Fit),
}

/// A fit in progress.
#[derive(Debug)]
struct Fit {
    start: Vec<ContactPatch>,
    /// The current patches.
    patches: Vec<ContactPatch>,
    /// `None` before the first step.
    at: Option<PatchFit>,
    steps: usize,
    /// Number of consecutive calls after which a patch was larger than a touch.
    large: usize,
}

/// Models and settings for a search.
pub(super) struct Tools<'a> {
    pub(super) sheet: &'a ContactSheet,
    pub(super) search: &'a PatchSearch,
    pub(super) options: &'a FitOptions,
    pub(super) half_width_m: f64,
}

/// Result of the work done in one frame.
pub(super) enum Outcome {
    /// The search isn't finished.
    UnderWay,
    /// No patches explain the frame.
    Nothing,
    /// These patches explain the frame, with this misfit.
    Found(Vec<ContactFit>, f64),
}

impl Seek {
    /// Starts a search; `None` if lengths disagree.
    pub(super) fn new(tools: &Tools<'_>, change: &[f64], deviation: &[f64]) -> Option<Self> {
        let sets = tools.search.begin(tools.sheet, change, deviation).ok()?;
        let (change, deviation) = (change.to_vec(), deviation.to_vec());
        Some(Self { change, deviation, sets, work: Work::Sets, best: None, found: None, left: Vec::new() })
    }

    /// Continues for about this long.
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

    /// Takes one or more steps of a fit. `None` if it isn't finished, otherwise its result, or `Some(None)` if it
    /// failed.
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
        // Patches that stay as large as the whole skin would take the time of many frames and be rejected in the end.
        // Without a time limit they may shrink again.
        fit.large = if are_large(&fits, tools.half_width_m) { fit.large + 1 } else { 0 };
        if nanoseconds.is_finite() && fit.large > MOST_LARGE {
            return Some(None);
        }
        let ended = summary.settled || fit.steps >= STEPS;
        ended.then_some(Some((fits, summary)))
    }

    /// Judges the fit of a set: keeps it if it is the best, and decides whether to look for a larger one.
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
            // The best set explains the frame and one more patch doesn't improve it; two more would not either.
            (None, Some(before)) => before.misfit < BELIEVED,
            (None, None) => false,
        };
        if ends { self.scaled(0) } else { Some(Work::Sets) }
    }

    /// The best set with its radii scaled by this factor of [`RADII`]; `None` after the last factor, or without a
    /// set.
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

    /// Number of typical patches that would cover the same area, but at least the number of patches.
    fn typical_patches(&self, options: &FitOptions) -> f64 {
        let covered: f64 = self.patches.iter().map(|patch| (patch.radius_m / options.radius_m).powi(2)).sum();
        covered.max(self.patches.len() as f64)
    }
}
