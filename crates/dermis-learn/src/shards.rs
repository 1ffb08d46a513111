//! Training sets on disk: a folder with `manifest.json` (what was simulated, how, and from which seed) and shards of
//! samples (`shard-00000.safetensors`: `inputs`, samples x images x rows x columns, F32; `labels`, samples x rows x
//! columns, U8). Every shard is determined by the manifest and its number alone, so an interrupted set is completed
//! by generating the missing shards. Shards are written atomically.

use std::path::{Path, PathBuf};

use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use serde::{Deserialize, Serialize};

use crate::LearnError;
use crate::model::{read_bounded, sha256, write_whole};

/// Version of the manifest format.
pub const SET_FORMAT: &str = "dermis-train-set-1";
const MANIFEST: &str = "manifest.json";
const LARGEST_MANIFEST_BYTES: u64 = 16 << 20;
const LARGEST_SHARD_BYTES: u64 = 4 << 30;
/// Maximum number of samples; more are a typing error.
const MOST_SAMPLES: usize = 100_000_000;

/// Contents of a training set and how they were generated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// [`SET_FORMAT`].
    pub format: String,
    /// Name of the skin.
    pub skin: String,
    /// Fingerprint of the skin's geometry, protocol and imaging.
    pub skin_sha256: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Total number of samples.
    pub samples: usize,
    /// Samples per shard (the last may have fewer).
    pub shard_samples: usize,
    /// Kinds of the input images, in order.
    pub inputs: Vec<String>,
    /// Rows of the images.
    pub rows: usize,
    /// Columns of the images.
    pub columns: usize,
    /// Names of the classes, in the order of the labels.
    pub classes: Vec<String>,
    /// How scenes and instruments were drawn, for human readers.
    pub recipe: serde_json::Value,
}

/// Samples of one shard.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shard {
    /// Samples x images x rows x columns.
    pub inputs: Vec<f32>,
    /// Samples x rows x columns.
    pub labels: Vec<u8>,
}

/// A training set in a folder.
#[derive(Clone, Debug)]
pub struct TrainingSet {
    folder: PathBuf,
    manifest: Manifest,
    manifest_sha256: String,
}

impl Manifest {
    fn check(&self, file: &Path) -> Result<(), LearnError> {
        let refuse = |field: &str, reason: String| Err(LearnError::content(file, field, reason));
        if self.format != SET_FORMAT {
            return refuse("format", format!("expected {SET_FORMAT:?}, found {:?}", self.format));
        }
        for (field, value, most) in [
            ("samples", self.samples, MOST_SAMPLES),
            ("shard_samples", self.shard_samples, 100_000),
            ("rows", self.rows, 4096),
            ("columns", self.columns, 4096),
            ("inputs", self.inputs.len(), 64),
            ("classes", self.classes.len(), 64),
        ] {
            if !(1..=most).contains(&value) {
                return refuse(field, format!("expected from 1 to {most}, found {value}"));
            }
        }
        Ok(())
    }

    /// Number of shards.
    pub fn shards(&self) -> usize {
        self.samples.div_ceil(self.shard_samples)
    }

    /// Number of samples in a shard.
    pub fn samples_of(&self, shard: usize) -> usize {
        self.shard_samples.min(self.samples.saturating_sub(shard * self.shard_samples))
    }

    /// Number of values in one sample's images.
    pub fn input_len(&self) -> usize {
        self.inputs.len() * self.rows * self.columns
    }

    /// Number of pixels in an image.
    pub fn pixels(&self) -> usize {
        self.rows * self.columns
    }
}

impl TrainingSet {
    /// Starts a training set, or resumes one with the same manifest.
    ///
    /// # Errors
    /// Fails if the folder holds another set or cannot be written.
    pub fn create(folder: &Path, manifest: Manifest) -> Result<Self, LearnError> {
        let file = folder.join(MANIFEST);
        manifest.check(&file)?;
        let text = serde_json::to_vec_pretty(&manifest)
            .map_err(|error| LearnError::content(&file, "manifest", error.to_string()))?;
        if file.exists() {
            let there = Self::open(folder)?;
            if there.manifest != manifest {
                let reason = "the folder holds another training set; name another folder or remove it";
                return Err(LearnError::content(file, "manifest", reason));
            }
        } else {
            std::fs::create_dir_all(folder).map_err(LearnError::io(folder))?;
            write_whole(&file, &text)?;
        }
        Ok(Self { folder: folder.to_path_buf(), manifest, manifest_sha256: sha256(&text) })
    }

