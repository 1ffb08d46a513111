//! Touches as parameters: each is a smooth spot with a position, a radius and an amplitude, fitted to a frame with
//! the forward model itself rather than read off an image. The responses of spots are tabulated once over positions
//! and radii, whitened, and projected on the few combinations of channels that spots can change. A fit then only
//! interpolates, and allocates nothing.
//!
//! A spot at p with radius r and amplitude a is the load of a round face with a smoothed edge ([`SpotShape`]) that has
//! the integral and the second moment of a Gaussian `a exp(-|q - p|^2 / (2 r^2))`. The channels change by that
//! load times the response to a load on each pixel, summed over pixels. If a load changes only the pixel it acts on,
//! the response is the Jacobian. A membrane spreads loads, and the response is then the Jacobian times the change of
//! every pixel per load on one. All spots of a frame are fitted together with a uniform change of the whole skin
//! (temperature, or displaced liquid) by Levenberg-Marquardt. The covariance is the inverse of the Fisher matrix,
//! times the mean square of the whitened residual if that exceeds the noise. It is the Cramer-Rao bound if the model
//! is right (Kay, Fundamentals of Statistical Signal Processing, 1993, eq. 3.31).
//!
//! If changes may be large ([`SpotModel::with_large_changes`]), the fit continues with a correction: at every trial,
//! the nonlinear part of the response to its spots, computed by a forward model or extrapolated from its last results,
//! is subtracted from the frame.

mod beyond;
mod fit;
mod large_changes;
mod model;
mod products;
mod responses;
mod scratch;
mod seek;
mod shape;
mod spot;
mod table;

pub use fit::FitOutcome;
pub use large_changes::ChangeResponse;
pub use model::SpotModel;
pub use scratch::FitScratch;
pub use seek::{SpotFilter, SpotProposal};
pub use shape::SpotShape;
pub use spot::Spot;
pub use table::SpotOptions;
