//! From images over time to touches.
//!
//! This crate is pure. It turns images into contacts ([`ContactFinder`]) and contacts into touches with stable
//! identities ([`Tracker`]). It keeps the baseline that difference data refer to ([`Baseline`]) and noise statistics
//! ([`RunningStats`], [`Covariance`], [`snr_db`]). From series and experiments it computes the measures that
//! laboratories report ([`measure`]), spectra ([`rhythm`]) and calibrated forces ([`force`]). It has no forward
//! model, no instrument and no clock: the caller gives times, in nanoseconds on any monotonic axis. It works with any
//! array of taxels.
//!
//! ```
//! use dermis_touch::{ContactFinder, ContactParams, GridGeometry, PixelNoise, Tracker, TrackerParams};
//!
//! // Images of 40 x 40 pixels of 2 mm, each of noise 0.01, on which a spot moves to the right.
//! let grid = GridGeometry { columns: 40, rows: 40, pixel_m: 2e-3, left_m: -0.04, top_m: 0.04 };
//! let mut finder = ContactFinder::new(grid, ContactParams::default())?;
//! let mut tracker = Tracker::new(TrackerParams::default())?;
//! let (mut contacts, mut ended) = (Vec::new(), Vec::new());
//! for frame in 0..10_u64 {
//!     let spot = |k: usize| {
//!         let (x, y) = ((k % 40) as f32 - 10.0 - frame as f32, (k / 40) as f32 - 20.0);
//!         (-(x * x + y * y) / 18.0).exp()
//!     };
//!     let image: Vec<f32> = (0..1600).map(spot).collect();
//!     finder.find(&image, PixelNoise::Uniform(0.01), &mut contacts)?;
//!     tracker.update(20_000_000 * frame, &contacts, &mut ended)?;
//! }
//! let [touch] = tracker.touches() else { panic!("one touch") };
//! assert!(touch.id == 1 && touch.velocity_m_per_s[0] > 0.05, "{touch:?}");
//! # Ok::<(), dermis_touch::TouchError>(())
//! ```
//!
//! | | |
//! |---|---|
//! | [`ContactFinder`], [`Tracker`] | images to contacts, contacts to touches with identities |
//! | [`Baseline`] | the reference of difference data: start, tare, drift |
//! | [`PlaceHypotheses`] | two positions that explain a frame about equally well, followed over a press |
//! | [`health`], [`damage`] | faulty channels and electrodes; damage as opposed to touch |
//! | [`guard`] | one verdict per frame: go on, stop, or unknown |
//! | [`locator`], [`force`] | positions and forces from calibrations, with their uncertainty |
//! | [`measure`], [`rhythm`], [`RunningStats`] | the measures that laboratories report; spectra; noise |
//!
//! Conventions: x right, y up, metres. An image is `f32` values on cells ([`ImageCells`]), and NaN marks cells
//! outside the skin. On a grid the image is row-major with row 0 at the top (+y), and a pixel's value is at the
//! pixel's centre ([`GridGeometry`]). Everything that runs once per frame uses memory kept by its owner, and
//! allocates nothing once that memory has reached its working size.

mod assignment;
mod baseline;
mod blob;
mod cells;
mod contact;
pub mod damage;
mod error;
mod finder;
pub mod force;
pub mod guard;
pub mod health;
mod hypotheses;
mod kalman;
pub mod locator;
pub mod measure;
mod moments;
mod noise;
mod plane;
pub mod rhythm;
mod statistics;
mod touch;
mod track;
mod tracker_params;
mod watershed;

pub use baseline::{
    Baseline, BaselineChange, BaselineParams, BaselineState, DriftCompensation, Load, ReferenceOrigin, ReferenceRecord,
    TareGuard,
};
pub use cells::{GridGeometry, ImageCells, SurfaceCells};
pub use contact::{
    CentroidWeight, Contact, ContactParams, ContactSign, ContactSigns, ContactStrength, LoadQuantity, PixelNoise,
    TouchLoad,
};
pub use error::TouchError;
pub use finder::ContactFinder;
pub use hypotheses::{PlaceHypotheses, PlaceHypothesis, PlaceModes, PlacesTold};
pub use locator::{Located, Locator, LocatorError, LocatorOptions, LocatorScratch};
pub use noise::{Covariance, RunningStats, ShrinkageTarget, SnrDefinition, SnrSummary, average_snr_db, snr_db};
pub use statistics::{evenly, median};
pub use touch::{Observation, Touch, TouchPhase};
pub use track::Tracker;
pub use tracker_params::{PositionSource, TrackerParams};
