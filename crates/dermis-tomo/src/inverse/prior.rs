//! Priors: the expected image before any measurement, as `R` (inverse covariance) or its inverse.

use faer::{Mat, MatRef, Side, linalg::solvers::Solve};

use super::{InverseError, SmoothCovariance, Weighting};
use crate::mesh::Mesh;
use crate::sparse::{Ordering, SpdStructure};

/// Positions and adjacency of the unknowns.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageBasis {
    /// Centres, metres.
    pub positions: Vec<[f64; 3]>,
    /// Pairs of unknowns that share a face (elements) or a side (pixels).
    pub neighbours: Vec<[u32; 2]>,
}

impl ImageBasis {
    /// One unknown per element.
    pub fn of_elements(mesh: &Mesh) -> Self {
        let positions = (0..mesh.element_count()).map(|element| mesh.centroid(element)).collect();
        Self { positions, neighbours: mesh.neighbours() }
    }

    /// Number of unknowns.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// True if there are no unknowns.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }
}

/// Maximum nesting of mixtures. Copying, printing and building a prior recurse, so deeper ones are refused.
pub const MOST_NESTED: usize = 16;

/// Common regularisation matrices.
#[derive(Clone, Debug, PartialEq)]
pub enum Prior {
    /// `R = I` (zeroth-order Tikhonov).
    Identity,
    /// Twice the graph Laplacian over shared faces: `R[a,a] += 2, R[b,b] += 2, R[a,b] -= 2` (EIDORS `prior_laplace`).
    Laplace,
    /// `R = diag(J'J)^exponent` (Cheney et al., Int. J. Imaging Syst. Technol. 2, 1990; EIDORS uses exponent 0.5).
    Noser {
        /// 0.5 is customary; 0 gives the identity, 1 fully balances sensitivity.
        exponent: f64,
    },
    /// Gaussian smoothness: covariance `exp(-d^2 / (2 l^2))` between unknowns at distance d; `R` is its inverse.
    Gaussian {
        /// Correlation length l, metres.
        correlation_length_m: f64,
    },
    /// Gaussian smoothness balanced by sensitivity: covariance `D^-1/2 K D^-1/2` with `D = diag(J'WJ)^exponent`,
    /// scaled to mean 1, and K as in [`Prior::Gaussian`]. This is NOSER, smoothed. Sensitivities have a floor, so that
    /// regions which hardly any channel sees stay dark: a thousandth of the mean, and 0.7 of the 5 % quantile.
    GaussianNoser {
        /// Correlation length, metres.
        correlation_length_m: f64,
        /// NOSER exponent.
        exponent: f64,
    },
    /// Weighted sum of the matrices of other priors.
    Mixture(Vec<(f64, Prior)>),
}

/// A prior evaluated for a Jacobian and a basis.
#[derive(Debug, Clone)]
pub enum PriorMatrix {
    /// Diagonal of R.
    Diagonal(Vec<f64>),
    /// Lower-triangle entries of a sparse R: (row, column, value); repeated entries add up.
    Sparse {
        /// Number of unknowns.
        size: usize,
        /// The entries.
        entries: Vec<(u32, u32, f64)>,
        /// Centres, used for the elimination order.
        positions: Vec<[f64; 3]>,
    },
    /// The covariance, `R^-1`.
    Covariance(SmoothCovariance),
    /// R itself, dense.
    Dense(Mat<f64>),
}

impl Prior {
    /// True if mixtures are nested at most this deep.
    fn is_within(&self, depth: usize) -> bool {
        match self {
            Prior::Mixture(parts) => depth > 0 && parts.iter().all(|(_, part)| part.is_within(depth - 1)),
            _ => true,
        }
    }

