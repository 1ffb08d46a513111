//! Quality of a segmentation: intersection over union of each class (never plain accuracy: 95 % of all pixels are
//! background), expected calibration error of the probabilities, and the temperature that calibrates them.

use crate::LearnError;
use crate::network::softmax;

/// Confusion matrix of true and predicted classes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Confusion {
    classes: usize,
    /// True x predicted.
    counts: Vec<u64>,
}

impl Confusion {
    /// An empty matrix.
    pub fn new(classes: usize) -> Self {
        Self { classes, counts: vec![0; classes * classes] }
    }

    /// Counts one frame.
    ///
    /// # Errors
    /// Fails if the lengths differ or a label is not a class.
    pub fn add(&mut self, truth: &[u8], found: &[u8]) -> Result<(), LearnError> {
        if truth.len() != found.len() {
            return Err(LearnError::Size { what: "labels", expected: truth.len(), got: found.len() });
        }
        for (t, f) in truth.iter().zip(found) {
            for label in [*t, *f] {
                if usize::from(label) >= self.classes {
                    let expected = format!("below {}", self.classes);
                    return Err(LearnError::Value { what: "label", value: label.to_string(), expected });
                }
            }
            self.counts[usize::from(*t) * self.classes + usize::from(*f)] += 1;
        }
        Ok(())
    }

    /// Intersection over union of a class; `None` if it is neither present nor predicted.
    pub fn intersection_over_union(&self, class: usize) -> Option<f64> {
        let at = |t: usize, f: usize| self.counts[t * self.classes + f];
        let truth: u64 = (0..self.classes).map(|k| at(class, k)).sum();
        let found: u64 = (0..self.classes).map(|k| at(k, class)).sum();
        let union = truth + found - at(class, class);
        (union > 0).then(|| at(class, class) as f64 / union as f64)
    }

    /// Intersection over union of all classes, and the mean over the classes that occur, without `background`.
    pub fn summary(&self, background: usize) -> (Vec<Option<f64>>, f64) {
        let all: Vec<Option<f64>> = (0..self.classes).map(|class| self.intersection_over_union(class)).collect();
        let others: Vec<f64> =
            all.iter().enumerate().filter(|(class, _)| *class != background).filter_map(|(_, iou)| *iou).collect();
        let mean = if others.is_empty() { 0.0 } else { others.iter().sum::<f64>() / others.len() as f64 };
        (all, mean)
    }
}

/// The most likely class of every pixel; `values` is classes x pixels.
///
/// # Panics
/// If `labels` does not have one value per pixel, which is a programming error.
pub fn most_likely(values: &[f32], classes: usize, labels: &mut [u8]) {
    let pixels = values.len() / classes;
    assert_eq!(labels.len(), pixels, "one label a pixel");
    for (pixel, label) in labels.iter_mut().enumerate() {
        let mut best = 0;
        for class in 1..classes {
            if values[class * pixels + pixel] > values[best * pixels + pixel] {
                best = class;
            }
        }
        *label = best as u8;
    }
}

/// Expected calibration error, accumulated frame by frame. Pixels are binned by the probability of their most likely
/// class; the error is the mean over pixels of `|share correct - mean probability|` in their bin (Guo et al., ICML
/// 2017, eq. 3).
#[derive(Clone, Debug)]
pub struct Calibration {
    /// Number of pixels, number of correct pixels, sum of probabilities.
    bins: Vec<(u64, u64, f64)>,
}

/// Number of bins, as in the paper that defined the error.
const BINS: usize = 15;

impl Default for Calibration {
    fn default() -> Self {
        Self { bins: vec![(0, 0, 0.0); BINS] }
    }
}

impl Calibration {
    /// Counts one frame of probabilities (classes x pixels).
    ///
    /// # Errors
    /// Fails if the lengths do not match.
    pub fn add(&mut self, probabilities: &[f32], truth: &[u8]) -> Result<(), LearnError> {
        let pixels = truth.len();
        if pixels == 0 || !probabilities.len().is_multiple_of(pixels) {
            return Err(LearnError::Size { what: "probabilities", expected: pixels, got: probabilities.len() });
        }
        let classes = probabilities.len() / pixels;
        for (pixel, label) in truth.iter().enumerate() {
            let (mut best, mut most) = (0, f32::NEG_INFINITY);
            for class in 0..classes {
                let p = probabilities[class * pixels + pixel];
                if p > most {
                    (best, most) = (class, p);
                }
            }
            let bin = ((f64::from(most) * BINS as f64) as usize).min(BINS - 1);
            self.bins[bin].0 += 1;
            self.bins[bin].1 += u64::from(best == usize::from(*label));
            self.bins[bin].2 += f64::from(most);
        }
        Ok(())
    }

    /// The error, 0 to 1; 0 if there are no pixels.
    pub fn error(&self) -> f64 {
        let pixels: u64 = self.bins.iter().map(|bin| bin.0).sum();
        let gap: f64 = self.bins.iter().map(|(_, right, sum)| (*right as f64 - sum).abs()).sum();
        if pixels == 0 { 0.0 } else { gap / pixels as f64 }
    }
}

