//! What a workshop gets wrong, and what it costs: a skin is built many times with errors of every kind, each time as a
//! twin, and read by the model of the skin file, which knows nothing of the errors.
//!
//! Errors are normal and cut off at three deviations, because a workshop throws worse ones away. Factors that spread
//! over more than a few per cent (contact impedance, conductivity, noise) are log-normal. The sizes are assumptions of
//! what care with hand tools, laser cutters and printers leaves; a file replaces any of them.
//!
//! Every cause has random numbers of its own, drawn from seed, sample and cause. So a sample has the same errors alone
//! and among others (but for electrodes that would touch), and reports do not depend on the number of threads.

mod bench;
mod cause;
mod conductivity;
mod places;
mod report;
mod workshop;

pub use cause::{Cause, causes};
pub use dermis_skin::Tolerances;
pub use report::{Extent, PlaceError, ToleranceReport, ToleranceRow, run};
pub(crate) use workshop::frontend_of;

#[cfg(test)]
mod tests;
