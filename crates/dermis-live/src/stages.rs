//! The stages of the live pipeline between difference data and touches. They do not know each other: the pipeline
//! passes on their results.

pub(crate) mod build_learning;
pub(crate) mod circuit;
pub mod classes;
pub mod damage;
mod drift;
pub(crate) mod element_contacts;
pub(crate) mod element_presses;
pub(crate) mod ended_presses;
pub(crate) mod force_law;
pub(crate) mod guard;
pub mod health;
mod model_error;
mod pace;
pub mod placement;
pub(crate) mod plates;
pub(crate) mod press_frames;
mod press_model;
mod press_peaks;
pub mod refinement;
pub mod spot_model;
pub mod touch_refinement;
mod touch_search;
pub mod touches;
pub(crate) mod workshop_ensemble;
pub(crate) mod workshop_error;
