//! Experiments E1 to E11 of the EM-skins (paper E: magnetic induction tomography) on the twins with eight and sixteen
//! coils, and two that the paper could not do: finding the best frequency, and metal nearby. The paper shows images
//! and gives few numbers. Its elements are "either at rest or displaced proximal to the coils", which is a hard press
//! here.

mod array;
mod extensions;
mod force;
mod spectrum;
mod touches;

use crate::report::Experiment;

/// All experiments of the paper.
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
