//! Fits a locator to pokes and physics: chooses hyperparameters, and judges each example by the others.

use faer::{Mat, MatMut};

use super::channel_covariance::ChannelPrior;
use super::data::{
    Examples, Hyperparameters, LeaveOneOut, LocatorOptions, MIN_CHANNELS, MIN_EXAMPLES, Selection, SignatureMap,
};
use super::design::{Design, Prior, basis};
use super::error::{LocatorError, check_length};
use super::load::{LoadLaw, root_mean_square};
use super::model::Locator;
use super::posterior::{
    CHOSEN_QUANTITIES, Calibration, SELECTION_MARGIN, Spread, Trial, calibrate, extent, moments, quantile,
};
use super::regression::{FittedMap, WorkedOut, example_noise, smoothed};
use super::state::{LOCATOR_VERSION, LocatorState, check_hyperparameters};
use super::turn::Turn;
use crate::statistics::{evenly, median, spacing};

/// Number of passes that fill missing channels of the examples from the regression on the others.
const FILLING_PASSES: usize = 3;
/// Correlation lengths tried, as fractions of the skin's radius; the first is the default.
const LENGTHS: [f64; 3] = [0.38, 0.25, 0.57];
/// Noise variances tried; the first is the default.
const NOISES: [f64; 3] = [0.04, 0.02, 0.08];
/// Number of sectors, by direction from the centroid, for testing how well one part of the skin is located from the
/// others.
pub(super) const SECTORS: usize = 4;
/// Up to this many examples with rotated copies are left out one by one; more are left out in `PARTS` parts.
const SINGLY: usize = 20;
const PARTS: usize = 10;
/// Shrinkages tried.
const SHRINKAGES: [f64; 4] = [0.9, 0.6, 0.3, 0.97];
/// The candidates of [`Locator::fit`].
const GRID: Grid = Grid { lengths: &LENGTHS, noises: &NOISES, shrinkages: &SHRINKAGES };

/// Candidates of each hyperparameter; lengths are fractions of the skin's radius. The first of each is the default.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    pub(super) lengths: &'static [f64],
    pub(super) noises: &'static [f64],
    pub(super) shrinkages: &'static [f64],
}

/// Inputs common to every fit over the same map.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fitting<'a> {
    pub(super) positions: &'a [[f64; 2]],
    pub(super) basis: Option<&'a Mat<f64>>,
    pub(super) spacing_m: f64,
    pub(super) channel_prior: Option<&'a ChannelPrior>,
    /// Rotations under which every example has copies.
    pub(super) turn: Option<&'a Turn>,
    pub(super) grid: Grid,
}

/// A fit with its calibration, and the log-likelihoods (positions by examples) and misfits of the left-out examples.
#[derive(Debug, Clone)]
pub(super) struct Judged {
    pub(super) map: FittedMap,
    pub(super) calibration: Calibration,
    pub(super) left_out: Mat<f64>,
    pub(super) misfits: Vec<f64>,
    /// Remaining variance of the map (positions by examples) without each example, if it was refitted for that.
    refitted_variance: Option<Mat<f64>>,
}

impl Judged {
    /// Remaining variance of the map at position `p` without example `i`.
    pub(super) fn left_out_variance(&self, i: usize, p: usize) -> f64 {
        self.refitted_variance.as_ref().map_or_else(|| self.map.left_out_variance(i, p), |variance| variance[(p, i)])
    }
}

