//! Experiments H1 to H6 of the self-healing sandwich (paper H: two-step imaging, touch told from damage) on its twin,
//! whose two sheets, mesh and noise are not the reconstruction's. Every case is read off one frame at the published
//! noise.

mod bench;
mod damage;
mod live;
mod touches;

use crate::report::Experiment;

/// All of them.
pub(super) const EXPERIMENTS: [Experiment; 6] = [
    touches::SINGLE,
    touches::POSITIONS,
    touches::SEVERAL,
    damage::CUT_AND_TOUCHES,
    damage::HEALING,
    damage::ON_THE_CUT,
];
