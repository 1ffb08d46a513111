//! Gain over the surface: local sensitivity of a skin relative to its average.

use faer::prelude::*;
use serde::{Deserialize, Serialize};

use crate::error::{TouchError, require, require_finite, require_length};

/// Signal at a position relative to the average position. Always positive.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum GainMap {
    /// `exp(sum c_k m_k)` with the monomials 1, x, y, x^2, xy, y^2 of positions over `scale_m`.
    Quadratic {
        /// Length by which positions are divided, metres.
        scale_m: f64,
        /// Six coefficients.
        coefficients: [f64; 6],
    },
    /// Mean of known gains, weighted by distance^-2 (Shepard).
    InverseDistance {
        /// Positions, metres.
        positions_m: Vec<[f64; 2]>,
        /// Gains at these positions.
        gains: Vec<f64>,
    },
}

impl GainMap {
    /// A smooth map fitted to measured gains (for example, slopes of signal against force), divided by their
    /// geometric mean.
    ///
    /// # Errors
    /// Different lengths, fewer than 6 positions, positions on one conic, values that are not positive and finite.
    pub fn quadratic(positions_m: &[[f64; 2]], gains: &[f64]) -> Result<Self, TouchError> {
        let gains = normalised(positions_m, gains)?;
        require(gains.len() >= 6, "places of a quadratic gain map", gains.len() as f64, "at least 6")?;
        let scale_m = positions_m.iter().flatten().map(|value| value.abs()).fold(0.0, f64::max);
        require(scale_m > 0.0, "extent of the places in m", scale_m, "above 0")?;
        let matrix = Mat::from_fn(gains.len(), 6, |row, k| monomials(positions_m[row], scale_m)[k]);
        let logarithms = Mat::from_fn(gains.len(), 1, |row, _| gains[row].ln());
        let normal = matrix.transpose() * &matrix;
        let expected = "places not all on one line, circle or other conic";
        let smallest = normal
            .self_adjoint_eigenvalues(faer::Side::Lower)
            .ok()
            .map_or(0.0, |values| values[0] / values[5].max(f64::MIN_POSITIVE));
        require(smallest > 1e-12, "spread of the places", smallest, expected)?;
        let solution = matrix.qr().solve_lstsq(logarithms);
        Ok(Self::Quadratic { scale_m, coefficients: std::array::from_fn(|k| solution[(k, 0)]) })
    }

    /// The map that interpolates the measured gains exactly, divided by their geometric mean.
    ///
    /// # Errors
    /// Different lengths, no positions, values that are not positive and finite.
    pub fn inverse_distance(positions_m: &[[f64; 2]], gains: &[f64]) -> Result<Self, TouchError> {
        let gains = normalised(positions_m, gains)?;
        Ok(Self::InverseDistance { positions_m: positions_m.to_vec(), gains })
    }

    /// Gain at a position (metres).
    #[must_use]
    pub fn gain_at(&self, position_m: [f64; 2]) -> f64 {
        match self {
            Self::Quadratic { scale_m, coefficients } => {
                let terms = monomials(position_m, *scale_m);
                terms.iter().zip(coefficients).map(|(m, c)| m * c).sum::<f64>().exp()
            }
            Self::InverseDistance { positions_m, gains } => {
                let (mut sum, mut weights) = (0.0, 0.0);
                for (place, gain) in positions_m.iter().zip(gains) {
                    let square = (place[0] - position_m[0]).powi(2) + (place[1] - position_m[1]).powi(2);
                    if square == 0.0 {
                        return *gain;
                    }
                    (sum, weights) = (sum + gain / square, weights + 1.0 / square);
                }
                sum / weights
            }
        }
    }

    /// Checks a loaded map.
    pub(super) fn check(&self) -> Result<(), TouchError> {
        match self {
            Self::Quadratic { scale_m, coefficients } => {
                require(scale_m.is_finite() && *scale_m > 0.0, "gain scale_m", *scale_m, "positive and finite")?;
                require_finite("gain coefficients", coefficients)
            }
            Self::InverseDistance { positions_m, gains } => normalised(positions_m, gains).map(|_| ()),
        }
    }
}

fn monomials([x, y]: [f64; 2], scale_m: f64) -> [f64; 6] {
    let (x, y) = (x / scale_m, y / scale_m);
    [1.0, x, y, x * x, x * y, y * y]
}

/// Checks gains and divides them by their geometric mean.
fn normalised(positions_m: &[[f64; 2]], gains: &[f64]) -> Result<Vec<f64>, TouchError> {
    require_length("gains", positions_m.len(), gains.len())?;
    require(!gains.is_empty(), "places of a gain map", 0.0, "at least 1")?;
    for gain in gains {
        require(gain.is_finite() && *gain > 0.0, "gain", *gain, "positive and finite")?;
    }
    for value in positions_m.iter().flatten() {
        require(value.is_finite(), "place of a gain in m", *value, "finite")?;
    }
    let mean = (gains.iter().map(|gain| gain.ln()).sum::<f64>() / gains.len() as f64).exp();
    Ok(gains.iter().map(|gain| gain / mean).collect())
}