impl Locator {
    /// Fits a locator to pokes and physics.
    ///
    /// The cost is a few products of (positions x channels) with (channels x examples) for each of up to eight
    /// choices of hyperparameters: about a second for 400 examples of 192 channels over 2,000 positions.
    ///
    /// # Errors
    /// Different channel counts, an example without enough usable channels or without signal, hyperparameters or
    /// options out of range, or examples so similar that their covariance is singular.
    pub fn fit(examples: &Examples, physics: &SignatureMap, options: &LocatorOptions) -> Result<Self, LocatorError> {
        check_options(options)?;
        check_length("channels of the signature map", examples.channels, physics.channels)?;
        let radius = extent(&physics.positions_m);
        let start = default_hyperparameters(radius);
        let (design, prior) = prepare(examples, physics, &start)?;
        let basis = basis(&design, &prior, options.max_rank)?;
        let spacing_m = spacing(&physics.positions_m);
        let (positions, basis) = (&physics.positions_m, basis.as_ref());
        let fitting = Fitting { positions, basis, spacing_m, channel_prior: None, turn: None, grid: GRID };
        let hyper = match options.selection {
            Selection::Fixed(hyper) => hyper,
            Selection::LeaveOneOut => {
                let rows = evenly(design.positions_m.len(), options.selection_examples);
                let (design, prior) = (design.subset(&rows), prior.subset(&rows));
                let mut worked_out = WorkedOut::default();
                let score = fitting.judge(&design, &prior, &start, &mut worked_out)?.calibration.score;
                fitting.select(&design, &prior, (score, start), radius, worked_out)?.1
            }
        };
        let judged = fitting.judge(&design, &prior, &hyper, &mut WorkedOut::default())?;
        let near = fitting.near_trials(&design, &judged);
        let far = fitting.far_trials(&design, &prior, &hyper, judged.calibration.temperature)?;
        let spread = Spread::fit(&near, &far, CHOSEN_QUANTITIES);
        let load = match &examples.loads {
            None => None,
            Some(loads) => {
                let (map, poked) = (&physics.positions_m, &design.positions_m);
                LoadLaw::fit(map, poked, &design.amplitude, loads, hyper.length_m, root_mean_square)?
            }
        };
        Self::from_state(LocatorState::assemble(&design, &prior, &fitting, &judged, spread, hyper, load))
    }
}

impl LocatorState {
    /// Builds the state from a finished fit.
    pub(super) fn assemble(
        design: &Design,
        prior: &Prior,
        fitting: &Fitting,
        judged: &Judged,
        spread: Spread,
        hyperparameters: Hyperparameters,
        load: Option<LoadLaw>,
    ) -> Self {
        let map = &judged.map;
        let (whitening, whitened) = (map.transform(), map.signatures());
        let (rank, channels) = (whitening.nrows(), whitening.ncols());
        let mut transform = Vec::with_capacity(rank * channels);
        for r in 0..rank {
            transform.extend((0..channels).map(|k| whitening[(r, k)] as f32));
        }
        let mut signatures = Vec::with_capacity(rank * fitting.positions.len());
        for p in 0..fitting.positions.len() {
            signatures.extend(whitened.col_as_slice(p).iter().map(|v| *v as f32));
        }
        Self {
            version: LOCATOR_VERSION,
            positions_m: fitting.positions.to_vec(),
            spacing_m: fitting.spacing_m,
            weights: design.weights.clone(),
            energy: design.energy.clone(),
            rank,
            transform,
            signatures,
            variance: map.variance().to_vec(),
            median_amplitude: median(&design.amplitude),
            usual_misfit: quantile(&judged.misfits, 0.95),
            temperature: judged.calibration.temperature,
            sigma_factor: spread.factor,
            extrapolation_m: spread.extrapolation_m,
            hyperparameters,
            example_noise: example_noise(design, hyperparameters.noise),
            report: fitting.report(design, prior, judged, spread, load.as_ref()),
            load,
        }
    }
}

