//! Fits both experts and their combination.

use super::excess::{Excess, Unlike, misfit_ratio};
use super::features::Features;
use super::form_choice::{Form, GRID, MOST_TURNED, TELLING, choose_form, forward_examples, projection};
use super::fusion::{Cells, Fusion, LeftOutView};
use super::inverse::{Guess, Memory};
use super::inverse_fit::{Inverse, Plain, Units};
use super::live::unit_length;
use super::model::FusedLocator;
use super::prior::Sister;
use super::report::{Accuracy, FusedReport};
use super::sessions::{self, Weights};
use super::state::{FUSED_VERSION, FusedState};
use crate::locator::data::{Examples, LeaveOneOut, LeftOut, MIN_EXAMPLES, SignatureMap};
use crate::locator::design::{Design, Prior, nearest};
use crate::locator::error::{LocatorError, check_length};
use crate::locator::fit::{Fitting, Judged, SECTORS, by_direction, prepare};
use crate::locator::load::LoadLaw;
use crate::locator::model::Locator;
use crate::locator::posterior::{CHOSEN_QUANTITIES, ONE_SIGMA, Spread, Trial, quantile};
use crate::locator::regression::{WorkedOut, example_noise};
use crate::locator::state::LocatorState;
use crate::statistics::{evenly, median, spacing};

/// Minimum pokes per channel for using whitened frames. With fewer, the whitening has seen the left-out poke.
const WHITENED_POKES: usize = 3;
/// Maximum number of examples used to choose how the experts are combined.
const JOINING: usize = 400;
/// Maximum number of examples that show how well one part of the skin is located from the others (`SOME`), or that
/// teach the load (`LOADED`).
const SOME: usize = 600;
const LOADED: usize = 1000;
/// Examples that others contradict by more sigmas than this, and by this many median errors, are doubtful.
const DOUBTFUL_SIGMAS: f64 = 8.0;
const DOUBTFUL_MEDIANS: f64 = 10.0;
/// Maximum share of examples that may be excluded as doubtful, and maximum number of examples for refitting without
/// them.
const MOST_DOUBTFUL: f64 = 0.1;
const REFIT_AT_MOST: usize = 1000;
/// With rotated copies of few examples, the left-out examples choose only sigma. With those of an earlier session, the
/// new ones choose how the experts are combined, too.
const CHOSEN_BESIDE_COPIES: f64 = 1.0;
const CHOSEN_BY_NEW: f64 = 2.0;
/// Minimum number of examples for separate sigma factors in x and y.
const OWN_FACTORS: f64 = 100.0;

/// Options of [`FusedLocator::fit`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FusedOptions {
    /// Up to this many examples, both experts use every one. Time grows with its cube, memory with its square.
    pub exact_examples: usize,
    /// With more examples than that, this many evenly drawn ones make the forward expert's map and serve as the
    /// inverse expert's landmarks. All examples still train the inverse expert. Time grows with the number of
    /// examples times the square of this number, memory with its square, and time per frame in proportion to it.
    pub landmarks: usize,
    /// Exclude examples that the others contradict, and report them.
    pub leave_out_doubtful: bool,
}

impl Default for FusedOptions {
    fn default() -> Self {
        Self { exact_examples: 3000, landmarks: 3000, leave_out_doubtful: true }
    }
}

impl FusedLocator {
    /// Fits to pokes. `map` holds the positions at which touches are searched for, with the predictions of physics
    /// there, or zeros.
    ///
    /// # Errors
    /// As [`Locator::fit`](Locator::fit); options out of range.
    pub fn fit(examples: &Examples, map: &SignatureMap, options: &FusedOptions) -> Result<Self, LocatorError> {
        fit(examples, map, options, None)
    }

    /// Like [`FusedLocator::fit`], but starts from the calibration of a skin with the same outline and electrodes.
    ///
    /// # Errors
    /// As [`FusedLocator::fit`]; a prior with a different number of channels.
    pub fn fit_with_prior(
        examples: &Examples,
        map: &SignatureMap,
        options: &FusedOptions,
        sister: &FusedLocator,
    ) -> Result<Self, LocatorError> {
        check_length("channels of the prior", examples.channels(), sister.channels())?;
        let few = examples.len() <= MOST_TURNED;
        fit(examples, map, options, Some(&Sister::new(sister, few)?))
    }
}

