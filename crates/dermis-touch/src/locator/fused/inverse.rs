//! The inverse expert: kernel ridge regression from a frame's features to the position, y = m + k(f) a, where (K + r
//! I) a = Y - m and k is Matern 5/2 over the features' principal components. Leaving example i out shifts its
//! prediction by a_i / (K + r I)^-1_ii (Rasmussen & Williams 2006, section 5.4.2). Length and ridge minimise the
//! left-out errors. With more examples than can be solved exactly, the kernel is evaluated only at evenly drawn
//! landmarks ([`landmarks`]).
//!
//! Its variance at f is local: the mean of left-out squared errors weighted by a sharpened kernel. If the nearest
//! example is further away than usual, the variance is multiplied by the square of that ratio, so that a frame unlike
//! all examples says little.

use faer::linalg::solvers::DenseSolveCore;
use faer::{Mat, Side};
use rayon::prelude::*;

use super::landmarks;
use crate::locator::error::{LocatorError, check_first, check_length};
use crate::locator::pair_correlations::Sessions;
use crate::locator::posterior::quantile;
use crate::locator::rows::{dot, matern52, matern52_of, products};
use crate::plane::squared_distance;
use crate::statistics::{evenly, median};

/// Lengths tried, relative to the median distance between examples.
const LENGTHS: [f64; 6] = [0.6, 0.9, 1.3, 2.0, 3.0, 5.0];
/// Ridges tried, relative to the kernel's variance.
const RIDGES: [f64; 7] = [1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1];
/// Resemblances of two sessions to try, the default first, and the minimum drop in the sum of ln(e^2 + m^2) to choose
/// another: Akaike's penalty for one parameter, for a density that falls with the fourth power of the error.
const RESEMBLANCES: [f64; 7] = [1.0, 0.99, 0.97, 0.9, 0.75, 0.5, 0.0];
const RESEMBLANCE_MARGIN: f64 = 0.5;
/// Maximum number of examples that choose length and ridge.
const CHOOSING: usize = 500;
/// Squared width of the local variance's weights, relative to the median squared distance between examples.
const LOCAL_WIDTH: f64 = 0.07;
/// Weight of the median error in the local variance, in examples.
const LOCAL_PRIOR: f64 = 3.0;
/// The squared median of a Rayleigh distribution of unit variance.
const RAYLEIGH_MEDIAN2: f64 = 1.386_294;

/// A fitted regression.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Regression {
    /// Number of principal components.
    rank: usize,
    /// Mean of the features.
    centre: Vec<f32>,
    /// Principal directions: `rank` rows of features.
    basis: Vec<f32>,
    /// Components of each example or landmark: rows of length `rank`.
    points: Vec<f32>,
    /// Squared lengths of the points' rows.
    squares: Vec<f32>,
    /// a, for x and y.
    weights: Vec<[f64; 2]>,
    mean_m: [f64; 2],
    length: f64,
    ridge: f64,
    /// Squared left-out errors at the points, square metres, of the mix once that is known.
    residuals_m2: Vec<f64>,
    /// Variance of a coordinate that corresponds to the median left-out error, square metres.
    typical_m2: f64,
    /// 90 % quantile of the squared distance to the nearest example.
    usual_nearest: f64,
    /// The weight in the local variance is the kernel to the power of two to this.
    sharpening: u32,
}

/// Left-out predictions for the judged rows.
#[derive(Debug, Clone)]
pub(super) struct LeftOutPlaces {
    pub places_m: Vec<[f64; 2]>,
}

/// A position and the local variance of a coordinate.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Guess {
    pub mean_m: [f64; 2],
    pub variance_m2: f64,
    /// Squared distance to the nearest example over the usual one.
    pub distance: f64,
}

impl Guess {
    /// The mean of this and another guess, with this share of this one.
    pub(super) fn mixed(self, share: f64, other: Self) -> Self {
        let mix = |a: f64, b: f64| share * a + (1.0 - share) * b;
        Self {
            mean_m: [0, 1].map(|axis| mix(self.mean_m[axis], other.mean_m[axis])),
            variance_m2: mix(self.variance_m2, other.variance_m2),
            distance: mix(self.distance, other.distance),
        }
    }
}