impl Fitting<'_> {
    /// Fits, leaves out each example in turn, and calibrates. `worked_out` must belong to the same design and prior,
    /// or be new.
    pub(super) fn judge(
        &self,
        design: &Design,
        prior: &Prior,
        hyper: &Hyperparameters,
        worked_out: &mut WorkedOut,
    ) -> Result<Judged, LocatorError> {
        let mut map = self.fit_map(design, prior, hyper, worked_out)?;
        let n = design.positions_m.len();
        let mut left_out = Mat::<f64>::zeros(self.positions.len(), n);
        let (misfits, refitted_variance) = match self.turn {
            None => (leave_out(&map, 0, left_out.as_mut()), None),
            Some(_) => {
                let (misfits, variance) = self.refit_without(design, prior, hyper, &mut left_out)?;
                (misfits, Some(variance))
            }
        };
        map.forget_products();
        let calibration = calibrate(self.positions, &left_out, &design.positions_m, self.spacing_m);
        Ok(Judged { map, calibration, left_out, misfits, refitted_variance })
    }

    /// Fits the map to these examples. If they have rotated copies, it is fitted to those too, with a prior mean of
    /// zero.
    pub(super) fn fit_map(
        &self,
        design: &Design,
        prior: &Prior,
        hyper: &Hyperparameters,
        worked_out: &mut WorkedOut,
    ) -> Result<FittedMap, LocatorError> {
        let (positions, basis, channel_prior) = (self.positions, self.basis, self.channel_prior);
        let Some(turn) = self.turn else {
            return FittedMap::new(design, prior, positions, basis, hyper, channel_prior, worked_out);
        };
        let copies = turn.copies(design);
        let nothing = Prior::nothing(copies.z.nrows(), positions.len(), copies.z.ncols());
        FittedMap::new(&copies, &nothing, positions, basis, hyper, channel_prior, worked_out)
    }

    /// Log-likelihoods of the examples under maps fitted without them and their copies, one part of the examples at a
    /// time. Also returns their misfits and the remaining variance of these maps.
    fn refit_without(
        &self,
        design: &Design,
        prior: &Prior,
        hyper: &Hyperparameters,
        left_out: &mut Mat<f64>,
    ) -> Result<(Vec<f64>, Mat<f64>), LocatorError> {
        let n = design.positions_m.len();
        let parts = if n <= SINGLY { n } else { PARTS };
        let noise = example_noise(design, hyper.noise);
        let (mut misfits, mut variance) = (vec![0.0; n], Mat::<f64>::zeros(self.positions.len(), n));
        for part in 0..parts {
            let (inside, outside): (Vec<usize>, Vec<usize>) = (0..n).partition(|i| i % parts == part);
            let (some, about) = (design.subset(&outside), prior.subset(&outside));
            let map = self.fit_map(&some, &about, hyper, &mut WorkedOut::default())?;
            for i in inside {
                misfits[i] = map.log_likelihood(design.z.row(i), noise[i], left_out.col_as_slice_mut(i));
                variance.col_as_slice_mut(i).copy_from_slice(map.variance());
            }
        }
        Ok((misfits, variance))
    }

    /// Goes once through the candidates of each hyperparameter, starting from given values with their score. Keeps
    /// the value that predicts the left-out examples best, and returns it with its score. `worked_out` comes from
    /// judging the start.
    pub(super) fn select(
        &self,
        design: &Design,
        prior: &Prior,
        start: (f64, Hyperparameters),
        radius: f64,
        mut worked_out: WorkedOut,
    ) -> Result<(f64, Hyperparameters), LocatorError> {
        let margin = SELECTION_MARGIN / design.positions_m.len() as f64;
        let mut best = start;
        let mut consider = |propose: &dyn Fn(Hyperparameters) -> Hyperparameters| {
            let candidate = propose(best.1);
            let reached = self.judge(design, prior, &candidate, &mut worked_out)?.calibration.score;
            if reached > best.0 + margin {
                best = (reached, candidate);
            }
            Ok::<(), LocatorError>(())
        };
        for shrinkage in &self.grid.shrinkages[1..] {
            consider(&|kept| Hyperparameters { shrinkage: *shrinkage, ..kept })?;
        }
        for noise in &self.grid.noises[1..] {
            consider(&|kept| Hyperparameters { noise: *noise, ..kept })?;
        }
        for length in &self.grid.lengths[1..] {
            consider(&|kept| Hyperparameters { length_m: *length * radius, ..kept })?;
        }
        Ok(best)
    }

    /// Each example as located by the others.
    pub(super) fn near_trials(&self, design: &Design, judged: &Judged) -> Vec<Trial> {
        let mut weights = vec![0.0; self.positions.len()];
        let temperature = judged.calibration.temperature;
        let trial = |i: usize| {
            let left_out = judged.left_out.col_as_slice(i);
            let variance = |p: usize| judged.left_out_variance(i, p);
            self.trial(left_out, variance, design.positions_m[i], temperature, &mut weights)
        };
        (0..judged.misfits.len()).map(trial).collect()
    }

    /// Each example as located by those of the other sectors; empty if too few would be left.
    fn far_trials(
        &self,
        design: &Design,
        prior: &Prior,
        hyper: &Hyperparameters,
        temperature: f64,
    ) -> Result<Vec<Trial>, LocatorError> {
        let order = by_direction(&design.positions_m);
        let n = order.len();
        let noise = example_noise(design, hyper.noise);
        let mut trials = Vec::with_capacity(n);
        let (mut weights, mut log_likelihood) = (vec![0.0; self.positions.len()], vec![0.0; self.positions.len()]);
        for sector in 0..SECTORS {
            let inside = sector * n / SECTORS..(sector + 1) * n / SECTORS;
            let outside: Vec<usize> = (0..n).filter(|i| !inside.contains(i)).map(|i| order[i]).collect();
            if outside.len() < MIN_EXAMPLES {
                return Ok(Vec::new());
            }
            let (some, about) = (design.subset(&outside), prior.subset(&outside));
            let map = self.fit_map(&some, &about, hyper, &mut WorkedOut::default())?;
            for &i in &order[inside] {
                map.log_likelihood(design.z.row(i), noise[i], &mut log_likelihood);
                let variance = |p: usize| map.variance()[p];
                trials.push(self.trial(&log_likelihood, variance, design.positions_m[i], temperature, &mut weights));
            }
        }
        Ok(trials)
    }

    pub(super) fn trial(
        &self,
        log_likelihood: &[f64],
        variance: impl Fn(usize) -> f64,
        truth: [f64; 2],
        temperature: f64,
        weights: &mut [f64],
    ) -> Trial {
        let found = moments(self.positions, log_likelihood, temperature, self.spacing_m, weights);
        Trial {
            error_m: [found.mean_m[0] - truth[0], found.mean_m[1] - truth[1]],
            variance_m2: [found.covariance_m2[0], found.covariance_m2[1]],
            unexplained: weights.iter().enumerate().map(|(p, w)| w * variance(p)).sum(),
            weight: 1.0,
        }
    }

    /// Report on the left-out examples.
    fn report(
        &self,
        design: &Design,
        prior: &Prior,
        judged: &Judged,
        spread: Spread,
        load: Option<&LoadLaw>,
    ) -> LeaveOneOut {
        LeaveOneOut::of(
            &design.positions_m,
            &self.near_trials(design, judged),
            |trial| trial.variance_m2.map(|v| spread.variance_m2(v, trial.unexplained).sqrt()),
            &judged.misfits,
            prior.cosine,
            load.map(|law| law.relative_error),
        )
    }
}

