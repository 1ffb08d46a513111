//! A locator that keeps learning: two experts, joined by what the left-out pokes say of each.
//!
//! The forward expert is a [`Locator`]: from place to frame, good with few pokes, because it interpolates what is
//! smooth and may say that several places are likely. With thousands of pokes it stops improving, because what varies
//! between two touches of one place (what was pressed before, drift) is not the same noise everywhere. The inverse
//! expert is a kernel regression from frame to place, poor with few pokes and good with many, because it learns which
//! parts of a frame tell the place. Their product is at least as good as the better one: temperature and power that
//! switch either expert off are among those tried.
//!
//! Nothing need be known of the skin's geometry: positions that cover its outline and a number of channels are enough
//! ([`SignatureMap::without_physics`]). Where physics is given it is used if it predicts left-out pokes better.
//!
//! A calibration of another skin of the family ([`FusedLocator::fit_with_prior`]) lends its covariance between
//! channels, as an inverse Wishart prior, and its map as the mean of the new one, each only if left-out pokes are
//! predicted better.

mod drift;
mod features;
mod fit;
mod form;
mod fusion;
mod inverse;
mod landmarks;
mod live;
mod model;
mod prior;
mod report;
mod state;

pub use drift::SessionDrift;
pub use fit::FusedOptions;
pub use live::FusedScratch;
pub use model::FusedLocator;
pub use report::{Accuracy, FusedReport, PriorUse};
pub use state::FUSED_VERSION;
