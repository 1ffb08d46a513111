//! The signatures of touches over the skin as a Gaussian process, learned from frames of one or several touches.

use faer::linalg::solvers::{DenseSolveCore, Solve};
use faer::{Mat, MatRef, Side};

use crate::locator::error::{LocatorError, check_length, check_positions};
use crate::locator::pair_correlations::matern52;
use crate::locator::posterior::extent;
use crate::locator::rows::{dot, products};
use crate::plane::squared_distance;
use crate::statistics::{evenly, median};

/// Maximum rank of the projection, and maximum number of frames that define it.
const MOST_RANK: usize = 128;
const MOST_PROJECTED: usize = 600;
/// Maximum numbers of frames and of positions that the variance of errors is taken from.
const MOST_VARIANCE_FRAMES: usize = 200;
const MOST_VARIANCE_POSITIONS: usize = 50;
/// Candidates of the length, relative to the radius of the pokes, and of the noise variance of a frame relative to the
/// prior variance of a signature.
const LENGTHS: [f64; 4] = [0.2, 0.35, 0.6, 1.0];
const NOISES: [f64; 5] = [0.02, 0.1, 0.5, 2.0, 8.0];
/// Prior variance of the signature that all touches share, relative to that of their differences. With 1 instead, six
/// places poked nine times each have 28 to 30 % of their patterns right, not 28 to 35 %.
const COMMON: f64 = 0.3;
/// Minimum strength of a typical touch, in median pokes: below it, a touch is not seen at all.
const LEAST_TYPICAL: f64 = 0.05;
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

/// Signatures on the projection, in which the errors of the map are alike and independent.
#[derive(Clone, Debug)]
pub(super) struct Map {
    pub rank: usize,
    /// Projects frames: `rank` rows of channels.
    pub basis: Vec<f32>,
    /// Leads back from the projection: `rank` rows of channels.
    pub lift: Vec<f32>,
    /// A row of `rank` values for each position.
    pub signatures: Vec<f32>,
    /// Squared length of each signature.
    pub squares: Vec<f32>,
    /// Variance of frames about the map, along its signatures.
    pub error_variance: f64,
    /// Share of this variance at a typical touch that is noise: it doesn't grow with the strength of the touch.
    pub noise_share: f64,
}

/// The signatures learned from frames, not yet weighted by their errors.
pub(super) struct Learned {
    /// Orthonormal directions that span the frames: channels by rank.
    basis: Mat<f64>,
    /// Weights of each frame: frames by rank.
    alpha: Mat<f64>,
    /// Signatures at the positions: positions by rank.
    signatures: Mat<f64>,
    /// Influence of each frame on the map: a row of positions for each frame.
    influence: Vec<f32>,
    /// Diagonal of the inverse covariance.
    own: Vec<f64>,
    /// Candidates that exist because of a single frame.
    places: Vec<Vec<usize>>,
    /// As in [`Map`].
    noise_share: f64,
}

/// Frames as the map sees them.
pub(super) struct Sums<'a> {
    touches_m: Vec<&'a [[f64; 2]]>,
    /// Weighted frames in median pokes: frames by channels. Missing channels are zero.
    frames: Mat<f64>,
    /// Length of the frame in units of the rows of `frames`.
    scales: Vec<f64>,
}

