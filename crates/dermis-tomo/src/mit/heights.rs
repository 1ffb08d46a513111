//! Heights of known bodies from readings of coils: what moves under a touch are bodies at known places, so their travel
//! toward the coils is solved for directly instead of an image. Minimises
//! `sum ((d - f(t))/s)^2 + sum (t/p)^2 + 2 sum t/e` over travels `0 <= t <= limit` by Gauss-Newton steps, each a least-squares problem in
//! that box solved by coordinate descent (Franc, Hlavac and Navara 2005); f are changes of magnitudes of mutual
//! inductances, s their standard deviations, p and e those of a Gaussian and an exponential prior; the latter makes few
//! bodies move.

use super::error::positive;
use super::{Bodies, Complex, MitError};

/// How heights are solved for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeightsOptions {
    /// p: standard deviation of travels before anything is measured, metres.
    pub prior_m: f64,
    /// e: mean travel of the exponential prior, metres; infinite for none.
    pub mean_m: f64,
    /// Error of the model as a share of each channel's change, which adds to the noise.
    pub model_share: f64,
    /// The same as a share of the change's root mean square over all channels.
    pub model_floor: f64,
    /// Most Gauss-Newton steps.
    pub most_steps: usize,
    /// Ends where no travel changes by more, metres.
    pub tolerance_m: f64,
}

impl Default for HeightsOptions {
    /// For travels of millimetres and a model good to a few per cent.
    fn default() -> Self {
        Self { prior_m: 10e-3, mean_m: 1e-3, model_share: 0.02, model_floor: 0.003, most_steps: 30, tolerance_m: 1e-6 }
    }
}

/// Travels that fit readings.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightsFit {
    /// Travel of each body toward the coils, metres.
    pub travel_m: Vec<f64>,
    /// Posterior standard deviation of each, metres, linearised; of bodies at rest (on the bound), as if it were free.
    pub deviation_m: Vec<f64>,
    /// Mean squared residual in units of noise and model error; about 1 where these are right.
    pub misfit: f64,
    /// Gauss-Newton steps done.
    pub steps: usize,
    /// Whether the tolerance was met.
    pub converged: bool,
}

/// Bodies over coils whose travels are asked for.
#[derive(Clone, Debug)]
pub struct Heights {
    bodies: Bodies,
    mutuals_h: Vec<f64>,
    rest_m: Vec<f64>,
    limit_m: f64,
    rest_h: Vec<f64>,
    changes_h: Vec<Complex>,
    slopes_h_per_m: Vec<Complex>,
}

impl Heights {
    /// Bodies at their heights at rest, which move down by at most `limit_m`; `mutuals_h` without bodies, pair by pair.
    ///
    /// # Errors
    /// Counts that disagree, a limit that is not positive or leads out of the bodies' tables.
    pub fn new(mut bodies: Bodies, mutuals_h: Vec<f64>, rest_m: Vec<f64>, limit_m: f64) -> Result<Self, MitError> {
        positive("limit_m", limit_m)?;
        let (pairs, count) = (bodies.pairs().len(), bodies.count());
        if mutuals_h.len() != pairs {
            return Err(MitError::Count { what: "mutual inductances", expected: pairs, got: mutuals_h.len() });
        }
        let zero = Complex::new(0.0, 0.0);
        let mut changes_h = vec![zero; pairs];
        let lowest: Vec<f64> = rest_m.iter().map(|h| h - limit_m).collect();
        bodies.changes(&lowest, &mut changes_h)?;
        bodies.changes(&rest_m, &mut changes_h)?;
        let rest_h = magnitudes(&mutuals_h, &changes_h).collect();
        let slopes_h_per_m = vec![zero; pairs * count];
        Ok(Self { bodies, mutuals_h, rest_m, limit_m, rest_h, changes_h, slopes_h_per_m })
    }

    /// Number of bodies.
    pub fn count(&self) -> usize {
        self.rest_m.len()
    }

    /// Magnitudes of the mutual inductances at rest, henries.
    pub fn rest_h(&self) -> &[f64] {
        &self.rest_h
    }

    /// Changes of the magnitudes from rest, henries, for these travels.
    ///
    /// # Errors
    /// As [`Bodies::changes`].
    pub fn differences_h(&mut self, travel_m: &[f64]) -> Result<Vec<f64>, MitError> {
        let heights: Vec<f64> = self.rest_m.iter().zip(travel_m).map(|(rest, t)| rest - t).collect();
        self.bodies.changes(&heights, &mut self.changes_h)?;
        Ok(magnitudes(&self.mutuals_h, &self.changes_h).zip(&self.rest_h).map(|(now, rest)| now - rest).collect())
    }

