//! Several touches at once on a skin known only by pokes. A frame is a sum of signatures, y = sum_k a_k s(p_k) + noise.
//!
//! s, the change that a typical poke at p makes, is a Gaussian process with covariance 1 + k(p, p'), k Matern 5/2. A
//! sum of signatures is again Gaussian, so frames of one touch and of several labelled touches teach the same map. Its
//! length and noise maximise the marginal likelihood (Rasmussen & Williams 2006, eq. 2.30). Frames and map are
//! projected on the leading principal directions of the pokes, and weighted by the covariance of the map's errors in
//! frames left out.
//!
//! A new frame is explained greedily: the position that explains most of what is left joins, all positions are then
//! searched again with the others fixed, and the strengths a_k >= 0 are fitted together. Candidates are the places of
//! pokes. A further touch must be stronger than the false second touches found in each poke by the map of the others.

mod map;

use super::data::MIN_CHANNELS;
use super::error::{LocatorError, check_length};
use super::rows::{dot, products};
use crate::plane::squared_distance;
use crate::statistics::{evenly, median};
pub use map::LabelledFrame;
use map::{Learned, Map, Shape, Sums, candidates};

/// Maximum number of touches in a frame.
pub const MOST_TOUCHES: usize = 8;
/// Maximum number of frames from which the map is learned; time grows with their cube.
const MOST_FRAMES: usize = 800;
/// Maximum number of frames that choose length and noise.
const CHOOSING: usize = 300;
/// Touches whose signatures, before weighting, have a larger cosine than this count as one. With 0.8 instead, the map's
/// errors around a strong touch pass for others: on sums of two pokes of eight measured skins, fewer pairs are counted
/// right.
const MOST_ALIKE: f64 = 0.5;
/// Minimum number of frames, and the maximum that choose the threshold of a further touch.
const FEWEST: usize = 40;
const MOST_LEFT_OUT: usize = 200;
/// Share of these frames that may show a wrong number of touches, beyond those that always do. The threshold is then
/// raised by `FEW` over their number, since few of them seldom include a bad one.
const WRONG: f64 = 0.005;
const FEW: f64 = 10.0;
/// Standard deviations by which one position explains a frame better than another if it clearly does.
const CLEARLY: f64 = 3.0;
/// Maximum number of times that all positions are searched again.
const MOST_SWEEPS: usize = 4;
/// If the map explains less than `MOST_NOISE` of the median poke, frames are mostly noise, and a first touch must be as
/// strong as a further one. Up to the share `WEAK` of the pokes may then be too weak.
const MOST_NOISE: f64 = 0.5;
const WEAK: f64 = 0.1;

/// One of the touches that together explain a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Position of the poke that it resembles most, metres.
    pub position_m: [f64; 2],
    /// Strength in median pokes.
    pub share: f64,
    index: usize,
}

/// The signatures of touches over the skin, whose sums explain frames.
#[derive(Clone, Debug)]
pub struct Superposition {
    positions_m: Vec<[f64; 2]>,
    /// Weight of each channel, divided by the amplitude of the median poke; 0 if it is never used.
    weights: Vec<f64>,
    map: Map,
    /// Unweighted signatures of unit length, by which touches are told apart: a row for each position.
    shapes: Vec<f32>,
    /// Minimum strength of a further touch relative to the RMS sum of the others, or to a median poke if that is
    /// stronger.
    least_further: f64,
    /// Minimum strength of a first touch, in median pokes.
    least_first: f64,
}

/// Strengths found in frames by a map learned without them.
#[derive(Default)]
struct LeftOut {
    /// Strengths of the first touches.
    firsts: Vec<f64>,
    /// For each frame, its number of touches and the relative strengths of the second, third and so on.
    further: Vec<(usize, Vec<f64>)>,
}

/// Working memory of [`Superposition::explain`], kept by the caller between frames.
#[derive(Clone, Debug, Default)]
pub struct SuperpositionScratch {
    weighted: Vec<f32>,
    projected: Vec<f32>,
    residual: Vec<f32>,
    predicted: Vec<f64>,
    along: Vec<f32>,
    parts: Vec<Part>,
    trial: Vec<Part>,
}

