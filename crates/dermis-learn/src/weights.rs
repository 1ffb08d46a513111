//! Weights on disk: safetensors with the tensors of a U-Net, plus other named tensors (the novelty score). Files are
//! checked against the architecture before use.

use std::collections::BTreeMap;
use std::path::Path;

use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};

use crate::LearnError;
use crate::shape::{TensorRole, UNetShape};

/// Values of named tensors, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tensors {
    entries: BTreeMap<String, (Vec<usize>, Vec<f32>)>,
}

impl Tensors {
    /// Adds or replaces a tensor.
    ///
    /// # Errors
    /// Fails if the dimensions do not match the number of values.
    pub fn insert(&mut self, name: impl Into<String>, dims: Vec<usize>, values: Vec<f32>) -> Result<(), LearnError> {
        let expected = dims.iter().product();
        if values.len() != expected {
            return Err(LearnError::Size { what: "values of a tensor", expected, got: values.len() });
        }
        self.entries.insert(name.into(), (dims, values));
        Ok(())
    }

    /// Dimensions and values of a tensor.
    pub fn get(&self, name: &str) -> Option<(&[usize], &[f32])> {
        self.entries.get(name).map(|(dims, values)| (dims.as_slice(), values.as_slice()))
    }

    /// Name, dimensions and values, sorted by name.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &[usize], &[f32])> {
        self.entries.iter().map(|(name, (dims, values))| (name.as_str(), dims.as_slice(), values.as_slice()))
    }

    /// Reads safetensors; all tensors must be 32-bit and finite. PyTorch's batch counters (`num_batches_tracked`),
    /// which the network does not need, are skipped. `file` is for messages.
    ///
    /// # Errors
    /// Fails if the bytes are not safetensors, have other types, or contain non-finite values.
    pub fn from_bytes(bytes: &[u8], file: &Path) -> Result<Self, LearnError> {
        let refuse = |field: &str, reason: String| LearnError::content(file, field, reason);
        let parsed =
            SafeTensors::deserialize(bytes).map_err(|error| refuse("header", format!("no safetensors: {error}")))?;
        let mut tensors = Self::default();
        for (name, view) in parsed.iter() {
            if name.ends_with(".num_batches_tracked") && view.dtype() == Dtype::I64 {
                continue;
            }
            if view.dtype() != Dtype::F32 {
                return Err(refuse(name, format!("expected type F32, found {:?}", view.dtype())));
            }
            let values: Vec<f32> =
                view.data().as_chunks::<4>().0.iter().map(|four| f32::from_le_bytes(*four)).collect();
            if let Some(index) = values.iter().position(|value| !value.is_finite()) {
                return Err(refuse(name, format!("value {index} is {}, expected a finite one", values[index])));
            }
            tensors.insert(name, view.shape().to_vec(), values)?;
        }
        Ok(tensors)
    }

    /// Serialises to safetensors.
    ///
    /// # Errors
    /// Never for tensors made by [`Tensors::insert`]; errors of the safetensors library are passed on.
    pub fn to_bytes(&self) -> Result<Vec<u8>, LearnError> {
        let bytes: Vec<(&str, &[usize], Vec<u8>)> = self
            .iter()
            .map(|(name, dims, values)| (name, dims, values.iter().flat_map(|v| v.to_le_bytes()).collect()))
            .collect();
        let mut views = Vec::with_capacity(bytes.len());
        for (name, dims, data) in &bytes {
            let view = TensorView::new(Dtype::F32, dims.to_vec(), data)
                .map_err(|error| LearnError::content("safetensors", *name, error.to_string()))?;
            views.push((*name, view));
        }
        safetensors::serialize(views, None)
            .map_err(|error| LearnError::content("safetensors", "header", error.to_string()))
    }

    /// Checks that all tensors of a network are present with the right sizes and that variances are positive. Other
    /// tensors are allowed.
    ///
    /// # Errors
    /// The first tensor that is missing or has the wrong size.
    pub fn check(&self, shape: &UNetShape, file: &Path) -> Result<(), LearnError> {
        let refuse = |field: &str, reason: String| Err(LearnError::content(file, field, reason));
        for spec in shape.tensors() {
            let Some((dims, values)) = self.get(&spec.name) else {
                return refuse(&spec.name, format!("missing; a network of {shape:?} has one of {:?}", spec.dims));
            };
            if dims != spec.dims {
                return refuse(&spec.name, format!("expected {:?} for {shape:?}, found {dims:?}", spec.dims));
            }
            let negative = |value: &f32| spec.role == TensorRole::RunningVariance && *value < 0.0;
            if let Some(value) = values.iter().find(|value| negative(value)) {
                return refuse(&spec.name, format!("a variance is {value}, expected none below 0"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SHAPE: UNetShape = UNetShape { inputs: 1, classes: 3, width: 2, levels: 2 };

    fn some() -> Tensors {
        let mut tensors = Tensors::default();
        for (number, spec) in SHAPE.tensors().into_iter().enumerate() {
            let values = (0..spec.len()).map(|k| (number * 31 + k) as f32 * 0.01).collect();
            tensors.insert(spec.name, spec.dims, values).unwrap();
        }
        tensors
    }

    #[test]
    fn written_data_are_read_back_bit_for_bit() {
        let tensors = some();
        let bytes = tensors.to_bytes().unwrap();
        let read = Tensors::from_bytes(&bytes, Path::new("w")).unwrap();
        assert_eq!(read, tensors);
        read.check(&SHAPE, Path::new("w")).unwrap();
    }

    #[test]
    fn unknown_architectures_numbers_and_types_are_refused() {
        let tensors = some();
        let wide = UNetShape { width: 4, ..SHAPE };
        let error = tensors.check(&wide, Path::new("w")).unwrap_err().to_string();
        assert!(error.starts_with("w: down.0.conv1.weight: expected [4, 1, 3, 3]"), "{error}");
        let deep = UNetShape { levels: 3, ..SHAPE };
        let error = tensors.check(&deep, Path::new("w")).unwrap_err().to_string();
        assert!(error.contains("down.2.conv1.weight: missing"), "{error}");

        let mut bad = some();
        bad.insert("head.bias", vec![3], vec![0.0, f32::NAN, 0.0]).unwrap();
        let error = Tensors::from_bytes(&bad.to_bytes().unwrap(), Path::new("w")).unwrap_err().to_string();
        assert_eq!(error, "w: head.bias: value 1 is NaN, expected a finite one");

        let mut bad = some();
        bad.insert("down.0.norm1.running_var", vec![2], vec![1.0, -1.0]).unwrap();
        let error = bad.check(&SHAPE, Path::new("w")).unwrap_err().to_string();
        assert_eq!(error, "w: down.0.norm1.running_var: a variance is -1, expected none below 0");

        let half = [0_u8; 6];
        let view = TensorView::new(Dtype::F16, vec![3], &half).unwrap();
        let bytes = safetensors::serialize([("head.bias", view)], None).unwrap();
        let error = Tensors::from_bytes(&bytes, Path::new("w")).unwrap_err().to_string();
        assert_eq!(error, "w: head.bias: expected type F32, found F16");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        #[test]
        fn damaged_files_are_errors_or_still_whole(place in 0_usize..100_000, byte: u8, cut in 0_usize..100_000) {
            let mut bytes = some().to_bytes().unwrap();
            let length = bytes.len();
            prop_assert!(Tensors::from_bytes(&bytes[..cut % length], Path::new("w")).is_err());
            bytes[place % length] = byte;
            if let Ok(read) = Tensors::from_bytes(&bytes, Path::new("w")) {
                let _ = read.check(&SHAPE, Path::new("w"));
                prop_assert!(read.iter().all(|(_, _, values)| values.iter().all(|v| v.is_finite())));
            }
        }

        #[test]
        fn random_bytes_are_errors(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
            prop_assert!(Tensors::from_bytes(&bytes, Path::new("w")).is_err());
        }
    }
}