    /// Builds R (or its inverse) for a Jacobian (channels x unknowns).
    ///
    /// # Errors
    /// Fails if the basis and the Jacobian differ in size, a length or weight is not positive and finite, or the
    /// Gaussian part of a mixture cannot be inverted.
    pub fn matrix(
        &self,
        jacobian: MatRef<'_, f64>,
        weighting: &Weighting,
        basis: &ImageBasis,
    ) -> Result<PriorMatrix, InverseError> {
        let size = jacobian.ncols();
        if !self.is_within(MOST_NESTED) {
            return Err(InverseError::Nested { most: MOST_NESTED });
        }
        if basis.len() != size {
            return Err(InverseError::Size { what: "unknowns of the image basis", expected: size, got: basis.len() });
        }
        match self {
            Prior::Identity => Ok(PriorMatrix::Diagonal(vec![1.0; size])),
            Prior::Noser { exponent } => Ok(PriorMatrix::Diagonal(noser(jacobian, *exponent)?)),
            Prior::Laplace => Ok(laplace(basis)),
            Prior::Gaussian { correlation_length_m } => {
                Ok(PriorMatrix::Covariance(SmoothCovariance::new(&basis.positions, *correlation_length_m, None)?))
            }
            Prior::GaussianNoser { correlation_length_m, exponent } => {
                weighting.check(jacobian.nrows())?;
                let diagonal = match weighting {
                    Weighting::Full(_) => {
                        let mut whitened = jacobian.to_owned();
                        weighting.whiten(whitened.as_mut());
                        balance(whitened.as_ref(), None, *exponent)?
                    }
                    // Avoids a copy of the Jacobian, which would be among the largest objects in memory.
                    Weighting::Diagonal(weights) => balance(jacobian, Some(weights), *exponent)?,
                    Weighting::Identity => balance(jacobian, None, *exponent)?,
                };
                let mean = diagonal.iter().sum::<f64>() / size as f64;
                let scale = diagonal.iter().map(|d| (mean / d).sqrt()).collect();
                let covariance = SmoothCovariance::new(&basis.positions, *correlation_length_m, Some(scale))?;
                Ok(PriorMatrix::Covariance(covariance))
            }
            Prior::Mixture(parts) => mixture(parts, jacobian, weighting, basis),
        }
    }
}

/// Minimum sensitivity `(J'WJ)_kk` that [`Prior::GaussianNoser`] balances, relative to the mean. Pixels over pads and
/// outside them are hardly seen; permitting correspondingly large values there would let noise and model error fill
/// them.
const VISIBILITY_FLOOR: f64 = 1e-3;
/// Minimum relative to the sensitivity that this share of the pixels falls below. Corners far from electrodes would
/// otherwise be brighter than a press: with 8 electrodes on squares and rectangles, they were up to eight times as
/// bright. The centre of a disc, which also sees little, is above it.
const LEAST_VISIBLE: f64 = 0.7;
const HARDLY_SEEN: f64 = 0.05;

/// `diag(J'WJ)^exponent` for a diagonal W or none, with the sensitivity limited to these floors.
fn balance(jacobian: MatRef<'_, f64>, weights: Option<&[f64]>, exponent: f64) -> Result<Vec<f64>, InverseError> {
    check_exponent(exponent)?;
    let sensitivity = visible(sensitivity(jacobian, weights));
    let floor = VISIBILITY_FLOOR * sensitivity.iter().sum::<f64>() / sensitivity.len().max(1) as f64;
    let mut sorted = sensitivity.clone();
    sorted.sort_unstable_by(f64::total_cmp);
    let hardly_seen = sorted.get((HARDLY_SEEN * sorted.len() as f64) as usize).copied().unwrap_or(0.0);
    let least = floor.max(LEAST_VISIBLE * hardly_seen);
    Ok(sensitivity.into_iter().map(|d| d.max(least).powf(exponent)).collect())
}

fn check_exponent(exponent: f64) -> Result<(), InverseError> {
    if !(0.0..=2.0).contains(&exponent) {
        return Err(InverseError::Value { what: "NOSER exponent", index: None, value: exponent, expected: "0 to 2" });
    }
    Ok(())
}

fn noser(jacobian: MatRef<'_, f64>, exponent: f64) -> Result<Vec<f64>, InverseError> {
    check_exponent(exponent)?;
    Ok(visible(sensitivity(jacobian, None).into_iter().map(|value| value.powf(exponent)).collect()))
}

