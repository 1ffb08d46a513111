//! The product of both experts: w(p) ~ exp(b L(p)) (1 + d(p)^2 / 4 s^2)^(-3 c), where L is the forward expert's
//! log-likelihood at p, d the distance from p to the inverse expert's position and s its local standard deviation.
//! The second factor is a Student t with 4 degrees of freedom, so that neither expert can veto the other. The
//! temperature b and the power c are those that predict the left-out examples best; b = 0 and c = 0, either expert
//! alone, are among them.
//!
//! Each map position represents a cell of the map's spacing h, over which a position is spread with variance h^2 /
//! 12. Within a cell each coordinate is shifted by v (g + (m - x) c / s^2), v = 1 / (12 / h^2 + k + c / s^2), the
//! mean of a product of Gaussians. Here g and k are the slope and curvature of b L from the neighbouring positions,
//! and m is the inverse expert's position. A posterior narrower than a cell is therefore not rounded to the map.

use std::collections::HashMap;

use rayon::prelude::*;

use super::inverse::Guess;
use crate::locator::posterior::{ONE_SIGMA, log_student, weighted_quantile};
use crate::locator::rows::exponentials;
use crate::plane::squared_distance;

/// Temperatures b tried.
const TEMPERATURES: [f64; 8] = [0.0, 0.015, 0.03, 0.06, 0.12, 0.25, 0.5, 1.0];
/// Exponents e of the powers tried: c = 2^e / 2, that is a half, 1, 2, 4.
const DOUBLINGS: [u32; 4] = [0, 1, 2, 3];

/// Apply no shift within cells less likely than this share of the peak.
const LEANING: f64 = 1e-3;
/// Ignore log-likelihoods below this, relative to the largest.
const NEGLIGIBLE: f64 = -40.0;
/// Marks a missing neighbour.
const NONE: u32 = u32::MAX;

/// The map's positions as cells.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Cells {
    /// Indices of the positions left, right, below and above each one.
    neighbours: Vec<[u32; 4]>,
    pub spacing_m: f64,
}

impl Cells {
    /// Finds each position's neighbours: the position nearest to one spacing away along an axis, if within 0.6
    /// spacings.
    pub(super) fn new(positions: &[[f64; 2]], spacing_m: f64) -> Self {
        let cell = |p: [f64; 2]| p.map(|v| (v / spacing_m).floor() as i64);
        let mut buckets: HashMap<[i64; 2], Vec<u32>> = HashMap::new();
        for (i, p) in positions.iter().enumerate() {
            buckets.entry(cell(*p)).or_default().push(i as u32);
        }
        let find = |i: usize, step: [f64; 2]| {
            let target = [0, 1].map(|a| positions[i][a] + step[a] * spacing_m);
            let [cx, cy] = cell(target);
            let mut best = (NONE, (0.6 * spacing_m).powi(2));
            for at in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| [cx + dx, cy + dy])) {
                for &j in buckets.get(&at).into_iter().flatten().filter(|j| **j as usize != i) {
                    let d2 = squared_distance(positions[j as usize], target);
                    if d2 < best.1 {
                        best = (j, d2);
                    }
                }
            }
            best.0
        };
        let steps = [[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]];
        let neighbours = (0..positions.len()).map(|i| steps.map(|step| find(i, step))).collect();
        Self { neighbours, spacing_m }
    }

    /// Slope and downward curvature of `values` along an axis, per metre and per square metre. The curvature is not
    /// negative.
    fn shape(&self, values: &[f64], p: usize, axis: usize) -> (f64, f64) {
        let [low, high] = [self.neighbours[p][2 * axis], self.neighbours[p][2 * axis + 1]];
        let at = |i: u32| values[i as usize];
        let h = self.spacing_m;
        match (low != NONE, high != NONE) {
            (true, true) => {
                ((at(high) - at(low)) / (2.0 * h), ((2.0 * values[p] - at(high) - at(low)) / (h * h)).max(0.0))
            }
            (true, false) => ((values[p] - at(low)) / h, 0.0),
            (false, true) => ((at(high) - values[p]) / h, 0.0),
            (false, false) => (0.0, 0.0),
        }
    }
}

/// How the experts are combined.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Fusion {
    /// b.
    pub temperature: f64,
    /// c is a half times two to the power of this. `None`: the inverse expert is not used.
    pub doublings: Option<u32>,
}

/// A left-out example as both experts see it.
#[derive(Debug, Clone, Copy)]
pub(super) struct LeftOutView<'a> {
    /// Log-likelihood over the map.
    pub log_likelihood: &'a [f64],
    /// The inverse expert's position.
    pub guess: Option<Guess>,
    pub truth_m: [f64; 2],
    /// Weight among the examples.
    pub weight: f64,
}

