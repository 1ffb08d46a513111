//! Novelty score: how unlike the training set a frame is. The image means of the coarsest level's channels are compared
//! with those of the training set by Mahalanobis distance (Lee et al., NeurIPS 2018, with one Gaussian for all
//! classes). All but a thousandth of the held-out frames score below 1. For a frame above 1, use the first-step image
//! instead.

use crate::LearnError;
use crate::weights::Tensors;

/// Share of held-out frames that score below 1.
const KEPT: f64 = 0.999;
/// Ridge added to variances, as a share of their mean, to bound the weight of directions that never vary.
const RIDGE: f64 = 1e-2;

/// Mean and whitening matrix of the features.
#[derive(Clone, Debug, PartialEq)]
pub struct Novelty {
    mean: Vec<f32>,
    /// Lower triangle of L^-1 with covariance L L', row-major and square.
    whitener: Vec<f32>,
    /// Distance with score 1.
    reach: f32,
}

impl Novelty {
    /// Fits the score to the features of training frames and held-out frames.
    ///
    /// # Errors
    /// Fails if there are fewer than two frames of either, or if lengths differ.
    pub fn fit(training: &[Vec<f32>], held_out: &[Vec<f32>]) -> Result<Self, LearnError> {
        let size = training.first().map_or(0, Vec::len);
        if training.len() < 2 || held_out.len() < 2 || size == 0 {
            let value = format!("{} and {}", training.len(), held_out.len());
            let expected = "at least 2 of each".into();
            return Err(LearnError::Value { what: "frames to fit the novelty score to", value, expected });
        }
        if let Some(other) = training.iter().chain(held_out).find(|features| features.len() != size) {
            return Err(LearnError::Size { what: "features", expected: size, got: other.len() });
        }
        let count = training.len() as f64;
        let mean: Vec<f64> = (0..size).map(|k| training.iter().map(|f| f64::from(f[k])).sum::<f64>() / count).collect();
        let mut covariance = vec![0.0; size * size];
        for features in training {
            let centred: Vec<f64> = features.iter().zip(&mean).map(|(f, m)| f64::from(*f) - m).collect();
            for row in 0..size {
                for column in 0..=row {
                    covariance[row * size + column] += centred[row] * centred[column] / (count - 1.0);
                }
            }
        }
        let trace: f64 = (0..size).map(|k| covariance[k * size + k]).sum();
        (0..size).for_each(|k| covariance[k * size + k] += RIDGE * trace / size as f64 + 1e-12);
        let whitener = inverse_factor(&covariance, size);
        let mean = mean.into_iter().map(|m| m as f32).collect();
        let mut novelty = Self { mean, whitener: whitener.iter().map(|w| *w as f32).collect(), reach: 1.0 };
        let mut distances: Vec<f32> = held_out.iter().map(|features| novelty.score(features)).collect();
        distances.sort_by(f32::total_cmp);
        novelty.reach = distances[((distances.len() - 1) as f64 * KEPT).round() as usize].max(1e-6);
        Ok(novelty)
    }

    /// Distance of a frame from the training set; above 1 it is unlike the training set. Allocates nothing.
    ///
    /// # Panics
    /// If the number of features differs from the fit. This is a programming error, checked when a model is loaded.
    pub fn score(&self, features: &[f32]) -> f32 {
        let size = self.mean.len();
        assert_eq!(features.len(), size, "features");
        let square: f32 = (0..size)
            .map(|row| {
                let weights = &self.whitener[row * size..row * size + row + 1];
                let sum: f32 = weights.iter().zip(features.iter().zip(&self.mean)).map(|(w, (f, m))| w * (f - m)).sum();
                sum * sum
            })
            .sum();
        square.sqrt() / self.reach
    }

    /// Number of features.
    pub fn features(&self) -> usize {
        self.mean.len()
    }

    /// Adds the score to a network's tensors, as `novelty.*`.
    ///
    /// # Errors
    /// Never; sizes agree by construction.
    pub fn store(&self, tensors: &mut Tensors) -> Result<(), LearnError> {
        let size = self.mean.len();
        tensors.insert("novelty.mean", vec![size], self.mean.clone())?;
        tensors.insert("novelty.whitener", vec![size, size], self.whitener.clone())?;
        tensors.insert("novelty.reach", vec![1], vec![self.reach])
    }

    /// Reads `novelty.*`; `None` if missing or of the wrong size.
    pub fn load(tensors: &Tensors, features: usize) -> Option<Self> {
        let (mean_dims, mean) = tensors.get("novelty.mean")?;
        let (whitener_dims, whitener) = tensors.get("novelty.whitener")?;
        let (_, reach) = tensors.get("novelty.reach")?;
        let fits = mean_dims == [features] && whitener_dims == [features, features] && reach.len() == 1;
        let reach = *reach.first().filter(|reach| **reach > 0.0)?;
        fits.then(|| Self { mean: mean.to_vec(), whitener: whitener.to_vec(), reach })
    }
}

/// L^-1 of a positive definite matrix given by its lower triangle.
fn inverse_factor(matrix: &[f64], size: usize) -> Vec<f64> {
    let mut factor = vec![0.0; size * size];
    for row in 0..size {
        for column in 0..=row {
            let dot: f64 = (0..column).map(|k| factor[row * size + k] * factor[column * size + k]).sum();
            let rest = matrix[row * size + column] - dot;
            // The ridge keeps the diagonal positive.
            factor[row * size + column] =
                if row == column { rest.max(f64::MIN_POSITIVE).sqrt() } else { rest / factor[column * size + column] };
        }
    }
    let mut inverse = vec![0.0; size * size];
    for column in 0..size {
        for row in column..size {
            let start = if row == column { 1.0 } else { 0.0 };
            let dot: f64 = (column..row).map(|k| factor[row * size + k] * inverse[k * size + column]).sum();
            inverse[row * size + column] = (start - dot) / factor[row * size + row];
        }
    }
    inverse
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::StdRng;
    use rand::{Rng, SeedableRng};

    fn frames(count: usize, seed: u64, shift: f32) -> Vec<Vec<f32>> {
        let mut random = StdRng::seed_from_u64(seed);
        let frame = |random: &mut StdRng| {
            let a: f32 = (0..12).map(|_| random.random_range(-0.5..0.5)).sum();
            let b: f32 = (0..12).map(|_| random.random_range(-0.5..0.5)).sum();
            // Strongly correlated: large variance along (1, 1), small variance across it.
            vec![a + 0.1 * b + shift, a - 0.1 * b - shift]
        };
        (0..count).map(|_| frame(&mut random)).collect()
    }

    #[test]
    fn held_out_frames_score_below_one_and_novel_ones_above() {
        let novelty = Novelty::fit(&frames(4000, 1, 0.0), &frames(4000, 2, 0.0)).unwrap();
        let beyond = |frames: Vec<Vec<f32>>| frames.iter().filter(|f| novelty.score(f) > 1.0).count();
        // Binomial: 4 of 4000 expected, standard deviation 2; the threshold has an error of the same size.
        assert!(beyond(frames(4000, 3, 0.0)) <= 16);
        // Across the correlation, a shift of 1 is ten standard deviations (the ridge makes it 0.14, or seven).
        assert!(beyond(frames(1000, 4, 1.0)) >= 990);
        let mut tensors = Tensors::default();
        novelty.store(&mut tensors).unwrap();
        assert_eq!(Novelty::load(&tensors, 2), Some(novelty));
        assert_eq!(Novelty::load(&tensors, 3), None);
        assert!(Novelty::fit(&frames(1, 1, 0.0), &frames(9, 1, 0.0)).is_err());
    }
}
