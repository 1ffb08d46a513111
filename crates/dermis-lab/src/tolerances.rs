//! Estimates what manufacturing errors cost. A skin is built many times as a twin, with errors of every kind, and
//! processed with the model of the skin file, without knowledge of the errors.
//!
//! Errors are normal and cut off at three standard deviations, because worse parts would be discarded. Factors that
//! spread over more than a few per cent (contact impedance, conductivity, noise) are log-normal. The default sizes
//! are assumptions about careful work with hand tools, laser cutters and printers; a file can replace any of them.
//!
//! Every cause has its own random numbers, drawn from seed, sample and cause. A sample therefore has the same errors
//! alone and in combination (except for electrodes that would touch), and reports don't depend on the number of
//! threads.

mod bench;
mod cause;
mod conductivity;
mod places;
mod report;
mod workshop;

pub use cause::{Cause, causes};
pub use dermis_skin::Tolerances;
pub use report::{Extent, PlaceError, ToleranceReport, ToleranceRow, run};
pub(crate) use workshop::built_twin;

#[cfg(test)]
mod tests;
