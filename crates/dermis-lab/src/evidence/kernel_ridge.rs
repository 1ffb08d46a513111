//! Gaussian kernel ridge regression from frames to places: the first thing a user without a model of the skin would
//! try. Channels are divided by their noise, or by their standard deviation over the pokes, and frames are scaled to
//! unit length. The kernel's length scale and the ridge are those with the smallest leave-one-out error, which has a
//! closed form.

use dermis_tomo::mesh::Point;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};

/// Length scales to try; frames lie on the unit sphere.
const LENGTHS: [f64; 5] = [0.1, 0.2, 0.35, 0.6, 1.0];
/// Ridges to try.
const RIDGES: [f64; 6] = [1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1];
/// Maximum number of pokes used to choose length scale and ridge.
const MOST_TO_CHOOSE: usize = 800;

/// A fitted regression.
#[derive(Clone, Debug)]
pub struct KernelRidge {
    scales: Vec<f64>,
    features: Vec<Vec<f64>>,
    length: f64,
    mean: [f64; 2],
    weights: Mat<f64>,
}

impl KernelRidge {
    /// Fits places to frames, one frame per poke. Channels are divided by `scales` or, if not given, by their
    /// deviation over the pokes. `None` for fewer than three pokes, frames of different lengths, or values that are
    /// not finite.
    pub fn fit(frames: &[&[f64]], places: &[Point], scales: Option<&[f64]>) -> Option<Self> {
        let channels = frames.first()?.len();
        let fits = frames.len() >= 3
            && frames.len() == places.len()
            && scales.is_none_or(|scales| scales.len() == channels)
            && frames.iter().all(|frame| frame.len() == channels && frame.iter().all(|value| value.is_finite()));
        if !fits {
            return None;
        }
        let count = frames.len() as f64;
        let deviation = |channel: usize| {
            let mean = frames.iter().map(|frame| frame[channel]).sum::<f64>() / count;
            (frames.iter().map(|frame| (frame[channel] - mean).powi(2)).sum::<f64>() / count).sqrt()
        };
        let scales = scales.map_or_else(|| (0..channels).map(deviation).collect(), <[f64]>::to_vec);
        let features: Vec<Vec<f64>> = frames.iter().map(|frame| feature(frame, &scales)).collect();
        let mean = [0, 1].map(|axis| places.iter().map(|place| place[axis]).sum::<f64>() / count);
        let sides = Mat::from_fn(places.len(), 2, |row, axis| places[row][axis] - mean[axis]);
        let few = features.len().min(MOST_TO_CHOOSE);
        let (length, ridge) = chosen(&features[..few], &sides)?;
        let mut system = kernel(&features, length);
        (0..features.len()).for_each(|row| system[(row, row)] += ridge);
        let weights = system.llt(Side::Lower).ok()?.solve(&sides);
        Some(Self { scales, features, length, mean, weights })
    }

    /// Predicts the place of a frame, which must have the same number of channels.
    pub fn place(&self, frame: &[f64]) -> [f64; 2] {
        let own = feature(frame, &self.scales);
        let mut place = self.mean;
        for (row, other) in self.features.iter().enumerate() {
            let alike = likeness(&own, other, self.length);
            (0..2).for_each(|axis| place[axis] += alike * self.weights[(row, axis)]);
        }
        place
    }
}

/// A frame scaled per channel and to unit length, without the channels that never change.
fn feature(frame: &[f64], scales: &[f64]) -> Vec<f64> {
    let scaled: Vec<f64> =
        frame.iter().zip(scales).map(|(value, scale)| if *scale > 0.0 { value / scale } else { 0.0 }).collect();
    let norm = scaled.iter().map(|value| value * value).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
    scaled.into_iter().map(|value| value / norm).collect()
}

/// Kernel of two frames of unit length.
fn likeness(one: &[f64], other: &[f64], length: f64) -> f64 {
    let product: f64 = one.iter().zip(other).map(|(a, b)| a * b).sum();
    ((product - 1.0) / (length * length)).exp()
}

fn kernel(features: &[Vec<f64>], length: f64) -> Mat<f64> {
    let count = features.len();
    let all = Mat::from_fn(count, features.first().map_or(0, Vec::len), |row, channel| features[row][channel]);
    let products = &all * all.transpose();
    Mat::from_fn(count, count, |row, column| ((products[(row, column)] - 1.0) / (length * length)).exp())
}

/// Length scale and ridge with the smallest leave-one-out error (root mean square).
fn chosen(features: &[Vec<f64>], sides: &Mat<f64>) -> Option<(f64, f64)> {
    let count = features.len();
    let mut best = (f64::INFINITY, None);
    for length in LENGTHS {
        let eigen = kernel(features, length).self_adjoint_eigen(Side::Lower).ok()?;
        let (vectors, values) = (eigen.U(), eigen.S().column_vector());
        let turned = vectors.transpose() * sides.get(..count, ..);
        for ridge in RIDGES {
            let share = |k: usize| 1.0 / (values[k].max(0.0) + ridge);
            let weights = vectors * Mat::from_fn(count, 2, |k, axis| share(k) * turned[(k, axis)]);
            let error: f64 = (0..count)
                .map(|row| {
                    let diagonal: f64 = (0..count).map(|k| share(k) * vectors[(row, k)].powi(2)).sum();
                    (0..2).map(|axis| (weights[(row, axis)] / diagonal).powi(2)).sum::<f64>()
                })
                .sum();
            if error < best.0 {
                best = (error, Some((length, ridge)));
            }
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Eight channels, each a bump over a square of side 1.
    fn frame([x, y]: Point) -> Vec<f64> {
        let bump = |k: usize| {
            let angle = k as f64 * std::f64::consts::FRAC_PI_4;
            (-2.0 * ((x - 0.5 - 0.5 * angle.cos()).powi(2) + (y - 0.5 - 0.5 * angle.sin()).powi(2))).exp()
        };
        (0..8).map(bump).collect()
    }

    #[test]
    fn places_of_smooth_frames_are_learnt() {
        let places: Vec<Point> = (0..120).map(|k| [(0.618 * k as f64).fract(), (0.7549 * k as f64).fract()]).collect();
        let frames: Vec<Vec<f64>> = places.iter().map(|place| frame(*place)).collect();
        let views: Vec<&[f64]> = frames.iter().map(Vec::as_slice).collect();
        let fitted = KernelRidge::fit(&views, &places, None).unwrap();
        for place in [[0.3, 0.4], [0.71, 0.62], [0.5, 0.2]] {
            let found = fitted.place(&frame(place));
            assert!(dermis_tomo::mesh::distance(found, place) < 0.02, "{place:?}: {found:?}");
        }
    }

    #[test]
    fn unusable_training_data_are_refused() {
        let frames: [&[f64]; 3] = [&[1.0, 2.0], &[2.0, 1.0], &[1.0, f64::NAN]];
        assert!(KernelRidge::fit(&frames, &[[0.0; 2]; 3], None).is_none());
        assert!(KernelRidge::fit(&frames[..2], &[[0.0; 2]; 2], None).is_none());
        assert!(KernelRidge::fit(&[], &[], None).is_none());
    }
}
