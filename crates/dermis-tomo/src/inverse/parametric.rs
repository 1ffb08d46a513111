//! Touches as parameters: each a smooth spot of a place, a radius and an amplitude, fitted to a frame by the forward
//! model itself rather than read off an image. The responses of spots are tabulated once over places and radii,
//! whitened and projected on the few combinations of channels that spots can change; a fit then interpolates, and
//! allocates nothing.
//!
//! A spot at p with radius r and amplitude a is a load `a exp(-|q - p|^2 / (2 r^2))`; the change of the channels is the
//! response to loads, pixel by pixel, times that. Where what is pressed is what changes, the response is the Jacobian;
//! a membrane spreads loads, and the response is then the Jacobian times what a load in one pixel changes in the
//! others. All spots of a frame and a uniform change of the whole skin (temperature, or liquid that was pushed aside)
//! are fitted together by Levenberg and Marquardt. The inverse of the Fisher matrix, times the mean square of the
//! whitened residual where that exceeds the noise, is the covariance: the Cramer-Rao bound where the model is right
//! (Kay, Fundamentals of Statistical Signal Processing, 1993, eq. 3.31).
//!
//! Where changes may be large ([`SpotModel::with_large_changes`]) the fit goes on with what its spots do beyond
//! proportion, as a forward model has it, taken out of the frame at every trial.

mod fit;
mod large;
mod model;
mod options;
mod products;
mod responses;
mod seek;
mod table;

pub use fit::{FitOutcome, FitScratch, Spot};
pub use large::ChangeResponse;
pub use model::SpotModel;
pub use options::SpotOptions;
pub use seek::{SpotFilter, SpotProposal};
