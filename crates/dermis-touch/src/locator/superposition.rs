//! Several touches at once on a skin known only by pokes. A frame is a sum of signatures, y = sum_k a_k s(p_k) + noise.
//!
//! s, the change that a typical poke at p makes, is a Gaussian process with covariance c + k(p, p'), k Matern 5/2. A
//! sum of signatures is again Gaussian, so frames of one touch and of several labelled touches teach the same map. Its
//! length and noise maximise the marginal likelihood (Rasmussen & Williams 2006, eq. 2.30). Frames and map are
//! projected on the leading principal directions of the pokes, and weighted by the covariance of the map's errors in
//! frames left out.
//!
//! A new frame is explained greedily: the position that explains most of what is left joins, all positions are then
//! searched again with the others fixed, and the strengths a_k >= 0 are fitted together. Candidates are the places of
//! pokes. Each touch needs evidence: the frame must be far more probable with all touches than without this one,
//! whatever their strengths. The threshold counts touches best in pokes, and in sums of two of them, by a map learned
//! from the others.

mod evidence;
mod map;

use super::data::MIN_CHANNELS;
use super::error::{LocatorError, check_length};
use super::posterior::extent;
use super::rows::{dot, products};
use crate::plane::squared_distance;
use crate::statistics::{evenly, median};
pub use map::LabelledFrame;
use map::{Learned, Map, Shape, Sums, candidates, equal_weights};

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
/// Number of parts of the frames. The map of the others judges each part.
const PARTS: usize = 10;
/// Sums of two frames of one touch are judged as well, if the touches are this far apart relative to the radius of the
/// pokes. A real frame counts for as many as `REAL` sums, since false second touches are worse than missed ones.
const SUMS_APART: f64 = 0.5;
const REAL: f64 = 18.0;
/// Share of the frames that may show a wrong number of touches, beyond those that always do.
const WRONG: f64 = 0.005;
/// The threshold is raised by this over the number of frames, since few of them seldom include a bad one.
const FEW: f64 = 20.0;
/// Standard deviations by which one position explains a frame better than another if it clearly does.
const CLEARLY: f64 = 3.0;
/// Maximum number of times that all positions are searched again.
const MOST_SWEEPS: usize = 4;
/// If the map explains less than `MOST_NOISE` of the median poke, frames are mostly noise, and a first touch needs as
/// much evidence as a further one. Up to the share `WEAK` of the pokes may then be too weak.
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
    /// Strength at which a map finds the typical poke near each position that it was not taught, in median pokes.
    typical: Vec<f64>,
    /// Minimum evidence for each of several touches, in standard deviations.
    least_further: f64,
    /// The same of a single touch.
    least_first: f64,
}

/// Evidence found in frames by a map learned without them.
#[derive(Default)]
struct LeftOut {
    /// Evidence for the first touches.
    firsts: Vec<f64>,
    further: Vec<Judged>,
}

/// A frame judged by a map learned without it.
struct Judged {
    touches: usize,
    /// The least evidence with two touches, three and so on, up to one too many.
    evidence: Vec<f64>,
    /// How much the frame counts.
    weight: f64,
}

impl Judged {
    fn is_right(&self, least: f64) -> bool {
        1 + self.evidence.iter().take_while(|evidence| **evidence >= least).count() == self.touches
    }
}

/// Working memory of [`Superposition::explain`], kept by the caller between frames.
#[derive(Clone, Debug, Default)]
pub struct SuperpositionScratch {
    weighted: Vec<f32>,
    projected: Vec<f32>,
    predicted: Vec<f64>,
    /// Inner products of the signatures with the projected frame, and with what the trial leaves of it.
    along: Vec<f32>,
    left: Vec<f32>,
    columns: Columns,
    parts: Vec<Part>,
    trial: Vec<Part>,
    /// Strength of the best single touch, relative to that which is typical at its place.
    gain: f64,
}

