//! Several touches at once on a skin known only by pokes. A frame is a sum of signatures, y = sum_k a_k s(p_k) + noise.
//!
//! s, the change that a typical poke at p makes, is a Gaussian process with covariance 1 + k(p, p'), k Matern 5/2. A
//! sum of signatures is again Gaussian, so frames of one touch and of several labelled touches teach the same map. Its
//! length and noise maximise the marginal likelihood (Rasmussen & Williams 2006, eq. 2.30). Frames and map are projected
//! on the leading principal directions of the pokes.
//!
//! A new frame is explained greedily: the position that explains most of what is left joins, all positions are then
//! searched again with the others fixed, and the strengths a_k >= 0 are fitted together. Candidates are the places of
//! pokes. A further touch must be stronger than the false second touches found in half of the pokes by a map learned
//! from the other half.

use faer::linalg::solvers::Solve;
use faer::{Mat, MatRef, Side};

use super::copies::{matern52, squared_distance};
use super::data::MIN_CHANNELS;
use super::error::{LocatorError, check_length, check_positions};
use super::fit::evenly;
use super::posterior::extent;
use super::rows::{dot, products};
use crate::typical::median;

/// Maximum number of touches in a frame.
pub const MOST_TOUCHES: usize = 8;
/// Maximum rank of the projection, and maximum number of frames that define it.
const MOST_RANK: usize = 64;
const MOST_PROJECTED: usize = 300;
/// Maximum number of frames from which the map is learned; time grows with their cube.
const MOST_FRAMES: usize = 800;
/// Maximum number of frames that choose length and noise.
const CHOOSING: usize = 300;
/// Candidates of the length, relative to the radius of the pokes, and of the noise variance of a frame relative to the
/// prior variance of a signature.
const LENGTHS: [f64; 4] = [0.2, 0.35, 0.6, 1.0];
const NOISES: [f64; 5] = [0.02, 0.1, 0.5, 2.0, 8.0];
/// Touches whose signatures have a larger cosine than this count as one. With 0.8 instead, the map's errors around a
/// strong touch pass for others: on sums of two pokes of eight measured skins, fewer pairs are counted right.
const MOST_ALIKE: f64 = 0.5;
/// Minimum number of frames held back for the threshold of a further touch, and the maximum used.
const FEWEST_HELD_BACK: usize = 20;
const MOST_HELD_BACK: usize = 200;
/// Share of the frames held back that may show a wrong number of touches, beyond those that always do. The threshold
/// is then raised by `FEW` over their number, since few of them seldom include a bad one.
const WRONG: f64 = 0.02;
const FEW: f64 = 20.0;
/// If the map explains less than `MOST_NOISE` of the median poke, frames are mostly noise, and a first touch must be as
/// strong as a further one. Up to the share `WEAK` of the pokes may then be too weak.
const MOST_NOISE: f64 = 0.5;
const WEAK: f64 = 0.1;
/// Minimum distance of two candidates, relative to the radius of the pokes.
const CANDIDATES_APART: f64 = 0.04;

/// A frame of difference data with the known positions of its touches.
#[derive(Clone, Copy, Debug)]
pub struct LabelledFrame<'a> {
    /// Difference data; NaN where a channel is missing.
    pub frame: &'a [f64],
    /// Positions of all touches, metres; at least one.
    pub touches_m: &'a [[f64; 2]],
}

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
    /// Minimum strength of a further touch relative to the strongest, or to a median poke if that is stronger.
    least_further: f64,
    /// Minimum strength of a first touch, in median pokes.
    least_first: f64,
}

/// Working memory of [`Superposition::explain`], kept by the caller between frames.
#[derive(Clone, Debug, Default)]
pub struct SuperpositionScratch {
    weighted: Vec<f32>,
    projected: Vec<f32>,
    residual: Vec<f32>,
    along: Vec<f32>,
    parts: Vec<Part>,
    trial: Vec<Part>,
}

/// Signatures on the projection.
#[derive(Clone, Debug)]
struct Map {
    rank: usize,
    /// `rank` rows of channels.
    basis: Vec<f32>,
    /// A row of `rank` values for each position.
    signatures: Vec<f32>,
    /// Squared length of each signature.
    squares: Vec<f32>,
}