/// Fits, and fits again without the examples that the others contradict.
fn fit(
    examples: &Examples,
    map: &SignatureMap,
    options: &FusedOptions,
    sister: Option<&Sister>,
) -> Result<FusedLocator, LocatorError> {
    check_length("channels of the signature map", examples.channels, map.channels)?;
    for (field, got) in [("exact_examples", options.exact_examples), ("landmarks", options.landmarks)] {
        if got < MIN_EXAMPLES {
            return Err(LocatorError::Count { field, got, expected: "at least 5" });
        }
    }
    let first = fit_all(examples, map, options, sister)?;
    let doubtful = first.report.doubtful.clone();
    let n = examples.len();
    let few = n <= REFIT_AT_MOST && doubtful.len() as f64 <= MOST_DOUBTFUL * n as f64;
    if doubtful.is_empty() || !few || !options.leave_out_doubtful || n - doubtful.len() < MIN_EXAMPLES {
        return FusedLocator::try_from(first);
    }
    let mut second = fit_all(&without(examples, &doubtful), map, options, sister)?;
    second.report.doubtful = doubtful;
    second.report.doubtful_left_out = true;
    FusedLocator::try_from(second)
}

fn without(examples: &Examples, rows: &[usize]) -> Examples {
    let kept: Vec<usize> = (0..examples.len()).filter(|i| !rows.contains(i)).collect();
    let c = examples.channels;
    Examples {
        channels: c,
        frames: kept.iter().flat_map(|&i| examples.frames[i * c..(i + 1) * c].iter().copied()).collect(),
        positions_m: kept.iter().map(|&i| examples.positions_m[i]).collect(),
        loads: examples.loads.as_ref().map(|loads| kept.iter().map(|&i| loads[i]).collect()),
        channel_noise: examples.channel_noise.clone(),
        earlier: kept.iter().filter(|&&i| i >= examples.len() - examples.earlier).count(),
    }
}