/// `diag(J'WJ)`, where W is the identity or diagonal.
fn sensitivity(jacobian: MatRef<'_, f64>, weights: Option<&[f64]>) -> Vec<f64> {
    let mut diagonal = vec![0.0; jacobian.ncols()];
    for (channel, row) in jacobian.row_iter().enumerate() {
        let root = weights.map_or(1.0, |weights| weights[channel].sqrt());
        diagonal.iter_mut().zip(row.iter()).for_each(|(sum, value)| *sum += (root * value) * (root * value));
    }
    diagonal
}

/// An unknown that no channel sees would have no prior; it gets the value of the least visible unknown.
fn visible(diagonal: Vec<f64>) -> Vec<f64> {
    let largest = diagonal.iter().copied().fold(0.0, f64::max);
    diagonal.into_iter().map(|d| if d > 1e-12 * largest { d } else { 1e-12 * largest.max(1e-300) }).collect()
}

fn laplace(basis: &ImageBasis) -> PriorMatrix {
    let entries =
        basis.neighbours.iter().flat_map(|&[a, b]| [(a, a, 2.0), (b, b, 2.0), (a.max(b), a.min(b), -2.0)]).collect();
    PriorMatrix::Sparse { size: basis.len(), entries, positions: basis.positions.clone() }
}

fn mixture(
    parts: &[(f64, Prior)],
    jacobian: MatRef<'_, f64>,
    weighting: &Weighting,
    basis: &ImageBasis,
) -> Result<PriorMatrix, InverseError> {
    let size = basis.len();
    let mut diagonal = vec![0.0; size];
    let mut sparse = Vec::new();
    let mut dense: Option<Mat<f64>> = None;
    if parts.is_empty() {
        return Err(InverseError::Size { what: "parts of the prior mixture", expected: 1, got: 0 });
    }
    for (index, (weight, prior)) in parts.iter().enumerate() {
        if !(*weight > 0.0 && weight.is_finite()) {
            return Err(InverseError::Value {
                what: "weight of mixture part",
                index: Some(index),
                value: *weight,
                expected: "positive and finite",
            });
        }
        match prior.matrix(jacobian, weighting, basis)? {
            PriorMatrix::Diagonal(values) => {
                diagonal.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value)
            }
            PriorMatrix::Sparse { entries, .. } => {
                sparse.extend(entries.into_iter().map(|(row, column, value)| (row, column, weight * value)))
            }
            matrix @ (PriorMatrix::Covariance(_) | PriorMatrix::Dense(_)) => {
                let part = matrix.dense()?;
                let sum = dense.get_or_insert_with(|| Mat::zeros(size, size));
                *sum += faer::Scale(*weight) * &part;
            }
        }
    }
    if let Some(mut sum) = dense {
        for (k, value) in diagonal.iter().enumerate() {
            sum[(k, k)] += value;
        }
        for (row, column, value) in sparse {
            sum[(row as usize, column as usize)] += value;
            if row != column {
                sum[(column as usize, row as usize)] += value;
            }
        }
        return Ok(PriorMatrix::Dense(sum));
    }
    if sparse.is_empty() {
        return Ok(PriorMatrix::Diagonal(diagonal));
    }
    sparse.extend(diagonal.iter().enumerate().filter(|(_, v)| **v != 0.0).map(|(k, v)| (k as u32, k as u32, *v)));
    Ok(PriorMatrix::Sparse { size, entries: sparse, positions: basis.positions.clone() })
}

/// Relative ridge on the diagonal of a sparse R before its inversion: the Laplacian alone does not see constants.
/// Small enough to change images by less than 1e-5, large enough for the factorisation.
const SPARSE_RIDGE: f64 = 1e-6;
/// Relative ridge on a Gaussian covariance before its inversion, because its smallest eigenvalues underflow.
const COVARIANCE_JITTER: f64 = 1e-6;

