//! Compares gradients with finite differences of the definition in double precision, and checks that weights do not
//! depend on the number of threads.

use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};

use super::*;
use crate::train::training::initial;

const CLASS_WEIGHTS: [f32; 3] = [1.0, 2.0, 0.5];

/// Channels x rows x columns of every sample.
type Images = Vec<Vec<Vec<f64>>>;

/// The loss according to its definition, in double precision; batch norms average over all samples.
struct Definition<'a> {
    shape: UNetShape,
    rows: usize,
    columns: usize,
    labels: &'a [u8],
}

impl Definition<'_> {
    fn loss(&self, values: &[Vec<f64>], images: &Images) -> f64 {
        let mut tensors = values.iter();
        let mut next = || tensors.next().unwrap().as_slice();
        let mut both = |images: &Images, level: usize| {
            let mut images = images.clone();
            for _ in 0..2 {
                let (kernel, gain, offset) = (next(), next(), next());
                let _running = (next(), next());
                images = self.layer(&images, level, kernel, gain, offset);
            }
            images
        };
        let mut images = images.clone();
        let mut kept = Vec::new();
        for level in 0..self.shape.levels {
            if level > 0 {
                images = self.each(&images, |channel| self.pooled(channel, level));
            }
            images = both(&images, level);
            kept.push(images.clone());
        }
        for level in (0..self.shape.levels - 1).rev() {
            let mut joined = self.each(&images, |channel| self.repeated(channel, level));
            for (sample, own) in joined.iter_mut().zip(&kept[level]) {
                sample.extend(own.iter().cloned());
            }
            images = both(&joined, level);
        }
        let (weight, bias) = (next(), next());
        self.entropy(&images, weight, bias)
    }

    fn each(&self, images: &Images, change: impl Fn(&[f64]) -> Vec<f64>) -> Images {
        images.iter().map(|sample| sample.iter().map(|channel| change(channel)).collect()).collect()
    }

    fn layer(&self, images: &Images, level: usize, kernel: &[f64], gain: &[f64], offset: &[f64]) -> Images {
        let (rows, columns) = ((self.rows >> level) as isize, (self.columns >> level) as isize);
        let inputs = images[0].len();
        let sum = |sample: &[Vec<f64>], output: usize, place: isize| {
            let mut sum = 0.0;
            for (input, channel) in sample.iter().enumerate() {
                for tap in 0..9_isize {
                    let (row, column) = (place / columns + tap / 3 - 1, place % columns + tap % 3 - 1);
                    if (0..rows).contains(&row) && (0..columns).contains(&column) {
                        let weight = kernel[(output * inputs + input) * 9 + tap as usize];
                        sum += weight * channel[(row * columns + column) as usize];
                    }
                }
            }
            sum
        };
        let channel =
            |sample: &[Vec<f64>], output: usize| (0..rows * columns).map(|k| sum(sample, output, k)).collect();
        let mut raw: Images =
            images.iter().map(|sample| (0..gain.len()).map(|output| channel(sample, output)).collect()).collect();
        for output in 0..gain.len() {
            let all: Vec<f64> = raw.iter().flat_map(|sample| sample[output].iter().copied()).collect();
            let mean = all.iter().sum::<f64>() / all.len() as f64;
            let variance = all.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / all.len() as f64;
            for value in raw.iter_mut().flat_map(|sample| sample[output].iter_mut()) {
                let z = gain[output] * (*value - mean) / (variance + 1e-5).sqrt() + offset[output];
                *value = z / (1.0 + z.abs());
            }
        }
        raw
    }

    fn pooled(&self, channel: &[f64], level: usize) -> Vec<f64> {
        let (rows, columns) = (self.rows >> level, self.columns >> level);
        let at = |place: usize, k: usize| {
            channel[(2 * (place / columns) + k / 2) * 2 * columns + 2 * (place % columns) + k % 2]
        };
        (0..rows * columns).map(|place| (0..4).map(|k| at(place, k)).fold(f64::MIN, f64::max)).collect()
    }

    fn repeated(&self, channel: &[f64], level: usize) -> Vec<f64> {
        let (rows, columns) = (self.rows >> level, self.columns >> level);
        (0..rows * columns).map(|place| channel[place / columns / 2 * (columns / 2) + place % columns / 2]).collect()
    }

    fn entropy(&self, images: &Images, weight: &[f64], bias: &[f64]) -> f64 {
        let (mut sum, mut all) = (0.0, 0.0);
        for (sample, labels) in images.iter().zip(self.labels.chunks_exact(self.rows * self.columns)) {
            for (place, label) in labels.iter().enumerate() {
                let logit = |class: usize| {
                    let products = sample.iter().enumerate().map(|(k, c)| weight[class * sample.len() + k] * c[place]);
                    bias[class] + products.sum::<f64>()
                };
                let logits: Vec<f64> = (0..bias.len()).map(logit).collect();
                let normaliser = logits.iter().map(|l| l.exp()).sum::<f64>().ln();
                let weight = f64::from(CLASS_WEIGHTS[usize::from(*label)]);
                sum += weight * (normaliser - logits[usize::from(*label)]);
                all += weight;
            }
        }
        sum / all
    }
}