impl Regression {
    /// Fits to the features, one row for each of `places_m`. Left-out errors are computed at the rows `judged`. If
    /// those are fewer than all rows, they are the landmarks too.
    pub(super) fn fit(
        features: &[Vec<f64>],
        places_m: &[[f64; 2]],
        most_rank: usize,
        judged: &[usize],
        is_earlier: Option<&[bool]>,
    ) -> Result<(Self, LeftOutPlaces), LocatorError> {
        let (centre, basis) = principal(features, most_rank)?;
        let rank = basis.ncols();
        let chosen = evenly(places_m.len(), CHOOSING);
        let mut fitted = Self {
            rank,
            centre: centre.iter().map(|v| *v as f32).collect(),
            basis: (0..rank).flat_map(|r| basis.col_as_slice(r).iter().map(|v| *v as f32)).collect(),
            points: Vec::new(),
            squares: Vec::new(),
            weights: Vec::new(),
            mean_m: [0, 1].map(|axis| places_m.iter().map(|p| p[axis]).sum::<f64>() / places_m.len() as f64),
            length: 1.0,
            ridge: RIDGES[0],
            residuals_m2: Vec::new(),
            typical_m2: 0.0,
            usual_nearest: 1.0,
            sharpening: 0,
        };
        let rows: Vec<Vec<f32>> = features.iter().map(|f| fitted.project(f)).collect();
        fitted.choose(&rows, places_m, &chosen)?;
        let places = match is_earlier.filter(|_| judged.len() == rows.len()) {
            Some(is_earlier) => fitted.solve_sessions(&rows, places_m, is_earlier)?,
            None => fitted.solve(&rows, places_m, judged)?,
        };
        fitted.points = judged.iter().flat_map(|&i| rows[i].iter().copied()).collect();
        fitted.squares = judged.iter().map(|&i| dot(&rows[i], &rows[i])).collect();
        let truth: Vec<[f64; 2]> = judged.iter().map(|&i| places_m[i]).collect();
        fitted.set_residuals(&places.places_m, &truth);
        Ok((fitted, places))
    }

    /// Sets the left-out errors that the local variance is computed from.
    pub(super) fn set_residuals(&mut self, left_out_m: &[[f64; 2]], truth_m: &[[f64; 2]]) {
        let square = |(a, b): (&[f64; 2], &[f64; 2])| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
        self.residuals_m2 = left_out_m.iter().zip(truth_m).map(square).collect();
        self.typical_m2 = (median(&self.residuals_m2) / RAYLEIGH_MEDIAN2).max(f64::MIN_POSITIVE);
    }

    /// Number of points that a frame is compared with.
    pub(super) fn points(&self) -> usize {
        self.weights.len()
    }

    fn project(&self, features: &[f64]) -> Vec<f32> {
        let centred: Vec<f32> = features.iter().zip(&self.centre).map(|(f, c)| *f as f32 - c).collect();
        self.basis.chunks_exact(centred.len()).map(|row| dot(row, &centred)).collect()
    }