impl PriorMatrix {
    /// Number of unknowns.
    pub fn size(&self) -> usize {
        match self {
            PriorMatrix::Diagonal(values) => values.len(),
            PriorMatrix::Sparse { size, .. } => *size,
            PriorMatrix::Covariance(covariance) => covariance.len(),
            PriorMatrix::Dense(matrix) => matrix.nrows(),
        }
    }

    /// True if R has a null space, so that only the model form is exact.
    pub fn is_singular(&self) -> bool {
        match self {
            PriorMatrix::Sparse { size, entries, .. } => {
                let mut sums = vec![0.0; *size];
                let mut largest: f64 = 0.0;
                for &(row, column, value) in entries {
                    sums[row as usize] += value;
                    if row != column {
                        sums[column as usize] += value;
                    }
                    largest = largest.max(value.abs());
                }
                sums.iter().all(|sum| sum.abs() < 1e-9 * largest)
            }
            _ => false,
        }
    }

    /// R as a dense matrix.
    ///
    /// # Errors
    /// A covariance that cannot be inverted.
    pub fn dense(&self) -> Result<Mat<f64>, InverseError> {
        Ok(match self {
            PriorMatrix::Diagonal(values) => {
                Mat::from_fn(values.len(), values.len(), |r, c| if r == c { values[r] } else { 0.0 })
            }
            PriorMatrix::Sparse { size, entries, .. } => {
                let mut matrix = Mat::zeros(*size, *size);
                for &(row, column, value) in entries {
                    matrix[(row as usize, column as usize)] += value;
                    if row != column {
                        matrix[(column as usize, row as usize)] += value;
                    }
                }
                matrix
            }
            PriorMatrix::Dense(matrix) => matrix.clone(),
            PriorMatrix::Covariance(covariance) => {
                let mut jittered = covariance.dense();
                for k in 0..jittered.nrows() {
                    jittered[(k, k)] *= 1.0 + COVARIANCE_JITTER;
                }
                let factor = jittered.llt(Side::Lower).map_err(|_| InverseError::Singular {
                    what: "the Gaussian prior's covariance",
                    hint: "shorten the correlation length or use the data-space form",
                })?;
                factor.solve(Mat::<f64>::identity(jittered.nrows(), jittered.nrows()))
            }
        })
    }

    /// `R^-1 B` for B (unknowns x any number of columns). A singular sparse R gets a ridge of 1e-6 of its mean
    /// diagonal.
    ///
    /// # Errors
    /// R is not positive definite.
    pub fn solve(&self, b: MatRef<'_, f64>) -> Result<Mat<f64>, InverseError> {
        let singular =
            |_| InverseError::Singular { what: "the prior", hint: "add some identity or NOSER to the mixture" };
        Ok(match self {
            PriorMatrix::Diagonal(values) => {
                let mut x = b.to_owned();
                for column in x.col_iter_mut() {
                    column.iter_mut().zip(values).for_each(|(entry, value)| *entry /= value);
                }
                x
            }
            PriorMatrix::Covariance(covariance) => covariance.times(b),
            PriorMatrix::Dense(matrix) => {
                let factor = matrix.llt(Side::Lower).map_err(|_| singular(()))?;
                factor.solve(b)
            }
            PriorMatrix::Sparse { size, entries, positions } => {
                let keys: Vec<(u32, u32)> = entries.iter().map(|&(row, column, _)| (row, column)).collect();
                let (structure, slots) =
                    SpdStructure::new(*size, &keys, Ordering::Dissection(positions)).map_err(|_| singular(()))?;
                let mut values = vec![0.0; structure.value_count()];
                for (slot, entry) in slots.iter().zip(entries) {
                    values[*slot as usize] += entry.2;
                }
                if self.is_singular() {
                    let trace: f64 = entries.iter().filter(|e| e.0 == e.1).map(|e| e.2).sum();
                    structure.add_to_diagonal(&mut values, SPARSE_RIDGE * trace / *size as f64);
                }
                let factor = structure.factor(&values).map_err(|_| singular(()))?;
                let mut x = b.to_owned();
                structure.solve_in_place(&factor, x.as_mut());
                x
            }
        })
    }
}
