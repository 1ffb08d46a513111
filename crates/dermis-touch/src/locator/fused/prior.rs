//! Prior information from a calibration of another skin of the family: the covariance between channels, the map
//! itself, and the effect of rotation on the channels.

use faer::linalg::solvers::Solve;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Mat, Par, Side};

use super::model::FusedLocator;
use crate::locator::data::SignatureMap;
use crate::locator::design::nearest;
use crate::locator::error::LocatorError;
use crate::locator::turn::Turn;

/// A sister's calibration in the coordinates of the channels.
#[derive(Debug, Clone)]
pub(super) struct Sister {
    /// True if its frames were companded; its covariance is valid only for the same form.
    pub companded: bool,
    /// Covariance between channels.
    pub covariance: Mat<f64>,
    /// Rotations under which it looks the same, if any.
    pub turn: Option<Turn>,
    positions_m: Vec<[f64; 2]>,
    /// Signatures: channels by positions.
    signatures: Mat<f64>,
}

impl Sister {
    /// Undoes the whitening of a fitted locator. Searches for rotations only if `wanted`.
    pub(super) fn new(other: &FusedLocator, wanted: bool) -> Result<Self, LocatorError> {
        let state = &other.state.forward.state;
        let (rank, channels) = (state.rank, state.weights.len());
        let transform = Mat::from_fn(rank, channels, |r, k| f64::from(state.transform[r * channels + k]));
        let coloured = if rank == channels {
            let mut inverse = Mat::<f64>::identity(rank, rank);
            solve_lower_triangular_in_place(transform.as_ref(), inverse.as_mut(), Par::Seq);
            inverse
        } else {
            let gram = &transform * transform.transpose();
            let factor =
                gram.llt(Side::Lower).map_err(|_| LocatorError::Singular { what: "transform of the prior" })?;
            factor.solve(&transform).transpose().to_owned()
        };
        let whitened = Mat::from_fn(rank, state.positions_m.len(), |r, p| f64::from(state.signatures[p * rank + r]));
        let mut sister = Self {
            companded: other.state.features.companded,
            covariance: &coloured * coloured.transpose(),
            positions_m: state.positions_m.clone(),
            signatures: &coloured * &whitened,
            turn: None,
        };
        if wanted {
            sister.turn = Turn::find(channels, &state.positions_m, |places| sister.map_at(places))?;
        }
        Ok(sister)
    }

    /// Its signatures at other positions.
    pub(super) fn map_at(&self, positions_m: &[[f64; 2]]) -> Result<SignatureMap, LocatorError> {
        let channels = self.signatures.nrows();
        let mut signatures = vec![0.0; channels * positions_m.len()];
        for (p, row) in positions_m.iter().zip(signatures.chunks_exact_mut(channels)) {
            for (q, share) in nearest(&self.positions_m, *p) {
                for k in 0..channels {
                    row[k] += share * self.signatures[(k, q)];
                }
            }
        }
        SignatureMap::new(channels, positions_m.to_vec(), signatures)
    }
}
