//! Chooses the form in which the forward expert sees frames, and its expectation before any poke. Everything
//! available is tried, and left-out pokes decide.

use faer::Mat;

use super::features::{Features, in_frame};
use super::prior::Sister;
use super::report::PriorUse;
use crate::locator::channel_covariance::ChannelPrior;
use crate::locator::data::{Examples, Hyperparameters, LocatorOptions, SignatureMap};
use crate::locator::design::{Design, Prior, basis};
use crate::locator::error::LocatorError;
use crate::locator::fit::{Fitting, Grid, default_hyperparameters, prepare};
use crate::locator::posterior::{SELECTION_MARGIN, extent};
use crate::locator::regression::WorkedOut;
use crate::locator::turn::{Turn, log_density};
use crate::statistics::{evenly, spacing};

/// Candidates of the forward expert's hyperparameters, wider than those of [`Locator::fit`].
pub(super) const GRID: Grid =
    Grid { lengths: &[0.38, 0.25, 0.57, 0.8], noises: &[0.04, 0.02, 0.01, 0.08], shrinkages: &[0.9, 0.6, 0.3, 0.97] };
/// Maximum number of examples that choose the forward expert's form and hyperparameters.
const CHOOSING: usize = 250;
/// From this many pokes on, the form of frames is chosen by its score with the usual hyperparameters, on every second
/// map position. Every fourth would suffice for most skins, but not for the gelatin skin.
const DECIDED: usize = 100;
/// Minimum number of positions in a thinned map.
const FEWEST_POSITIONS: usize = 400;
/// Weight of another skin's covariance, in pokes.
const SISTER_WORTH: f64 = 10.0;
/// Below this many pokes, leaving one out is too unreliable to choose by. If a sister's calibration is given, its
/// form and covariance are then adopted, and the search for hyperparameters starts from `UNTOLD` (length relative to
/// the skin's radius).
pub(super) const TELLING: usize = 30;
const UNTOLD: Hyperparameters = Hyperparameters { length_m: 0.4, noise: 0.04, shrinkage: 0.95 };
/// Gain in total log score that a mean of the map must bring in that case.
const UNTOLD_MARGIN: f64 = 1.0;

/// Maximum number of pokes with rotated copies, since more pokes need none, and the hyperparameters then used (length
/// relative to the skin's radius). Chosen on two measured skins with ten pokes, not by the pokes at hand.
pub(super) const MOST_TURNED: usize = 60;
const TURNED: Hyperparameters = Hyperparameters { length_m: 0.35, noise: 0.06, shrinkage: 1.0 };

/// The basis of the forward expert.
pub(super) struct Form {
    pub features: Features,
    pub map: SignatureMap,
    pub prior: Option<ChannelPrior>,
    /// Rotations under which every poke has copies.
    pub turn: Option<Turn>,
    pub hyper: Hyperparameters,
}

/// A form with its hyperparameters and the score that they reach.
struct Tried<'a> {
    features: Features,
    prior: Option<ChannelPrior>,
    hyper: Hyperparameters,
    score: f64,
    mean: Mean<'a>,
}

/// A form before its hyperparameters are chosen, with its score for the starting values.
struct Begun<'a> {
    features: Features,
    mean: Mean<'a>,
    design: Design,
    prior: Prior,
    projection: Option<Mat<f64>>,
    channel_prior: Option<ChannelPrior>,
    score: f64,
    worked_out: WorkedOut,
}

impl<'a> Begun<'a> {
    fn fitting<'b>(&'b self, map: &'b SignatureMap, spacing_m: f64) -> Fitting<'b> {
        Fitting {
            positions: &map.positions_m,
            basis: self.projection.as_ref(),
            spacing_m,
            channel_prior: self.channel_prior.as_ref(),
            turn: None,
            grid: GRID,
        }
    }

    /// True if the two forms differ at most in how they see frames.
    fn expects_the_same(&self, other: &Begun<'_>) -> bool {
        std::mem::discriminant(&self.mean) == std::mem::discriminant(&other.mean)
            && self.channel_prior.is_some() == other.channel_prior.is_some()
    }
}