    /// Chooses length and ridge, sharpening and usual distance from the rows `chosen`.
    fn choose(&mut self, rows: &[Vec<f32>], places_m: &[[f64; 2]], chosen: &[usize]) -> Result<(), LocatorError> {
        let n = chosen.len();
        let d2 = Mat::from_fn(n, n, |i, j| if i == j { 0.0 } else { distance2(&rows[chosen[i]], &rows[chosen[j]]) });
        let apart: Vec<f64> = (0..n).flat_map(|j| (0..j).map(move |i| (i, j))).map(|ij| d2[ij]).collect();
        let typical = median(&apart);
        if typical.is_nan() || typical <= 0.0 {
            return Err(LocatorError::Singular { what: "kernel between the examples" });
        }
        let targets = Mat::from_fn(n, 2, |i, axis| places_m[chosen[i]][axis] - self.mean_m[axis]);
        let try_length = |relative: f64| {
            let length = relative * typical.sqrt();
            let kernel = Mat::from_fn(n, n, |i, j| f64::from(matern52_of(d2[(i, j)] as f32, 1.0 / length as f32)));
            let eigen = kernel
                .self_adjoint_eigen(Side::Lower)
                .map_err(|_| LocatorError::Singular { what: "kernel between the examples" })?;
            let (u, values) = (eigen.U(), eigen.S().column_vector());
            let along = u.transpose() * &targets;
            let try_ridge = |ridge: f64| {
                let gain = |j: usize| 1.0 / (values[j].max(0.0) + ridge);
                let a = u * Mat::from_fn(n, 2, |j, axis| gain(j) * along[(j, axis)]);
                let gains: Vec<f64> = (0..n).map(gain).collect();
                let mut diagonal = vec![0.0; n];
                for (j, g) in gains.iter().enumerate() {
                    for (d, v) in diagonal.iter_mut().zip(u.col(j).iter()) {
                        *d += g * v * v;
                    }
                }
                let squares: Vec<f64> =
                    (0..n).map(|i| (a[(i, 0)].powi(2) + a[(i, 1)].powi(2)) / diagonal[i].powi(2)).collect();
                let middle = median(&squares).max(f64::MIN_POSITIVE);
                squares.iter().map(|s| (s + middle).ln()).sum::<f64>() / n as f64
            };
            Ok(RIDGES.map(|ridge| (try_ridge(ridge), length, ridge)))
        };
        let tried: Result<Vec<_>, LocatorError> = LENGTHS.into_par_iter().map(try_length).collect();
        let mut best = f64::INFINITY;
        for (score, length, ridge) in tried?.into_iter().flatten() {
            if score < best {
                (best, self.length, self.ridge) = (score, length, ridge);
            }
        }
        let nearest = |i: usize| (0..n).filter(|j| *j != i).map(|j| d2[(i, j)]).fold(f64::INFINITY, f64::min);
        self.usual_nearest = quantile(&(0..n).map(nearest).collect::<Vec<_>>(), 0.9).max(f64::MIN_POSITIVE);
        let at_width = f64::from(matern52_of((LOCAL_WIDTH * typical) as f32, 1.0 / self.length as f32));
        self.sharpening = (-0.5 / at_width.ln()).log2().round().clamp(0.0, 10.0) as u32;
        Ok(())
    }

    /// Solves for the weights a, and returns left-out predictions of the judged rows.
    fn solve(
        &mut self,
        rows: &[Vec<f32>],
        places_m: &[[f64; 2]],
        judged: &[usize],
    ) -> Result<LeftOutPlaces, LocatorError> {
        let inverse_length = 1.0 / self.length as f32;
        let kernel = |i: usize, j: usize| f64::from(matern52_of(distance2(&rows[i], &rows[j]) as f32, inverse_length));
        let m = judged.len();
        let target = |i: usize, axis: usize| places_m[i][axis] - self.mean_m[axis];
        if m == rows.len() {
            let own = |i: usize, j: usize| if i == j { 1.0 + self.ridge } else { kernel(i, j) };
            let exact = Exact::solve(symmetric(m, own), &Mat::from_fn(m, 2, target), places_m)?;
            self.weights = exact.weights;
            return Ok(exact.left_out);
        }
        let targets: Vec<[f64; 2]> = (0..rows.len()).map(|i| [0, 1].map(|axis| target(i, axis))).collect();
        let unsaid = m as f64 / rows.len() as f64;
        let kernel = landmarks::Kernel { length: self.length, ridge: self.ridge, unsaid };
        let learnt = landmarks::learn(rows, &targets, judged, kernel)?;
        let place = |(i, left_out): (&usize, &[f64; 2])| [0, 1].map(|axis| places_m[*i][axis] - left_out[axis]);
        self.weights = learnt.weights;
        Ok(LeftOutPlaces { places_m: judged.iter().zip(&learnt.left_out).map(place).collect() })
    }

