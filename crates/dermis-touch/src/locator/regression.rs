//! The map from position to frame: matrix-normal Gaussian-process regression about the physical signatures, z(p) ~
//! N(g u(p), k(p, p') S), k Matern 5/2, with noise s (0.2 + (A/a)^2) on a frame of amplitude a (A: the median). S,
//! the covariance between channels, is the regression's own residual covariance shrunk to its diagonal. Rasmussen &
//! Williams (2006), sections 2.2 and 5.4.2, for the regression and for leaving one example out without refitting.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use faer::linalg::solvers::DenseSolveCore;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Mat, Par, RowRef, Side};

use super::channel_covariance::{ChannelPrior, channel_factor};
use super::data::Hyperparameters;
use super::design::{Design, Prior};
use super::error::LocatorError;
use super::pair_correlations::matern52;
use crate::statistics::median;

/// Noise of the strongest frames relative to the median frame: the part that is independent of amplitude.
const AMPLITUDE_INDEPENDENT_NOISE: f64 = 0.2;

/// Noise variance, relative to the map's prior variance, of a frame of `amplitude`.
pub(super) fn noise_variance(noise: f64, amplitude: f64, median_amplitude: f64) -> f64 {
    noise * (AMPLITUDE_INDEPENDENT_NOISE + (median_amplitude / amplitude).powi(2))
}

/// Correlations of all `a` (rows) with all `b` (columns).
pub(super) fn correlations(a: &[[f64; 2]], b: &[[f64; 2]], length_m: f64) -> Mat<f64> {
    Mat::from_fn(a.len(), b.len(), |i, j| matern52(a[i], b[j], length_m))
}

/// Inverse of the examples' covariance, noise included.
pub(super) fn inverse_covariance(
    positions: &[[f64; 2]],
    noise: &[f64],
    length_m: f64,
) -> Result<Mat<f64>, LocatorError> {
    inverse_with_noise(correlations(positions, positions, length_m), noise)
}

/// Inverse of the examples' covariance: their correlations plus each one's noise.
fn inverse_with_noise(mut k: Mat<f64>, noise: &[f64]) -> Result<Mat<f64>, LocatorError> {
    for (i, noise) in noise.iter().enumerate() {
        k[(i, i)] += noise;
    }
    let factor = k.llt(Side::Lower).map_err(|_| LocatorError::Singular { what: "covariance of the examples" })?;
    Ok(factor.inverse())
}

/// The regression's smoothed value at each example, used to fill missing channels.
pub(super) fn smoothed(design: &Design, prior: &Prior, hyper: &Hyperparameters) -> Result<Mat<f64>, LocatorError> {
    let noise = example_noise(design, hyper.noise);
    let inverse = inverse_covariance(&design.positions_m, &noise, hyper.length_m)?;
    let alpha = &inverse * (&design.z - &prior.at_examples);
    Ok(Mat::from_fn(alpha.nrows(), alpha.ncols(), |i, k| design.z[(i, k)] - noise[i] * alpha[(i, k)]))
}

/// Noise variance of every example, including the extra variance of rotated copies.
pub(super) fn example_noise(design: &Design, noise: f64) -> Vec<f64> {
    let median = median(&design.amplitude);
    let apart = design.apart();
    design.amplitude.iter().map(|&a| apart + noise_variance(noise, a, median)).collect()
}

/// The fitted map in whitened coordinates y = T z, in which the covariance between channels is the identity, with
/// everything needed to leave one example out.
#[derive(Debug, Clone)]
pub(super) struct FittedMap {
    /// Computed on demand, since judging the candidates of a search does not need it.
    transform: OnceLock<Mat<f64>>,
    signatures: OnceLock<Mat<f64>>,
    /// Whitened examples: rank by examples.
    pub frames: Mat<f64>,
    /// Squared lengths of the whitened signatures.
    pub squares: Vec<f64>,
    unwhitened: Arc<UnwhitenedMap>,
    /// L, with T = L^-1 in the coordinates of the basis.
    factor: Mat<f64>,
    alpha: Mat<f64>,
    sample_share: f64,
    signatures_frames: Mat<f64>,
    signatures_alpha: Mat<f64>,
}

