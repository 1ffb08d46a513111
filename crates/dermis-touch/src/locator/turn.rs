//! A skin with rotational symmetry. If its electrodes are evenly spaced around the rim, rotating it by one electrode
//! replaces every channel by another: with t the rotation of the skin and P the permutation of the channels, the
//! frame at t p is about P z(p). A poke then also informs each of the rotated positions, the less the further it was
//! rotated:
//!
//! cov(z_c(p), z_c'(p')) = r(s) k(p, t^s p') S_c where c = P^s c', r the resemblance after s steps.
//!
//! Copies of the pokes with these correlations are examples of the same regression, since the factor is the same for
//! all channels. The permutation is learned from a sister's map ([`turn_search`](super::turn_search)).

use faer::{Mat, Side};

use super::data::Hyperparameters;
use super::design::{Design, Prior};
use super::error::LocatorError;
use super::pair_correlations::Copies;
use super::regression::example_noise;

/// Lower bound on the variance of a channel, as a share of the mean.
const SMALLEST_SHARE: f64 = 1e-3;

/// Effect of rotating a skin on its channels.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Turn {
    /// `channels[s][c]`: the channel that reads, s steps on, what channel c reads.
    pub channels: Vec<Vec<usize>>,
    /// Correlation of a channel's map with its map s steps on, rotated back.
    pub resemblance: Vec<f64>,
    /// Angle of one step, radians; negative is clockwise.
    pub angle: f64,
    /// Centre of rotation, metres.
    pub centre_m: [f64; 2],
}

impl Turn {
    /// The same channels on a skin whose electrodes are numbered in the opposite direction.
    pub(super) fn reversed(&self) -> Self {
        Self { angle: -self.angle, ..self.clone() }
    }

    /// A position rotated by `turns` steps.
    pub(super) fn place_m(&self, place_m: [f64; 2], turns: f64) -> [f64; 2] {
        let (sin, cos) = (self.angle * turns).sin_cos();
        let [x, y] = [0, 1].map(|axis| place_m[axis] - self.centre_m[axis]);
        [self.centre_m[0] + cos * x - sin * y, self.centre_m[1] + sin * x + cos * y]
    }

    /// The examples with all their rotated copies. A channel that is never used neither gives nor receives values.
    pub(super) fn copies(&self, design: &Design) -> Design {
        let (n, c) = (design.z.nrows(), design.z.ncols());
        let turns = self.resemblance.len();
        let used = |k: usize| design.weights[k] > 0.0;
        let value = |row: usize, k: usize| {
            let from = self.channels[row / n][k];
            if used(k) && used(from) { design.z[(row % n, from)] } else { 0.0 }
        };
        let row = |r: usize| (r % n, (r / n) as f64);
        Design {
            z: Mat::from_fn(turns * n, c, value),
            amplitude: (0..turns * n).map(|r| design.amplitude[r % n]).collect(),
            positions_m: (0..turns * n).map(row).map(|(i, s)| self.place_m(design.positions_m[i], -s)).collect(),
            copies: Some(Copies {
                steps: (0..turns * n).map(|r| r / n).collect(),
                resemblance: self.resemblance.clone(),
            }),
            sessions: None,
            weights: design.weights.clone(),
            energy: design.energy.clone(),
            missing: Vec::new(),
            noise_variance: design.noise_variance,
        }
    }

    /// Log evidence for rotated copies: log density of the examples with correlated copies minus that with
    /// independent ones.
    pub(super) fn evidence(&self, design: &Design, hyper: &Hyperparameters) -> Result<f64, LocatorError> {
        let mut single = self.clone();
        single.resemblance.iter_mut().enumerate().for_each(|(s, r)| *r = if s == 0 { 1.0 } else { 0.0 });
        Ok(log_density(&self.copies(design), hyper)? - log_density(&single.copies(design), hyper)?)
    }
}