    /// Opens a training set.
    ///
    /// # Errors
    /// Fails if there is no manifest or it is invalid.
    pub fn open(folder: &Path) -> Result<Self, LearnError> {
        let file = folder.join(MANIFEST);
        let content = read_bounded(&file, LARGEST_MANIFEST_BYTES)?;
        let manifest: Manifest = serde_json::from_slice(&content)
            .map_err(|error| LearnError::content(&file, "manifest", error.to_string()))?;
        manifest.check(&file)?;
        Ok(Self { folder: folder.to_path_buf(), manifest, manifest_sha256: sha256(&content) })
    }

    /// The manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// SHA-256 of the manifest.
    pub fn manifest_sha256(&self) -> &str {
        &self.manifest_sha256
    }

    /// Path of a shard.
    pub fn shard_file(&self, shard: usize) -> PathBuf {
        self.folder.join(format!("shard-{shard:05}.safetensors"))
    }

    /// Shards that are missing or incomplete.
    pub fn missing(&self) -> Vec<usize> {
        (0..self.manifest.shards()).filter(|&shard| self.read(shard).is_err()).collect()
    }

    /// Writes a shard.
    ///
    /// # Errors
    /// Fails if the sizes differ from the manifest or the file cannot be written.
    pub fn write(&self, number: usize, shard: &Shard) -> Result<(), LearnError> {
        let file = self.shard_file(number);
        let manifest = &self.manifest;
        let samples = manifest.samples_of(number);
        for (what, expected, got) in [
            ("inputs of a shard", samples * manifest.input_len(), shard.inputs.len()),
            ("labels of a shard", samples * manifest.pixels(), shard.labels.len()),
        ] {
            if expected != got {
                return Err(LearnError::Size { what, expected, got });
            }
        }
        let bytes: Vec<u8> = shard.inputs.iter().flat_map(|value| value.to_le_bytes()).collect();
        let (rows, columns) = (manifest.rows, manifest.columns);
        let refuse = |error: safetensors::SafeTensorError| LearnError::content(&file, "shard", error.to_string());
        let views = [
            (
                "inputs",
                TensorView::new(Dtype::F32, vec![samples, manifest.inputs.len(), rows, columns], &bytes)
                    .map_err(refuse)?,
            ),
            ("labels", TensorView::new(Dtype::U8, vec![samples, rows, columns], &shard.labels).map_err(refuse)?),
        ];
        let content = safetensors::serialize(views, None).map_err(refuse)?;
        write_whole(&file, &content)
    }

    /// Reads a shard.
    ///
    /// # Errors
    /// Fails if the file is missing, truncated, damaged or from another set, or contains non-finite values or unknown
    /// labels.
    pub fn read(&self, number: usize) -> Result<Shard, LearnError> {
        let file = self.shard_file(number);
        let content = read_bounded(&file, LARGEST_SHARD_BYTES)?;
        self.parse(number, &content, &file)
    }