fn fit_all(
    examples: &Examples,
    map: &SignatureMap,
    options: &FusedOptions,
    sister: Option<&Sister>,
) -> Result<FusedState, LocatorError> {
    let n = examples.len();
    let rows = evenly(n, if n > options.exact_examples { options.landmarks } else { n });
    let features = Features::new(examples)?;
    let units = Units::new(examples, &features)?;
    let (form, uses) = choose_form(examples, &features, map, &rows, sister)?;
    let seen = forward_examples(examples, &form.features, &rows)?;
    let (mut design, prior) = prepare(&seen, &form.map, &form.hyper)?;
    let mut weigh = Weights::new(examples, &rows);
    if let Some(is_earlier) = &weigh.is_earlier {
        let sessions = sessions::choose(&design, &prior, is_earlier, &form.hyper)?;
        weigh.discount(&sessions, form.hyper.noise);
        design.sessions = Some(sessions);
    }
    let projection = projection(&design, &prior, form.turn.as_ref())?;
    let fitting = Fitting {
        positions: &map.positions_m,
        basis: projection.as_ref(),
        spacing_m: spacing(&map.positions_m),
        channel_prior: form.prior.as_ref(),
        turn: form.turn.as_ref(),
        grid: GRID,
    };
    let (judged, plain) = rayon::join(
        || fitting.judge(&design, &prior, &form.hyper, &mut WorkedOut::default()),
        || Plain::fit(&units, &examples.positions_m, &rows, weigh.is_earlier.as_deref()),
    );
    let (judged, plain) = (judged?, plain?);
    let whitened = (n >= WHITENED_POKES * examples.channels)
        .then(|| whitened_rows(examples, &form.features, &judged))
        .transpose()?;
    let usual = median(&judged.misfits).max(f64::MIN_POSITIVE);
    let misfits: Vec<f64> = judged.misfits.iter().map(|misfit| misfit_ratio(*misfit, usual)).collect();
    let inverse = Inverse::fit(plain, whitened, &examples.positions_m, &rows, &misfits, weigh.is_earlier.as_deref())?;
    let joining = weigh.joining(JOINING);
    let alone = form.turn.is_some() && rows.len() < TELLING;
    let left_out: Vec<LeftOutView<'_>> = joining
        .iter()
        .map(|&(i, weight)| LeftOutView {
            log_likelihood: judged.left_out.col_as_slice(i),
            guess: Some(inverse.guesses[i]),
            truth_m: design.positions_m[i],
            weight,
        })
        .collect();
    let cells = Cells::new(&map.positions_m, fitting.spacing_m);
    let fusion = if alone { Fusion::UNTOLD } else { Fusion::choose(&map.positions_m, &cells, &left_out) };
    let mut near = near_trials(&fitting, &cells, &fusion, &judged, &inverse.guesses, &design.positions_m);
    near.iter_mut().enumerate().for_each(|(i, trial)| trial.weight = weigh.of(i));
    let usual_misfit = quantile(&judged.misfits, 0.95);
    let unlike = |(misfit, guess): (&f64, &Guess)| Unlike {
        novelty: misfit / usual_misfit,
        distance: if fusion.doublings.is_some() { guess.distance } else { 1.0 },
    };
    let unlike: Vec<Unlike> = judged.misfits.iter().zip(&inverse.guesses).map(unlike).collect();
    let excess = Excess::choose(&near, &unlike);
    for (trial, unlike) in near.iter_mut().zip(&unlike) {
        trial.variance_m2 = trial.variance_m2.map(|variance_m2| variance_m2 * excess.of(*unlike));
    }
    let far = Far { fitting: &fitting, cells: &cells, fusion: &fusion, form: &form, inverse: &inverse, rows: &rows };
    let (far_fused, far_forward) = far.trials(&design, &prior, judged.calibration.temperature)?;
    let axis = |trials: &[Trial], axis: usize| -> Vec<Trial> {
        let own = |t: &Trial| Trial { error_m: [t.error_m[axis]; 2], variance_m2: [t.variance_m2[axis]; 2], ..*t };
        trials.iter().map(own).collect()
    };
    let chose = match (alone, &weigh.is_earlier) {
        (true, _) => CHOSEN_BESIDE_COPIES,
        (false, Some(_)) => CHOSEN_BY_NEW,
        (false, None) => CHOSEN_QUANTITIES,
    };
    let both = Spread::fit(&near, &far_fused, chose);
    let mut sigma_factors = [both.factor; 2];
    if near.iter().map(|trial| trial.weight).sum::<f64>() >= OWN_FACTORS {
        let factor = |a: usize| Spread::factor_with(&axis(&near, a), both.extrapolation_m, chose);
        sigma_factors = [factor(0), factor(1)];
    }
    let mut load = load_law(examples, &units, &map.positions_m, form.hyper.length_m)?;
    if let (Some(law), Some(loads)) = (&mut load, &examples.loads) {
        // The load is solved for at the position found, not at the true one.
        let error = |(t, (i, p)): (&Trial, (usize, &[f64; 2]))| {
            let place = [0, 1].map(|a| t.error_m[a] + p[a]);
            let nearest = nearest(&map.positions_m, place);
            let log_factor: f64 = nearest.iter().map(|(q, share)| share * law.log_factor[*q]).sum();
            ((units.amplitude[rows[i]].ln() - log_factor) / law.exponent - loads[rows[i]].ln()).abs()
        };
        let errors: Vec<f64> = near.iter().zip(design.positions_m.iter().enumerate()).map(error).collect();
        law.relative_error = law.relative_error.max(quantile(&errors, ONE_SIGMA));
    }
    let near_forward = fitting.near_trials(&design, &judged);
    let forward_spread = Spread::fit(&near_forward, &far_forward, chose);
    let (hyper, load_error) = (form.hyper, load.as_ref().map(|law| law.relative_error));
    let state = LocatorState::assemble(&design, &prior, &fitting, &judged, forward_spread, hyper, load);
    let spreads = sigma_factors.map(|factor| Spread { factor, extrapolation_m: both.extrapolation_m });
    let sigma_m =
        |trial: &Trial| [0, 1].map(|a: usize| spreads[a].variance_m2(trial.variance_m2[a], trial.unexplained).sqrt());
    let left_out = LeaveOneOut::of(&design.positions_m, &near, sigma_m, &judged.misfits, prior.cosine, load_error);
    let doubtful = doubtful(&left_out).into_iter().map(|i| rows[i]).collect();
    let found = |trials: &[Trial]| {
        let places: Vec<[f64; 2]> =
            trials.iter().zip(&design.positions_m).map(|(t, p)| [0, 1].map(|a| t.error_m[a] + p[a])).collect();
        Accuracy::of(places.into_iter(), &design.positions_m)
    };
    let (forward_used, inverse_used) = FusedReport::experts(&fusion);
    let report = FusedReport {
        left_out,
        forward: found(&near_forward),
        inverse: Accuracy::of(inverse.places.places_m.iter().copied(), &design.positions_m),
        fused: found(&near),
        forward_used,
        inverse_used,
        companded: form.features.companded,
        physics: uses[0],
        sister_map: uses[1],
        sister_covariance: uses[2],
        sister_turn: uses[3],
        resemblance: design.sessions.as_ref().map(|sessions| sessions.resemblance),
        doubtful,
        doubtful_left_out: false,
    };
    Ok(FusedState {
        version: FUSED_VERSION,
        features: form.features,
        forward: Locator::from_state(state)?,
        plain: inverse.plain,
        whitened: inverse.whitened,
        plain_share: inverse.share,
        fusion,
        excess,
        sigma_factors,
        extrapolation_m: both.extrapolation_m,
        places_m: design.positions_m,
        report,
    })
}