    /// Derivatives of the magnitudes by the travels, pair by pair and body by body, henries per metre.
    fn jacobian(&mut self, travel_m: &[f64]) -> Result<Vec<f64>, MitError> {
        let heights: Vec<f64> = self.rest_m.iter().zip(travel_m).map(|(rest, t)| rest - t).collect();
        self.bodies.changes(&heights, &mut self.changes_h)?;
        self.bodies.slopes(&heights, &mut self.slopes_h_per_m)?;
        let mut jacobian = Vec::with_capacity(self.slopes_h_per_m.len());
        let rows = self.slopes_h_per_m.chunks_exact(self.rest_m.len());
        for ((row, change), mutual) in rows.zip(&self.changes_h).zip(&self.mutuals_h) {
            let whole = *change + *mutual;
            let direction = whole.conj() * (1.0 / whole.norm().max(f64::MIN_POSITIVE));
            jacobian.extend(row.iter().map(|slope| -(direction * *slope).re));
        }
        Ok(jacobian)
    }

    /// Travels that fit these changes of magnitudes (henries: volts over `2 pi f I`) with noise of these standard deviations.
    ///
    /// # Errors
    /// Counts that disagree, deviations or options that are not positive.
    pub fn solve(
        &mut self,
        differences_h: &[f64],
        deviations_h: &[f64],
        options: &HeightsOptions,
    ) -> Result<HeightsFit, MitError> {
        self.solve_from(&vec![0.0; self.count()], differences_h, deviations_h, options)
    }

    /// The same from travels that are thought to be near, as those of the frame before: fewer steps.
    ///
    /// # Errors
    /// As [`Heights::solve`].
    pub fn solve_from(
        &mut self,
        start_m: &[f64],
        differences_h: &[f64],
        deviations_h: &[f64],
        options: &HeightsOptions,
    ) -> Result<HeightsFit, MitError> {
        let weights = self.weights(differences_h, deviations_h, options)?;
        let (prior, pull) = (options.prior_m.powi(-2), 1.0 / options.mean_m);
        let count = self.count();
        if start_m.len() != count {
            return Err(MitError::Count { what: "travels", expected: count, got: start_m.len() });
        }
        let mut travel: Vec<f64> = start_m.iter().map(|t| t.clamp(0.0, self.limit_m)).collect();
        let predicted = self.differences_h(&travel)?;
        let mut residual: Vec<f64> = differences_h.iter().zip(&predicted).map(|(d, p)| d - p).collect();
        let cost = |residual: &[f64], travel: &[f64]| -> f64 {
            residual.iter().zip(&weights).map(|(r, w)| w * r * r).sum::<f64>()
                + travel.iter().map(|t| prior * t * t + 2.0 * pull * t).sum::<f64>()
        };
        let mut now = cost(&residual, &travel);
        let (mut steps, mut converged) = (0, false);
        while steps < options.most_steps && !converged {
            steps += 1;
            let jacobian = self.jacobian(&travel)?;
            let normal = normal_matrix(&jacobian, &weights, count, prior);
            let mut target = gradient(&jacobian, &weights, &residual, &travel, &normal, prior);
            target.iter_mut().for_each(|b| *b -= pull);
            let wanted = in_box(&normal, &target, &travel, self.limit_m);
            let mut share = 1.0;
            loop {
                let tried: Vec<f64> = travel.iter().zip(&wanted).map(|(t, w)| t + share * (w - t)).collect();
                let predicted = self.differences_h(&tried)?;
                let left: Vec<f64> = differences_h.iter().zip(&predicted).map(|(d, p)| d - p).collect();
                let then = cost(&left, &tried);
                let moved = travel.iter().zip(&tried).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                converged = moved <= options.tolerance_m;
                if then <= now {
                    (travel, residual, now) = (tried, left, then);
                    break;
                }
                if converged {
                    break;
                }
                share *= 0.5;
            }
        }
        let jacobian = self.jacobian(&travel)?;
        let normal = normal_matrix(&jacobian, &weights, count, prior);
        let squares: f64 = residual.iter().zip(&weights).map(|(r, w)| w * r * r).sum();
        let deviation_m = deviations(&normal, &travel);
        Ok(HeightsFit { travel_m: travel, deviation_m, misfit: squares / residual.len() as f64, steps, converged })
    }

