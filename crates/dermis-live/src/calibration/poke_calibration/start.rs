//! Calibrating from an earlier calibration: of the same skin in another session, or of a sister.
//!
//! If the earlier calibration places the new pokes much better than a guess, it is of the same skin. Both sets of pokes
//! then share a locator, in which the earlier ones count as much as the skin still resembles the earlier one. The
//! earlier calibration unchanged is used instead only if it places the new pokes clearly better. On another skin, the
//! new pokes alone and with the earlier calibration as prior compete. Locators are judged on the new pokes, left out
//! where they were used, by the mean of ln(e^2 + m^2), with e a poke's error and m the locator's median error. Few
//! pokes can't judge what was fitted to them alone.

use dermis_tomo::mesh::{Point, distance};
use dermis_touch::locator::{Examples, FusedLocator, FusedOptions, Located, SignatureMap};
use serde::{Deserialize, Serialize};

use super::strength;
use crate::Error;
use crate::prepare::Prepared;

/// Maximum median error of the earlier calibration on pokes of its own skin, relative to that of a guess at their
/// centre. Sisters with other electrode numbers are at 1; a skin that was damaged since was at 0.17.
const SAME_SKIN: f64 = 0.6;
/// With fewer pokes, a locator fitted to them alone doesn't compete: its left-out errors are far too small. From ten
/// pokes of a damaged skin and its prior, 2 mm were expected and 6 mm reached.
const TELLING: usize = 20;
/// Standard errors by which another locator must be better than the one that both sessions share.
const CLEARLY: f64 = 2.0;
/// Sigmas within which the earlier calibration explains a poke.
const EXPLAINED_SIGMAS: f64 = 2.5;
/// Share of errors within one standard deviation of a Gaussian.
const ONE_SIGMA: f64 = 0.6827;
/// Number of new pokes at which their errors and the old ones count equally in sigma.
const SIGMA_WORTH: f64 = 10.0;

/// Use of an earlier calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StartUse {
    /// Not used: the new pokes alone locate touches best.
    Nothing,
    /// As prior of the map, or of the covariance between channels.
    Prior,
    /// Its pokes are pooled with the new ones, and count as much as the sessions resemble each other.
    Pooled,
    /// It locates touches unchanged.
    Unchanged,
}

/// How an earlier calibration was used, and why.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StartReview {
    /// Its use.
    pub used: StartUse,
    /// Share of the new pokes that it places within 2.5 sigma.
    pub explained: f64,
    /// Correlation of the new session's map with the earlier one's, if their pokes are pooled: 1 if the skin has not
    /// changed, 0 if the sessions have nothing in common.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resemblance: Option<f64>,
    /// Median error on the new pokes with the earlier calibration unchanged, metres.
    pub unchanged_m: f64,
    /// Median error on the new pokes of the locator that was chosen, metres.
    pub chosen_m: f64,
}

/// An earlier calibration.
#[derive(Clone, Copy)]
pub(super) struct Earlier<'a> {
    /// Name of the skin that was poked.
    pub skin: &'a str,
    pub locator: &'a FusedLocator,
    /// Difference data of each poke, model volts.
    pub frames: &'a [Vec<f64>],
    pub positions_m: &'a [Point],
    pub loads: Option<&'a [f64]>,
}

/// A locator with the pokes that it should keep, and its review.
pub(super) struct Started {
    pub locator: FusedLocator,
    /// Pokes of the earlier calibration are part of this one.
    pub keeps: Option<usize>,
    pub review: Option<StartReview>,
}

/// A candidate with its errors on the new pokes, metres, and its standard deviations there.
struct Candidate {
    locator: FusedLocator,
    used: StartUse,
    sister: Option<usize>,
    errors: Vec<Miss>,
}

/// An error with its standard deviation, both for x and y, metres.
#[derive(Clone, Copy)]
struct Miss {
    error_m: [f64; 2],
    sigma_m: [f64; 2],
}

impl Miss {
    fn distance_m(&self) -> f64 {
        self.error_m[0].hypot(self.error_m[1])
    }

    fn sigmas(&self) -> [f64; 2] {
        [0, 1].map(|axis| (self.error_m[axis] / self.sigma_m[axis]).abs())
    }
}

