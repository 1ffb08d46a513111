//! Correlations of examples by the distance between their positions, of rotated copies of examples, and of examples of
//! different sessions.

use crate::plane::squared_distance;

/// Variance of a frame about a map that is built from rotated copies, at any amplitude, relative to the map's prior
/// variance.
pub(super) const APART: f64 = 0.17;

/// Matern 5/2 correlation of two positions in metres, Rasmussen & Williams eq. 4.17.
pub(super) fn matern52(a: [f64; 2], b: [f64; 2], length_m: f64) -> f64 {
    let s = (5.0 * squared_distance(a, b)).sqrt() / length_m;
    (1.0 + s + s * s / 3.0) * (-s).exp()
}

/// Which rows of a design are rotated copies.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Copies {
    /// Number of steps each row is rotated by.
    pub(super) steps: Vec<usize>,
    pub(super) resemblance: Vec<f64>,
}

impl Copies {
    /// Factor on the correlation of two rows.
    pub(super) fn between(&self, i: usize, j: usize) -> f64 {
        let turns = self.resemblance.len();
        self.resemblance[(turns + self.steps[i] - self.steps[j]) % turns]
    }

    /// Factor on the correlation of the map with a row.
    pub(super) fn with_map(&self, i: usize) -> f64 {
        self.resemblance[self.steps[i]]
    }
}

/// The rows of a design from an earlier session, and how much its map resembles that of the new one. Both maps are
/// the sum of a common map with variance r and a map of their own with variance 1 - r, all with the same correlation
/// over the skin: rows of different sessions are correlated by the factor r.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sessions {
    pub(super) is_earlier: Vec<bool>,
    /// r, from 0 (nothing in common) to 1 (the same skin).
    pub(super) resemblance: f64,
}

impl Sessions {
    /// Factor on the correlation of two rows.
    pub(super) fn between(&self, i: usize, j: usize) -> f64 {
        if self.is_earlier[i] == self.is_earlier[j] { 1.0 } else { self.resemblance }
    }

    /// Factor on the correlation of the new session's map with a row.
    pub(super) fn with_map(&self, i: usize) -> f64 {
        if self.is_earlier[i] { self.resemblance } else { 1.0 }
    }

    /// The given rows.
    pub(super) fn subset(&self, rows: &[usize]) -> Self {
        Self { is_earlier: rows.iter().map(|&i| self.is_earlier[i]).collect(), resemblance: self.resemblance }
    }
}
