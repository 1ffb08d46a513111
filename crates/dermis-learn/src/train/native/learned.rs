//! Tensors learned by gradient descent, and how they are loaded.

use crate::LearnError;
use crate::shape::TensorSpec;
use crate::weights::Tensors;

/// Adam's decay rates, from the paper.
const DECAY: [f64; 2] = [0.9, 0.999];
/// Adam's epsilon, from the paper.
const ADAM_EPSILON: f64 = 1e-8;

/// A tensor learned by gradient descent, with the gradient of the last batch and Adam's moments.
pub(super) struct Learned {
    pub(super) value: Vec<f32>,
    pub(super) slope: Vec<f32>,
    pub(super) first: Vec<f32>,
    pub(super) second: Vec<f32>,
}

impl Learned {
    pub(super) fn step(&mut self, rate: f64, steps: usize) {
        let powers = DECAY.map(|decay| 1.0 - decay.powi(steps as i32));
        let (rate, second_scale) = ((rate / powers[0]) as f32, (1.0 / powers[1]) as f32);
        let [a, b] = DECAY.map(|decay| decay as f32);
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((value, slope), (first, second)) in self.value.iter_mut().zip(&self.slope).zip(moments) {
            *first = a * *first + (1.0 - a) * slope;
            *second = b * *second + (1.0 - b) * slope * slope;
            *value -= rate * *first / ((*second * second_scale).sqrt() + ADAM_EPSILON as f32);
        }
    }
}

/// Loads learned tensors from named values.
pub(super) struct Loader<'a> {
    pub(super) tensors: &'a Tensors,
    pub(super) moments: Option<&'a Tensors>,
}

impl Loader<'_> {
    pub(super) fn learned(&self, spec: &TensorSpec) -> Result<Learned, LearnError> {
        let moment = |name: &str| match self.moments {
            Some(moments) => Self::values(moments, &format!("{name}.{}", spec.name), spec),
            None => Ok(vec![0.0; spec.len()]),
        };
        let (first, second) = (moment("first")?, moment("second")?);
        Ok(Learned { value: self.running(spec)?, slope: vec![0.0; spec.len()], first, second })
    }

    /// Values that are not learned by gradient descent.
    pub(super) fn running(&self, spec: &TensorSpec) -> Result<Vec<f32>, LearnError> {
        Self::values(self.tensors, &spec.name, spec)
    }

    fn values(tensors: &Tensors, name: &str, spec: &TensorSpec) -> Result<Vec<f32>, LearnError> {
        match tensors.get(name) {
            Some((dims, values)) if dims == spec.dims => Ok(values.to_vec()),
            found => {
                let got = found.map_or(0, |(_, values)| values.len());
                Err(LearnError::Size { what: "values of a tensor", expected: spec.len(), got })
            }
        }
    }
}