/// Fills the columns with the log-likelihoods of examples, from number `first` on, in the fit without each. Returns
/// their misfits.
fn leave_out(map: &FittedMap, first: usize, mut columns: MatMut<'_, f64>) -> Vec<f64> {
    const TOGETHER: usize = 32;
    let count = columns.ncols();
    if count <= TOGETHER {
        let one = |k: usize| {
            let column =
                columns.as_mut().col_mut(k).try_as_col_major_mut().expect("a column of a matrix is contiguous");
            map.left_out_log_likelihood(first + k, column.as_slice_mut())
        };
        return (0..count).map(one).collect();
    }
    let middle = count / 2;
    let (left, right) = columns.split_at_col_mut(middle);
    let (mut misfits, others) = rayon::join(|| leave_out(map, first, left), || leave_out(map, first + middle, right));
    misfits.extend(others);
    misfits
}

/// Indices of positions, sorted by their direction from the centroid.
pub(super) fn by_direction(positions: &[[f64; 2]]) -> Vec<usize> {
    let n = positions.len() as f64;
    let centre = [0, 1].map(|axis| positions.iter().map(|p| p[axis]).sum::<f64>() / n);
    let angle = |i: &usize| (positions[*i][1] - centre[1]).atan2(positions[*i][0] - centre[0]);
    let mut order: Vec<usize> = (0..positions.len()).collect();
    order.sort_by(|a, b| angle(a).total_cmp(&angle(b)));
    order
}

/// Brings examples and physics into the same form and fills the examples' missing channels.
pub(super) fn prepare(
    examples: &Examples,
    physics: &SignatureMap,
    hyper: &Hyperparameters,
) -> Result<(Design, Prior), LocatorError> {
    let mut design = Design::new(examples)?;
    let mut prior = Prior::new(physics, &design)?;
    if !design.missing.is_empty() {
        for _ in 0..FILLING_PASSES {
            let fitted = smoothed(&design, &prior, hyper)?;
            design.fill(&fitted);
        }
        prior = Prior::new(physics, &design)?;
    }
    Ok((design, prior))
}

pub(super) fn default_hyperparameters(radius: f64) -> Hyperparameters {
    Hyperparameters { length_m: LENGTHS[0] * radius, noise: NOISES[0], shrinkage: SHRINKAGES[0] }
}

fn check_options(options: &LocatorOptions) -> Result<(), LocatorError> {
    if options.selection_examples < MIN_EXAMPLES {
        let got = options.selection_examples;
        return Err(LocatorError::Count { field: "selection_examples", got, expected: "at least 5" });
    }
    if options.max_rank < MIN_CHANNELS {
        return Err(LocatorError::Count { field: "max_rank", got: options.max_rank, expected: "at least 3" });
    }
    match options.selection {
        Selection::LeaveOneOut => Ok(()),
        Selection::Fixed(hyper) => check_hyperparameters(&hyper),
    }
}