    fn parse(&self, number: usize, content: &[u8], file: &Path) -> Result<Shard, LearnError> {
        let refuse = |field: &str, reason: String| LearnError::content(file, field, reason);
        let manifest = &self.manifest;
        let samples = manifest.samples_of(number);
        let parsed = SafeTensors::deserialize(content).map_err(|error| {
            refuse("header", format!("no safetensors: {error}; remove the file to create it again"))
        })?;
        let tensor = |name: &str, dtype: Dtype, dims: &[usize]| {
            let view = parsed.tensor(name).map_err(|error| refuse(name, error.to_string()))?;
            if view.dtype() != dtype || view.shape() != dims {
                let found = format!("found {:?} {:?}", view.dtype(), view.shape());
                return Err(refuse(name, format!("expected {dtype:?} {dims:?}, {found}")));
            }
            Ok(view)
        };
        let (rows, columns) = (manifest.rows, manifest.columns);
        let inputs = tensor("inputs", Dtype::F32, &[samples, manifest.inputs.len(), rows, columns])?;
        let labels = tensor("labels", Dtype::U8, &[samples, rows, columns])?;
        let inputs: Vec<f32> = inputs.data().as_chunks::<4>().0.iter().map(|four| f32::from_le_bytes(*four)).collect();
        if let Some(index) = inputs.iter().position(|value| !value.is_finite()) {
            return Err(refuse("inputs", format!("value {index} is {}, expected a finite one", inputs[index])));
        }
        let labels = labels.data().to_vec();
        let classes = manifest.classes.len();
        if let Some(label) = labels.iter().find(|label| usize::from(**label) >= classes) {
            return Err(refuse("labels", format!("{label} is no class, expected below {classes}")));
        }
        Ok(Shard { inputs, labels })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn manifest() -> Manifest {
        Manifest {
            format: SET_FORMAT.into(),
            skin: "x".into(),
            skin_sha256: "0".into(),
            seed: 1,
            samples: 5,
            shard_samples: 2,
            inputs: vec!["a".into(), "b".into()],
            rows: 2,
            columns: 3,
            classes: vec!["0".into(), "1".into()],
            recipe: serde_json::Value::Null,
        }
    }

    fn shard(samples: usize) -> Shard {
        let inputs = (0..samples * 12).map(|k| k as f32).collect();
        Shard { inputs, labels: (0..samples * 6).map(|k| (k % 2) as u8).collect() }
    }

    #[test]
    fn an_interrupted_set_is_resumed() {
        let folder = tempfile::tempdir().unwrap();
        let set = TrainingSet::create(folder.path(), manifest()).unwrap();
        assert_eq!(set.missing(), [0, 1, 2]);
        set.write(1, &shard(2)).unwrap();
        set.write(2, &shard(1)).unwrap();
        let again = TrainingSet::create(folder.path(), manifest()).unwrap();
        assert_eq!(again.missing(), [0]);
        assert_eq!(again.read(1).unwrap(), shard(2));
        assert_eq!(again.manifest_sha256(), TrainingSet::open(folder.path()).unwrap().manifest_sha256());
        // A truncated shard is generated again.
        let bytes = std::fs::read(set.shard_file(1)).unwrap();
        std::fs::write(set.shard_file(1), &bytes[..bytes.len() - 1]).unwrap();
        assert_eq!(again.missing(), [0, 1]);
        let other = Manifest { seed: 2, ..manifest() };
        let error = TrainingSet::create(folder.path(), other).unwrap_err().to_string();
        assert!(error.contains("the folder holds another training set"), "{error}");
        let error = set.write(0, &shard(1)).unwrap_err().to_string();
        assert_eq!(error, "inputs of a shard: expected 24 values, got 12");
    }

    #[test]
    fn values_that_are_no_samples_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let set = TrainingSet::create(folder.path(), manifest()).unwrap();
        let mut bad = shard(2);
        bad.labels[3] = 7;
        set.write(0, &bad).unwrap();
        assert!(set.read(0).unwrap_err().to_string().ends_with("labels: 7 is no class, expected below 2"));
        let mut bad = shard(2);
        bad.inputs[5] = f32::INFINITY;
        set.write(0, &bad).unwrap();
        assert!(set.read(0).unwrap_err().to_string().ends_with("inputs: value 5 is inf, expected a finite one"));
        // A shard with a different number of samples.
        std::fs::copy(set.shard_file(0), set.shard_file(2)).unwrap();
        assert!(set.read(2).unwrap_err().to_string().contains("expected F32 [1, 2, 2, 3], found F32 [2, 2, 2, 3]"));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        #[test]
        fn damaged_shards_are_errors_or_still_samples(place in 0_usize..10_000, byte: u8, cut in 0_usize..10_000) {
            let folder = tempfile::tempdir().unwrap();
            let set = TrainingSet::create(folder.path(), manifest()).unwrap();
            set.write(0, &shard(2)).unwrap();
            let mut bytes = std::fs::read(set.shard_file(0)).unwrap();
            let length = bytes.len();
            prop_assert!(set.parse(0, &bytes[..cut % length], Path::new("s")).is_err());
            bytes[place % length] = byte;
            if let Ok(read) = set.parse(0, &bytes, Path::new("s")) {
                prop_assert!(read.inputs.iter().all(|v| v.is_finite()) && read.labels.iter().all(|l| *l < 2));
            }
        }
    }
}
