//! Coil arrays of published EM-skins (paper E), as plain descriptions.

use crate::array::CoilArray;
use crate::coil::CoilShape;
use crate::coil_spec::{CoilGrid, CoilSpec, Conductor};
use crate::error::MitError;

/// A published array: coils on a square grid around the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PublishedArray {
    /// The coils.
    pub spec: CoilSpec,
    /// Number of coils along a side.
    pub per_side: usize,
    /// Distance between neighbours, metres.
    pub pitch_m: f64,
    /// Numbers of the positions that stay empty, from 1.
    pub left_out: &'static [usize],
}

/// Eight hand-wound coils of 40 mm on a 3 x 3 grid of 45 mm with an empty middle; 150 uH each. The grid pitch and the
/// winding (six layers of 6 turns of 0.5 mm) are assumed.
pub const EM_8: PublishedArray = PublishedArray {
    spec: CoilSpec {
        shape: CoilShape::Round,
        inner_m: 0.034,
        outer_m: 0.040,
        turns: 36,
        layers: 6,
        layer_pitch_m: 0.0005,
        conductor: Conductor::Wire { diameter_m: 0.0005 },
        inductance_h: Some(150e-6),
    },
    per_side: 3,
    pitch_m: 0.045,
    left_out: &[5],
};

/// Sixteen printed circular spirals with 51 turns, 30 to 70 mm, 5 mm between neighbours; measured at 155 uH each.
pub const EM_16_CIRCULAR: PublishedArray = PublishedArray {
    spec: CoilSpec::spiral(CoilShape::Round, 0.03, 0.07, 51).with_inductance(155e-6),
    per_side: 4,
    pitch_m: 0.075,
    left_out: &[],
};

/// Sixteen printed square spirals with 51 turns, 25 to 75 mm, 3 mm between neighbours; measured at 157 uH each.
pub const EM_16_SQUARE: PublishedArray = PublishedArray {
    spec: CoilSpec::spiral(CoilShape::Square, 0.025, 0.075, 51).with_inductance(157e-6),
    per_side: 4,
    pitch_m: 0.078,
    left_out: &[],
};

impl PublishedArray {
    /// Positions of the coils.
    pub fn grid(&self) -> CoilGrid {
        CoilGrid {
            rows: self.per_side,
            columns: self.per_side,
            pitch_m: [self.pitch_m; 2],
            left_out: self.left_out.to_vec(),
        }
    }

    /// The coils at their positions.
    ///
    /// # Errors
    /// Never with the published numbers.
    pub fn coils(&self) -> Result<CoilArray, MitError> {
        CoilArray::new(&self.spec, &self.grid().places_m()?)
    }
}

impl CoilArray {
    /// [`EM_8`], numbered row by row from the bottom left.
    ///
    /// # Errors
    /// Never with these numbers.
    pub fn em_8() -> Result<Self, MitError> {
        EM_8.coils()
    }

    /// [`EM_16_CIRCULAR`].
    ///
    /// # Errors
    /// Never with these numbers.
    pub fn em_16_circular() -> Result<Self, MitError> {
        EM_16_CIRCULAR.coils()
    }

    /// [`EM_16_SQUARE`].
    ///
    /// # Errors
    /// Never with these numbers.
    pub fn em_16_square() -> Result<Self, MitError> {
        EM_16_SQUARE.coils()
    }
}