/// Held-out frames for fitting a temperature: logits and truth.
#[derive(Clone, Debug)]
pub struct HeldOut {
    /// Number of classes.
    pub classes: usize,
    /// Logits of each frame, classes x pixels.
    pub logits: Vec<Vec<f32>>,
    /// Labels of each frame.
    pub truth: Vec<Vec<u8>>,
}

impl HeldOut {
    /// Mean negative log-likelihood of the truth at a temperature.
    pub fn loss(&self, temperature: f32) -> f64 {
        let (mut sum, mut count) = (0.0, 0_usize);
        let mut values = Vec::new();
        for (logits, truth) in self.logits.iter().zip(&self.truth) {
            values.clone_from(logits);
            softmax(&mut values, self.classes, temperature);
            for (pixel, label) in truth.iter().enumerate() {
                let p = values[usize::from(*label) * truth.len() + pixel];
                sum -= f64::from(p.max(1e-12)).ln();
            }
            count += truth.len();
        }
        sum / count.max(1) as f64
    }

    /// The temperature with the lowest loss, by golden-section search on its logarithm from 0.25 to 4 (the loss is
    /// convex in 1 / temperature).
    pub fn temperature(&self) -> f32 {
        let golden = 0.5 * (5.0_f32.sqrt() - 1.0);
        let (mut low, mut high) = (0.25_f32.ln(), 4.0_f32.ln());
        let at = |x: f32| self.loss(x.exp());
        let (mut a, mut b) = (high - golden * (high - low), low + golden * (high - low));
        let (mut loss_a, mut loss_b) = (at(a), at(b));
        for _ in 0..16 {
            if loss_a < loss_b {
                (high, b, loss_b) = (b, a, loss_a);
                a = high - golden * (high - low);
                loss_a = at(a);
            } else {
                (low, a, loss_a) = (a, b, loss_b);
                b = low + golden * (high - low);
                loss_b = at(b);
            }
        }
        (0.5 * (low + high)).exp()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intersection_over_union_of_a_counted_example() {
        let mut confusion = Confusion::new(3);
        confusion.add(&[0, 0, 0, 1, 1, 2], &[0, 0, 1, 1, 0, 0]).unwrap();
        // Class 1: one pixel in both; two true, two predicted. Class 2: never predicted.
        assert_eq!(confusion.intersection_over_union(1), Some(1.0 / 3.0));
        assert_eq!(confusion.intersection_over_union(2), Some(0.0));
        assert_eq!(confusion.intersection_over_union(0), Some(0.4));
        assert_eq!(confusion.summary(0).1, 0.5 / 3.0);
        assert_eq!(Confusion::new(3).intersection_over_union(1), None);
        assert_eq!(confusion.add(&[3], &[0]).unwrap_err().to_string(), "label = 3: expected below 3");
    }

    #[test]
    fn calibration_error_of_a_counted_example() {
        // Ten pixels predicted as class 1 with 0.8, six of them correct; ten as class 0 with 0.6, six of them
        // correct.
        let mut probabilities = vec![0.2; 10];
        probabilities.extend([0.6; 10]);
        probabilities.extend([0.8; 10]);
        probabilities.extend([0.4; 10]);
        let truth: Vec<u8> = (0..20).map(|k| u8::from(if k < 10 { k < 6 } else { k >= 16 })).collect();
        let mut calibration = Calibration::default();
        calibration.add(&probabilities, &truth).unwrap();
        assert!((calibration.error() - 0.1).abs() < 1e-6, "{}", calibration.error());
    }

    #[test]
    fn the_temperature_undoes_overconfidence() {
        // The truth is drawn with the probabilities of logits l; the network outputs 2.5 l.
        let (mut logits, mut truth) = (Vec::new(), Vec::new());
        for k in 0..4000_u32 {
            let l = (k % 40) as f32 * 0.1 - 2.0;
            let p = 1.0 / (1.0 + (-l).exp());
            // A share p of the hundred pixels with this logit are class 1.
            truth.push(u8::from(((k / 40) as f32 + 0.5) / 100.0 < p));
            logits.push(2.5 * l);
        }
        let mut both = vec![0.0; 4000];
        both.extend(logits);
        let held_out = HeldOut { classes: 2, logits: vec![both], truth: vec![truth] };
        let temperature = held_out.temperature();
        assert!((temperature - 2.5).abs() < 0.05, "{temperature}");
        assert!(held_out.loss(temperature) < held_out.loss(1.0));
    }

    #[test]
    fn the_most_likely_class_is_found() {
        let mut labels = [9; 3];
        most_likely(&[0.5, 0.2, 0.1, 0.3, 0.3, 0.2, 0.2, 0.5, 0.7], 3, &mut labels);
        assert_eq!(labels, [0, 2, 2]);
    }
}
