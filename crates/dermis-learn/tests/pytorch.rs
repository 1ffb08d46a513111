//! A network trained in PyTorch 1.13 and saved there as a state_dict (`scripts/check_network.py --fixture`): it is
//! read unchanged and must give PyTorch's results.

use std::path::PathBuf;

use dermis_learn::{Network, Tensors, UNetShape};

fn read(name: &str) -> Tensors {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/pytorch").join(name);
    Tensors::from_bytes(&std::fs::read(&path).unwrap(), &path).unwrap()
}

#[test]
fn a_state_dict_of_pytorch_runs_as_it_does_there() {
    let (weights, case) = (read("state_dict.safetensors"), read("case.safetensors"));
    assert!(weights.iter().all(|(name, ..)| !name.ends_with("num_batches_tracked")));
    let shape = UNetShape { inputs: 2, classes: 3, width: 4, levels: 3 };
    let (dims, image) = case.get("image").unwrap();
    assert_eq!(dims, [2, 16, 24]);
    let mut network = Network::new(shape, &weights, 16, 24).unwrap();
    let mut logits = vec![0.0; 3 * 16 * 24];
    network.logits(image, &mut logits).unwrap();
    let (_, expected) = case.get("logits").unwrap();
    let largest = expected.iter().fold(0.0_f32, |largest, value| largest.max(value.abs()));
    let gap = logits.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max) / largest;
    println!("largest difference {gap:e} of the largest logit");
    // PyTorch computed in double precision; 32-bit sums of some hundred terms are off by a few units in the last
    // place.
    assert!(gap < 1e-6, "{gap:e}");
}

#[test]
fn written_weights_are_the_same_state_dict() {
    let weights = read("state_dict.safetensors");
    let bytes = weights.to_bytes().unwrap();
    let again = Tensors::from_bytes(&bytes, &PathBuf::from("again")).unwrap();
    assert_eq!(again, weights);
}
