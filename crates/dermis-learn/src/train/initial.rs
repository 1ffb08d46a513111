//! Initial weights.

use rand::Rng;

use crate::LearnError;
use crate::shape::{TensorRole, UNetShape};
use crate::weights::Tensors;

/// Kernels uniform within `sqrt(3 / fan-in)` (unit gain), gains 1, offsets 0.
pub(super) fn initial(shape: &UNetShape, random: &mut impl Rng) -> Result<Tensors, LearnError> {
    let mut tensors = Tensors::default();
    for spec in shape.tensors() {
        let count = spec.len();
        let values = match spec.role {
            TensorRole::Kernel => {
                let bound = (3.0 / spec.dims[1..].iter().product::<usize>() as f32).sqrt();
                (0..count).map(|_| random.random_range(-bound..bound)).collect()
            }
            TensorRole::Gain | TensorRole::RunningVariance => vec![1.0; count],
            TensorRole::Offset | TensorRole::RunningMean => vec![0.0; count],
        };
        tensors.insert(spec.name, spec.dims, values)?;
    }
    Ok(tensors)
}
