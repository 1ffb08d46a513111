//! Training sets simulated from a skin file ([`train_set`]), and labels for recorded frames, with a network or without
//! ([`segment`]).

mod model_mismatch;
mod score;
pub mod segment;
mod solver;
pub mod train_set;

pub use score::challenge_score;
