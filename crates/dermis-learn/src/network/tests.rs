//! Compares the network with its definition, written out pixel by pixel in double precision, and checks that it does
//! not allocate.

use super::*;
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};

use crate::shape::TensorRole;

/// Random weights of the magnitude that training produces.
pub(crate) fn random_tensors(shape: &UNetShape, seed: u64) -> Tensors {
    let mut random = StdRng::seed_from_u64(seed);
    let mut tensors = Tensors::default();
    for spec in shape.tensors() {
        let spread = match spec.role {
            TensorRole::Kernel => (6.0 / spec.dims[1..].iter().product::<usize>() as f32).sqrt(),
            _ => 0.5,
        };
        let positive = matches!(spec.role, TensorRole::RunningVariance | TensorRole::Gain);
        let value = |_| {
            let value = random.random_range(-spread..spread);
            if positive { 1.0 + value } else { value }
        };
        let values = (0..spec.len()).map(value).collect();
        tensors.insert(spec.name, spec.dims, values).unwrap();
    }
    tensors
}

/// An image of channels x rows x columns.
struct Image {
    channels: usize,
    rows: usize,
    columns: usize,
    values: Vec<f64>,
}

impl Image {
    fn new(channels: usize, rows: usize, columns: usize) -> Self {
        Self { channels, rows, columns, values: vec![0.0; channels * rows * columns] }
    }

    fn get(&self, channel: usize, row: isize, column: isize) -> f64 {
        if row < 0 || column < 0 || row >= self.rows as isize || column >= self.columns as isize {
            return 0.0;
        }
        self.values[(channel * self.rows + row as usize) * self.columns + column as usize]
    }

    fn map(channels: usize, rows: usize, columns: usize, value: impl Fn(usize, isize, isize) -> f64) -> Self {
        let mut image = Self::new(channels, rows, columns);
        for channel in 0..channels {
            for row in 0..rows {
                for column in 0..columns {
                    image.values[(channel * rows + row) * columns + column] =
                        value(channel, row as isize, column as isize);
                }
            }
        }
        image
    }
}

fn block(tensors: &Tensors, prefix: &str, number: usize, image: &Image) -> Image {
    let values = |part: &str, leaf: &str| tensors.get(&format!("{prefix}.{part}{number}.{leaf}")).unwrap();
    let (dims, kernel) = values("conv", "weight");
    let norm = |leaf: &str, channel: usize| f64::from(values("norm", leaf).1[channel]);
    Image::map(dims[0], image.rows, image.columns, |output, row, column| {
        let mut sum = 0.0;
        for input in 0..image.channels {
            for y in 0..3 {
                for x in 0..3 {
                    let tap = kernel[((output * image.channels + input) * 3 + y) * 3 + x];
                    sum += f64::from(tap) * image.get(input, row + y as isize - 1, column + x as isize - 1);
                }
            }
        }
        let normal = (sum - norm("running_mean", output)) / (norm("running_var", output) + 1e-5).sqrt();
        let value = norm("weight", output) * normal + norm("bias", output);
        value / (1.0 + value.abs())
    })
}

/// The network according to its definition.
fn by_definition(shape: &UNetShape, tensors: &Tensors, input: Image) -> Image {
    let both = |prefix: &str, image: &Image| block(tensors, prefix, 2, &block(tensors, prefix, 1, image));
    let mut image = input;
    let mut kept: Vec<Image> = Vec::new();
    for level in 0..shape.levels {
        if level > 0 {
            image = Image::map(image.channels, image.rows / 2, image.columns / 2, |c, row, column| {
                let four = [(0, 0), (0, 1), (1, 0), (1, 1)];
                four.iter().map(|(y, x)| image.get(c, 2 * row + y, 2 * column + x)).fold(f64::NEG_INFINITY, f64::max)
            });
        }
        image = both(&format!("down.{level}"), &image);
        kept.push(Image { values: image.values.clone(), ..image });
    }
    for level in (0..shape.levels - 1).rev() {
        let own = &kept[level];
        let joined = Image::map(image.channels + own.channels, own.rows, own.columns, |c, row, column| {
            if c < image.channels {
                image.get(c, row / 2, column / 2)
            } else {
                own.get(c - image.channels, row, column)
            }
        });
        image = both(&format!("up.{level}"), &joined);
    }
    let (head, bias) = (tensors.get("head.weight").unwrap().1, tensors.get("head.bias").unwrap().1);
    Image::map(shape.classes, image.rows, image.columns, |class, row, column| {
        let weight = |c: usize| f64::from(head[class * shape.width + c]);
        f64::from(bias[class]) + (0..shape.width).map(|c| weight(c) * image.get(c, row, column)).sum::<f64>()
    })
}

#[test]
fn logits_agree_with_the_definition() {
    // Widths below, at and between the blocks of output channels; one level; non-square images.
    for (inputs, classes, width, levels, rows, columns) in
        [(1, 3, 8, 4, 16, 24), (3, 2, 5, 3, 12, 8), (2, 4, 12, 2, 6, 10), (1, 3, 3, 1, 5, 7)]
    {
        let shape = UNetShape { inputs, classes, width, levels };
        let tensors = random_tensors(&shape, 7);
        let mut random = StdRng::seed_from_u64(3);
        let input: Vec<f32> = (0..inputs * rows * columns).map(|_| random.random_range(-1.0..1.0)).collect();
        let values = input.iter().map(|v| f64::from(*v)).collect();
        let expected = by_definition(&shape, &tensors, Image { channels: inputs, rows, columns, values });
        let mut network = Network::new(shape, &tensors, rows, columns).unwrap();
        let mut logits = vec![f32::NAN; classes * rows * columns];
        // The second frame reuses the memory of the first.
        network.logits(&vec![9.0; input.len()], &mut logits).unwrap();
        network.logits(&input, &mut logits).unwrap();
        // Error of single precision through at most 14 blocks with outputs below 1.
        for (found, expected) in logits.iter().zip(&expected.values) {
            assert!((f64::from(*found) - expected).abs() < 2e-5, "{shape:?}: {found} {expected}");
        }
    }
}

#[test]
fn frames_after_the_first_allocate_nothing() {
    let shape = UNetShape { inputs: 1, classes: 3, width: 8, levels: 3 };
    let mut network = Network::new(shape, &random_tensors(&shape, 1), 32, 32).unwrap();
    let (input, mut output) = (vec![0.3; 32 * 32], vec![0.0; 3 * 32 * 32]);
    let counted = allocation_counter::measure(|| network.probabilities(&input, 1.3, &mut output).unwrap());
    assert_eq!(counted.count_total, 0);
    let sums = (0..1024).map(|pixel| (0..3).map(|class| output[class * 1024 + pixel]).sum::<f32>());
    assert!(sums.into_iter().all(|sum| (sum - 1.0).abs() < 1e-6));
}

#[test]
fn outside_pixels_count_as_zero_and_lengths_are_checked() {
    let shape = UNetShape { inputs: 1, classes: 3, width: 4, levels: 2 };
    let mut network = Network::new(shape, &random_tensors(&shape, 1), 8, 8).unwrap();
    let (mut zero, mut outside) = (vec![0.0; 192], vec![0.0; 192]);
    network.logits(&[0.0; 64], &mut zero).unwrap();
    network.logits(&[f32::NAN; 64], &mut outside).unwrap();
    assert_eq!(zero, outside);
    let error = network.logits(&[0.0; 63], &mut zero).unwrap_err().to_string();
    assert_eq!(error, "input of the network: expected 64 values, got 63");
}
