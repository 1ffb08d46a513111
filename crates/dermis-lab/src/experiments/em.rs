//! Experiments E1 to E11 of the EM-skins (paper E: magnetic induction tomography) on the twins of eight and sixteen
//! coils, and two that the paper could not do: which frequency is best, and metal nearby. The paper shows images and
//! gives few numbers; its elements are "either at rest or displaced proximal to the coils", which a hard press does
//! here.

mod array;
mod extensions;
mod force;
mod spectrum;
mod touches;

use crate::report::Experiment;

/// All of them.
pub(super) const EXPERIMENTS: [Experiment; 13] = [
    touches::SINGLE,
    touches::ADJACENT,
    touches::SEVERAL,
    touches::COILS,
    touches::SHAPES,
    spectrum::STABILITY,
    spectrum::CYCLIC,
    spectrum::TWO_RHYTHMS,
    force::RAMPS,
    force::SMALLEST,
    extensions::SWEEP,
    extensions::METAL,
    extensions::FOIL,
];