    fn weights(&self, d: &[f64], deviations_h: &[f64], options: &HeightsOptions) -> Result<Vec<f64>, MitError> {
        positive("prior_m", options.prior_m)?;
        positive("tolerance_m", options.tolerance_m)?;
        if options.mean_m.is_nan() || options.mean_m <= 0.0 {
            return Err(MitError::Value { field: "mean_m", value: options.mean_m, expected: "above zero" });
        }
        for (what, got) in [("differences", d.len()), ("deviations", deviations_h.len())] {
            if got != self.mutuals_h.len() {
                return Err(MitError::Count { what, expected: self.mutuals_h.len(), got });
            }
        }
        let mean_square = d.iter().map(|d| d * d).sum::<f64>() / d.len() as f64;
        let mut weights = Vec::with_capacity(d.len());
        for (d, s) in d.iter().zip(deviations_h) {
            positive("deviation_h", *s)?;
            let model = (options.model_share * d).powi(2) + options.model_floor.powi(2) * mean_square;
            let weight = 1.0 / (s * s + model);
            if !d.is_finite() {
                return Err(MitError::Value { field: "difference_h", value: *d, expected: "finite" });
            }
            weights.push(weight);
        }
        Ok(weights)
    }
}

fn magnitudes<'a>(mutuals_h: &'a [f64], changes_h: &'a [Complex]) -> impl Iterator<Item = f64> + 'a {
    mutuals_h.iter().zip(changes_h).map(|(mutual, change)| (*change + *mutual).norm())
}

/// `J'WJ + prior I`, row by row.
fn normal_matrix(jacobian: &[f64], weights: &[f64], count: usize, prior: f64) -> Vec<f64> {
    let mut normal = vec![0.0; count * count];
    for (row, w) in jacobian.chunks_exact(count).zip(weights) {
        for (i, a) in row.iter().enumerate() {
            let scaled = w * a;
            normal[i * count..(i + 1) * count].iter_mut().zip(row).for_each(|(n, b)| *n += scaled * b);
        }
    }
    (0..count).for_each(|i| normal[i * count + i] += prior);
    normal
}

/// b of the quadratic `t'Ht/2 - b't` around the travels now: `J'W r - prior t + H t`.
fn gradient(
    jacobian: &[f64],
    weights: &[f64],
    residual: &[f64],
    travel: &[f64],
    normal: &[f64],
    prior: f64,
) -> Vec<f64> {
    let count = travel.len();
    let mut b: Vec<f64> = normal
        .chunks_exact(count)
        .zip(travel)
        .map(|(row, t)| row.iter().zip(travel).map(|(h, t)| h * t).sum::<f64>() - prior * t)
        .collect();
    for ((row, w), r) in jacobian.chunks_exact(count).zip(weights).zip(residual) {
        b.iter_mut().zip(row).for_each(|(b, j)| *b += w * r * j);
    }
    b
}

/// Minimum of `t'Ht/2 - b't` with every t between 0 and the limit.
fn in_box(normal: &[f64], b: &[f64], start: &[f64], limit: f64) -> Vec<f64> {
    let count = b.len();
    let mut t = start.to_vec();
    for _ in 0..2000 {
        let mut moved: f64 = 0.0;
        for (i, row) in normal.chunks_exact(count).enumerate() {
            let slope = row.iter().zip(&t).map(|(h, t)| h * t).sum::<f64>() - b[i];
            let next = (t[i] - slope / row[i]).clamp(0.0, limit);
            moved = moved.max((next - t[i]).abs());
            t[i] = next;
        }
        if moved <= 1e-9 * limit {
            break;
        }
    }
    t
}

/// Roots of the diagonal of the inverse over the bodies that moved; for each other, over those and itself.
fn deviations(normal: &[f64], travel: &[f64]) -> Vec<f64> {
    let count = travel.len();
    let variance = |free: &[usize], of: usize| -> f64 {
        // A Cholesky factor of the free part with `of` last: the inverse's last entry is 1/l^2.
        let order: Vec<usize> = free.iter().copied().filter(|k| *k != of).chain([of]).collect();
        let n = order.len();
        let mut l = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                let known: f64 = (0..j).map(|k| l[i * n + k] * l[j * n + k]).sum();
                let value = normal[order[i] * count + order[j]] - known;
                l[i * n + j] = if i == j { value.max(f64::MIN_POSITIVE).sqrt() } else { value / l[j * n + j] };
            }
        }
        l[n * n - 1].powi(-2)
    };
    let free: Vec<usize> = (0..count).filter(|k| travel[*k] > 0.0).collect();
    (0..count).map(|k| variance(&free, k).sqrt()).collect()
}
