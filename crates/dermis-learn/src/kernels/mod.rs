//! Kernels for inference and training: images stored channel by channel, each with a border of zeros, and 3x3
//! convolutions over them as runs of pixels in vector registers. Rows are separated by two zeros, so an image is one
//! run of pixels with no special cases at its rim, whatever the register width.

mod convolve;
mod plane;
mod slopes;

pub(crate) use convolve::{Finish, Taps, convolve};
pub(crate) use plane::{Layout, pool, pool_back, repeat, repeat_back};
pub(crate) use slopes::add_kernel_slopes;
