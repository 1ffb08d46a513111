//! Offline work: twins as instruments, design, diagnosis, offline images, calibration, training sets and the published
//! experiments.
//!
//! ```
//! use dermis_lab::design::{Maps, Noise, Summary};
//! use dermis_live::prepare::Prepared;
//! use dermis_skin::{Layer, SheetLayer, Skin};
//!
//! // How well could a gel of 100 x 100 mm place a touch that changes its conductivity by a tenth, before it is built?
//! let gel = Layer::Sheet(SheetLayer::gel(5.0, 0.2));
//! let mut skin = Skin::rectangle("pad", 100.0, 100.0, gel);
//! skin.imaging.elements = 800;
//! let maps = Maps::new(&Prepared::new(skin)?, Noise::Assumed, 0.1, 8)?;
//! let bound = Summary::of(&maps.position_m);
//! assert!(bound.best < bound.median && bound.median < 0.05, "{bound:?}");
//! # Ok::<(), dermis_lab::Error>(())
//! ```
//!
//! | module | |
//! |---|---|
//! | [`twin_source`], [`twin_sample`], [`serve`](mod@serve) | twins as sources, as labelled data, behind a socket |
//! | [`design`], [`tolerances`](mod@tolerances) | a skin's abilities before it is built; the cost of manufacturing errors |
//! | [`doctor`], [`channel_search`], [`measured_list`] | faults of an instrument; the order of its readings; its protocol as a list |
//! | [`reconstruct`](mod@reconstruct), [`forces`], [`learning`] | files to images and touches; force calibrations; training sets, labels |
//! | [`case`], [`solve`] | single forward problems |
//! | [`conductance`](mod@conductance) | a sheet in siemens, from one state |
//! | [`experiments`], [`report`], [`twin_bench`] | replays of published experiments |
//! | [`evidence`] | data measured by others: errors of dermis and of a plain method |

pub mod case;
pub mod channel_search;
pub mod conductance;
pub mod design;
pub mod doctor;
mod error;
pub mod evidence;
pub mod experiments;
pub mod forces;
pub mod learning;
pub mod measured_list;
mod odd_frames;
pub mod reconstruct;
pub mod report;
pub mod serve;
pub mod solve;
pub mod tolerances;
pub mod twin_bench;
pub mod twin_commands;
pub mod twin_sample;
pub mod twin_source;

pub use error::Error;