/// All examples as whitened by the forward expert, scaled to unit length.
fn whitened_rows(examples: &Examples, features: &Features, judged: &Judged) -> Result<Vec<Vec<f64>>, LocatorError> {
    let all: Vec<usize> = (0..examples.len()).collect();
    let design = Design::new(&forward_examples(examples, features, &all)?)?;
    let whitened = judged.map.transform() * design.z.transpose();
    Ok((0..examples.len())
        .map(|i| {
            let mut row: Vec<f32> = whitened.col_as_slice(i).iter().map(|v| *v as f32).collect();
            unit_length(&mut row);
            row.into_iter().map(f64::from).collect()
        })
        .collect())
}

fn load_law(
    examples: &Examples,
    units: &Units,
    map: &[[f64; 2]],
    length_m: f64,
) -> Result<Option<LoadLaw>, LocatorError> {
    let Some(loads) = &examples.loads else { return Ok(None) };
    let chosen = evenly(examples.len(), LOADED);
    let positions: Vec<[f64; 2]> = chosen.iter().map(|&i| examples.positions_m[i]).collect();
    let pick = |values: &[f64]| -> Vec<f64> { chosen.iter().map(|&i| values[i]).collect() };
    // Not an RMS: a few pokes with large errors would make it too wide for most.
    let summary = |values: &[f64]| quantile(values, ONE_SIGMA) * (1.0 + 3.0 / values.len() as f64);
    LoadLaw::fit(map, &positions, &pick(&units.amplitude), &pick(loads), length_m, summary)
}

/// Each example as located by both experts without it.
fn near_trials(
    fitting: &Fitting,
    cells: &Cells,
    fusion: &Fusion,
    judged: &Judged,
    guesses: &[Guess],
    truth: &[[f64; 2]],
) -> Vec<Trial> {
    let (mut weights, mut memory) = (vec![0.0; fitting.positions.len()], Vec::new());
    let trial = |i: usize| {
        let left_out = judged.left_out.col_as_slice(i);
        let found = fusion.join(fitting.positions, cells, left_out, Some(guesses[i]), &mut memory, &mut weights);
        Trial {
            error_m: [found.mean_m[0] - truth[i][0], found.mean_m[1] - truth[i][1]],
            variance_m2: [found.covariance_m2[0], found.covariance_m2[1]],
            unexplained: weights.iter().enumerate().map(|(p, w)| w * judged.left_out_variance(i, p)).sum(),
            weight: 1.0,
        }
    };
    (0..truth.len()).map(trial).collect()
}