/// Frames as the map sees them.
struct Sums<'a> {
    touches_m: Vec<&'a [[f64; 2]]>,
    /// Weighted frames in median pokes: frames by channels. Missing channels are zero.
    frames: Mat<f64>,
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
        if labelled.len() < 2 * FEWEST_HELD_BACK {
            return Ok(None);
        }
        let half = |first: usize| (first..labelled.len()).step_by(2).collect::<Vec<_>>();
        let chosen = evenly(labelled.len(), CHOOSING);
        let (sums, typical) = Sums::of(&labelled, weights)?;
        let shape = Shape::choose(&sums.some(&chosen))?;
        let positions_m = candidates(&sums);
        let mut fitted = Self {
            map: Map::fit(&sums.some(&half(0)), &shape, &positions_m)?,
            positions_m,
            weights: weights.iter().map(|weight| weight / typical).collect(),
            least_further: 0.0,
            least_first: 0.0,
        };
        let held_back = half(1);
        let held_back: Vec<LabelledFrame<'_>> =
            evenly(held_back.len(), MOST_HELD_BACK).into_iter().map(|i| labelled[held_back[i]]).collect();
        fitted.set_thresholds(&held_back)?;
        fitted.map = Map::fit(&sums, &shape, &fitted.positions_m)?;
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
    pub fn without_others(&self, frame: &[f64], parts: &[Part], kept: usize, out: &mut Vec<f64>) {
        out.clear();
        out.extend_from_slice(frame);
        let channels = self.channels();
        for part in parts.iter().enumerate().filter(|(number, _)| *number != kept).map(|(_, part)| part) {
            let signature = self.map.signature(part.index);
            for (row, coordinate) in self.map.basis.chunks_exact(channels).zip(signature) {
                let strength = part.share * f64::from(*coordinate);
                for ((value, direction), weight) in out.iter_mut().zip(row).zip(&self.weights) {
                    if *weight > 0.0 {
                        *value -= strength * f64::from(*direction) / weight;
                    }
                }
            }
        }
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
                let signature = self.map.signature(index);
                for k in (0..channels).filter(|&k| self.weights[k] > 0.0 && !frame[k].is_finite()) {
                    let predicted: f32 =
                        (0..self.map.rank).map(|r| self.map.basis[r * channels + k] * signature[r]).sum();
                    scratch.weighted[k] = strength as f32 * predicted;
                }
                products(&self.map.basis, channels, &scratch.weighted, &mut scratch.projected);
            }
        }
        Ok(())
    }

    /// Puts the touches found so far and one more into the trial. Returns the strength of the weakest, relative to the
    /// strongest or to a median poke if that is stronger; of a first touch, its own. `None` if nothing more fits.
    fn try_another(&self, scratch: &mut SuperpositionScratch) -> Option<f64> {
        scratch.trial.clone_from(&scratch.parts);
        self.leave(scratch, usize::MAX);
        let trial = std::mem::take(&mut scratch.trial);
        let found = self.best(scratch, &trial);
        scratch.trial = trial;
        let (index, share) = found?;
        scratch.trial.push(self.part(index, share));
        self.fit_strengths(scratch);
        if scratch.trial.len() > 1 {
            for moved in 0..scratch.trial.len() {
                self.leave(scratch, moved);
                let kept = scratch.trial.swap_remove(moved);
                let trial = std::mem::take(&mut scratch.trial);
                let found = self.best(scratch, &trial);
                scratch.trial = trial;
                scratch.trial.push(found.map_or(kept, |(index, share)| self.part(index, share)));
                let last = scratch.trial.len() - 1;
                scratch.trial.swap(moved, last);
                self.fit_strengths(scratch);
            }
        }
        let shares = scratch.trial.iter().map(|part| part.share);
        let weakest = shares.clone().fold(f64::INFINITY, f64::min);
        if scratch.trial.len() == 1 {
            return Some(weakest);
        }
        Some(weakest / shares.fold(1.0, f64::max))
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
        products(&map.signatures, map.rank, &scratch.residual, &mut scratch.along);
        let mut best = (0.0_f32, None);
        for (p, (along, square)) in scratch.along.iter().zip(&map.squares).enumerate() {
            if *along <= 0.0 || along * along <= best.0 * square {
                continue;
            }
            let signature = map.signature(p);
            let is_alike = |other: &Part| {
                let lengths = f64::from(map.squares[other.index] * square).sqrt();
                f64::from(dot(signature, map.signature(other.index))) > MOST_ALIKE * lengths
            };
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

    /// Chooses the smallest strength of a further touch that gets nearly as many numbers of touches right as any, and
    /// the smallest strength of a first touch.
    fn set_thresholds(&mut self, held_back: &[LabelledFrame<'_>]) -> Result<(), LocatorError> {
        let mut scratch = SuperpositionScratch::default();
        let (mut firsts, mut explained) = (Vec::new(), Vec::new());
        // For each frame, its number of touches and the relative strengths of the second, third and so on.
        let mut further: Vec<(usize, Vec<f64>)> = Vec::new();
        for labelled in held_back {
            self.project(labelled.frame, &mut scratch)?;
            scratch.parts.clear();
            let count = labelled.touches_m.len().min(MOST_TOUCHES - 1);
            let mut strengths = Vec::with_capacity(count);
            for number in 0..=count {
                let Some(strength) = self.try_another(&mut scratch) else { break };
                if number == 0 {
                    firsts.push(strength);
                    let square: f64 = scratch.weighted.iter().map(|v| f64::from(v * v)).sum();
                    let touch = scratch.trial[0];
                    explained.push(touch.share.powi(2) * f64::from(self.map.squares[touch.index]) / square);
                } else {
                    strengths.push(strength);
                }
                std::mem::swap(&mut scratch.parts, &mut scratch.trial);
            }
            further.push((count, strengths));
        }
        let right = |least: f64| {
            let found = |strengths: &[f64]| 1 + strengths.iter().take_while(|strength| **strength >= least).count();
            further.iter().filter(|(count, strengths)| found(strengths) == *count).count() as f64
        };
        let steps = (1..=100).map(|step| 0.01 * f64::from(step));
        let most = steps.clone().map(right).fold(0.0, f64::max);
        let enough = most - WRONG * further.len() as f64;
        let least = steps.clone().find(|least| right(*least) >= enough).unwrap_or(1.0);
        self.least_further = least * (1.0 + FEW / further.len() as f64);
        firsts.sort_by(f64::total_cmp);
        let weak = firsts.get((WEAK * firsts.len() as f64) as usize).copied().unwrap_or(0.0);
        // What noise alone shows is no stronger than a false second touch.
        self.least_first = if median(&explained) < MOST_NOISE { self.least_further.min(weak) } else { 0.0 };
        Ok(())
    }
}

impl<'a> Sums<'a> {
    /// Weighted frames, and the amplitude of the median poke. A frame of one touch is scaled to one median poke.
    fn of(labelled: &[LabelledFrame<'a>], weights: &[f64]) -> Result<(Self, f64), LocatorError> {
        let channels = weights.len();
        let mut frames = Mat::<f64>::zeros(labelled.len(), channels);
        let mut lengths = Vec::with_capacity(labelled.len());
        for (i, labelled) in labelled.iter().enumerate() {
            check_length("frame", channels, labelled.frame.len())?;
            check_positions("touches_m", labelled.touches_m)?;
            if labelled.touches_m.is_empty() {
                return Err(LocatorError::Count { field: "touches of a frame", got: 0, expected: "at least 1" });
            }
            for (k, value) in labelled.frame.iter().enumerate() {
                frames[(i, k)] = if value.is_finite() { value * weights[k] } else { 0.0 };
            }
            let length = frames.row(i).iter().map(|v| v * v).sum::<f64>().sqrt();
            if !(length > 0.0 && length.is_finite()) {
                return Err(LocatorError::EmptyFrame { frame: i });
            }
            lengths.push(length);
        }
        let singles: Vec<f64> =
            labelled.iter().zip(&lengths).filter(|(of, _)| of.touches_m.len() == 1).map(|(_, l)| *l).collect();
        let typical = median(if singles.is_empty() { &lengths } else { &singles });
        for (i, labelled) in labelled.iter().enumerate() {
            let scale = if labelled.touches_m.len() == 1 { lengths[i] } else { typical };
            (0..channels).for_each(|k| frames[(i, k)] /= scale);
        }
        Ok((Self { touches_m: labelled.iter().map(|labelled| labelled.touches_m).collect(), frames }, typical))
    }

    fn some(&self, rows: &[usize]) -> Self {
        Self {
            touches_m: rows.iter().map(|&i| self.touches_m[i]).collect(),
            frames: Mat::from_fn(rows.len(), self.frames.ncols(), |i, k| self.frames[(rows[i], k)]),
        }
    }

    fn len(&self) -> usize {
        self.touches_m.len()
    }

    /// The projection, and the weights of the Gaussian process on it.
    fn regression(&self, shape: &Shape) -> Result<(Mat<f64>, Mat<f64>), LocatorError> {
        let basis = self.basis()?;
        let mut k = covariance(&self.touches_m, &self.touches_m, shape.length_m);
        (0..self.len()).for_each(|i| k[(i, i)] += shape.noise);
        let factor = k.llt(Side::Lower).map_err(|_| LocatorError::Singular { what: "covariance of the pokes" })?;
        let alpha = factor.solve(&self.frames * &basis);
        Ok((basis, alpha))
    }

    /// Positions of all touches.
    fn places_m(&self) -> Vec<[f64; 2]> {
        self.touches_m.iter().flat_map(|touches| touches.iter().copied()).collect()
    }

    /// Orthonormal directions (channels by rank) that span the frames.
    fn basis(&self) -> Result<Mat<f64>, LocatorError> {
        let rows = evenly(self.len(), MOST_PROJECTED);
        let some = self.some(&rows).frames;
        let gram = &some * some.transpose();
        let eigen = gram
            .self_adjoint_eigen(Side::Lower)
            .map_err(|_| LocatorError::Singular { what: "Gram matrix of the pokes" })?;
        let values = eigen.S().column_vector();
        let largest = values[values.nrows() - 1];
        let kept: Vec<usize> =
            (0..values.nrows()).rev().take(MOST_RANK).filter(|&j| values[j] > 1e-9 * largest).collect();
        let combine = Mat::from_fn(rows.len(), kept.len(), |i, j| eigen.U()[(i, kept[j])] / values[kept[j]].sqrt());
        Ok(some.transpose() * &combine)
    }
}

/// Length and noise of the Gaussian process.
struct Shape {
    length_m: f64,
    noise: f64,
}

impl Shape {
    /// The shape with the largest marginal likelihood.
    fn choose(sums: &Sums<'_>) -> Result<Self, LocatorError> {
        let z = &sums.frames * sums.basis()?;
        let radius = extent(&sums.places_m()).max(f64::MIN_POSITIVE);
        let (n, rank) = (sums.len() as f64, z.ncols() as f64);
        let mut best = (f64::NEG_INFINITY, Self { length_m: radius, noise: 1.0 });
        for length_m in LENGTHS.map(|share| share * radius) {
            let among = covariance(&sums.touches_m, &sums.touches_m, length_m);
            for noise in NOISES {
                let mut k = among.clone();
                (0..sums.len()).for_each(|i| k[(i, i)] += noise);
                let Ok(factor) = k.llt(Side::Lower) else { continue };
                let explained = z.transpose() * factor.solve(&z);
                let scale = (0..explained.nrows()).map(|r| explained[(r, r)]).sum::<f64>() / (n * rank);
                let log_determinant: f64 = (0..sums.len()).map(|i| 2.0 * factor.L()[(i, i)].ln()).sum();
                let likelihood = -0.5 * rank * (log_determinant + n * scale.ln());
                if likelihood > best.0 {
                    best = (likelihood, Self { length_m, noise });
                }
            }
        }
        Ok(best.1)
    }
}

/// Covariances of sums of signatures: the sums `a` (rows) with the sums `b` (columns).
fn covariance(a: &[&[[f64; 2]]], b: &[&[[f64; 2]]], length_m: f64) -> Mat<f64> {
    Mat::from_fn(a.len(), b.len(), |i, j| {
        a[i].iter().flat_map(|p| b[j].iter().map(move |q| 1.0 + matern52(*p, *q, length_m))).sum::<f64>()
    })
}

/// The places of pokes, without those next to another.
fn candidates(sums: &Sums<'_>) -> Vec<[f64; 2]> {
    let places_m = sums.places_m();
    let apart2 = (CANDIDATES_APART * extent(&places_m)).powi(2);
    let mut kept: Vec<[f64; 2]> = Vec::new();
    for place_m in places_m {
        if kept.iter().all(|other| squared_distance(*other, place_m) > apart2) {
            kept.push(place_m);
        }
    }
    kept
}

/// A matrix row by row.
fn single_precision(matrix: MatRef<'_, f64>) -> Vec<f32> {
    let rows = (0..matrix.nrows()).flat_map(|row| (0..matrix.ncols()).map(move |column| (row, column)));
    rows.map(|at| matrix[at] as f32).collect()
}

impl Map {
    fn fit(sums: &Sums<'_>, shape: &Shape, positions_m: &[[f64; 2]]) -> Result<Self, LocatorError> {
        let (basis, alpha) = sums.regression(shape)?;
        let rank = alpha.ncols();
        let single: Vec<&[[f64; 2]]> = positions_m.iter().map(std::slice::from_ref).collect();
        let signatures = covariance(&single, &sums.touches_m, shape.length_m) * alpha;
        let signatures = single_precision(signatures.as_ref());
        // A signature of zero explains nothing, and must not be divided by.
        let squares = signatures.chunks_exact(rank).map(|row| dot(row, row).max(f32::MIN_POSITIVE)).collect();
        Ok(Self { rank, basis: single_precision(basis.transpose()), signatures, squares })
    }

    fn signature(&self, position: usize) -> &[f32] {
        &self.signatures[position * self.rank..(position + 1) * self.rank]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHANNELS: usize = 40;
    const SIDE_M: f64 = 0.1;

    /// A channel's change by a touch: a smooth bump about the channel's own place, which is on a grid.
    fn signature(place_m: [f64; 2]) -> Vec<f64> {
        let sensor = |k: usize| [0.02 * (k % 8) as f64 - 0.02, 0.025 * (k / 8) as f64];
        (0..CHANNELS).map(|k| (-squared_distance(sensor(k), place_m) / (2.0 * 0.02_f64.powi(2))).exp()).collect()
    }

    /// A number from -1 to 1 that looks random.
    fn dither(seed: usize) -> f64 {
        let mixed =
            (seed as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29).wrapping_mul(0xD1B5_4A32_D192_ED03);
        (mixed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn place(number: usize) -> [f64; 2] {
        [0, 1].map(|axis| 0.5 * SIDE_M * (1.0 + dither(2 * number + axis)))
    }

    fn frame(touches: &[([f64; 2], f64)], seed: usize) -> Vec<f64> {
        let mut frame: Vec<f64> = (0..CHANNELS).map(|k| 0.02 * dither(9_000_000 + seed * CHANNELS + k)).collect();
        for (place_m, strength) in touches {
            frame.iter_mut().zip(signature(*place_m)).for_each(|(value, change)| *value += strength * change);
        }
        frame
    }

    fn learned() -> Superposition {
        let places: Vec<[f64; 2]> = (0..200).map(place).collect();
        let frames: Vec<Vec<f64>> = places.iter().enumerate().map(|(i, p)| frame(&[(*p, 1.0)], i)).collect();
        let touches = places.iter().map(std::slice::from_ref);
        let labelled: Vec<LabelledFrame<'_>> =
            frames.iter().zip(touches).map(|(frame, touches_m)| LabelledFrame { frame, touches_m }).collect();
        Superposition::fit(&labelled, &[1.0; CHANNELS]).unwrap().unwrap()
    }

    #[test]
    fn one_touch_is_one_and_two_or_three_apart_are_counted_and_placed() {
        let (map, mut scratch) = (learned(), SuperpositionScratch::default());
        let mut right = [0; 4];
        for number in 0..60 {
            let touches: Vec<([f64; 2], f64)> =
                (0..3).map(|touch| (place(5_000 + 3 * number + touch), 0.8 + 0.2 * touch as f64)).collect();
            let are_apart = (0..3).all(|a| (0..a).all(|b| squared_distance(touches[a].0, touches[b].0).sqrt() > 0.05));
            for count in 1..=if are_apart { 3 } else { 1 } {
                let parts = map.explain(&frame(&touches[..count], 50_000 + 4 * number + count), &mut scratch).unwrap();
                let is_near = |place_m: [f64; 2]| {
                    parts.iter().any(|part| squared_distance(part.position_m, place_m).sqrt() < 0.012)
                };
                let is_right = parts.len() == count && touches[..count].iter().all(|(place_m, _)| is_near(*place_m));
                right[count] += usize::from(is_right);
                right[0] += usize::from(count == 3);
            }
        }
        let [triples, single, double, triple] = right;
        assert!(triples >= 5 && single >= 58, "{right:?}");
        assert!(10 * double >= 9 * triples && 10 * triple >= 8 * triples, "{right:?}");
    }

    #[test]
    fn a_frame_without_the_other_touch_is_that_of_one_touch() {
        let (map, mut scratch) = (learned(), SuperpositionScratch::default());
        let both = frame(&[([0.02, 0.03], 1.0), ([0.08, 0.07], 1.0)], 77_777);
        let parts = map.explain(&both, &mut scratch).unwrap().to_vec();
        assert_eq!(parts.len(), 2, "{parts:?}");
        let kept = usize::from(parts[0].position_m[0] > 0.05);
        let mut alone = Vec::new();
        map.without_others(&both, &parts, kept, &mut alone);
        let expected = signature([0.02, 0.03]);
        let product: f64 = alone.iter().zip(&expected).map(|(a, b)| a * b).sum();
        let length = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
        assert!(product / (length(&alone) * length(&expected)) > 0.97, "{alone:?}");
    }

    #[test]
    fn labelled_pairs_teach_as_single_touches_do() {
        let pairs: Vec<[[f64; 2]; 2]> = (0..200).map(|i| [place(2 * i), place(2 * i + 1)]).collect();
        let frames: Vec<Vec<f64>> =
            pairs.iter().enumerate().map(|(i, [a, b])| frame(&[(*a, 1.0), (*b, 1.0)], i)).collect();
        let labelled: Vec<LabelledFrame<'_>> =
            frames.iter().zip(&pairs).map(|(frame, touches_m)| LabelledFrame { frame, touches_m }).collect();
        let map = Superposition::fit(&labelled, &[1.0; CHANNELS]).unwrap().unwrap();
        let mut scratch = SuperpositionScratch::default();
        let parts = map.explain(&frame(&[([0.03, 0.06], 1.0), ([0.08, 0.02], 1.0)], 1), &mut scratch).unwrap();
        assert_eq!(parts.len(), 2, "{parts:?}");
    }

    #[test]
    fn few_frames_frames_of_other_lengths_and_frames_without_touches_are_refused() {
        let frame = vec![1.0; CHANNELS];
        let one = [[0.0, 0.0]];
        let labelled = vec![LabelledFrame { frame: &frame, touches_m: &one }; 2 * FEWEST_HELD_BACK - 1];
        assert!(Superposition::fit(&labelled, &[1.0; CHANNELS]).unwrap().is_none());
        let labelled = vec![LabelledFrame { frame: &frame, touches_m: &one }; 2 * FEWEST_HELD_BACK];
        assert!(matches!(Superposition::fit(&labelled, &[1.0; 3]), Err(LocatorError::Length { .. })));
        let labelled = vec![LabelledFrame { frame: &frame, touches_m: &[] }; 2 * FEWEST_HELD_BACK];
        assert!(matches!(Superposition::fit(&labelled, &[1.0; CHANNELS]), Err(LocatorError::Count { .. })));
        let mut scratch = SuperpositionScratch::default();
        assert!(learned().explain(&[f64::NAN; CHANNELS], &mut scratch).is_err());
    }
}