    /// As [`Regression::solve`], for examples of two sessions. The kernel between the sessions is multiplied by a
    /// resemblance: the one that predicts the new examples best when they are left out.
    fn solve_sessions(
        &mut self,
        rows: &[Vec<f32>],
        places_m: &[[f64; 2]],
        is_earlier: &[bool],
    ) -> Result<LeftOutPlaces, LocatorError> {
        let inverse_length = 1.0 / self.length as f32;
        let kernel = |i: usize, j: usize| match i == j {
            true => 1.0 + self.ridge,
            false => f64::from(matern52_of(distance2(&rows[i], &rows[j]) as f32, inverse_length)),
        };
        let plain = symmetric(rows.len(), kernel);
        let targets = Mat::from_fn(rows.len(), 2, |i, axis| places_m[i][axis] - self.mean_m[axis]);
        let mut best: Option<(f64, f64, Exact)> = None;
        let mut sessions = Sessions { is_earlier: is_earlier.to_vec(), resemblance: RESEMBLANCES[0] };
        for resemblance in RESEMBLANCES {
            sessions.resemblance = resemblance;
            let shared = Mat::from_fn(rows.len(), rows.len(), |i, j| sessions.between(i, j) * plain[(i, j)]);
            let mut exact = Exact::solve(shared, &targets, places_m)?;
            exact.weights.iter_mut().enumerate().for_each(|(i, a)| *a = a.map(|a| a * sessions.with_map(i)));
            let new = (0..rows.len()).filter(|&i| !is_earlier[i]);
            let squares: Vec<f64> = new.map(|i| squared_distance(exact.left_out.places_m[i], places_m[i])).collect();
            let middle = best.as_ref().map_or_else(|| median(&squares).max(f64::MIN_POSITIVE), |best| best.1);
            let score = squares.iter().map(|square| (square + middle).ln()).sum::<f64>();
            if best.as_ref().is_none_or(|best| score < best.0 - RESEMBLANCE_MARGIN) {
                best = Some((score, middle, exact));
            }
        }
        let (_, _, exact) = best.ok_or(LocatorError::Singular { what: "kernel between the examples" })?;
        self.weights = exact.weights;
        Ok(exact.left_out)
    }

    /// Position for a frame with these features. The variance ignores point `left_out`, if given.
    pub(super) fn guess(&self, features: &[f32], memory: &mut Memory, left_out: Option<usize>) -> Guess {
        memory.centred.clear();
        memory.centred.extend(features.iter().zip(&self.centre).map(|(f, c)| f - c));
        memory.components.resize(self.rank, 0.0);
        products(&self.basis, self.centre.len(), &memory.centred, &mut memory.components);
        let here = &memory.components;
        let own = dot(here, here);
        memory.kernel.resize(self.weights.len(), 0.0);
        products(&self.points, self.rank, here, &mut memory.kernel);
        let distance = |(k, square): (&mut f32, &f32)| *k = (own + square - 2.0 * *k).max(0.0);
        memory.kernel.iter_mut().zip(&self.squares).for_each(distance);
        let nearest = match left_out {
            None => least(&memory.kernel),
            Some(i) => least(&memory.kernel[..i]).min(least(&memory.kernel[i + 1..])),
        };
        let inverse_length = 1.0 / self.length as f32;
        matern52(&mut memory.kernel, inverse_length);
        let moved = sums(&memory.kernel, &self.weights, |k, a| [k * a[0], k * a[1]]);
        let mean_m = [0, 1].map(|axis| self.mean_m[axis] + moved[axis]);
        let variance_m2 = self.local_variance(&mut memory.kernel, f64::from(nearest), left_out);
        Guess { mean_m, variance_m2, distance: f64::from(nearest) / self.usual_nearest }
    }