/// The mean of the forward expert's map before any poke.
#[derive(Clone, Copy)]
pub(super) enum Mean<'a> {
    Zero,
    /// The signatures of the map itself.
    Physics,
    Sister(&'a Sister),
}

/// The given examples as the forward expert sees them.
pub(super) fn forward_examples(
    examples: &Examples,
    features: &Features,
    rows: &[usize],
) -> Result<Examples, LocatorError> {
    let c = examples.channels;
    let mut frames = vec![0.0; rows.len() * c];
    let mut unit = vec![0.0; c];
    for (&i, out) in rows.iter().zip(frames.chunks_exact_mut(c)) {
        let frame = &examples.frames[i * c..(i + 1) * c];
        let (amplitude, _) = features.unit(frame, &mut unit).map_err(|error| in_frame(error, i))?;
        features.forward(frame, &unit, amplitude, out);
    }
    let positions_m = rows.iter().map(|&i| examples.positions_m[i]).collect();
    // The frames are already in units of the noise.
    let channel_noise = examples.channel_noise.as_ref().map(|_| vec![1.0; c]);
    Ok(Examples { channels: c, frames, positions_m, loads: None, channel_noise, earlier: 0 })
}

/// The mean of the map in the form that the forward expert sees.
fn mean_map(mean: Mean, map: &SignatureMap, features: &Features) -> Result<SignatureMap, LocatorError> {
    let c = map.channels;
    match mean {
        Mean::Zero => SignatureMap::without_physics(c, map.positions_m.clone()),
        Mean::Sister(sister) => sister.map_at(&map.positions_m),
        Mean::Physics => {
            let mut signatures = map.signatures.clone();
            for row in signatures.chunks_exact_mut(c) {
                row.iter_mut().zip(&features.weights).for_each(|(v, w)| *v *= w);
                let length = row.iter().map(|v| v * v).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
                row.iter_mut().enumerate().for_each(|(k, v)| *v = features.compand(k, *v / length));
            }
            SignatureMap::new(c, map.positions_m.clone(), signatures)
        }
    }
}