impl Superposition {
    /// Learns the signatures from labelled frames. `weights` is the weight of each channel, usually one over its noise,
    /// and 0 if it is unused. `None` with too few frames for a threshold.
    ///
    /// # Errors
    /// Frames or weights of different lengths, frames without touches or without readings, degenerate frames.
    pub fn fit(labelled: &[LabelledFrame<'_>], weights: &[f64]) -> Result<Option<Self>, LocatorError> {
        let labelled: Vec<LabelledFrame<'_>> =
            evenly(labelled.len(), MOST_FRAMES).into_iter().map(|i| labelled[i]).collect();
        if labelled.len() < FEWEST {
            return Ok(None);
        }
        let (sums, typical) = Sums::of(&labelled, weights)?;
        let shape = Shape::choose(&sums.some(&evenly(labelled.len(), CHOOSING)))?;
        let positions_m = candidates(&sums);
        let learned = Learned::of(&sums, &shape, &positions_m)?;
        let all: Vec<usize> = (0..labelled.len()).collect();
        let mut fitted = Self {
            map: learned.map(&all)?.0,
            shapes: learned.shapes(),
            positions_m,
            weights: weights.iter().map(|weight| weight / typical).collect(),
            least_further: 0.0,
            least_first: 0.0,
        };
        let left_out = fitted.clone().leave_out(&labelled, &learned)?;
        fitted.set_thresholds(&labelled, left_out)?;
        Ok(Some(fitted))
    }

    /// Number of channels a frame must have.
    pub fn channels(&self) -> usize {
        self.weights.len()
    }

    /// The touches that together explain a frame of difference data, strongest first. Empty if it shows none.
    ///
    /// # Errors
    /// A frame of the wrong length, or with too few channels.
    pub fn explain<'a>(
        &self,
        frame: &[f64],
        scratch: &'a mut SuperpositionScratch,
    ) -> Result<&'a [Part], LocatorError> {
        self.project(frame, scratch)?;
        scratch.parts.clear();
        while scratch.parts.len() < MOST_TOUCHES {
            let Some(share) = self.try_another(scratch) else { break };
            let is_touch =
                if scratch.parts.is_empty() { share >= self.least_first } else { share >= self.least_further };
            if !is_touch {
                break;
            }
            std::mem::swap(&mut scratch.parts, &mut scratch.trial);
        }
        scratch.parts.sort_by(|a, b| b.share.total_cmp(&a.share));
        Ok(&scratch.parts)
    }

    /// A frame without the touches other than the one numbered `kept`.
    pub fn without_others(
        &self,
        frame: &[f64],
        parts: &[Part],
        kept: usize,
        scratch: &mut SuperpositionScratch,
        out: &mut Vec<f64>,
    ) {
        out.clear();
        out.extend_from_slice(frame);
        for (_, part) in parts.iter().enumerate().filter(|(number, _)| *number != kept) {
            self.map.channels_of(part.index, part.share, &mut scratch.predicted);
            for ((value, predicted), weight) in out.iter_mut().zip(&scratch.predicted).zip(&self.weights) {
                if *weight > 0.0 {
                    *value -= predicted / weight;
                }
            }
        }
    }

    /// True if a frame of one touch clearly shows it at the part's position rather than at another.
    ///
    /// # Errors
    /// As [`Superposition::explain`].
    pub fn is_rather_at(
        &self,
        part: &Part,
        other_m: [f64; 2],
        frame: &[f64],
        scratch: &mut SuperpositionScratch,
    ) -> Result<bool, LocatorError> {
        let away = |index: usize| squared_distance(self.positions_m[index], other_m);
        let Some(other) = (0..self.positions_m.len()).min_by(|a, b| away(*a).total_cmp(&away(*b))) else {
            return Ok(false);
        };
        self.project(frame, scratch)?;
        let explained = |index: usize| {
            let along = dot(self.map.signature(index), &scratch.projected).max(0.0);
            f64::from(along * along / self.map.squares[index])
        };
        Ok(explained(part.index) - explained(other) > CLEARLY.powi(2) * self.map.error_variance)
    }

    /// Projects a weighted frame. Missing channels are filled with what the best single touch predicts.
    fn project(&self, frame: &[f64], scratch: &mut SuperpositionScratch) -> Result<(), LocatorError> {
        let channels = self.channels();
        check_length("frame", channels, frame.len())?;
        let is_usable = |k: usize| self.weights[k] > 0.0 && frame[k].is_finite();
        let usable = (0..channels).filter(|&k| is_usable(k)).count();
        if usable < MIN_CHANNELS {
            return Err(LocatorError::TooFewChannels { frame: 0, got: usable, expected: MIN_CHANNELS });
        }
        scratch.weighted.clear();
        scratch
            .weighted
            .extend((0..channels).map(|k| if is_usable(k) { (frame[k] * self.weights[k]) as f32 } else { 0.0 }));
        scratch.projected.resize(self.map.rank, 0.0);
        scratch.along.resize(self.positions_m.len(), 0.0);
        products(&self.map.basis, channels, &scratch.weighted, &mut scratch.projected);
        if usable < self.weights.iter().filter(|weight| **weight > 0.0).count() {
            scratch.residual.clone_from(&scratch.projected);
            if let Some((index, strength)) = self.best(scratch, &[]) {
                self.map.channels_of(index, strength, &mut scratch.predicted);
                for k in (0..channels).filter(|&k| self.weights[k] > 0.0 && !frame[k].is_finite()) {
                    scratch.weighted[k] = scratch.predicted[k] as f32;
                }
                products(&self.map.basis, channels, &scratch.weighted, &mut scratch.projected);
            }
        }
        Ok(())
    }

    /// Puts the touches found so far and one more into the trial. Returns the strength of the weakest, relative to the
    /// RMS sum of the others or to a median poke if that is stronger; of a first touch, its own. `None` if nothing more
    /// fits.
    fn try_another(&self, scratch: &mut SuperpositionScratch) -> Option<f64> {
        scratch.trial.clone_from(&scratch.parts);
        self.leave(scratch, usize::MAX);
        let trial = std::mem::take(&mut scratch.trial);
        let found = self.best(scratch, &trial);
        scratch.trial = trial;
        let (index, share) = found?;
        scratch.trial.push(self.part(index, share));
        self.fit_strengths(scratch);
        for _ in 0..MOST_SWEEPS {
            if scratch.trial.len() < 2 || !self.search_again(scratch) {
                break;
            }
        }
        let weakest = scratch.trial.iter().map(|part| part.share).fold(f64::INFINITY, f64::min);
        if scratch.trial.len() == 1 {
            return Some(weakest);
        }
        // The map's errors at the other touches add in quadrature.
        let squares: f64 = scratch.trial.iter().map(|part| part.share.powi(2)).sum();
        Some(weakest / (squares - weakest.powi(2)).sqrt().max(1.0))
    }

    /// Searches the position of each part again, with the others fixed. Returns true if one has moved.
    fn search_again(&self, scratch: &mut SuperpositionScratch) -> bool {
        let mut has_moved = false;
        for number in 0..scratch.trial.len() {
            self.leave(scratch, number);
            let kept = scratch.trial.swap_remove(number);
            let trial = std::mem::take(&mut scratch.trial);
            let found = self.best(scratch, &trial).map_or(kept, |(index, share)| self.part(index, share));
            scratch.trial = trial;
            scratch.trial.push(found);
            let last = scratch.trial.len() - 1;
            scratch.trial.swap(number, last);
            has_moved |= found.index != kept.index;
            self.fit_strengths(scratch);
        }
        has_moved
    }

    fn part(&self, index: usize, share: f64) -> Part {
        Part { position_m: self.positions_m[index], share, index }
    }

    /// What is left of the frame without the parts of the trial, other than the one numbered `but`.
    fn leave(&self, scratch: &mut SuperpositionScratch, but: usize) {
        scratch.residual.clone_from(&scratch.projected);
        for (number, part) in scratch.trial.iter().enumerate() {
            if number != but {
                let strength = part.share as f32;
                let signature = self.map.signature(part.index);
                scratch.residual.iter_mut().zip(signature).for_each(|(value, s)| *value -= strength * s);
            }
        }
    }

    /// The position that explains most of the residual, with its strength, unlike those of `others`.
    fn best(&self, scratch: &mut SuperpositionScratch, others: &[Part]) -> Option<(usize, f64)> {
        let map = &self.map;
        let shape = |position: usize| &self.shapes[position * map.rank..(position + 1) * map.rank];
        products(&map.signatures, map.rank, &scratch.residual, &mut scratch.along);
        let mut best = (0.0_f32, None);
        for (p, (along, square)) in scratch.along.iter().zip(&map.squares).enumerate() {
            if *along <= 0.0 || along * along <= best.0 * square {
                continue;
            }
            let is_alike = |other: &Part| f64::from(dot(shape(p), shape(other.index))) > MOST_ALIKE;
            if !others.iter().any(is_alike) {
                best = (along * along / square, Some((p, f64::from(along / square))));
            }
        }
        best.1
    }

    /// Fits the strengths of the trial's parts together, none below zero, by coordinate descent.
    fn fit_strengths(&self, scratch: &mut SuperpositionScratch) {
        const SWEEPS: usize = 30;
        let mut gram = [[0.0_f64; MOST_TOUCHES + 1]; MOST_TOUCHES + 1];
        let mut along = [0.0_f64; MOST_TOUCHES + 1];
        for (i, a) in scratch.trial.iter().enumerate() {
            along[i] = f64::from(dot(self.map.signature(a.index), &scratch.projected));
            for (j, b) in scratch.trial.iter().enumerate() {
                gram[i][j] = f64::from(dot(self.map.signature(a.index), self.map.signature(b.index)));
            }
        }
        for _ in 0..SWEEPS {
            for i in 0..scratch.trial.len() {
                let others: f64 =
                    scratch.trial.iter().enumerate().filter(|(j, _)| *j != i).map(|(j, b)| gram[i][j] * b.share).sum();
                scratch.trial[i].share = ((along[i] - others) / gram[i][i]).max(0.0);
            }
        }
    }

    /// Share of the median frame's energy that its best touch explains, by the map of all frames. A map of too few
    /// frames explains little of another one, even without noise.
    fn explained(
        &self,
        labelled: &[LabelledFrame<'_>],
        scratch: &mut SuperpositionScratch,
    ) -> Result<f64, LocatorError> {
        let mut shares = Vec::with_capacity(labelled.len().min(MOST_LEFT_OUT));
        for number in evenly(labelled.len(), MOST_LEFT_OUT) {
            self.project(labelled[number].frame, scratch)?;
            scratch.parts.clear();
            if self.try_another(scratch).is_some() {
                let touch = scratch.trial[0];
                self.map.channels_of(touch.index, touch.share, &mut scratch.predicted);
                let square = |value: f64| value * value;
                let weighted = || scratch.weighted.iter().map(|value| f64::from(*value));
                let left: f64 =
                    weighted().zip(&scratch.predicted).map(|(value, predicted)| square(value - predicted)).sum();
                shares.push(1.0 - left / weighted().map(square).sum::<f64>());
            }
        }
        Ok(if shares.is_empty() { 0.0 } else { median(&shares) })
    }

    /// Strengths found in each frame by a map learned without it. Each half of the frames is weighted by the errors in
    /// the other half, since frames that weight a map show smaller errors than new ones do.
    fn leave_out(mut self, labelled: &[LabelledFrame<'_>], learned: &Learned) -> Result<LeftOut, LocatorError> {
        let (mut scratch, mut left_out) = (SuperpositionScratch::default(), LeftOut::default());
        for half in 0..2 {
            let (judged, weighting): (Vec<usize>, Vec<usize>) = (0..labelled.len()).partition(|i| i % 2 == half);
            let (map, alpha) = learned.map(&weighting)?;
            self.map = map.clone();
            for number in evenly(judged.len(), MOST_LEFT_OUT / 2).into_iter().map(|k| judged[k]) {
                self.map.leave_out(&map, &alpha, learned, number);
                self.project(labelled[number].frame, &mut scratch)?;
                scratch.parts.clear();
                let count = labelled[number].touches_m.len().min(MOST_TOUCHES - 1);
                let mut strengths = Vec::with_capacity(count);
                for touch in 0..=count {
                    let Some(strength) = self.try_another(&mut scratch) else { break };
                    if touch == 0 {
                        left_out.firsts.push(strength);
                    } else {
                        strengths.push(strength);
                    }
                    std::mem::swap(&mut scratch.parts, &mut scratch.trial);
                }
                left_out.further.push((count, strengths));
            }
        }
        Ok(left_out)
    }

    /// Chooses the minimum strength of a further touch, such that nearly as many numbers of touches are right as with
    /// any, and that of a first touch.
    fn set_thresholds(&mut self, labelled: &[LabelledFrame<'_>], left_out: LeftOut) -> Result<(), LocatorError> {
        let LeftOut { mut firsts, further } = left_out;
        let explained = self.explained(labelled, &mut SuperpositionScratch::default())?;
        let right = |least: f64| {
            let found = |strengths: &[f64]| 1 + strengths.iter().take_while(|strength| **strength >= least).count();
            further.iter().filter(|(count, strengths)| found(strengths) == *count).count() as f64
        };
        let steps = (1..=100).map(|step| 0.01 * f64::from(step));
        let most = steps.clone().map(right).fold(0.0, f64::max);
        let enough = most - WRONG * further.len() as f64;
        let mut good = steps.filter(|least| right(*least) >= enough);
        let least = good.next().unwrap_or(1.0);
        let has_several = further.iter().any(|(count, _)| *count > 1);
        self.least_further = match good.next_back() {
            // In the middle between the false touches and the weakest true ones.
            Some(most) if has_several => (least * most).sqrt(),
            _ => least * (1.0 + FEW / further.len() as f64),
        };
        firsts.sort_by(f64::total_cmp);
        let weak = firsts.get((WEAK * firsts.len() as f64) as usize).copied().unwrap_or(0.0);
        // What noise alone shows is no stronger than a false second touch.
        self.least_first = if explained < MOST_NOISE { self.least_further.min(weak) } else { 0.0 };
        Ok(())
    }
}

#[cfg(test)]
mod tests;
