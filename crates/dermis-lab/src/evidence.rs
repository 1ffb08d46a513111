//! Runs dermis on measurements published by others; the work behind `dermis evidence`. Each data set has a file that
//! takes it through the public path (skin file, [`reconstruct`](mod@crate::reconstruct), calibration, pipeline) and
//! states what was known, what was tuned on these data, how a plain method performs on them, and what others have
//! published.
//!
//! ```no_run
//! use dermis_lab::evidence::{Extent, SETS};
//!
//! for set in &SETS {
//!     let report = set.measure("data".as_ref(), Extent::Quick, &mut |step| eprintln!("{}: {step}", set.name));
//!     for finding in &report.findings {
//!         println!("{}: {}", finding.measured, finding.here_text());
//!     }
//! }
//! ```

mod bench;
mod finding;
pub mod five_skins;
pub mod gel_watch;
pub mod golfball;
pub mod hydrogel;
pub mod imaged;
mod kernel_ridge;
pub mod ktc;
pub mod place_errors;
pub mod pyeidors;
pub mod sciospec;
mod sets;
pub mod team7;

pub use bench::Extent;
pub use finding::{Comparison, Figure, Finding};
pub use kernel_ridge::KernelRidge;
pub use sets::{SETS, Set, SetReport};
