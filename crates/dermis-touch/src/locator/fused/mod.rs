//! A locator that keeps improving with more pokes: two experts, combined according to their errors on left-out pokes.
//!
//! The forward expert is a [`Locator`], which predicts frames from positions. It works well with few pokes, because
//! it interpolates smooth functions and can report several likely positions. With thousands of pokes it stops
//! improving, because the differences between two touches of one place (earlier presses, drift) are not the same
//! noise everywhere. The inverse expert is a kernel regression from frames to positions. It is poor with few pokes
//! and good with many, because it learns which parts of a frame indicate the position. Their product is at least as
//! good as the better one: the temperatures and powers tried include those that switch either expert off.
//!
//! No knowledge of the skin's geometry is needed: positions that cover its outline and a number of channels are
//! enough ([`SignatureMap::without_physics`]). If physics is given, it is used if it improves the prediction of
//! left-out pokes.
//!
//! A calibration of another skin of the family ([`FusedLocator::fit_with_prior`]) provides its covariance between
//! channels, as an inverse Wishart prior, and its map as the mean of the new one. Each is used only if it improves
//! the prediction of left-out pokes.

mod drift;
mod excess;
mod features;
mod fit;
mod form_choice;
mod fusion;
mod inverse;
mod inverse_fit;
mod landmarks;
mod live;
mod model;
mod prior;
mod report;
mod sessions;
mod state;

pub use drift::SessionDrift;
pub use fit::FusedOptions;
pub use live::FusedScratch;
pub use model::FusedLocator;
pub use report::{Accuracy, FusedReport, PriorUse};
pub use state::FUSED_VERSION;
