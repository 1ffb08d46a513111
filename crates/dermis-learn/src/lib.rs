//! Segmentation of tactile images by a U-Net (the second step of two-step imaging): every pixel is compressed,
//! background or damaged, with probabilities. Inference and training on the CPU need no machine-learning framework,
//! and inference allocates nothing per frame. On GPUs, networks are trained with PyTorch from the same training sets.
//!
//! ```
//! use dermis_learn::metrics::{Confusion, most_likely};
//! use dermis_learn::{LearnError, Network, Tensors, UNetShape};
//!
//! // The smallest network: one input image, three classes. Its weights have the names of a PyTorch `state_dict`.
//! let shape = UNetShape { inputs: 1, classes: 3, width: 4, levels: 2 };
//! let missing = Network::new(shape, &Tensors::default(), 16, 16).unwrap_err();
//! assert!(missing.to_string().contains("weight"), "{missing}");
//!
//! // From what a network says of two pixels (classes x pixels) to labels, and how these agree with what is true.
//! let mut labels = [0; 2];
//! most_likely(&[0.9, 0.1, 0.05, 0.2, 0.05, 0.7], 3, &mut labels);
//! let mut confusion = Confusion::new(3);
//! confusion.add(&[0, 2], &labels)?;
//! assert_eq!((labels, confusion.intersection_over_union(2)), ([0, 2], Some(1.0)));
//! # Ok::<(), LearnError>(())
//! ```
//!
//! | | |
//! |---|---|
//! | [`Network`], [`UNetShape`], [`Tensors`] | the network, its architecture, its weights |
//! | [`Model`], [`ModelCard`], [`Novelty`] | a trained network with its card; a score of unfamiliar frames |
//! | [`scene`], [`TrainingSet`] | random scenes for training samples; sets of samples on disk |
//! | [`train`], [`metrics`] | training; quality of labels |

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
pub use model::{CARD_FORMAT, FirstCard, Model, ModelCard, TrainingRecord, sha256};
pub use network::Network;
pub use novelty::Novelty;
pub use shape::{TensorRole, TensorSpec, UNetShape};
pub use shards::{Manifest, SET_FORMAT, Shard, TrainingSet};
pub use weights::Tensors;
