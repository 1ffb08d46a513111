//! Segmentation of tactile images by a U-Net (second step of two-step imaging): every pixel is compressed, background or
//! damaged, with probabilities. Inference and training on the processor need no machine-learning framework, and inference
//! allocates nothing per frame; feature `train` adds training on the backends of `burn`.

mod error;
mod kernels;
pub mod metrics;
mod model;
mod network;
mod novelty;
pub mod scene;
mod shape;
mod shards;
pub mod train;
mod weights;

pub use error::LearnError;
pub use model::{CARD_FORMAT, Model, ModelCard, TrainingRecord, sha256};
pub use network::Network;
pub use novelty::Novelty;
pub use shape::{TensorRole, TensorSpec, UNetShape};
pub use shards::{Manifest, SET_FORMAT, Shard, TrainingSet};
pub use weights::Tensors;