fn samples(shape: &UNetShape, count: usize, rows: usize, columns: usize) -> (Vec<f32>, Vec<u8>) {
    let mut random = StdRng::seed_from_u64(11);
    let inputs = (0..count * shape.inputs * rows * columns).map(|_| random.random_range(-1.0..1.0)).collect();
    (inputs, (0..count * rows * columns).map(|_| random.random_range(0..3)).collect())
}

#[test]
fn slopes_agree_with_finite_differences() {
    // Widths that fill a block of output channels and widths that do not; non-square images; one level.
    for (width, levels, rows, columns) in [(3, 3, 8, 12), (5, 2, 6, 4), (2, 1, 5, 7)] {
        let shape = UNetShape { inputs: 2, classes: 3, width, levels };
        let tensors = initial(&shape, &mut StdRng::seed_from_u64(3)).unwrap();
        let (inputs, labels) = samples(&shape, 3, rows, columns);
        let batch = Batch { count: 3, rows, columns, inputs: &inputs, labels: &labels };
        let mut network = NativeUNet::new(shape, &tensors, None, &CLASS_WEIGHTS).unwrap();
        let loss = network.slopes(&batch);
        let found: Vec<Vec<f32>> = network.learned().map(|learned| learned.slope.clone()).collect();

        let definition = Definition { shape, rows, columns, labels: &labels };
        let specs = shape.tensors();
        let of = |name: &str| tensors.get(name).unwrap().1.iter().map(|v| f64::from(*v)).collect::<Vec<f64>>();
        let mut values: Vec<Vec<f64>> = specs.iter().map(|spec| of(&spec.name)).collect();
        let channel = |image: &[f32]| image.iter().map(|v| f64::from(*v)).collect();
        let images: Images = inputs
            .chunks_exact(2 * rows * columns)
            .map(|sample| sample.chunks_exact(rows * columns).map(channel).collect())
            .collect();
        let expected = definition.loss(&values, &images);
        assert!((loss - expected).abs() < 1e-5 * expected, "{loss} {expected}");
        // The learned tensors in the order of `learned`; running means and variances are not learned.
        let learned = (0..specs.len()).filter(|k| !specs[*k].name.contains("running"));
        for (found, tensor) in found.iter().zip(learned) {
            for place in (0..found.len()).step_by(1 + found.len() / 12) {
                let middle = values[tensor][place];
                let step = 1e-5;
                values[tensor][place] = middle + step;
                let above = definition.loss(&values, &images);
                values[tensor][place] = middle - step;
                let slope = (above - definition.loss(&values, &images)) / (2.0 * step);
                values[tensor][place] = middle;
                // Single precision against gradients of about 0.01 to 0.1; a wrong term would be as large as the
                // gradient.
                let gap = (f64::from(found[place]) - slope).abs();
                assert!(gap < 2e-5 + 1e-3 * slope.abs(), "{} {place}: {} {slope}", specs[tensor].name, found[place]);
            }
        }
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let shape = UNetShape { inputs: 1, classes: 3, width: 8, levels: 3 };
    let tensors = initial(&shape, &mut StdRng::seed_from_u64(3)).unwrap();
    let (inputs, labels) = samples(&shape, 5, 16, 16);
    let trained = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut network = NativeUNet::new(shape, &tensors, None, &[1.0; 3]).unwrap();
            for count in [5, 2, 5] {
                let (inputs, labels) = (&inputs[..count * 256], &labels[..count * 256]);
                network.step(&Batch { count, rows: 16, columns: 16, inputs, labels }, 1e-2);
            }
            network.tensors().unwrap()
        })
    };
    assert_eq!(trained(1), trained(3));
}

#[test]
fn a_step_of_adam_is_that_of_the_paper() {
    // Algorithm 1 by hand for gradients 0.5 and then -1: m = 0.05, 0.9 * 0.05 - 0.1; v = 0.00025, 0.999 * 0.00025 +
    // 0.001.
    let mut learned = Learned { value: vec![1.0], slope: vec![0.5], first: vec![0.0], second: vec![0.0] };
    learned.step(0.1, 1);
    assert!((learned.value[0] - 0.9).abs() < 1e-6, "the first step is the rate itself: {}", learned.value[0]);
    learned.slope[0] = -1.0;
    learned.step(0.1, 2);
    let (m, v) = (-0.055_f64 / (1.0 - 0.81), 0.001_249_75_f64 / (1.0 - 0.998_001));
    assert!((f64::from(learned.value[0]) - (0.9 - 0.1 * m / v.sqrt())).abs() < 1e-6, "{}", learned.value[0]);
}
