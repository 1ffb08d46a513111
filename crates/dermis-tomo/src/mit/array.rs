//! The coil arrays of paper E, and arrays of one's own.

use super::{Coil, MitError, Vector, norm, subtract};

/// Coils beside each other.
#[derive(Clone, Debug, PartialEq)]
pub struct CoilArray {
    coils: Vec<Coil>,
}

/// Self inductance of the hand-wound coils (paper E), henries.
const HAND_WOUND_H: f64 = 150e-6;
/// Measured self inductances of the printed spirals (paper E), henries.
const PRINTED_H: [f64; 2] = [155e-6, 157e-6];

impl CoilArray {
    /// Coils that do not reach into each other.
    ///
    /// # Errors
    /// No coils, coils that overlap or are nowhere.
    pub fn new(coils: Vec<Coil>) -> Result<Self, MitError> {
        if coils.is_empty() {
            return Err(MitError::Count { what: "coils", expected: 1, got: 0 });
        }
        for (k, a) in coils.iter().enumerate() {
            if let Some(value) = a.centre_m.into_iter().find(|x| !x.is_finite()) {
                return Err(MitError::Value { field: "centre of a coil (m)", value, expected: "finite" });
            }
            for (n, b) in coils.iter().enumerate().skip(k + 1) {
                let between = subtract(a.centre_m, b.centre_m);
                let needed_m = a.half_width_m + b.half_width_m;
                // Round or square: apart along an axis is apart.
                if between[0].abs().max(between[1].abs()) < needed_m * (1.0 - 1e-9) && norm(between) < needed_m {
                    let distance_m = norm(between);
                    return Err(MitError::CoilsOverlap { first: k + 1, second: n + 1, distance_m, needed_m });
                }
            }
        }
        Ok(Self { coils })
    }

    /// Eight hand-wound coils of 40 mm on a 3 x 3 grid of 45 mm whose middle place stays empty, numbered row by row from the
    /// bottom left; 150 uH each. The grid's pitch and the winding (six layers of 6 turns of 0.5 mm) are assumed.
    ///
    /// # Errors
    /// None with these numbers.
    pub fn em_8() -> Result<Self, MitError> {
        let (coil, _) = Coil::solenoid([0.0; 3], 0.034, 0.0005, 6, 6)?.calibrated_to(HAND_WOUND_H)?;
        let places = (0..9).filter(|k| *k != 4).map(|k| grid(k, 3, 0.045));
        Self::new(places.map(|place| coil.clone().moved(place)).collect())
    }

    /// Sixteen printed circular spirals of 51 turns, 30 to 70 mm, 5 mm between neighbours; 155 uH each.
    ///
    /// # Errors
    /// None with these numbers.
    pub fn em_16_circular() -> Result<Self, MitError> {
        let (coil, _) = Coil::circular_spiral([0.0; 3], 0.03, 0.07, 51)?.calibrated_to(PRINTED_H[0])?;
        Self::new((0..16).map(|k| coil.clone().moved(grid(k, 4, 0.075))).collect())
    }

    /// Sixteen printed square spirals of 51 turns, 25 to 75 mm, 3 mm between neighbours; 157 uH each.
    ///
    /// # Errors
    /// None with these numbers.
    pub fn em_16_square() -> Result<Self, MitError> {
        let (coil, _) = Coil::square_spiral([0.0; 3], 0.025, 0.075, 51)?.calibrated_to(PRINTED_H[1])?;
        Self::new((0..16).map(|k| coil.clone().moved(grid(k, 4, 0.078))).collect())
    }

    /// The same array over a perfectly conducting plane at a height below it.
    pub fn with_shield(self, z_m: f64) -> Self {
        Self { coils: self.coils.into_iter().map(|coil| coil.with_shield(z_m)).collect() }
    }

    /// The coils.
    pub fn coils(&self) -> &[Coil] {
        &self.coils
    }

    /// All pairs of two coils, (0, 1), (0, 2), ... (n-2, n-1): N(N-1)/2 channels.
    pub fn pairs(&self) -> Vec<[usize; 2]> {
        let count = self.coils.len();
        (0..count).flat_map(|a| (a + 1..count).map(move |b| [a, b])).collect()
    }

    /// Mutual inductance of every pair without bodies, henries.
    pub fn mutuals_h(&self) -> Vec<f64> {
        self.pairs().iter().map(|&[a, b]| self.coils[a].mutual_h(&self.coils[b])).collect()
    }
}

/// Place `k` of a square grid, row by row from the bottom left, around the origin.
fn grid(k: usize, per_side: usize, pitch_m: f64) -> Vector {
    let at = |index: usize| (index as f64 - 0.5 * (per_side - 1) as f64) * pitch_m;
    [at(k % per_side), at(k / per_side), 0.0]
}