/// The locator that predicts the new pokes best.
pub(super) fn fit_best(
    examples: &Examples,
    map: &SignatureMap,
    sisters: &[Earlier<'_>],
    prepared: &Prepared,
) -> Result<Started, Error> {
    let options = FusedOptions::default();
    let count = examples.len();
    let fit = |examples: &Examples| FusedLocator::fit(examples, map, &options);
    if sisters.is_empty() {
        return Ok(Started { locator: fit(examples)?, keeps: None, review: None });
    }
    let guess_m = guess_m(examples);
    let mut unchanged: Vec<Vec<Miss>> = Vec::new();
    let mut candidates = Vec::new();
    for (number, sister) in sisters.iter().enumerate() {
        check(sister, prepared)?;
        let mut consider = |locator: FusedLocator, used: StartUse, errors: Vec<Miss>| {
            candidates.push(Candidate { locator, used, sister: Some(number), errors });
        };
        let as_it_is = on(sister.locator, examples);
        let is_same_skin = median_m(&as_it_is) < SAME_SKIN * guess_m;
        match if is_same_skin { pooled(examples, sister)? } else { None } {
            Some(both) => {
                let both = fit(&both)?;
                let errors = left_out(&both, count);
                consider(both, StartUse::Pooled, errors);
            }
            None => {
                let prior = FusedLocator::fit_with_prior(examples, map, &options, sister.locator)?;
                let errors = left_out(&prior, count);
                consider(prior, StartUse::Prior, errors);
            }
        }
        if is_same_skin {
            consider(sister.locator.clone(), StartUse::Unchanged, as_it_is.clone());
        }
        unchanged.push(as_it_is);
    }
    // The shared locator includes the new pokes alone, as a resemblance of 0.
    if candidates.iter().all(|candidate| candidate.used != StartUse::Pooled) {
        let alone = fit(examples)?;
        let errors = left_out(&alone, count);
        candidates.push(Candidate { locator: alone, used: StartUse::Nothing, sister: None, errors });
    }
    let best = choose(&candidates, count);
    let closest = unchanged.iter().min_by(|a, b| score(a).total_cmp(&score(b)));
    let inside = |miss: &&Miss| miss.sigmas().iter().all(|sigmas| *sigmas <= EXPLAINED_SIGMAS);
    let (explained, unchanged_m) = closest.map_or((0.0, f64::INFINITY), |errors| {
        (errors.iter().filter(inside).count() as f64 / count as f64, median_m(errors))
    });
    let Candidate { mut locator, used, sister, errors } = candidates.swap_remove(best);
    let keeps = sister.filter(|_| matches!(used, StartUse::Pooled | StartUse::Unchanged));
    if used == StartUse::Unchanged {
        // The errors behind its sigmas are of the earlier session.
        let share = count as f64 / (count as f64 + SIGMA_WORTH);
        locator.scale_sigmas(sigma_factor(&errors).powf(share))?;
    }
    let resemblance = locator.report().resemblance;
    let review = Some(StartReview { used, explained, resemblance, unchanged_m, chosen_m: median_m(&errors) });
    Ok(Started { locator, keeps, review })
}

/// Index of the best candidate. An earlier calibration of the same skin remains unchanged only if it is clearly better
/// than the locator that both sessions share.
fn choose(candidates: &[Candidate], count: usize) -> usize {
    let by_score = |a: &usize, b: &usize| score(&candidates[*a].errors).total_cmp(&score(&candidates[*b].errors));
    let best_of = |competes: &dyn Fn(usize) -> bool| (0..candidates.len()).filter(|&i| competes(i)).min_by(by_score);
    let Some(shared) = best_of(&|i| candidates[i].used == StartUse::Pooled) else {
        return best_of(&|i| candidates[i].used != StartUse::Nothing || count >= TELLING).unwrap_or(0);
    };
    let is_better = |i: usize| {
        candidates[i].used == StartUse::Unchanged
            && is_clearly_better(&candidates[i].errors, &candidates[shared].errors)
    };
    best_of(&is_better).unwrap_or(shared)
}

/// True if errors are smaller than others of the same pokes by more than [`CLEARLY`] standard errors of ln(e^2 + m^2).
fn is_clearly_better(errors: &[Miss], others: &[Miss]) -> bool {
    let middle2 = median_m(others).powi(2).max(f64::MIN_POSITIVE);
    let log = |miss: &Miss| (miss.distance_m().powi(2).min(1.0) + middle2).ln();
    let gains: Vec<f64> = errors.iter().zip(others).map(|(miss, other)| log(other) - log(miss)).collect();
    let count = gains.len() as f64;
    let mean = gains.iter().sum::<f64>() / count;
    let variance = gains.iter().map(|gain| (gain - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
    mean > CLEARLY * (variance / count).sqrt()
}

/// Rejects a calibration with another number of channels.
fn check(sister: &Earlier<'_>, prepared: &Prepared) -> Result<(), Error> {
    if sister.locator.channels() == prepared.channels() {
        return Ok(());
    }
    Err(Error::Frames {
        what: format!("calibration to start from, of skin {}", sister.skin),
        expected: format!("one of {} channels", prepared.channels()),
        got: format!("{} channels", sister.locator.channels()),
    })
}

/// The new pokes, with those that the sister keeps as an earlier session. `None` if only one of the two has loads.
fn pooled(examples: &Examples, sister: &Earlier<'_>) -> Result<Option<Examples>, Error> {
    if examples.loads().is_some() != sister.loads.is_some() {
        return Ok(None);
    }
    let frames = sister.frames.iter().flatten().copied().collect();
    let mut earlier = Examples::new(examples.channels(), frames, sister.positions_m.to_vec())?;
    if let Some(loads) = sister.loads {
        earlier = earlier.with_loads(loads.to_vec())?;
    }
    Ok(Some(examples.clone().with_earlier(&earlier)?))
}

/// Errors of the first `count` examples of a locator, each located by the others. Excluded ones are infinitely wrong.
fn left_out(locator: &FusedLocator, count: usize) -> Vec<Miss> {
    let report = locator.report();
    let mut examples = report.left_out.examples.iter();
    let excluded = |number: usize| report.doubtful_left_out && report.doubtful.contains(&number);
    let miss = |number: usize| match if excluded(number) { None } else { examples.next() } {
        Some(example) => Miss {
            error_m: [0, 1].map(|axis| example.located_m[axis] - example.position_m[axis]),
            sigma_m: example.sigma_m,
        },
        None => Miss { error_m: [f64::INFINITY; 2], sigma_m: [f64::MAX; 2] },
    };
    (0..count).map(miss).collect()
}

/// Errors of a locator on examples that it has not seen.
fn on(locator: &FusedLocator, examples: &Examples) -> Vec<Miss> {
    let mut scratch = locator.scratch();
    let frames = examples.frames().chunks_exact(examples.channels()).zip(examples.positions_m());
    let miss = |(frame, place_m): (&[f64], &[f64; 2])| match locator.predict_into(frame, &mut scratch) {
        Ok(Located { x_m, y_m, sigma_x_m, sigma_y_m, .. }) => {
            Miss { error_m: [x_m - place_m[0], y_m - place_m[1]], sigma_m: [sigma_x_m, sigma_y_m] }
        }
        Err(_) => Miss { error_m: [f64::INFINITY; 2], sigma_m: [f64::MAX; 2] },
    };
    frames.map(miss).collect()
}

/// Median distance of the pokes from their centre, metres.
fn guess_m(examples: &Examples) -> f64 {
    let places_m = examples.positions_m();
    let centre_m = [0, 1].map(|axis| places_m.iter().map(|p| p[axis]).sum::<f64>() / places_m.len() as f64);
    quantile(places_m.iter().map(|p| distance(*p, centre_m)).collect(), 0.5)
}

fn median_m(errors: &[Miss]) -> f64 {
    quantile(errors.iter().map(Miss::distance_m).collect(), 0.5)
}

/// Mean of ln(e^2 + m^2), with m the median of the errors e. A poke that is not placed counts as ten times the largest
/// error.
fn score(errors: &[Miss]) -> f64 {
    let distances = errors.iter().map(Miss::distance_m);
    let largest = distances.clone().filter(|d| d.is_finite()).fold(0.0, f64::max);
    let distances: Vec<f64> = distances.map(|d| if d.is_finite() { d } else { 10.0 * largest }).collect();
    let middle = quantile(distances.clone(), 0.5).max(f64::MIN_POSITIVE);
    distances.iter().map(|d| (d * d + middle * middle).ln()).sum::<f64>() / distances.len() as f64
}

/// Factor on sigma with which 68 % of the errors are within one.
fn sigma_factor(errors: &[Miss]) -> f64 {
    let sigmas: Vec<f64> = errors.iter().flat_map(Miss::sigmas).filter(|sigmas| sigmas.is_finite()).collect();
    if sigmas.is_empty() { 1.0 } else { quantile(sigmas, ONE_SIGMA).clamp(0.1, 10.0) }
}

/// As [`strength::quantile`], of a list that is not empty.
fn quantile(values: Vec<f64>, share: f64) -> f64 {
    strength::quantile(values, share).unwrap_or(f64::NAN)
}
