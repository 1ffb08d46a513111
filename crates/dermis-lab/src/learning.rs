//! Training sets simulated from a skin file ([`train_set`]), and segmentation of recorded frames, with or without a
//! network ([`segment`]).

mod model_mismatch;
mod score;
pub mod segment;
mod solver;
pub mod train_set;

pub use score::challenge_score;
