//! Predicts what a skin will be able to do before it is built. From its forward model alone: maps of sensitivity,
//! smallest detectable amplitude, the width of a point's image, and the Cramér-Rao bound on a touch's position and
//! amplitude at the instrument's noise. From the mechanics of its twin: the smallest detectable force. Also searches
//! for a better skin.
//!
//! A touch of amplitude a at (x, y) changes the channels by `a s(x, y)`, where `s` is the signature of the skin
//! file's touch ([`Prepared::signatures`](dermis_live::prepare::Prepared::signatures)). With noise of covariance C
//! the Fisher information about `(x, y, a)` is `G' C^-1 G`, `G = [a ds/dx, a ds/dy, s]`, and no unbiased estimator
//! has a smaller covariance than its inverse (Kay, Fundamentals of Statistical Signal Processing, 1993, eq. 3.31).
//! The smallest amplitude is 3.3 standard deviations of the matched filter, `3.3 / sqrt(s' C^-1 s)`.

mod compare;
mod force;
mod maps;
mod search;

pub use compare::{SharedInstrument, verdict};
pub use force::{ForceMap, smallest_force};
pub use maps::{DETECTED_SIGMA, Maps, Noise, Summary, spread_width};
pub use search::{Candidate, Freedom, Search, improve};
