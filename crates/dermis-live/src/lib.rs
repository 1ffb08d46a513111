//! From a skin file to an operator ([`prepare`]), and from frames to touches ([`pipeline`]).

pub mod calibration;
pub mod channels;
pub mod clock;
pub mod driver;
mod error;
pub mod forces;
mod image_cells;
pub mod imager;
pub mod latency;
pub mod magnetic_model;
pub mod network;
pub mod output;
pub mod pipeline;
pub mod prepare;
pub mod reconstructor;
pub mod reference;
pub mod stages;

pub use error::Error;
