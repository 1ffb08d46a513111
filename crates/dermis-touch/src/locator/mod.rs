//! A calibrated touch locator: from one frame to the position of one touch with a calibrated uncertainty, learned
//! from a few dozen to a few hundred pokes at known positions and interpolated between them by physics.
//!
//! The frame of a touch at p, weighted by the channel noise and scaled to unit length, is modelled as z(p) ~ N(G
//! u(p), k(p, p') S) + noise, where u is the physical signature, G a diagonal of channel gains, k a Matern 5/2
//! correlation and S the covariance between channels. Conditioning on the pokes gives a mean signature m(p) and a
//! variance v(p) at every position of the map. A new frame has the log-likelihood L(p) = -[d(p)^2 / (v(p) + s) + C
//! ln(v(p) + s)] / 2, with d the distance (in the metric of S) from the frame to the nearest positive multiple of
//! m(p), and s the noise, which is larger for weaker touches.
//!
//! Position and covariance are the moments of exp(b L(p)). The temperature b accounts for errors shared between
//! channels. It and a factor on sigma are chosen so that each example, when left out, is predicted best and is within
//! one sigma in 68 % of cases. Far from any poke, a second term of sigma grows with v; its size predicts left-out
//! examples best, and is at most what locating each quarter of the skin from the others needs. Sigma is also multiplied
//! by 1 + 7/n for the seven quantities chosen by the same left-out examples.
//!
//! Because the model runs from position to frame, it interpolates smooth functions, needs few pokes, and its
//! posterior may have several peaks where the skin is ambiguous.
//!
//! The module is pure and has no forward model: physics arrives as plain arrays ([`SignatureMap`]).

mod channel_covariance;
mod correction;
mod data;
mod design;
mod error;
mod fit;
mod fused;
mod left_out;
mod live;
mod load;
mod model;
mod pair_correlations;
mod posterior;
mod regression;
mod rows;
mod state;
mod suggest;
mod superposition;
mod turn;
mod turn_search;

pub use correction::{PlaceCorrection, PokeSight, SeenPoke, TypicalAmplitude};
pub use data::{
    Examples, Hyperparameters, LeaveOneOut, LeftOut, LoadEstimate, Located, LocatorOptions, MIN_CHANNELS, MIN_EXAMPLES,
    Selection, SignatureMap, SuggestedPoke,
};
pub use error::LocatorError;
pub use fused::*;
pub use live::LocatorScratch;
pub use model::Locator;
pub use state::LOCATOR_VERSION;
pub use superposition::{LabelledFrame, MOST_TOUCHES, Part, Superposition, SuperpositionScratch};