impl<'a> Sums<'a> {
    /// Weighted frames, and the amplitude of the median poke. A frame of one touch is scaled to one median poke.
    pub(super) fn of(labelled: &[LabelledFrame<'a>], weights: &[f64]) -> Result<(Self, f64), LocatorError> {
        let channels = weights.len();
        let mut frames = Mat::<f64>::zeros(labelled.len(), channels);
        let mut lengths = Vec::with_capacity(labelled.len());
        for (i, labelled) in labelled.iter().enumerate() {
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
        let mut scales = Vec::with_capacity(labelled.len());
        for (i, labelled) in labelled.iter().enumerate() {
            let scale = if labelled.touches_m.len() == 1 { lengths[i] } else { typical };
            (0..channels).for_each(|k| frames[(i, k)] /= scale);
            scales.push(scale / typical);
        }
        Ok((Self { touches_m: labelled.iter().map(|labelled| labelled.touches_m).collect(), frames, scales }, typical))
    }

    pub(super) fn some(&self, rows: &[usize]) -> Self {
        Self {
            touches_m: rows.iter().map(|&i| self.touches_m[i]).collect(),
            frames: Mat::from_fn(rows.len(), self.frames.ncols(), |i, k| self.frames[(rows[i], k)]),
            scales: rows.iter().map(|&i| self.scales[i]).collect(),
        }
    }

    fn len(&self) -> usize {
        self.touches_m.len()
    }

    /// For each frame, the candidates next to touches of no other frame.
    fn places_of_one(&self, candidates_m: &[[f64; 2]]) -> Vec<Vec<usize>> {
        let mut places = vec![Vec::new(); self.len()];
        let apart2 = apart2(&self.places_m());
        for (candidate, candidate_m) in candidates_m.iter().enumerate() {
            let is_next = |place_m: &[f64; 2]| squared_distance(*place_m, *candidate_m) <= apart2;
            let mut next = (0..self.len()).filter(|&frame| self.touches_m[frame].iter().any(is_next));
            if let (Some(frame), None) = (next.next(), next.next()) {
                places[frame].push(candidate);
            }
        }
        places
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
pub(super) struct Shape {
    length_m: f64,
    noise: f64,
}

impl Shape {
    /// The shape with the largest marginal likelihood.
    pub(super) fn choose(sums: &Sums<'_>) -> Result<Self, LocatorError> {
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
        a[i].iter().flat_map(|p| b[j].iter().map(move |q| COMMON + matern52(*p, *q, length_m))).sum::<f64>()
    })
}

/// Share of the errors' variance that is noise. Of frames with small and with large signatures, the median squared
/// errors e and signatures s give e^2 = n + m s^2, and n / (n + m s^2) at the median s. `scales` are as in [`Sums`].
fn noise_share(scales: &[f64], signatures: &Mat<f64>, errors: &Mat<f64>) -> f64 {
    let square = |of: &Mat<f64>, i: usize| scales[i].powi(2) * of.row(i).iter().map(|value| value * value).sum::<f64>();
    let mut squares: Vec<(f64, f64)> = (0..scales.len()).map(|i| (square(signatures, i), square(errors, i))).collect();
    squares.sort_by(|a, b| a.0.total_cmp(&b.0));
    let medians = |some: &[(f64, f64)]| {
        let (signatures, errors): (Vec<f64>, Vec<f64>) = some.iter().copied().unzip();
        (median(&signatures), median(&errors))
    };
    let (small, large) = squares.split_at(squares.len() / 2);
    let ((small, its_error), (large, error)) = (medians(small), medians(large));
    let growth = ((error - its_error) / (large - small)).max(0.0);
    let noise = (its_error - growth * small).max(0.0);
    let share = noise / (noise + growth * medians(&squares).0);
    if share.is_finite() { share } else { 0.0 }
}

/// Square of the minimum distance of two candidates, m^2.
fn apart2(places_m: &[[f64; 2]]) -> f64 {
    (CANDIDATES_APART * extent(places_m)).powi(2)
}

/// Weights with which the channels that are used have the same RMS in these frames; 0 for the others.
pub(super) fn equal_weights(labelled: &[LabelledFrame<'_>], is_used: &[bool]) -> Result<Vec<f64>, LocatorError> {
    let mut squares = vec![0.0; is_used.len()];
    for labelled in labelled {
        check_length("frame", is_used.len(), labelled.frame.len())?;
        let finite = |value: &f64| if value.is_finite() { value * value } else { 0.0 };
        squares.iter_mut().zip(labelled.frame).for_each(|(square, value)| *square += finite(value));
    }
    let weight = |(square, is_used): (f64, &bool)| if *is_used && square > 0.0 { square.sqrt().recip() } else { 0.0 };
    Ok(squares.into_iter().zip(is_used).map(weight).collect())
}

/// The places of pokes, without those next to another.
pub(super) fn candidates(sums: &Sums<'_>) -> Vec<[f64; 2]> {
    let places_m = sums.places_m();
    let apart2 = apart2(&places_m);
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

impl Learned {
    /// Learns from all frames what signatures at these positions are like.
    pub(super) fn of(sums: &Sums<'_>, shape: &Shape, positions_m: &[[f64; 2]]) -> Result<Self, LocatorError> {
        let basis = sums.basis()?;
        let mut k = covariance(&sums.touches_m, &sums.touches_m, shape.length_m);
        (0..sums.len()).for_each(|i| k[(i, i)] += shape.noise);
        let factor = k.llt(Side::Lower).map_err(|_| LocatorError::Singular { what: "covariance of the pokes" })?;
        let inverse = factor.inverse();
        let single: Vec<&[[f64; 2]]> = positions_m.iter().map(std::slice::from_ref).collect();
        let to_map = covariance(&single, &sums.touches_m, shape.length_m);
        let projected = &sums.frames * &basis;
        let alpha = &inverse * &projected;
        let mut learned = Self {
            noise_share: 0.0,
            signatures: &to_map * &alpha,
            influence: single_precision((&inverse * to_map.transpose()).as_ref()),
            own: (0..sums.len()).map(|i| inverse[(i, i)]).collect(),
            places: sums.places_of_one(positions_m),
            basis,
            alpha,
        };
        let errors = learned.errors(&(0..sums.len()).collect::<Vec<_>>());
        learned.noise_share = noise_share(&sums.scales, &(projected - &errors), &errors);
        Ok(learned)
    }

    /// Strength, in median pokes, that the map of the other frames finds for the typical touch near each position. It
    /// is below one where touches are faint, because the map has errors. `alpha` are the weights of the frames in `map`.
    pub(super) fn typical(&self, map: &Map, alpha: &[f32], sums: &Sums<'_>, positions_m: &[[f64; 2]]) -> Vec<f64> {
        let mut found = vec![0.0; map.rank];
        let strength = |frame: usize| {
            let weighted: Vec<f32> = sums.frames.row(frame).iter().map(|value| *value as f32).collect();
            products(&map.basis, weighted.len(), &weighted, &mut found);
            let (mut along, mut square) = (0.0, 0.0);
            for (found, alpha) in found.iter().zip(&alpha[frame * map.rank..(frame + 1) * map.rank]) {
                let signature = f64::from(*found) - f64::from(*alpha) / self.own[frame];
                along += signature * f64::from(*found);
                square += signature * signature;
            }
            if square > 0.0 { along / square } else { 0.0 }
        };
        let strengths: Vec<f64> = (0..sums.len()).map(strength).collect();
        let touches = sums.touches_m.iter().zip(strengths);
        let mut touches: Vec<([f64; 2], f64)> =
            touches.flat_map(|(touches_m, strength)| touches_m.iter().map(move |at_m| (*at_m, strength))).collect();
        let near = (touches.len() as f64).sqrt().ceil() as usize;
        let typical = |position_m: &[f64; 2]| {
            let away2 = |touch: &([f64; 2], f64)| squared_distance(touch.0, *position_m);
            touches.select_nth_unstable_by(near - 1, |a, b| away2(a).total_cmp(&away2(b)));
            let strengths: Vec<f64> = touches[..near].iter().map(|touch| touch.1).collect();
            median(&strengths).max(LEAST_TYPICAL)
        };
        positions_m.iter().map(typical).collect()
    }

    /// Errors that the map of the other frames makes in each of these frames, `alpha / own` (Rasmussen & Williams,
    /// eq. 5.12): frames by rank.
    fn errors(&self, frames: &[usize]) -> Mat<f64> {
        Mat::from_fn(frames.len(), self.alpha.ncols(), |i, r| self.alpha[(frames[i], r)] / self.own[frames[i]])
    }

    /// Signatures of unit length, a row for each position.
    pub(super) fn shapes(&self) -> Vec<f32> {
        let lengths: Vec<f64> = self.signatures.row_iter().map(|row| row.norm_l2().max(f64::MIN_POSITIVE)).collect();
        let (rows, columns) = (self.signatures.nrows(), self.signatures.ncols());
        single_precision(Mat::from_fn(rows, columns, |i, j| self.signatures[(i, j)] / lengths[i]).as_ref())
    }

    /// The map of all frames, weighted by the errors in those numbered `judged`, and the weights of each frame: rows of
    /// `rank` values.
    pub(super) fn map(&self, judged: &[usize]) -> Result<(Map, Vec<f32>), LocatorError> {
        let (whiten, unwhiten) = self.whitening(judged)?;
        let mut map = Map {
            rank: self.alpha.ncols(),
            basis: single_precision((&self.basis * &whiten).transpose()),
            lift: single_precision((&self.basis * &unwhiten).transpose()),
            signatures: single_precision((&self.signatures * &whiten).as_ref()),
            squares: Vec::new(),
            error_variance: 0.0,
            noise_share: self.noise_share,
        };
        map.measure();
        let alpha = single_precision((&self.alpha * &whiten).as_ref());
        map.error_variance = self.error_variance(&map, &alpha, judged);
        Ok((map, alpha))
    }

    /// Variance of the frames' errors along signatures that were learned without them. Along the directions that span
    /// the frames, it would be far too large: these hold all noise of the frames, but little of another frame's.
    fn error_variance(&self, map: &Map, alpha: &[f32], judged: &[usize]) -> f64 {
        let positions = map.squares.len();
        let (mut sum, mut count) = (0.0, 0.0);
        for frame in evenly(judged.len(), MOST_VARIANCE_FRAMES).into_iter().map(|number| judged[number]) {
            let alpha = &alpha[frame * map.rank..(frame + 1) * map.rank];
            let own = self.own[frame] as f32;
            for position in evenly(positions, MOST_VARIANCE_POSITIONS) {
                let share = self.influence[frame * positions + position] / own;
                let (mut along, mut square) = (0.0_f64, 0.0_f64);
                for (signature, alpha) in map.signature(position).iter().zip(alpha) {
                    let signature = f64::from(signature - share * alpha);
                    along += signature * f64::from(alpha / own);
                    square += signature * signature;
                }
                if square > 0.0 {
                    sum += along * along / square;
                    count += 1.0;
                }
            }
        }
        sum / f64::max(count, 1.0)
    }

    /// Symmetric square roots of the inverse covariance of the map's errors and of that covariance, relative to their
    /// mean square along a direction. The covariance has an inverse Wishart prior about equal, independent errors, with
    /// as many degrees of freedom as dimensions.
    fn whitening(&self, judged: &[usize]) -> Result<(Mat<f64>, Mat<f64>), LocatorError> {
        let (count, rank) = (judged.len(), self.alpha.ncols());
        let errors = self.errors(judged);
        let squares = errors.transpose() * &errors;
        let sum: f64 = (0..rank).map(|r| squares[(r, r)]).sum();
        let mean = (sum / (count * rank) as f64).max(f64::MIN_POSITIVE);
        let covariance = Mat::from_fn(rank, rank, |a, b| {
            let prior = if a == b { rank as f64 } else { 0.0 };
            (squares[(a, b)] / mean + prior) / (count + rank) as f64
        });
        let eigen = covariance
            .self_adjoint_eigen(Side::Lower)
            .map_err(|_| LocatorError::Singular { what: "covariance of the map's errors" })?;
        let power = |power: f64| {
            let scaled = Mat::from_fn(rank, rank, |a, b| eigen.U()[(a, b)] * eigen.S().column_vector()[b].powf(power));
            scaled * eigen.U().transpose()
        };
        Ok((power(-0.5), power(0.5)))
    }
}

impl Map {
    /// Becomes the map without the frame numbered `number`: S - w a' / k, with a its weights, k its diagonal element of
    /// the inverse covariance K^-1, and w the map's covariances with all frames times its column of K^-1. Places poked
    /// by this frame alone explain nothing then, because a new touch isn't at the place of a poke either. A second frame
    /// is left out as if the first had no influence on it.
    pub(super) fn leave_out(&mut self, alpha: &[f32], learned: &Learned, number: usize) {
        let positions = self.squares.len();
        let influence = &learned.influence[number * positions..(number + 1) * positions];
        let alpha = &alpha[number * self.rank..(number + 1) * self.rank];
        for (row, influence) in self.signatures.chunks_exact_mut(self.rank).zip(influence) {
            let share = influence / learned.own[number] as f32;
            row.iter_mut().zip(alpha).for_each(|(value, alpha)| *value -= share * alpha);
        }
        let places: Vec<usize> = (0..positions).filter(|&place| self.squares[place] == f32::INFINITY).collect();
        self.measure();
        places.iter().chain(&learned.places[number]).for_each(|&place| self.squares[place] = f32::INFINITY);
    }

    fn measure(&mut self) {
        self.squares.clear();
        // A signature of zero explains nothing, and must not be divided by.
        let square = |row: &[f32]| dot(row, row).max(f32::MIN_POSITIVE);
        self.squares.extend(self.signatures.chunks_exact(self.rank).map(square));
    }

    /// The weighted channels of a touch.
    pub(super) fn channels_of(&self, position: usize, strength: f64, out: &mut Vec<f64>) {
        let channels = self.lift.len() / self.rank;
        out.clear();
        out.resize(channels, 0.0);
        for (row, coordinate) in self.lift.chunks_exact(channels).zip(self.signature(position)) {
            let along = strength * f64::from(*coordinate);
            out.iter_mut().zip(row).for_each(|(value, direction)| *value += along * f64::from(*direction));
        }
    }

    pub(super) fn signature(&self, position: usize) -> &[f32] {
        &self.signatures[position * self.rank..(position + 1) * self.rank]
    }
}
