//! What happens at a desk, not on a robot: twins as instruments, design, examination, offline images, calibration, training
//! sets and the published experiments.

pub mod case;
pub mod design;
pub mod doctor;
mod error;
pub mod experiments;
pub mod forces;
pub mod learning;
pub mod measured_list;
pub mod reconstruct;
pub mod report;
pub mod serve;
pub mod solve;
pub mod tolerances;
pub mod twin_bench;
pub mod twin_sample;
pub mod twin_source;

pub use error::Error;