/// Values shared by all combinations of the same likelihood and guess.
struct Weighing {
    top: f64,
    /// exp(b (L - top)) for the temperature b in `of`.
    likely: Vec<f32>,
    of: f64,
    /// The inverse expert's factor at each position, by doublings; all empty without a guess.
    factors: [Vec<f64>; DOUBLINGS.len()],
    /// Probabilities.
    weights: Vec<f64>,
}

impl Weighing {
    fn new(positions: usize) -> Self {
        let factors = DOUBLINGS.map(|_| Vec::with_capacity(positions));
        Self { top: 0.0, likely: Vec::with_capacity(positions), of: f64::NAN, factors, weights: vec![0.0; positions] }
    }

    fn begin(&mut self, positions: &[[f64; 2]], cells: &Cells, log_likelihood: &[f64], guess: Option<Guess>) {
        self.top = log_likelihood.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        self.of = f64::NAN;
        self.factors.iter_mut().for_each(Vec::clear);
        let Some(guess) = guess else { return };
        let scale = 0.25 / (guess.variance_m2 + cells.spacing_m * cells.spacing_m / 12.0);
        let [first, rest @ ..] = &mut self.factors;
        first.extend(positions.iter().map(|p| {
            let base = 1.0 + squared_distance(*p, guess.mean_m) * scale;
            1.0 / (base * base.sqrt())
        }));
        let mut last = first;
        for next in rest {
            next.extend(last.iter().map(|factor| factor * factor));
            last = next;
        }
    }

    /// Fills the probabilities. Returns the most probable position.
    fn weigh(&mut self, fusion: &Fusion, log_likelihood: &[f64]) -> usize {
        let b = fusion.temperature;
        if self.of != b {
            self.of = b;
            self.likely.clear();
            self.likely.extend(log_likelihood.iter().map(|l| (b * (self.top - l)) as f32));
            exponentials(&mut self.likely);
        }
        let likely = self.likely.iter().zip(log_likelihood);
        let weighed = likely.map(|(w, l)| if b * (l - self.top) < NEGLIGIBLE { 0.0 } else { f64::from(*w) });
        match fusion.doublings.and_then(|d| self.factors.get(d as usize)).filter(|f| !f.is_empty()) {
            Some(factors) => {
                let of_both = weighed.zip(factors).map(|(w, factor)| w * factor);
                self.weights.iter_mut().zip(of_both).for_each(|(weight, w)| *weight = w);
            }
            None => self.weights.iter_mut().zip(weighed).for_each(|(weight, w)| *weight = w),
        }
        let (mut total, mut peak) = (0.0, 0);
        for (p, w) in self.weights.iter().enumerate() {
            total += w;
            if *w > self.weights[peak] {
                peak = p;
            }
        }
        self.weights.iter_mut().for_each(|w| *w /= total);
        peak
    }
}

/// Mean and covariance of the product.
#[derive(Debug, Clone, Copy)]
pub(super) struct Joined {
    pub mean_m: [f64; 2],
    /// Variances of x and y and their covariance, square metres, before calibration.
    pub covariance_m2: [f64; 3],
    pub peak: usize,
    pub log_evidence: f64,
}

impl Fusion {
    /// For pokes with rotated copies that are too few to choose by: the forward expert alone, since the inverse
    /// expert knows nothing of copies.
    pub(super) const UNTOLD: Self = Self { temperature: 0.5, doublings: None };

    /// Combines a log-likelihood over the map with a guess. `weights` receives the probabilities.
    pub(super) fn join(
        &self,
        positions: &[[f64; 2]],
        cells: &Cells,
        log_likelihood: &[f64],
        guess: Option<Guess>,
        memory: &mut Vec<f32>,
        weights: &mut [f64],
    ) -> Joined {
        let top = log_likelihood.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let cell = cells.spacing_m * cells.spacing_m / 12.0;
        let inverse = guess.zip(self.doublings);
        memory.clear();
        memory.extend(log_likelihood.iter().map(|l| (self.temperature * (top - l)) as f32));
        exponentials(memory);
        let (mut total, mut evidence, mut peak) = (0.0, 0.0, 0);
        for p in 0..positions.len() {
            let below = log_likelihood[p] - top;
            if below > NEGLIGIBLE {
                evidence += below.exp();
            }
            weights[p] = if self.temperature * below < NEGLIGIBLE { 0.0 } else { f64::from(memory[p]) };
            if let Some((guess, doublings)) = inverse {
                let d2 = squared_distance(positions[p], guess.mean_m);
                let base = 1.0 + d2 / (4.0 * (guess.variance_m2 + cell));
                let mut power = base * base.sqrt();
                for _ in 0..doublings {
                    power *= power;
                }
                weights[p] /= power;
            }
            total += weights[p];
            if weights[p] > weights[peak] {
                peak = p;
            }
        }
        weights.iter_mut().for_each(|w| *w /= total);
        let log_evidence = top + (evidence / positions.len() as f64).ln();
        Joined { log_evidence, ..self.read_out(positions, cells, log_likelihood, inverse, weights, peak) }
    }

