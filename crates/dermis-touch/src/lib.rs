//! From images over time to touches.
//!
//! This crate is pure: it turns images, one after another, into contacts ([`ContactFinder`]) and contacts into touches
//! with stable identities ([`Tracker`]); it keeps the baseline that difference data are taken against ([`Baseline`])
//! and the statistics of the noise ([`RunningStats`], [`Covariance`], [`snr_db`]). From series and experiments come the
//! measures that laboratories report ([`measure`]), spectra ([`rhythm`]) and calibrated forces ([`force`]). It knows no forward model, no
//! instrument and no clock: times are given by the caller, in nanoseconds on any monotonic axis.
//!
//! Conventions: x right, y up, metres; an image is `f32` values on cells ([`ImageCells`]), and NaN marks cells outside the
//! skin. On a grid the image is row-major with row 0 at the top (+y), and a pixel's value stands at the pixel's centre
//! ([`GridGeometry`]). Everything that runs once per frame
//! works in memory that its owner keeps, and allocates nothing once that memory has grown to its working size.

mod assignment;
mod baseline;
mod blob;
mod cells;
mod contact;
pub mod damage;
mod error;
mod finder;
pub mod force;
pub mod health;
mod kalman;
pub mod locator;
pub mod measure;
mod moments;
mod noise;
pub mod rhythm;
mod track;
mod watershed;

pub use baseline::{
    Baseline, BaselineChange, BaselineParams, BaselineState, DriftCompensation, Load, ReferenceOrigin, ReferenceRecord,
    TareGuard,
};
pub use cells::{GridGeometry, ImageCells, SurfaceCells};
pub use contact::{CentroidWeight, Contact, ContactParams, ContactSign, ContactSigns, ContactStrength, PixelNoise};
pub use error::TouchError;
pub use finder::ContactFinder;
pub use locator::{Located, Locator, LocatorError, LocatorOptions, LocatorScratch};
pub use noise::{Covariance, RunningStats, ShrinkageTarget, SnrDefinition, SnrSummary, average_snr_db, snr_db};
pub use track::{Observation, PositionSource, Touch, TouchEvent, TouchPhase, Tracker, TrackerParams};