/// Inner products of all signatures with those of the positions tried in a frame.
#[derive(Clone, Debug, Default)]
struct Columns {
    positions: Vec<usize>,
    /// A column for each position, and memory for more.
    values: Vec<Vec<f32>>,
}

impl Columns {
    fn of(&self, position: usize) -> &[f32] {
        let number =
            self.positions.iter().position(|held| *held == position).expect("the column of every part is held");
        &self.values[number]
    }

    fn hold(&mut self, map: &Map, position: usize) {
        if self.positions.contains(&position) {
            return;
        }
        let number = self.positions.len();
        if number == self.values.len() {
            self.values.push(Vec::new());
        }
        self.values[number].resize(map.squares.len(), 0.0);
        products(&map.signatures, map.rank, map.signature(position), &mut self.values[number]);
        self.positions.push(position);
    }
}

impl Superposition {
    /// Learns the signatures from labelled frames, with each channel scaled to the same RMS in them. Channels for which
    /// `is_used` is false are left out. `None` with too few frames for a threshold.
    ///
    /// # Errors
    /// Frames of another length than `is_used`, frames without touches or without readings, degenerate frames.
    pub fn fit(labelled: &[LabelledFrame<'_>], is_used: &[bool]) -> Result<Option<Self>, LocatorError> {
        let labelled: Vec<LabelledFrame<'_>> =
            evenly(labelled.len(), MOST_FRAMES).into_iter().map(|i| labelled[i]).collect();
        if labelled.len() < FEWEST {
            return Ok(None);
        }
        let weights = equal_weights(&labelled, is_used)?;
        let (sums, typical) = Sums::of(&labelled, &weights)?;
        let shape = Shape::choose(&sums.some(&evenly(labelled.len(), CHOOSING)))?;
        let positions_m = candidates(&sums);
        let learned = Learned::of(&sums, &shape, &positions_m)?;
        let (map, alpha) = learned.map(&(0..labelled.len()).collect::<Vec<_>>())?;
        let mut fitted = Self {
            shapes: learned.shapes(),
            typical: learned.typical(&map, &alpha, &sums, &positions_m),
            map,
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
        self.begin(frame, scratch)?;
        while scratch.parts.len() < MOST_TOUCHES {
            let Some(evidence) = self.try_another(scratch) else { break };
            if evidence < if scratch.parts.is_empty() { self.least_first } else { self.least_further } {
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

    /// Prepares to explain a frame.
    fn begin(&self, frame: &[f64], scratch: &mut SuperpositionScratch) -> Result<(), LocatorError> {
        self.project(frame, scratch)?;
        self.match_signatures(scratch);
        scratch.columns.positions.clear();
        scratch.parts.clear();
        Ok(())
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
        products(&self.map.basis, channels, &scratch.weighted, &mut scratch.projected);
        if usable < self.weights.iter().filter(|weight| **weight > 0.0).count() {
            self.match_signatures(scratch);
            scratch.trial.clear();
            if let Some(part) = self.best(scratch, usize::MAX) {
                self.map.channels_of(part.index, part.share, &mut scratch.predicted);
                for k in (0..channels).filter(|&k| self.weights[k] > 0.0 && !frame[k].is_finite()) {
                    scratch.weighted[k] = scratch.predicted[k] as f32;
                }
                products(&self.map.basis, channels, &scratch.weighted, &mut scratch.projected);
            }
        }
        Ok(())
    }

    fn match_signatures(&self, scratch: &mut SuperpositionScratch) {
        scratch.along.resize(self.positions_m.len(), 0.0);
        products(&self.map.signatures, self.map.rank, &scratch.projected, &mut scratch.along);
    }

    /// Puts the touches found so far and one more into the trial. Returns the evidence for the least certain one, or
    /// `None` if nothing more fits.
    fn try_another(&self, scratch: &mut SuperpositionScratch) -> Option<f64> {
        scratch.trial.clone_from(&scratch.parts);
        let found = self.best(scratch, usize::MAX)?;
        scratch.columns.hold(&self.map, found.index);
        scratch.trial.push(found);
        self.fit_strengths(scratch);
        for _ in 0..MOST_SWEEPS {
            if scratch.trial.len() < 2 || !self.search_again(scratch) {
                break;
            }
        }
        // The best single touch tells how strong the frame is: halves of it, if it is split, are weaker.
        if let [alone] = scratch.trial[..] {
            scratch.gain = 1.0;
            let evidence = self.evidence(scratch, 0);
            scratch.gain = alone.share / self.typical[alone.index];
            return Some(evidence);
        }
        let evidence = (0..scratch.trial.len()).map(|part| self.evidence(scratch, part));
        Some(evidence.fold(f64::INFINITY, f64::min))
    }

    /// Searches the position of each part again, with the others fixed. Returns true if one has moved.
    fn search_again(&self, scratch: &mut SuperpositionScratch) -> bool {
        let mut has_moved = false;
        for number in 0..scratch.trial.len() {
            let Some(found) = self.best(scratch, number) else { continue };
            has_moved |= found.index != scratch.trial[number].index;
            scratch.columns.hold(&self.map, found.index);
            scratch.trial[number] = found;
            self.fit_strengths(scratch);
        }
        has_moved
    }

    /// The best position for one more touch: it explains most of what the trial leaves of the frame. Positions that
    /// look like one of the trial's are skipped. The trial's part numbered `but` is ignored.
    fn best(&self, scratch: &mut SuperpositionScratch, but: usize) -> Option<Part> {
        let SuperpositionScratch { along, left, columns, trial, .. } = scratch;
        let others = || trial.iter().enumerate().filter(|(number, _)| *number != but).map(|(_, part)| part);
        left.clone_from(along);
        for other in others() {
            let strength = other.share as f32;
            left.iter_mut().zip(columns.of(other.index)).for_each(|(value, column)| *value -= strength * column);
        }
        let rank = self.map.rank;
        let shape = |position: usize| &self.shapes[position * rank..(position + 1) * rank];
        let is_alike = |a: usize, b: usize| f64::from(dot(shape(a), shape(b))) > MOST_ALIKE;
        let mut best = (0.0_f32, None);
        for (index, (along, square)) in left.iter().zip(&self.map.squares).enumerate() {
            if *along <= 0.0 || along * along <= best.0 * square || others().any(|other| is_alike(index, other.index)) {
                continue;
            }
            let share = f64::from(along / square);
            best = (along * along / square, Some(Part { position_m: self.positions_m[index], share, index }));
        }
        best.1
    }

    /// Fits the strengths of the trial's parts together, none below zero, by coordinate descent.
    fn fit_strengths(&self, scratch: &mut SuperpositionScratch) {
        const SWEEPS: usize = 30;
        let SuperpositionScratch { along, columns, trial, .. } = scratch;
        let mut gram = [[0.0_f64; MOST_TOUCHES + 1]; MOST_TOUCHES + 1];
        for (row, a) in gram.iter_mut().zip(trial.iter()) {
            let column = columns.of(a.index);
            row.iter_mut().zip(trial.iter()).for_each(|(value, b)| *value = f64::from(column[b.index]));
        }
        for _ in 0..SWEEPS {
            for i in 0..trial.len() {
                let others: f64 = (0..trial.len()).filter(|j| *j != i).map(|j| gram[i][j] * trial[j].share).sum();
                trial[i].share = ((f64::from(along[trial[i].index]) - others) / gram[i][i]).max(0.0);
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
            self.begin(labelled[number].frame, scratch)?;
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

    /// Evidence found in each frame, and in sums of two, by a map learned without them. A part's own errors don't
    /// weight the map that judges it, since its frames would then fit too well.
    fn leave_out(mut self, labelled: &[LabelledFrame<'_>], learned: &Learned) -> Result<LeftOut, LocatorError> {
        let (mut scratch, mut left_out) = (SuperpositionScratch::default(), LeftOut::default());
        let apart2 = (SUMS_APART * extent(&self.positions_m)).powi(2);
        let are_apart = |a: usize, b: usize| {
            let touches_m = (labelled[a].touches_m, labelled[b].touches_m);
            matches!(touches_m, ([a_m], [b_m]) if squared_distance(*a_m, *b_m) >= apart2)
        };
        for part in 0..PARTS {
            let (judged, weighting): (Vec<usize>, Vec<usize>) = (0..labelled.len()).partition(|i| i % PARTS == part);
            let (map, alpha) = learned.map(&weighting)?;
            let some: Vec<usize> = evenly(judged.len(), MOST_LEFT_OUT / PARTS).into_iter().map(|k| judged[k]).collect();
            for (place, &number) in some.iter().enumerate() {
                self.map.clone_from(&map);
                self.map.leave_out(&alpha, learned, number);
                let LabelledFrame { frame, touches_m } = labelled[number];
                let touches = touches_m.len().min(MOST_TOUCHES - 1);
                let (first, evidence) = self.least_evidence(frame, touches, &mut scratch)?;
                left_out.firsts.extend(first);
                left_out.further.push(Judged { touches, evidence, weight: REAL });
                let others = some[place + 1..].iter().chain(&some[..place]);
                let Some(other) = others.copied().find(|&other| are_apart(number, other)) else { continue };
                self.map.leave_out(&alpha, learned, other);
                let sum: Vec<f64> = frame.iter().zip(labelled[other].frame).map(|(a, b)| a + b).collect();
                // A sum of two frames has the noise of both.
                self.map.error_variance *= 2.0;
                let (_, evidence) = self.least_evidence(&sum, 2, &mut scratch)?;
                left_out.further.push(Judged { touches: 2, evidence, weight: 1.0 });
            }
        }
        Ok(left_out)
    }

    /// Evidence for a frame's first touch, and the least with two, three and so on, up to one more than `touches`.
    fn least_evidence(
        &self,
        frame: &[f64],
        touches: usize,
        scratch: &mut SuperpositionScratch,
    ) -> Result<(Option<f64>, Vec<f64>), LocatorError> {
        self.begin(frame, scratch)?;
        let (mut first, mut further) = (None, Vec::with_capacity(touches));
        for touch in 0..=touches {
            let Some(evidence) = self.try_another(scratch) else { break };
            if touch == 0 {
                first = Some(evidence);
            } else {
                further.push(evidence);
            }
            std::mem::swap(&mut scratch.parts, &mut scratch.trial);
        }
        Ok((first, further))
    }

    /// Chooses the minimum evidence for a further touch, such that nearly as many numbers of touches are right as with
    /// any, and that for a first touch.
    fn set_thresholds(&mut self, labelled: &[LabelledFrame<'_>], left_out: LeftOut) -> Result<(), LocatorError> {
        let LeftOut { mut firsts, further } = left_out;
        let explained = self.explained(labelled, &mut SuperpositionScratch::default())?;
        let right = |least: f64| {
            let right = further.iter().filter(|judged| judged.is_right(least));
            right.map(|judged| judged.weight).sum::<f64>()
        };
        let steps = (0..=250).map(|step| 0.1 * 1.025_f64.powi(step));
        let most = steps.clone().map(right).fold(0.0, f64::max);
        let enough = most - WRONG * further.iter().map(|judged| judged.weight).sum::<f64>();
        let mut good = steps.filter(|least| right(*least) >= enough);
        let least = good.next().unwrap_or(1.0);
        // In the middle between the false touches and the weakest true ones.
        let middle = (least * good.next_back().unwrap_or(least)).sqrt();
        self.least_further = middle * (1.0 + FEW / labelled.len() as f64);
        firsts.sort_by(f64::total_cmp);
        let weak = firsts.get((WEAK * firsts.len() as f64) as usize).copied().unwrap_or(0.0);
        // What noise alone shows is no stronger than a false second touch.
        self.least_first = if explained < MOST_NOISE { self.least_further.min(weak) } else { 0.0 };
        Ok(())
    }
}

#[cfg(test)]
mod tests;