/// Log density of the examples about a mean of zero, with the maximum-likelihood variance of each channel. For copies
/// it is divided by their number, since every example appears in every copy.
pub(super) fn log_density(design: &Design, hyper: &Hyperparameters) -> Result<f64, LocatorError> {
    let (rows, c) = (design.z.nrows(), design.z.ncols());
    let mut covariance = design.correlations_among(hyper.length_m);
    for (i, noise) in example_noise(design, hyper.noise).iter().enumerate() {
        covariance[(i, i)] += noise;
    }
    let factor =
        covariance.llt(Side::Lower).map_err(|_| LocatorError::Singular { what: "covariance of the examples" })?;
    let mut whitened = design.z.clone();
    faer::linalg::triangular_solve::solve_lower_triangular_in_place(factor.L(), whitened.as_mut(), faer::Par::Seq);
    let used: Vec<usize> = (0..c).filter(|k| design.weights[*k] > 0.0).collect();
    let variance: Vec<f64> = used.iter().map(|k| whitened.col(*k).squared_norm_l2() / rows as f64).collect();
    let least = SMALLEST_SHARE * variance.iter().sum::<f64>() / used.len() as f64;
    let spread: f64 = variance.iter().map(|v| v.max(least).ln()).sum();
    let volume: f64 = (0..rows).map(|i| 2.0 * factor.L()[(i, i)].ln()).sum();
    let copies = design.copies.as_ref().map_or(1, |copies| copies.resemblance.len());
    Ok(-0.5 * (rows as f64 * spread + used.len() as f64 * volume) / copies as f64)
}

impl Prior {
    /// A prior that expects nothing of any frame.
    pub(super) fn nothing(examples: usize, positions: usize, channels: usize) -> Self {
        let zeros = |rows: usize| Mat::zeros(rows, channels);
        Self { at_examples: zeros(examples), over_map: zeros(positions), cosine: 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two channels that a half turn exchanges.
    fn half_turn() -> Turn {
        Turn {
            channels: vec![vec![0, 1], vec![1, 0]],
            resemblance: vec![1.0, 0.8],
            angle: std::f64::consts::PI,
            centre_m: [0.01, 0.0],
        }
    }

    fn design(frames: &[[f64; 2]]) -> Design {
        let n = frames.len();
        Design {
            z: Mat::from_fn(n, 2, |i, k| frames[i][k]),
            amplitude: vec![1.0; n],
            positions_m: (0..n).map(|i| [0.01 * i as f64, 0.02]).collect(),
            copies: None,
            sessions: None,
            weights: vec![1.0; 2],
            energy: vec![0.5; 2],
            missing: Vec::new(),
            noise_variance: 0.0,
        }
    }

    #[test]
    fn a_copy_reads_in_the_other_channel_at_the_turned_place() {
        let copied = half_turn().copies(&design(&[[0.6, 0.8], [1.0, 0.0]]));
        assert_eq!(copied.z.nrows(), 4);
        assert_eq!([copied.z[(2, 0)], copied.z[(2, 1)]], [0.8, 0.6]);
        let close = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).abs() < 1e-12 && (a[1] - b[1]).abs() < 1e-12;
        assert!(close(copied.positions_m[2], [0.02, -0.02]), "{:?}", copied.positions_m);
        let copies = copied.copies.as_ref().expect("copies");
        assert_eq!([copies.between(0, 1), copies.between(0, 2), copies.between(3, 1)], [1.0, 0.8, 0.8]);
        assert_eq!([copies.with_map(1), copies.with_map(3)], [1.0, 0.8]);
    }

    #[test]
    fn an_unused_channel_contributes_nothing() {
        let mut broken = design(&[[0.6, 0.8]]);
        broken.weights[1] = 0.0;
        let copied = half_turn().copies(&broken);
        assert_eq!([copied.z[(0, 0)], copied.z[(1, 0)], copied.z[(1, 1)]], [0.6, 0.0, 0.0]);
    }

    /// Frames at opposite positions support the rotation if they are each other's with channels exchanged, and
    /// contradict it otherwise.
    #[test]
    fn the_evidence_distinguishes_a_rotation_from_none() {
        let hyper = Hyperparameters { length_m: 0.02, noise: 0.05, shrinkage: 1.0 };
        let places = [[0.0, 0.02], [0.02, -0.02], [0.04, 0.03], [-0.02, -0.03]];
        let told = |frames: &[[f64; 2]]| {
            let made = Design { positions_m: places.to_vec(), ..design(frames) };
            half_turn().evidence(&made, &hyper).expect("can be solved")
        };
        assert!(told(&[[0.6, 0.8], [0.8, 0.6], [-0.2, 0.9], [0.9, -0.2]]) > 0.5);
        assert!(told(&[[0.6, 0.8], [-0.8, -0.6], [-0.2, 0.9], [-0.9, 0.2]]) < -0.5);
    }
}