/// The part of the fitted map that does not depend on the covariance between channels.
#[derive(Debug)]
pub(super) struct UnwhitenedMap {
    /// Noise variance of each example.
    noise: Vec<f64>,
    /// Examples, and their residuals against the prior: examples by rank.
    z: Mat<f64>,
    residual: Mat<f64>,
    /// K^-1 times the residual.
    alpha: Mat<f64>,
    /// k(p, .) K^-1: positions by examples.
    influence: Mat<f64>,
    inverse_diagonal: Vec<f64>,
    /// Remaining variance of the map at each position, relative to the prior's.
    variance: Vec<f64>,
    /// Positions by rank.
    map: Mat<f64>,
    /// Set if the prior is zero everywhere: the map is then their `to_map` times `alpha`.
    without_prior: Option<Arc<Correlations>>,
}

/// Correlations of positions for one length.
#[derive(Debug)]
struct Correlations {
    among_examples: Mat<f64>,
    /// Positions by examples.
    to_map: Mat<f64>,
}

/// Results of a hyperparameter search for examples and a map at the same positions, by length.
#[derive(Debug, Clone, Default)]
struct Known(Arc<Mutex<Vec<AtLength>>>);

/// A length with the correlations for it.
type AtLength = (f64, Arc<Correlations>);

impl Known {
    fn at(&self, positions: &[[f64; 2]], design: &Design, length_m: f64) -> Arc<Correlations> {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, known)) = known.iter().find(|(of, _)| *of == length_m) {
            return known.clone();
        }
        let to_map = design.correlations_to(positions, length_m);
        let new = Arc::new(Correlations { among_examples: design.correlations_among(length_m), to_map });
        known.push((length_m, new.clone()));
        new
    }
}

/// Latest intermediate results of a hyperparameter search for one design, prior, map and basis. Most of them serve
/// the next candidate too.
#[derive(Debug, Default)]
pub(super) struct WorkedOut {
    correlations: Known,
    /// Keyed by length and noise.
    unwhitened: Option<([f64; 2], Arc<UnwhitenedMap>)>,
}

impl WorkedOut {
    /// Results that remain valid for another design and prior with examples and a map at the same positions.
    pub(super) fn elsewhere(&self) -> Self {
        Self { correlations: self.correlations.clone(), unwhitened: None }
    }

    fn unwhitened(
        &mut self,
        design: &Design,
        prior: &Prior,
        positions: &[[f64; 2]],
        basis: Option<&Mat<f64>>,
        hyper: &Hyperparameters,
    ) -> Result<Arc<UnwhitenedMap>, LocatorError> {
        let key = [hyper.length_m, hyper.noise];
        if let Some((_, known)) = self.unwhitened.as_ref().filter(|(of, _)| *of == key) {
            return Ok(known.clone());
        }
        let correlations = self.correlations.at(positions, design, hyper.length_m);
        let unwhitened = Arc::new(UnwhitenedMap::new(design, prior, &correlations, basis, hyper)?);
        self.unwhitened = Some((key, unwhitened.clone()));
        Ok(unwhitened)
    }
}

impl UnwhitenedMap {
    fn new(
        design: &Design,
        prior: &Prior,
        correlations: &Arc<Correlations>,
        basis: Option<&Mat<f64>>,
        hyper: &Hyperparameters,
    ) -> Result<Self, LocatorError> {
        let project = |m: &Mat<f64>| basis.map_or_else(|| m.clone(), |q| m * q);
        let noise = example_noise(design, hyper.noise);
        let inverse = inverse_with_noise(correlations.among_examples.clone(), &noise)?;
        let z = project(&design.z);
        let residual = &z - project(&prior.at_examples);
        let alpha = &inverse * &residual;
        let influence = &correlations.to_map * &inverse;
        let map = project(&prior.over_map) + &correlations.to_map * &alpha;
        let is_zero = prior.over_map.norm_max() == 0.0;
        Ok(Self {
            without_prior: is_zero.then(|| correlations.clone()),
            variance: remaining_variance(&correlations.to_map, &influence, design.apart()),
            inverse_diagonal: (0..noise.len()).map(|i| inverse[(i, i)]).collect(),
            noise,
            z,
            residual,
            alpha,
            influence,
            map,
        })
    }
}

