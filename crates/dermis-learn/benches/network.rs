//! One frame through the network: the cost of the second step for a live image.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use dermis_learn::{Network, Tensors, UNetShape};

/// Weights that are neither zero nor all equal; their values do not affect the time.
fn weights(shape: &UNetShape) -> Tensors {
    let mut tensors = Tensors::default();
    for (number, spec) in shape.tensors().into_iter().enumerate() {
        let values = (0..spec.len()).map(|k| 0.1 + 0.01 * ((number + 7 * k) % 13) as f32).collect();
        tensors.insert(spec.name, spec.dims, values).expect("sizes are the specification's");
    }
    tensors
}

fn frame(criterion: &mut Criterion) {
    for (width, side) in [(8, 64), (8, 96), (16, 64)] {
        let shape = UNetShape { inputs: 1, classes: 3, width, levels: 4 };
        let mut network = Network::new(shape, &weights(&shape), side, side).expect("the shape fits");
        let (input, mut output) = (vec![0.3; side * side], vec![0.0; 3 * side * side]);
        criterion.bench_function(&format!("network, width {width}, {side} x {side}"), |bencher| {
            bencher.iter(|| network.probabilities(black_box(&input), 1.0, &mut output));
        });
    }
}

criterion_group!(benches, frame);
criterion_main!(benches);