    /// The local variance of a coordinate from kernel values, which are sharpened in place.
    fn local_variance(&self, kernel: &mut [f32], nearest: f64, left_out: Option<usize>) -> f64 {
        for _ in 0..self.sharpening {
            kernel.iter_mut().for_each(|k| *k *= *k);
        }
        if let Some(i) = left_out {
            kernel[i] = 0.0;
        }
        let [sum, weight] = sums(kernel, &self.residuals_m2, |k, square| [k * square, k]);
        let local = (0.5 * sum + LOCAL_PRIOR * self.typical_m2) / (weight + LOCAL_PRIOR);
        local * (nearest / self.usual_nearest).max(1.0).powi(2)
    }

    /// Expected feature k of a touch at a position: the mean of the points weighted by `shares`.
    pub(super) fn expected(&self, k: usize, shares: &[(usize, f64)]) -> f64 {
        let width = self.centre.len();
        let component =
            |r: usize| shares.iter().map(|(i, s)| s * f64::from(self.points[i * self.rank + r])).sum::<f64>();
        (0..self.rank)
            .fold(f64::from(self.centre[k]), |sum, r| sum + f64::from(self.basis[r * width + k]) * component(r))
    }

    /// The same regression, with its components, length and ridge, on other examples.
    pub(super) fn refitted(&self, features: &[&Vec<f64>], places_m: &[[f64; 2]]) -> Result<Self, LocatorError> {
        let mut fitted = self.clone();
        let rows: Vec<Vec<f32>> = features.iter().map(|f| fitted.project(f)).collect();
        let all: Vec<usize> = (0..rows.len()).collect();
        let left_out = fitted.solve(&rows, places_m, &all)?;
        fitted.squares = rows.iter().map(|row| dot(row, row)).collect();
        fitted.points = rows.concat();
        fitted.set_residuals(&left_out.places_m, places_m);
        Ok(fitted)
    }

    /// Rejects arrays that do not match.
    pub(super) fn check(&self, features: usize) -> Result<(), LocatorError> {
        let (rank, n) = (self.rank, self.weights.len());
        for (field, got) in [("regression rank", rank), ("regression points", n)] {
            if got == 0 {
                return Err(LocatorError::Count { field, got, expected: "at least 1" });
            }
        }
        check_length("regression centre", features, self.centre.len())?;
        check_length("regression basis", rank * features, self.basis.len())?;
        check_length("regression points", rank * n, self.points.len())?;
        check_length("regression squares", n, self.squares.len())?;
        check_length("regression residuals_m2", n, self.residuals_m2.len())?;
        for (field, values) in [
            ("regression centre", &self.centre),
            ("regression basis", &self.basis),
            ("regression points", &self.points),
            ("regression squares", &self.squares),
        ] {
            check_first(field, values.iter().map(|v| f64::from(*v)), f64::is_finite, "a finite number")?;
        }
        check_first("regression weights", self.weights.iter().flatten().copied(), f64::is_finite, "a finite number")?;
        check_first("regression mean_m", self.mean_m.iter().copied(), f64::is_finite, "a finite number")?;
        let not_negative = |v: f64| v.is_finite() && v >= 0.0;
        let expected = "a finite number, zero or above";
        check_first("regression residuals_m2", self.residuals_m2.iter().copied(), not_negative, expected)?;
        let above = |v: f64| v.is_finite() && v > 0.0;
        let scales = [self.length, self.ridge, self.usual_nearest, self.typical_m2];
        check_first("regression scales", scales.into_iter(), above, "a finite number above zero")
    }
}

/// The weights of a regression on all examples, and what it predicts for each from the others.
struct Exact {
    weights: Vec<[f64; 2]>,
    left_out: LeftOutPlaces,
}

