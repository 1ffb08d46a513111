//! Everything needed to resume a training: weights, Adam's moments and the best weights in one safetensors
//! file, and the scalars in a JSON file that also holds the hash of the tensors. Two tensor files alternate and the
//! JSON is written last, so a training killed during a write resumes from the previous checkpoint.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::options::TrainOptions;
use crate::LearnError;
use crate::model::{read_bounded, sha256, write_whole};
use crate::shape::UNetShape;
use crate::weights::Tensors;

const LARGEST_BYTES: u64 = 2 << 30;

/// State of a training.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct State {
    pub(super) tensors: Tensors,
    pub(super) moments: Tensors,
    pub(super) best: Tensors,
    /// Passes completed.
    pub(super) epoch: usize,
    pub(super) best_epoch: usize,
    pub(super) best_loss: f64,
    /// Steps of Adam.
    pub(super) steps: usize,
    pub(super) duration_s: f64,
}

impl State {
    pub(super) fn fresh(tensors: Tensors) -> Self {
        Self {
            best: tensors.clone(),
            tensors,
            moments: Tensors::default(),
            epoch: 0,
            best_epoch: 0,
            best_loss: f64::MAX,
            steps: 0,
            duration_s: 0.0,
        }
    }

    /// Keeps the weights if this pass is the best yet; returns whether it is.
    pub(super) fn keep_if_best(&mut self, loss: f64) -> bool {
        let better = loss < self.best_loss;
        if better {
            self.best_loss = loss;
            self.best_epoch = self.epoch;
            self.best = self.tensors.clone();
        }
        better
    }
}

/// The scalars of a checkpoint.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Head {
    data_sha256: String,
    options: TrainOptions,
    tensors_sha256: String,
    epoch: usize,
    best_epoch: usize,
    best_loss: f64,
    steps: usize,
    duration_s: f64,
}

/// A folder with a checkpoint.
pub(super) struct Checkpoint {
    folder: PathBuf,
    data_sha256: String,
    options: TrainOptions,
}

impl Checkpoint {
    pub(super) fn new(folder: &Path, data_sha256: &str, options: &TrainOptions) -> Self {
        Self { folder: folder.to_path_buf(), data_sha256: data_sha256.into(), options: options.clone() }
    }

    /// Alternates between two files: the previous one stays complete until the JSON names the new one.
    fn tensors_file(&self, epoch: usize) -> PathBuf {
        self.folder.join(format!("checkpoint-{}.safetensors", epoch % 2))
    }

    fn head_file(&self) -> PathBuf {
        self.folder.join("checkpoint.json")
    }

    /// The existing checkpoint, if any.
    pub(super) fn read(&self, shape: &UNetShape) -> Result<Option<State>, LearnError> {
        let file = self.head_file();
        if !file.exists() {
            return Ok(None);
        }
        let content = read_bounded(&file, 1 << 20)?;
        let head: Head = serde_json::from_slice(&content)
            .map_err(|error| LearnError::content(&file, "checkpoint", error.to_string()))?;
        if head.data_sha256 != self.data_sha256 || head.options != self.options {
            let reason = "made with other options or another training set; use those, or remove the folder";
            return Err(LearnError::content(&file, "checkpoint", reason));
        }
        let tensors_file = self.tensors_file(head.epoch);
        let bytes = read_bounded(&tensors_file, LARGEST_BYTES)?;
        if sha256(&bytes) != head.tensors_sha256 {
            let reason = "not what the checkpoint says; remove the folder to start over";
            return Err(LearnError::content(&tensors_file, "content", reason));
        }
        let all = Tensors::from_bytes(&bytes, &tensors_file)?;
        let part = |prefix: &str| {
            let mut tensors = Tensors::default();
            for (name, dims, values) in all.iter() {
                if let Some(rest) = name.strip_prefix(prefix) {
                    tensors.insert(rest, dims.to_vec(), values.to_vec())?;
                }
            }
            Ok::<Tensors, LearnError>(tensors)
        };
        let state = State {
            tensors: part("now.")?,
            moments: part("moments.")?,
            best: part("best.")?,
            epoch: head.epoch,
            best_epoch: head.best_epoch,
            best_loss: head.best_loss,
            steps: head.steps,
            duration_s: head.duration_s,
        };
        state.tensors.check(shape, &tensors_file)?;
        state.best.check(shape, &tensors_file)?;
        Ok(Some(state))
    }

    pub(super) fn write(&self, state: &State) -> Result<(), LearnError> {
        std::fs::create_dir_all(&self.folder).map_err(LearnError::io(&self.folder))?;
        let mut all = Tensors::default();
        for (prefix, tensors) in [("now.", &state.tensors), ("moments.", &state.moments), ("best.", &state.best)] {
            for (name, dims, values) in tensors.iter() {
                all.insert(format!("{prefix}{name}"), dims.to_vec(), values.to_vec())?;
            }
        }
        let bytes = all.to_bytes()?;
        let head = Head {
            data_sha256: self.data_sha256.clone(),
            options: self.options.clone(),
            tensors_sha256: sha256(&bytes),
            epoch: state.epoch,
            best_epoch: state.best_epoch,
            best_loss: state.best_loss,
            steps: state.steps,
            duration_s: state.duration_s,
        };
        let text = serde_json::to_vec_pretty(&head)
            .map_err(|error| LearnError::content(self.head_file(), "checkpoint", error.to_string()))?;
        write_whole(&self.tensors_file(state.epoch), &bytes)?;
        write_whole(&self.head_file(), &text)
    }
}