/// The best form on some of the rows, and the gains from physics, a sister's map, a sister's covariance and rotation.
pub(super) fn choose_form<'a>(
    examples: &Examples,
    features: &Features,
    map: &'a SignatureMap,
    rows: &[usize],
    sister: Option<&'a Sister>,
) -> Result<(Form, [Option<PriorUse>; 4]), LocatorError> {
    let chosen: Vec<usize> = evenly(rows.len(), CHOOSING).into_iter().map(|r| rows[r]).collect();
    let radius = extent(&map.positions_m);
    let tries_all = chosen.len() < DECIDED;
    let coarse = if tries_all { map.clone() } else { thinned(map, spacing(&map.positions_m)) };
    let spacing_m = spacing(&coarse.positions_m);
    let mut means = vec![Mean::Zero];
    means.extend(map.signatures.iter().any(|v| *v != 0.0).then_some(Mean::Physics));
    means.extend(sister.map(Mean::Sister));
    let mut begun: Vec<Begun> = Vec::new();
    let known = WorkedOut::default();
    let untold = sister.is_some() && chosen.len() < TELLING;
    let start = match untold {
        true => Hyperparameters { length_m: UNTOLD.length_m * radius, ..UNTOLD },
        false => default_hyperparameters(radius),
    };
    for companded in [false, true] {
        let features = Features { companded, ..features.clone() };
        let seen = forward_examples(examples, &features, &chosen)?;
        let akin = sister.filter(|s| s.companded == companded);
        for &mean in &means {
            if akin.is_none() && (untold || matches!(mean, Mean::Sister(_))) {
                continue;
            }
            let about = mean_map(mean, &coarse, &features)?;
            for lent in [None, akin].into_iter().take(1 + usize::from(akin.is_some())) {
                let (design, prior) = prepare(&seen, &about, &start)?;
                let projection = projection(&design, &prior, None)?;
                let channel_prior = lent.map(|s| channel_prior(s, projection.as_ref()));
                let features = features.clone();
                let mut worked_out = known.elsewhere();
                let fitting = Fitting {
                    positions: &coarse.positions_m,
                    basis: projection.as_ref(),
                    spacing_m,
                    channel_prior: channel_prior.as_ref(),
                    turn: None,
                    grid: GRID,
                };
                let score = fitting.judge(&design, &prior, &start, &mut worked_out)?.calibration.score;
                begun.push(Begun { features, mean, design, prior, projection, channel_prior, score, worked_out });
            }
        }
    }
    // With many pokes, choose the form of frames before the hyperparameters, for each mean and covariance. With few,
    // try all.
    let is_beaten = |form: &Begun| begun.iter().any(|other| form.expects_the_same(other) && other.score > form.score);
    let tried: Vec<bool> = begun.iter().map(|form| tries_all || !is_beaten(form)).collect();
    let mut forms: Vec<Tried> = Vec::new();
    for (mut form, _) in begun.into_iter().zip(tried).filter(|(_, tried)| *tried) {
        let worked_out = std::mem::take(&mut form.worked_out);
        let fitting = form.fitting(&coarse, spacing_m);
        let (score, hyper) = fitting.select(&form.design, &form.prior, (form.score, start), radius, worked_out)?;
        let Begun { features, channel_prior: prior, mean, .. } = form;
        forms.push(Tried { features, prior, hyper, score, mean });
    }
    let best = |accept: &dyn Fn(&Tried) -> bool| {
        forms.iter().filter(|f| accept(f)).map(|f| f.score).fold(f64::NEG_INFINITY, f64::max)
    };
    // Additional information must improve the score by more than chance would.
    let margin = if untold { UNTOLD_MARGIN } else { SELECTION_MARGIN } / chosen.len() as f64;
    let charged = |f: &Tried| {
        let mean = if matches!(f.mean, Mean::Zero) { 0.0 } else { margin };
        let covariance = match (f.prior.is_some(), untold) {
            (false, true) if !matches!(f.mean, Mean::Sister(_)) => f64::INFINITY,
            (true, false) => margin,
            _ => 0.0,
        };
        f.score - mean - covariance
    };
    let winner = (0..forms.len()).fold(0, |b, i| if charged(&forms[i]) > charged(&forms[b]) { i } else { b });
    let compare = |given: bool, with: &dyn Fn(&Tried) -> bool| {
        let gain = best(with) - best(&|f| !with(f));
        given.then(|| PriorUse { used: with(&forms[winner]), gain }).filter(|u| u.gain.is_finite())
    };
    let score = forms[winner].score;
    let mut uses = [
        compare(means.len() > 1 + usize::from(sister.is_some()), &|f| matches!(f.mean, Mean::Physics)),
        compare(sister.is_some(), &|f| matches!(f.mean, Mean::Sister(_))),
        compare(sister.is_some(), &|f| f.prior.is_some()),
        None,
    ];
    let turn = sister.and_then(|s| s.turn.as_ref()).filter(|_| chosen.len() <= MOST_TURNED);
    let turned = turn.map(|turn| turned_form(examples, features, map, &coarse, &chosen, &means, turn)).transpose()?;
    if let Some((turned, reached)) = turned.flatten() {
        let gain = reached - score;
        let used = untold || gain > margin;
        uses[3] = Some(PriorUse { used, gain });
        if used {
            uses.iter_mut().take(3).flatten().for_each(|part| part.used = false);
            return Ok((turned, uses));
        }
    }
    let Tried { features, prior, hyper, mean, .. } = forms.swap_remove(winner);
    let map = mean_map(mean, map, &features)?;
    Ok((Form { features, map, prior, turn: None, hyper }, uses))
}

