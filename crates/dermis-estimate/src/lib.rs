//! Explains a frame by presses: how many there are, where each is, and how certain that is.
//!
//! A frame is the change of a skin's channels since its baseline. A [`PressFit`] knows one kind of skin: it fits a
//! given number of presses to a frame, together with the nuisances (a uniform change of the skin), and proposes where
//! one more would help. The [`Estimator`] is independent of the kind of skin: it decides by evidence how many presses
//! there are and starts from those of the last frame. One rule decides when presses begin, split and end.
//!
//! The crate opens no files, reads no clock and knows no image format.

mod anchor;
mod estimator;
mod evidence;
mod plates;
mod press;
mod spots;
mod whitening;

pub use anchor::Anchor;
pub use estimator::{Allowance, Estimate, Estimator, Memory};
pub use evidence::Evidence;
pub use plates::{PlateFit, PlateLaw, PlateModel, PlateOptions};
pub use press::{BuiltVariance, Cost, Effort, Footprint, MOST_NOISE, Press, PressFit};
pub use spots::SpotFit;