impl FittedMap {
    /// Fits the map to a design whose rows `basis` (if any) projects. `worked_out` must belong to the same design,
    /// prior, positions and basis, or be new.
    pub(super) fn new(
        design: &Design,
        prior: &Prior,
        positions: &[[f64; 2]],
        basis: Option<&Mat<f64>>,
        hyper: &Hyperparameters,
        channel_prior: Option<&ChannelPrior>,
        worked_out: &mut WorkedOut,
    ) -> Result<Self, LocatorError> {
        let unwhitened = worked_out.unwhitened(design, prior, positions, basis, hyper)?;
        let UnwhitenedMap { z, residual, alpha, map, .. } = &*unwhitened;
        let n = z.nrows();
        // Directions made for the examples contain little of another frame except its noise.
        let least = basis.map_or(0.0, |_| design.noise_variance / noise_variance(hyper.noise, 1.0, 1.0));
        let factor = channel_factor(residual, alpha, hyper.shrinkage, least, channel_prior)?;
        let (frames, alpha) = (whitened(&factor, z), whitened(&factor, alpha));
        let (transform, signatures) = (OnceLock::new(), OnceLock::new());
        if let Some(q) = basis {
            let _ = transform.set(whitened(&factor, q));
        }
        // With few examples, signatures are sums over the examples, and so are their products.
        let short = unwhitened.without_prior.as_deref().filter(|_| 4 * n < 5 * z.ncols());
        let (squares, signatures_frames, signatures_alpha) = match short {
            Some(Correlations { to_map, .. }) => {
                let signatures_alpha = to_map * (alpha.transpose() * &alpha);
                let mut squares = vec![0.0; to_map.nrows()];
                for i in 0..n {
                    let pairs = to_map.col_as_slice(i).iter().zip(signatures_alpha.col_as_slice(i));
                    squares.iter_mut().zip(pairs).for_each(|(sum, (k, along))| *sum += k * along);
                }
                squares.iter_mut().for_each(|square| *square = square.max(0.0));
                (squares, to_map * (alpha.transpose() * &frames), signatures_alpha)
            }
            None => {
                let all = signatures.get_or_init(|| whitened(&factor, map));
                let squares = (0..all.ncols()).map(|p| all.col(p).squared_norm_l2()).collect();
                (squares, all.transpose() * &frames, all.transpose() * &alpha)
            }
        };
        Ok(Self {
            transform,
            signatures,
            frames,
            squares,
            unwhitened,
            factor,
            alpha,
            sample_share: (1.0 - hyper.shrinkage) / (n as f64 + channel_prior.map_or(0.0, |p| p.examples)),
            signatures_frames,
            signatures_alpha,
        })
    }

    /// Frees the products of signatures and examples, after which no example can be left out.
    pub(super) fn forget_products(&mut self) {
        (self.signatures_frames, self.signatures_alpha) = (Mat::new(), Mat::new());
    }

    /// T: rank by channels.
    pub(super) fn transform(&self) -> &Mat<f64> {
        let channels = self.factor.nrows();
        self.transform.get_or_init(|| whitened(&self.factor, &Mat::identity(channels, channels)))
    }

    /// Whitened signature of each map position: rank by positions.
    pub(super) fn signatures(&self) -> &Mat<f64> {
        self.signatures.get_or_init(|| whitened(&self.factor, &self.unwhitened.map))
    }

    /// Remaining variance of the map at each position, relative to the prior's.
    pub(super) fn variance(&self) -> &[f64] {
        &self.unwhitened.variance
    }

    /// Remaining variance of the map at position `p` in the fit without example `i`.
    pub(super) fn left_out_variance(&self, i: usize, p: usize) -> f64 {
        let UnwhitenedMap { variance, influence, inverse_diagonal, .. } = &*self.unwhitened;
        variance[p] + influence[(p, i)].powi(2) / inverse_diagonal[i]
    }

    /// Log-likelihood over the map of a frame that was not in the fit. Returns the misfit at the best position.
    pub(super) fn log_likelihood(&self, z: RowRef<'_, f64>, noise: f64, out: &mut [f64]) -> f64 {
        let frame = self.transform() * z.transpose();
        let along = self.signatures().transpose() * &frame;
        let (frame_frame, rank) = (frame.squared_norm_l2(), self.frames.nrows() as f64);
        let mut best = (f64::NEG_INFINITY, 0.0);
        for (p, value) in out.iter_mut().enumerate() {
            let products = Products { frame_frame, frame_map: along[p], map_map: self.squares[p] };
            let variance = self.variance()[p] + noise;
            let misfit = products.misfit() / variance;
            *value = -0.5 * (misfit + rank * variance.ln());
            if *value > best.0 {
                best = (*value, misfit);
            }
        }
        best.1 / rank
    }