/// Inputs for locating one part of the skin from the others.
struct Far<'a> {
    fitting: &'a Fitting<'a>,
    cells: &'a Cells,
    fusion: &'a Fusion,
    form: &'a Form,
    inverse: &'a Inverse,
    rows: &'a [usize],
}

impl Far<'_> {
    /// Some examples as located from those of the other sectors: first by both experts, then by the forward expert
    /// alone. Empty if too few would be left.
    fn trials(
        &self,
        design: &Design,
        prior: &Prior,
        temperature: f64,
    ) -> Result<(Vec<Trial>, Vec<Trial>), LocatorError> {
        let some = evenly(design.positions_m.len(), SOME);
        let (design, prior) = (design.subset(&some), prior.subset(&some));
        let rows: Vec<&Vec<f64>> = some.iter().map(|&i| &self.inverse.plain_rows[self.rows[i]]).collect();
        let order = by_direction(&design.positions_m);
        let n = order.len();
        let noise = example_noise(&design, self.form.hyper.noise);
        let (mut fused, mut forward) = (Vec::with_capacity(n), Vec::with_capacity(n));
        let positions = self.fitting.positions;
        let (mut weights, mut log_likelihood) = (vec![0.0; positions.len()], vec![0.0; positions.len()]);
        let (mut memory, mut exponents) = (Memory::default(), Vec::new());
        for sector in 0..SECTORS {
            let inside = sector * n / SECTORS..(sector + 1) * n / SECTORS;
            let outside: Vec<usize> = (0..n).filter(|i| !inside.contains(i)).map(|i| order[i]).collect();
            if outside.len() < MIN_EXAMPLES {
                return Ok((Vec::new(), Vec::new()));
            }
            let (part, about) = (design.subset(&outside), prior.subset(&outside));
            let map = self.fitting.fit_map(&part, &about, &self.form.hyper, &mut WorkedOut::default())?;
            let features: Vec<&Vec<f64>> = outside.iter().map(|&i| rows[i]).collect();
            let regression = self.inverse.plain.refitted(&features, &part.positions_m)?;
            for &i in &order[inside] {
                let truth = design.positions_m[i];
                map.log_likelihood(design.z.row(i), noise[i], &mut log_likelihood);
                let variance = |p: usize| map.variance()[p];
                forward.push(self.fitting.trial(&log_likelihood, variance, truth, temperature, &mut weights));
                let row: Vec<f32> = rows[i].iter().map(|v| *v as f32).collect();
                let guess = regression.guess(&row, &mut memory, None);
                let (likely, given) = (&log_likelihood, Some(guess));
                let found = self.fusion.join(positions, self.cells, likely, given, &mut exponents, &mut weights);
                fused.push(Trial {
                    error_m: [found.mean_m[0] - truth[0], found.mean_m[1] - truth[1]],
                    variance_m2: [found.covariance_m2[0], found.covariance_m2[1]],
                    unexplained: weights.iter().enumerate().map(|(p, w)| w * map.variance()[p]).sum(),
                    weight: 1.0,
                });
            }
        }
        Ok((fused, forward))
    }
}

/// Examples that the others strongly contradict.
fn doubtful(report: &LeaveOneOut) -> Vec<usize> {
    let far = |e: &LeftOut| {
        let sigmas = |axis: usize| ((e.located_m[axis] - e.position_m[axis]) / e.sigma_m[axis]).powi(2);
        sigmas(0) + sigmas(1) > DOUBTFUL_SIGMAS.powi(2) && e.error_m > DOUBTFUL_MEDIANS * report.median_error_m
    };
    (0..report.examples.len()).filter(|&i| far(&report.examples[i])).collect()
}
