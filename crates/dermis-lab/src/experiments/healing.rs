//! Experiments H1 to H6 of the self-healing sandwich (paper H: two-step imaging, touch distinguished from damage) on
//! its twin. The twin has two sheets, and its mesh and noise differ from the reconstruction's. Every case is read
//! from a single frame at the published noise.

mod bench;
mod damage;
mod live;
mod touches;

use crate::report::Experiment;

/// All experiments of the paper.
pub(super) const EXPERIMENTS: [Experiment; 6] = [
    touches::SINGLE,
    touches::POSITIONS,
    touches::SEVERAL,
    damage::CUT_AND_TOUCHES,
    damage::HEALING,
    damage::ON_THE_CUT,
];