    /// Log-likelihood over the map of example `i` in the fit without it. Returns the misfit at the best position.
    ///
    /// Without example i the map is m(p) - h r, with r = alpha_i / K^-1_ii and h = (k(p, .) K^-1)_i. Its variance
    /// grows by h^2 / K^-1_ii, and the sample covariance loses alpha_i alpha_i' / K^-1_ii. By the Sherman-Morrison
    /// formula the latter adds one term to every inner product.
    pub(super) fn left_out_log_likelihood(&self, i: usize, out: &mut [f64]) -> f64 {
        let UnwhitenedMap { variance: remaining, influence, inverse_diagonal, noise, .. } = &*self.unwhitened;
        let diagonal = inverse_diagonal[i];
        let (z, a, h) = (self.frames.col(i), self.alpha.col(i), influence.col(i));
        let (zz, za, aa) = (z.squared_norm_l2(), z.transpose() * a, a.squared_norm_l2());
        let extra = match self.sample_share {
            share if share > 0.0 => 1.0 / (diagonal / share - aa).max(1e-9 * diagonal / share),
            _ => 0.0,
        };
        let (step, rank) = (1.0 / diagonal, self.frames.nrows() as f64);
        let mut best = (f64::NEG_INFINITY, 0.0);
        for (p, value) in out.iter_mut().enumerate() {
            let hr = h[p] * step;
            let (mz, ma) = (self.signatures_frames[(p, i)], self.signatures_alpha[(p, i)]);
            let ma_out = ma - hr * aa;
            let products = Products {
                frame_frame: zz + extra * za * za,
                frame_map: mz - hr * za + extra * za * ma_out,
                map_map: self.squares[p] - 2.0 * hr * ma + hr * hr * aa + extra * ma_out * ma_out,
            };
            let variance = remaining[p] + h[p] * hr + noise[i];
            let misfit = products.misfit() / variance;
            *value = -0.5 * (misfit + rank * variance.ln());
            if *value > best.0 {
                best = (*value, misfit);
            }
        }
        best.1 / rank
    }
}

/// Rows as columns in whitened coordinates: L^-1 of each.
fn whitened(factor: &Mat<f64>, rows: &Mat<f64>) -> Mat<f64> {
    let mut columns = rows.transpose().to_owned();
    solve_lower_triangular_in_place(factor.as_ref(), columns.as_mut(), Par::Seq);
    columns
}

/// Inner products of a whitened frame and a whitened signature.
#[derive(Debug, Clone, Copy)]
pub(super) struct Products {
    /// Frame with itself.
    pub frame_frame: f64,
    /// Frame with signature.
    pub frame_map: f64,
    /// Signature with itself.
    pub map_map: f64,
}

impl Products {
    /// Squared distance from the frame to the best positive multiple of the signature.
    pub(super) fn misfit(self) -> f64 {
        let along = self.frame_map.max(0.0);
        if self.map_map > 0.0 { (self.frame_frame - along * along / self.map_map).max(0.0) } else { self.frame_frame }
    }
}

