//! What inference and training compute with: images channel by channel, each with a border of zeros, and 3x3
//! convolutions over them as runs of pixels in vector registers. Rows follow each other with two zeros between, so that
//! an image is one run of pixels without special cases at its rim, whatever the width of the registers.

mod convolve;
mod plane;
mod slopes;

pub(crate) use convolve::{Finish, Taps, convolve};
pub(crate) use plane::{Layout, pool, pool_back, repeat, repeat_back};
pub(crate) use slopes::add_kernel_slopes;
