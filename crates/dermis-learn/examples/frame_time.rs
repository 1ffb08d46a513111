//! Times one frame: `cargo run --release -p dermis-learn --example frame_time`. Width 8, four levels, 64x64 pixels,
//! three classes, one core; prints the minimum and the median of 300 frames.

use std::time::Instant;

use dermis_learn::{Network, Tensors, UNetShape};

fn main() -> Result<(), dermis_learn::LearnError> {
    let shape = UNetShape { inputs: 1, classes: 3, width: 8, levels: 4 };
    let mut tensors = Tensors::default();
    for spec in shape.tensors() {
        let values = (0..spec.len()).map(|k| 0.1 + (k as f32 * 0.7).sin().abs() * 0.1).collect();
        tensors.insert(spec.name, spec.dims, values)?;
    }
    let mut network = Network::new(shape, &tensors, 64, 64)?;
    let input: Vec<f32> = (0..4096).map(|k| (k as f32 * 0.01).sin()).collect();
    let mut output = vec![0.0; 3 * 4096];
    let mut times_ms: Vec<f64> = Vec::new();
    for _ in 0..300 {
        let begun = Instant::now();
        network.probabilities(&input, 1.0, &mut output)?;
        times_ms.push(begun.elapsed().as_secs_f64() * 1e3);
    }
    times_ms.sort_by(f64::total_cmp);
    println!("quickest {:.3} ms, median {:.3} ms", times_ms[0], times_ms[150]);
    Ok(())
}