/// 1 - k K^-1 k' at every map position, with a small positive lower bound, plus `apart`.
fn remaining_variance(to_map: &Mat<f64>, influence: &Mat<f64>, apart: f64) -> Vec<f64> {
    let explained = |p: usize| (0..to_map.ncols()).map(|i| to_map[(p, i)] * influence[(p, i)]).sum::<f64>();
    (0..to_map.nrows()).map(|p| (1.0 - explained(p)).max(1e-6) + apart).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn made_up(n: usize, channels: usize) -> (Design, Prior, Vec<[f64; 2]>) {
        let scattered = |i: usize, k: usize| ((i * 131 + k) as f64 * 12.9898).sin() * 43_758.545_3 % 1.0;
        let positions_m: Vec<[f64; 2]> = (0..n).map(|i| [0, 1].map(|k| 0.05 * scattered(i, k))).collect();
        let map: Vec<[f64; 2]> =
            (0..25).map(|p| [0.02 * f64::from(p % 5) - 0.04, 0.02 * f64::from(p / 5) - 0.04]).collect();
        let smooth = |p: [f64; 2], k: usize| (20.0 * p[0] + k as f64).sin() + (15.0 * p[1] - k as f64).cos();
        let design = Design {
            z: Mat::from_fn(n, channels, |i, k| smooth(positions_m[i], k) + scattered(i, k + 2)),
            amplitude: vec![1.0; n],
            positions_m,
            copies: None,
            sessions: None,
            weights: vec![1.0; channels],
            energy: vec![1.0; channels],
            missing: Vec::new(),
            noise_variance: 0.0,
        };
        let prior =
            Prior { at_examples: Mat::zeros(n, channels), over_map: Mat::zeros(map.len(), channels), cosine: 0.0 };
        (design, prior, map)
    }

    /// The closed form for leaving an example out agrees with refitting without it. Without shrinkage the two sample
    /// covariances differ by a factor: n - 1 examples give n / (n - 1) times the closed form's, which keeps n.
    #[test]
    fn leaving_out_equals_refitting() {
        let (n, channels, out) = (40, 6, 11);
        let (design, prior, map) = made_up(n, channels);
        let hyper = Hyperparameters { length_m: 0.03, noise: 0.1, shrinkage: 1e-12 };
        let full = FittedMap::new(&design, &prior, &map, None, &hyper, None, &mut WorkedOut::default()).expect("fits");
        let mut closed = vec![0.0; map.len()];
        full.left_out_log_likelihood(out, &mut closed);
        let rows: Vec<usize> = (0..n).filter(|i| *i != out).collect();
        let (some, about) = (design.subset(&rows), prior.subset(&rows));
        let new = &mut WorkedOut::default();
        let rest = FittedMap::new(&some, &about, &map, None, &hyper, None, new).expect("fits");
        let frame = rest.transform() * design.z.row(out).transpose();
        for p in 0..map.len() {
            let signature = rest.signatures().col(p);
            let frame_map = signature.transpose() * &frame;
            let products = Products { frame_frame: frame.squared_norm_l2(), frame_map, map_map: rest.squares[p] };
            let variance = rest.variance()[p] + full.unwhitened.noise[out];
            let misfit = products.misfit() * n as f64 / (n - 1) as f64 / variance;
            let refitted = -0.5 * (misfit + channels as f64 * variance.ln());
            let difference = (closed[p] - refitted).abs();
            assert!(difference < 1e-8 * refitted.abs().max(1.0), "position {p}: {} against {refitted}", closed[p]);
        }
    }

    /// With fewer examples than channels, the sample covariance nearly vanishes in the direction of the left-out
    /// example, and the closed form must reproduce that. It keeps the diagonal and the count of all n examples, hence
    /// the tolerance.
    #[test]
    fn leaving_out_one_of_few_examples_is_not_flattering() {
        let (n, channels) = (10, 60);
        let (design, prior, map) = made_up(n, channels);
        let hyper = Hyperparameters { length_m: 0.03, noise: 0.1, shrinkage: 0.03 };
        let full = FittedMap::new(&design, &prior, &map, None, &hyper, None, &mut WorkedOut::default()).expect("fits");
        let (mut closed, mut refitted) = (vec![0.0; map.len()], vec![0.0; map.len()]);
        for out in 0..n {
            full.left_out_log_likelihood(out, &mut closed);
            let rows: Vec<usize> = (0..n).filter(|i| *i != out).collect();
            let (some, about) = (design.subset(&rows), prior.subset(&rows));
            let rest =
                FittedMap::new(&some, &about, &map, None, &hyper, None, &mut WorkedOut::default()).expect("fits");
            rest.log_likelihood(design.z.row(out), full.unwhitened.noise[out], &mut refitted);
            let top = (0..map.len()).fold(0, |b, p| if closed[p] > closed[b] { p } else { b });
            let misfit =
                |value: f64| -2.0 * value / channels as f64 - (rest.variance()[top] + full.unwhitened.noise[out]).ln();
            let ratio = misfit(closed[top]) / misfit(refitted[top]);
            assert!((0.7..1.4).contains(&ratio), "example {out}: misfit {ratio} times that of the refit");
        }
    }

    /// With few examples and no prior, products of signatures are summed over the examples. Up to rounding, they
    /// agree with direct products.
    #[test]
    fn products_without_signatures_equal_those_of_signatures() {
        let (design, prior, map) = made_up(10, 60);
        let hyper = Hyperparameters { length_m: 0.03, noise: 0.1, shrinkage: 0.3 };
        let fitted =
            FittedMap::new(&design, &prior, &map, None, &hyper, None, &mut WorkedOut::default()).expect("fits");
        assert!(fitted.signatures.get().is_none(), "the short way is taken");
        let signatures = fitted.signatures();
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "{a} and {b}");
        for p in 0..map.len() {
            close(fitted.squares[p], signatures.col(p).squared_norm_l2());
            for i in 0..10 {
                close(fitted.signatures_frames[(p, i)], signatures.col(p).transpose() * fitted.frames.col(i));
                close(fitted.signatures_alpha[(p, i)], signatures.col(p).transpose() * fitted.alpha.col(i));
            }
        }
    }

    #[test]
    fn correlation_falls_from_one() {
        assert_eq!(matern52([0.01, 0.02], [0.01, 0.02], 0.03), 1.0);
        // (1 + sqrt 5 + 5/3) exp(-sqrt 5), Rasmussen & Williams eq. 4.17 at r = l.
        assert!((matern52([0.0, 0.0], [0.03, 0.0], 0.03) - 0.523_994).abs() < 1e-6);
    }
}