    /// Like [`Fusion::join`] for the inputs `weighing` was started with, but without the evidence.
    fn join_weighed(
        &self,
        positions: &[[f64; 2]],
        cells: &Cells,
        log_likelihood: &[f64],
        guess: Option<Guess>,
        weighing: &mut Weighing,
    ) -> Joined {
        let peak = weighing.weigh(self, log_likelihood);
        self.read_out(positions, cells, log_likelihood, guess.zip(self.doublings), &weighing.weights, peak)
    }

    /// Mean and covariance of probabilities that peak at `peak`; no evidence.
    fn read_out(
        &self,
        positions: &[[f64; 2]],
        cells: &Cells,
        log_likelihood: &[f64],
        inverse: Option<(Guess, u32)>,
        weights: &[f64],
        peak: usize,
    ) -> Joined {
        let cell = cells.spacing_m * cells.spacing_m / 12.0;
        // Precision of the inverse expert's position within a cell.
        let pull = inverse.map_or(0.0, |(g, doublings)| 0.5 * f64::from(1_u32 << doublings.min(8)) / g.variance_m2);
        let target = inverse.map_or([0.0; 2], |(g, _)| g.mean_m);
        let (origin, least) = (positions[peak], LEANING * weights[peak]);
        let (mut mean, mut square, mut cross) = ([0.0; 2], [0.0; 2], 0.0);
        for p in 0..positions.len() {
            let w = weights[p];
            if w == 0.0 {
                continue;
            }
            let mut at = [0.0; 2];
            for axis in 0..2 {
                let (mut lean, mut grain) = (0.0, cell);
                if w > least {
                    let (slope, curvature) = cells.shape(log_likelihood, p, axis);
                    grain = 1.0 / (1.0 / cell + self.temperature * curvature + pull);
                    lean = grain * (self.temperature * slope + pull * (target[axis] - positions[p][axis]));
                }
                at[axis] =
                    positions[p][axis] - origin[axis] + lean.clamp(-0.5 * cells.spacing_m, 0.5 * cells.spacing_m);
                mean[axis] += w * at[axis];
                square[axis] += w * (at[axis] * at[axis] + grain);
            }
            cross += w * at[0] * at[1];
        }
        Joined {
            mean_m: [origin[0] + mean[0], origin[1] + mean[1]],
            covariance_m2: [
                (square[0] - mean[0] * mean[0]).max(1e-3 * cell),
                (square[1] - mean[1] * mean[1]).max(1e-3 * cell),
                cross - mean[0] * mean[1],
            ],
            peak,
            log_evidence: f64::NEG_INFINITY,
        }
    }

    /// All combinations to try, the forward expert alone first.
    fn candidates(with_inverse: bool) -> Vec<Self> {
        let alone = TEMPERATURES[1..].iter().map(|&temperature| Self { temperature, doublings: None });
        let joined =
            TEMPERATURES.iter().flat_map(|&temperature| DOUBLINGS.map(|d| Self { temperature, doublings: Some(d) }));
        alone.chain(joined.filter(|_| with_inverse)).collect()
    }

    /// The combination that predicts left-out examples best.
    pub(super) fn choose(positions: &[[f64; 2]], cells: &Cells, left_out: &[LeftOutView<'_>]) -> Self {
        let candidates = Self::candidates(left_out.iter().all(|example| example.guess.is_some()));
        // For each example and candidate, errors, posterior standard deviations and weights of x and y.
        let locate = |weighing: &mut Weighing, example: &LeftOutView<'_>| {
            let LeftOutView { log_likelihood, guess, truth_m, weight } = *example;
            weighing.begin(positions, cells, log_likelihood, guess);
            let mut by_candidate = |candidate: &Self| {
                let joined = candidate.join_weighed(positions, cells, log_likelihood, guess, weighing);
                [0, 1].map(|axis| (joined.mean_m[axis] - truth_m[axis], joined.covariance_m2[axis].sqrt(), weight))
            };
            candidates.iter().map(&mut by_candidate).collect::<Vec<_>>()
        };
        let located = left_out.par_iter().map_init(|| Weighing::new(positions.len()), locate);
        let errors: Vec<Vec<[(f64, f64, f64); 2]>> = located.collect();
        let mut best = (f64::NEG_INFINITY, Self { temperature: TEMPERATURES[4], doublings: None });
        for (number, candidate) in candidates.iter().enumerate() {
            let errors: Vec<(f64, f64, f64)> = errors.iter().flat_map(|example| example[number]).collect();
            let ratios: Vec<(f64, f64)> = errors.iter().map(|e| ((e.0 / e.1).abs(), e.2)).collect();
            let factor = weighted_quantile(ratios, ONE_SIGMA).max(1e-3);
            let score = errors.iter().map(|e| e.2 * log_student(e.0, e.1 * factor)).sum::<f64>();
            if score > best.0 {
                best = (score, *candidate);
            }
        }
        best.1
    }
}