impl Exact {
    /// Solves K a = y for a kernel with its ridge and targets relative to their mean.
    fn solve(kernel: Mat<f64>, targets: &Mat<f64>, places_m: &[[f64; 2]]) -> Result<Self, LocatorError> {
        let what = "kernel between the examples";
        let inverse = kernel.llt(Side::Lower).map_err(|_| LocatorError::Singular { what })?.inverse();
        let a = &inverse * targets;
        let left_out = |i: usize| [0, 1].map(|axis| places_m[i][axis] - a[(i, axis)] / inverse[(i, i)]);
        Ok(Self {
            weights: (0..a.nrows()).map(|i| [a[(i, 0)], a[(i, 1)]]).collect(),
            left_out: LeftOutPlaces { places_m: (0..a.nrows()).map(left_out).collect() },
        })
    }
}

/// Working memory of [`Regression::guess`].
#[derive(Debug, Clone, Default)]
pub(super) struct Memory {
    centred: Vec<f32>,
    components: Vec<f32>,
    kernel: Vec<f32>,
}

/// The smallest of some squared distances; infinite for none.
fn least(squared: &[f32]) -> f32 {
    squared.iter().fold(f32::INFINITY, |least, d2| if *d2 < least { *d2 } else { least })
}

/// Sums of two terms over all values, in eight running sums each: a single sum would wait for each addition.
fn sums<T>(kernel: &[f32], values: &[T], terms: impl Fn(f64, &T) -> [f64; 2]) -> [f64; 2] {
    const LANES: usize = 8;
    let mut lanes = [[0.0; 2]; LANES];
    let (whole, rest) = kernel.as_chunks::<LANES>();
    let (whole_values, rest_values) = values.as_chunks::<LANES>();
    let mut add = |lane: usize, k: f32, value: &T| {
        let [first, second] = terms(f64::from(k), value);
        lanes[lane][0] += first;
        lanes[lane][1] += second;
    };
    for (k, value) in whole.iter().zip(whole_values) {
        for lane in 0..LANES {
            add(lane, k[lane], &value[lane]);
        }
    }
    for (lane, (k, value)) in rest.iter().zip(rest_values).enumerate() {
        add(lane, *k, value);
    }
    lanes.iter().fold([0.0; 2], |sum, lane| [sum[0] + lane[0], sum[1] + lane[1]])
}

fn distance2(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum::<f32>().into()
}

fn symmetric(n: usize, value: impl Fn(usize, usize) -> f64) -> Mat<f64> {
    let mut out = Mat::<f64>::zeros(n, n);
    for j in 0..n {
        for i in j..n {
            let v = value(i, j);
            out[(i, j)] = v;
            out[(j, i)] = v;
        }
    }
    out
}

/// Mean and leading principal directions (columns) of rows of features.
fn principal(features: &[Vec<f64>], most: usize) -> Result<(Vec<f64>, Mat<f64>), LocatorError> {
    let rows = evenly(features.len(), 4000);
    let (n, d) = (rows.len(), features[0].len());
    let centre: Vec<f64> = (0..d).map(|k| rows.iter().map(|&i| features[i][k]).sum::<f64>() / n as f64).collect();
    let centred = Mat::from_fn(n, d, |i, k| features[rows[i]][k] - centre[k]);
    let what = "covariance of the frames";
    let small = n < d;
    let gram = if small { &centred * centred.transpose() } else { centred.transpose() * &centred };
    let eigen = gram.self_adjoint_eigen(Side::Lower).map_err(|_| LocatorError::Singular { what })?;
    let values = eigen.S().column_vector();
    let (size, largest) = (values.nrows(), values[values.nrows() - 1]);
    if largest.is_nan() || largest <= 0.0 {
        return Err(LocatorError::Singular { what });
    }
    let kept: Vec<usize> = (0..size).rev().take(most).filter(|&j| values[j] > 1e-9 * largest).collect();
    let vectors = Mat::from_fn(size, kept.len(), |i, j| eigen.U()[(i, kept[j])]);
    let basis = if small {
        let scaled = Mat::from_fn(size, kept.len(), |i, j| vectors[(i, j)] / values[kept[j]].sqrt());
        centred.transpose() * &scaled
    } else {
        vectors
    };
    Ok((centre, basis))
}