/// The form in which every poke has copies, rotated as a sister's map shows, with its score. `None` if the pokes are
/// more likely without copies, or with one of the `means`. The skin may be numbered in the opposite direction from
/// the sister, so both are tried.
fn turned_form(
    examples: &Examples,
    features: &Features,
    map: &SignatureMap,
    coarse: &SignatureMap,
    chosen: &[usize],
    means: &[Mean],
    turn: &Turn,
) -> Result<Option<(Form, f64)>, LocatorError> {
    // Companding equalises the channels, whatever their noise.
    let features = Features { companded: true, ..features.clone() };
    let hyper = Hyperparameters { length_m: TURNED.length_m * extent(&map.positions_m), ..TURNED };
    let about = SignatureMap::without_physics(map.channels, coarse.positions_m.clone())?;
    let (design, prior) = prepare(&forward_examples(examples, &features, chosen)?, &about, &hyper)?;
    let mut best = (0.0, None);
    for mean in means {
        best.0 = evidence_of(*mean, examples, &features, coarse, chosen, &hyper)?.max(best.0);
    }
    for turn in [turn.clone(), turn.reversed()] {
        let evidence = turn.evidence(&design, &hyper)?;
        if evidence > best.0 {
            best = (evidence, Some(turn));
        }
    }
    let Some(turn) = best.1 else { return Ok(None) };
    let projection = projection(&design, &prior, Some(&turn))?;
    let fitting = Fitting {
        positions: &about.positions_m,
        basis: projection.as_ref(),
        spacing_m: spacing(&about.positions_m),
        channel_prior: None,
        turn: Some(&turn),
        grid: GRID,
    };
    let score = fitting.judge(&design, &prior, &hyper, &mut WorkedOut::default())?.calibration.score;
    let map = SignatureMap::without_physics(map.channels, map.positions_m.clone())?;
    Ok(Some((Form { features, map, prior: None, turn: Some(turn), hyper }, score)))
}

/// Log evidence gained by using a mean of the map instead of zero.
fn evidence_of(
    mean: Mean,
    examples: &Examples,
    features: &Features,
    map: &SignatureMap,
    chosen: &[usize],
    hyper: &Hyperparameters,
) -> Result<f64, LocatorError> {
    let companded = match mean {
        Mean::Zero => return Ok(0.0),
        Mean::Physics => features.companded,
        Mean::Sister(sister) => sister.companded,
    };
    let features = Features { companded, ..features.clone() };
    let about = mean_map(mean, map, &features)?;
    let (design, expected) = prepare(&forward_examples(examples, &features, chosen)?, &about, hyper)?;
    let rest = Design { z: &design.z - &expected.at_examples, ..design.clone() };
    Ok(log_density(&rest, hyper)? - log_density(&design, hyper)?)
}

/// Projection for frames with very many channels.
pub(super) fn projection(
    design: &Design,
    prior: &Prior,
    turn: Option<&Turn>,
) -> Result<Option<Mat<f64>>, LocatorError> {
    let most = LocatorOptions::default().max_rank;
    match turn {
        Some(turn) => basis(&turn.copies(design), prior, most),
        None => basis(design, prior, most),
    }
}

/// Every second map position: on a square lattice, the fields of one colour on a chessboard.
fn thinned(map: &SignatureMap, spacing_m: f64) -> SignatureMap {
    let origin = map.positions_m[0];
    let is_kept = |p: &[f64; 2]| {
        let [column, row] = [0, 1].map(|axis| ((p[axis] - origin[axis]) / spacing_m).round() as i64);
        (column + row) % 2 == 0
    };
    let (mut positions_m, mut signatures) = (Vec::new(), Vec::new());
    for (p, row) in map.positions_m.iter().zip(map.signatures.chunks_exact(map.channels)) {
        if is_kept(p) {
            positions_m.push(*p);
            signatures.extend_from_slice(row);
        }
    }
    // A map with few positions is not thinned.
    if positions_m.len() < FEWEST_POSITIONS {
        return map.clone();
    }
    SignatureMap { channels: map.channels, positions_m, signatures }
}

fn channel_prior(sister: &Sister, projection: Option<&Mat<f64>>) -> ChannelPrior {
    let covariance = match projection {
        Some(q) => q.transpose() * &sister.covariance * q,
        None => sister.covariance.clone(),
    };
    ChannelPrior { covariance, examples: SISTER_WORTH }
}
