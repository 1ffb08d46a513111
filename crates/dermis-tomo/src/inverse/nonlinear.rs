//! Gauss-Newton for large contrasts, in `y = log(sigma / sigma_rest)` on pixels. Conductivity stays positive, and an
//! insulator and a metal are equally far from rest. With the forward model `F(y)`, `J = dF/dy` at the iterate, and
//! the prior's covariance `P = R^-1` and lambda fixed, every step solves the linearised problem (Tarantola, Inverse
//! Problem Theory, 2005, eq. 3.51): `y+ = P J'(J P J' + lambda^2 W^-1)^-1 (dv - F(y) + F(0) + J y)`.
//!
//! Channels are never handled one by one. Every voltage is a combination `v = B u` of the L(L-1)/2 transfer
//! impedances u between neighbouring pairs of the L electrodes (reciprocity makes the others equal). With
//! `B'WB = Q e Q'`, `e^1/2 Q'` can replace `W^1/2 B` and gives the same normal equations. For example, 2356 channels
//! of 32 electrodes become 496 rows without loss.
//!
//! Pixels are not handled one by one either if the prior is smooth: with `P = U U'` of few columns (pivoted Cholesky)
//! the step is `y+ = U (U'J'J U + lambda^2)^-1 U'J' b`, over those columns alone.

use faer::{ColRef, Mat, Side, linalg::solvers::Solve};

use super::error::positive;
use super::{InverseError, PriorMatrix, SmoothCovariance, Weighting};
use crate::eit::{EitError, ForwardModel, Jacobian, Pattern, Protocol, ProtocolError};
use crate::mesh::{ElectrodedMesh, PixelMap};

/// Directions of `B'WB` below this share of the largest eigenvalue are rounding noise.
const SMALLEST_EIGENVALUE: f64 = 1e-10;

/// Maximum share of the largest prior variance that the factor of a smooth prior may neglect at any pixel.
const NEGLECTED: f64 = 1e-9;

/// Parameters of the iteration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaussNewton {
    /// Number of steps, at least 1; the first gives the linear image.
    pub steps: usize,
    /// lambda, the same for all steps.
    pub hyperparameter: f64,
    /// Maximum change of any pixel in one step (in log conductivity); a larger step is shortened as a whole.
    pub largest_step: f64,
    /// Pixels are clamped to plus and minus this log conductivity.
    pub limit: f64,
}

impl GaussNewton {
    /// The usual limits: steps of at most 1.5, pixels within 3 (factors of 4.5 and 20 in conductivity).
    pub fn new(steps: usize, hyperparameter: f64) -> Self {
        Self { steps, hyperparameter, largest_step: 1.5, limit: 3.0 }
    }

    pub(super) fn check(&self) -> Result<(), InverseError> {
        for (what, value) in [
            ("Gauss-Newton steps", self.steps as f64),
            ("hyperparameter", self.hyperparameter),
            ("largest Gauss-Newton step", self.largest_step),
            ("limit of the log conductivity", self.limit),
        ] {
            positive(what, value)?;
        }
        Ok(())
    }
}

/// Result of the iteration.
#[derive(Clone, Debug, PartialEq)]
pub struct GaussNewtonResult {
    /// `log(sigma / sigma_rest)` of every inside pixel.
    pub log_conductivity: Vec<f64>,
    /// Norm of the whitened data that is unexplained at the start of each step; the first is the norm of the data
    /// themselves.
    pub residuals: Vec<f64>,
}

/// A forward model with weights and prior, for inversion frame by frame.
#[derive(Debug)]
pub struct NonlinearProblem {
    pub(super) model: ForwardModel,
    pub(super) map: PixelMap,
    rest_conductivity: f64,
    weighting: Weighting,
    prior: FactoredPrior,
    /// B: channels x transfer impedances.
    combination: Mat<f64>,
    pub(super) at_rest: Linearisation,
}

/// The prior in the form used by the steps.
#[derive(Debug)]
struct FactoredPrior {
    matrix: PriorMatrix,
    /// U with `P = U U'`, unknowns x rank, if the rank is low.
    factor: Option<Mat<f64>>,
}

/// Weighted data of a set of channels, reduced to one row per independent transfer impedance.
#[derive(Clone, Debug)]
pub struct ReducedChannels {
    /// `e^-1/2 Q' B'W`, rows x channels; zero for missing channels.
    project: Mat<f64>,
    /// `e^1/2 Q'`: rows x transfer impedances.
    pub(super) combine: Mat<f64>,
}

/// Transfer impedances and their derivative with respect to log conductivity.
#[derive(Debug)]
pub(super) struct Linearisation {
    pub(super) transfers: Vec<f64>,
    jacobian: Jacobian,
    /// `J U` for a smooth prior.
    along_prior: Option<Mat<f64>>,
}

impl NonlinearProblem {
    /// Combines the parts. `rest_conductivity` is uniform, in S/m (S for sheets); `map` belongs to the mesh of
    /// `body`; the prior is over the inside pixels, for relative changes of conductivity; frames will have the
    /// channels of `protocol`.
    ///
    /// # Errors
    /// Mismatched sizes, or a body that cannot be solved.
    pub fn new(
        body: ElectrodedMesh,
        protocol: &Protocol,
        map: &PixelMap,
        rest_conductivity: f64,
        weighting: &Weighting,
        prior: &PriorMatrix,
    ) -> Result<Self, InverseError> {
        weighting.check(protocol.channel_count())?;
        if prior.size() != map.inside_count() {
            return Err(InverseError::Size {
                what: "size of the prior",
                expected: map.inside_count(),
                got: prior.size(),
            });
        }
        if map.element_count() != body.mesh.element_count() {
            return Err(InverseError::Size {
                what: "elements of the pixel map",
                expected: body.mesh.element_count(),
                got: map.element_count(),
            });
        }
        let electrodes = body.electrodes.len();
        if protocol.electrode_count() != electrodes || electrodes < 2 {
            return Err(EitError::ElectrodeCount { mesh: electrodes, protocol: protocol.electrode_count() }.into());
        }
        let transfers = transfer_protocol(electrodes)
            .map_err(|_| EitError::ElectrodeCount { mesh: electrodes, protocol: protocol.electrode_count() })?;
        let model = ForwardModel::new(body, transfers)?;
        let prior = FactoredPrior::new(prior);
        let at_rest = linearise(&model, map, &prior, &vec![rest_conductivity; map.element_count()])?;
        let combination = combination(protocol);
        let (map, weighting) = (map.clone(), weighting.clone());
        Ok(Self { model, map, rest_conductivity, weighting, prior, combination, at_rest })
    }

    /// Prepares the data side without the missing channels (in any order), once for all frames that lack the same
    /// ones.
    ///
    /// # Errors
    /// A channel that does not exist, all channels missing, or an eigenvalue iteration that does not converge.
    pub fn reduce(&self, missing: &[u32]) -> Result<ReducedChannels, InverseError> {
        let channels = self.combination.nrows();
        if let Some(&channel) = missing.iter().find(|&&channel| channel as usize >= channels) {
            return Err(InverseError::Size {
                what: "missing channel index",
                expected: channels,
                got: channel as usize,
            });
        }
        let present: Vec<usize> = (0..channels).filter(|&channel| !missing.contains(&(channel as u32))).collect();
        if present.is_empty() {
            return Err(InverseError::NoChannels { channels });
        }
        let weighting = self.weighting.of_channels(&present)?;
        let mut whitened = Mat::from_fn(present.len(), self.combination.ncols(), |row, column| {
            self.combination[(present[row], column)]
        });
        weighting.whiten(whitened.as_mut());
        let normal = whitened.transpose() * &whitened;
        let decomposition = normal.self_adjoint_eigen(Side::Lower).map_err(|_| InverseError::Singular {
            what: "the matrix of the transfer impedances (its eigenvalues were not found)",
            hint: "look for channels of vastly different scale",
        })?;
        let (values, vectors) = (decomposition.S().column_vector(), decomposition.U());
        let largest = values.iter().copied().fold(0.0, f64::max);
        let kept: Vec<usize> = (0..values.nrows()).filter(|&k| values[k] > SMALLEST_EIGENVALUE * largest).collect();
        let combine = Mat::from_fn(kept.len(), vectors.nrows(), |row, column| {
            values[kept[row]].sqrt() * vectors[(column, kept[row])]
        });
        let scaled = Mat::from_fn(vectors.nrows(), kept.len(), |row, column| {
            vectors[(row, kept[column])] / values[kept[column]].sqrt()
        });
        let mut columns = &whitened * &scaled;
        weighting.whiten_adjoint(columns.as_mut());
        let mut project = Mat::zeros(kept.len(), channels);
        for (row, &channel) in present.iter().enumerate() {
            for k in 0..kept.len() {
                project[(k, channel)] = columns[(row, k)];
            }
        }
        Ok(ReducedChannels { project, combine })
    }

    /// Inverts one frame of difference data (volts of the model; missing channels may have any value, including
    /// `NaN`). `step_done` is called with the number of completed steps.
    ///
    /// # Errors
    /// Parameters that are not positive, a frame of the wrong length or with non-finite values in channels that are
    /// present, or a forward problem that cannot be solved.
    pub fn solve(
        &self,
        parameters: &GaussNewton,
        channels: &ReducedChannels,
        dv: &[f64],
        mut step_done: impl FnMut(usize),
    ) -> Result<GaussNewtonResult, InverseError> {
        parameters.check()?;
        let data = channels.data(dv)?;
        let mut image = vec![0.0; self.map.inside_count()];
        let mut residuals = Vec::with_capacity(parameters.steps);
        for step in 0..parameters.steps {
            let moved;
            let here = if step == 0 {
                &self.at_rest
            } else {
                moved = linearise(&self.model, &self.map, &self.prior, &self.conductivity(&image))?;
                &moved
            };
            let change: Vec<f64> =
                here.transfers.iter().zip(&self.at_rest.transfers).map(|(u, rest)| u - rest).collect();
            let left = data.as_ref() - &channels.combine * ColRef::from_slice(&change);
            residuals.push(left.norm_l2());
            let target = left + &channels.combine * (here.jacobian.as_mat() * ColRef::from_slice(&image));
            let next = self.step(here, channels, target, parameters.hyperparameter)?;
            advance(&mut image, &next, parameters);
            step_done(step + 1);
        }
        Ok(GaussNewtonResult { log_conductivity: image, residuals })
    }

    /// `P A'(A P A' + lambda^2)^-1 b`, where A is the Jacobian of the reduced channels.
    fn step(
        &self,
        here: &Linearisation,
        channels: &ReducedChannels,
        b: faer::Col<f64>,
        lambda: f64,
    ) -> Result<Vec<f64>, InverseError> {
        let solved = |mut system: Mat<f64>, b: &faer::Col<f64>| {
            for k in 0..system.nrows() {
                system[(k, k)] += lambda * lambda;
            }
            let factor = system.llt(Side::Lower).map_err(|_| InverseError::Singular {
                what: "the system of a Gauss-Newton step",
                hint: "raise the hyperparameter",
            })?;
            Ok::<_, InverseError>(factor.solve(b))
        };
        let step = if let (Some(factor), Some(along)) = (&self.prior.factor, &here.along_prior) {
            let a = &channels.combine * along;
            factor * solved(a.transpose() * &a, &(a.transpose() * &b))?
        } else {
            let a = &channels.combine * here.jacobian.as_mat();
            let spread = self.prior.matrix.solve(a.transpose())?;
            &spread * solved(&a * &spread, &b)?
        };
        Ok(step.iter().copied().collect())
    }

    pub(super) fn conductivity(&self, log_conductivity: &[f64]) -> Vec<f64> {
        (0..self.map.element_count())
            .map(|element| {
                let mean: f64 =
                    self.map.overlaps_of_element(element).map(|(p, share)| share * log_conductivity[p]).sum();
                self.rest_conductivity * mean.exp()
            })
            .collect()
    }
}

impl ReducedChannels {
    pub(super) fn data(&self, dv: &[f64]) -> Result<faer::Col<f64>, InverseError> {
        if dv.len() != self.project.ncols() {
            return Err(InverseError::Size {
                what: "channels of the frame",
                expected: self.project.ncols(),
                got: dv.len(),
            });
        }
        let mut sum = faer::Col::zeros(self.project.nrows());
        for (channel, &value) in dv.iter().enumerate() {
            let column = self.project.col(channel);
            if value.is_finite() {
                sum.iter_mut().zip(column.iter()).for_each(|(sum, weight)| *sum += weight * value);
            } else if column.iter().any(|weight| *weight != 0.0) {
                return Err(InverseError::Value { what: "channel", index: Some(channel), value, expected: "finite" });
            }
        }
        Ok(sum)
    }
}

/// Moves towards `next` as far as allowed and returns the share of the step taken.
pub(super) fn advance(image: &mut [f64], next: &[f64], parameters: &GaussNewton) -> f64 {
    let largest = image.iter().zip(next).map(|(old, new)| (new - old).abs()).fold(0.0, f64::max);
    let share = if largest > parameters.largest_step { parameters.largest_step / largest } else { 1.0 };
    for (old, new) in image.iter_mut().zip(next) {
        *old = (*old + share * (new - *old)).clamp(-parameters.limit, parameters.limit);
    }
    share
}

fn linearise(
    model: &ForwardModel,
    map: &PixelMap,
    prior: &FactoredPrior,
    conductivity: &[f64],
) -> Result<Linearisation, EitError> {
    let solution = model.solve(conductivity)?;
    let jacobian = log_jacobian(&solution.jacobian(), map, conductivity);
    let along_prior = prior.factor.as_ref().map(|factor| jacobian.as_mat() * factor);
    Ok(Linearisation { transfers: solution.voltages(), jacobian, along_prior })
}

impl FactoredPrior {
    fn new(matrix: &PriorMatrix) -> Self {
        let factor = match matrix {
            PriorMatrix::Covariance(covariance) => pivoted_cholesky(covariance, NEGLECTED),
            _ => None,
        };
        Self { matrix: matrix.clone(), factor }
    }
}

/// U such that `U U'` equals the covariance, except for a neglected share of the largest variance in each variance.
/// `None` if that takes more than half as many columns as rows (Higham, Wiley Interdiscip. Rev. Comput. Stat. 1,
/// 2009, algorithm 3).
pub(super) fn pivoted_cholesky(covariance: &SmoothCovariance, neglected: f64) -> Option<Mat<f64>> {
    let size = covariance.len();
    let mut left: Vec<f64> = (0..size).map(|k| covariance.variance(k)).collect();
    let enough = neglected * left.iter().copied().fold(0.0, f64::max);
    let mut columns: Vec<Vec<f64>> = Vec::new();
    loop {
        let (pivot, &variance) = left.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
        if variance <= enough {
            break;
        }
        if columns.len() == size / 2 {
            return None;
        }
        let mut column = covariance.column(pivot);
        for earlier in &columns {
            let share = earlier[pivot];
            column.iter_mut().zip(earlier).for_each(|(value, part)| *value -= share * part);
        }
        let scale = variance.sqrt().recip();
        for (value, left) in column.iter_mut().zip(&mut left) {
            *value *= scale;
            *left -= *value * *value;
        }
        left[pivot] = 0.0;
        columns.push(column);
    }
    Some(Mat::from_fn(size, columns.len(), |row, column| columns[column][row]))
}

/// Converts `du/dsigma` of elements to `du/dy` of pixels: `dsigma/dy = sigma`, and an element's y is the mean of its
/// pixels' y weighted by overlap.
pub(super) fn log_jacobian(of_elements: &Jacobian, map: &PixelMap, conductivity: &[f64]) -> Jacobian {
    let (rows, columns) = (of_elements.rows, map.inside_count());
    let mut values = vec![0.0; rows * columns];
    for (row, target) in values.chunks_exact_mut(columns).enumerate() {
        for (element, (value, sigma)) in of_elements.row(row).iter().zip(conductivity).enumerate() {
            for (pixel, share) in map.overlaps_of_element(element) {
                target[pixel] += share * sigma * value;
            }
        }
    }
    Jacobian { rows, columns, values }
}

/// One ampere through every neighbouring pair (k, k+1) except the last, read at that pair and all later ones.
fn transfer_protocol(electrodes: usize) -> Result<Protocol, ProtocolError> {
    let pairs: Vec<Pattern> = (1..electrodes as u32).map(|k| Pattern::pair(k - 1, k, 1.0)).collect();
    let channels = transfer_pairs(pairs.len()).map(|(drive, read)| (pairs[read].clone(), drive)).collect();
    Protocol::from_patterns(electrodes, pairs.clone(), channels)
}

fn transfer_pairs(pairs: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..pairs).flat_map(move |a| (a..pairs).map(move |b| (a, b)))
}

/// B: every channel as a combination of the transfer impedances.
fn combination(protocol: &Protocol) -> Mat<f64> {
    let pairs = protocol.electrode_count() - 1;
    let stimulations: Vec<Vec<f64>> = protocol.stimulations().iter().map(|p| in_pairs(p, pairs)).collect();
    let patterns: Vec<Vec<f64>> = protocol.patterns().iter().map(|p| in_pairs(p, pairs)).collect();
    let mut combination = Mat::zeros(protocol.channel_count(), pairs * (pairs + 1) / 2);
    for (row, channel) in protocol.measurements().iter().enumerate() {
        let (drive, read) = (&stimulations[channel.stimulation as usize], &patterns[channel.pattern as usize]);
        for (column, (a, b)) in transfer_pairs(pairs).enumerate() {
            let mirrored = if a == b { 0.0 } else { drive[b] * read[a] };
            combination[(row, column)] = drive[a] * read[b] + mirrored;
        }
    }
    combination
}

/// Coefficients of a pattern (minus its mean over all electrodes) in the pairs e_k - e_(k+1): its running sum.
fn in_pairs(pattern: &Pattern, pairs: usize) -> Vec<f64> {
    let mean = pattern.sum() / (pairs + 1) as f64;
    let mut dense = vec![-mean; pairs + 1];
    for &(electrode, weight) in pattern.entries() {
        dense[electrode as usize] += weight;
    }
    let mut sum = 0.0;
    dense[..pairs]
        .iter()
        .map(|weight| {
            sum += weight;
            sum
        })
        .collect()
}

impl Weighting {
    /// The weights of a subset of the channels; for a full covariance, those of its block.
    fn of_channels(&self, chosen: &[usize]) -> Result<Weighting, InverseError> {
        Ok(match self {
            Weighting::Identity => Weighting::Identity,
            Weighting::Diagonal(weights) => {
                Weighting::Diagonal(chosen.iter().map(|&channel| weights[channel]).collect())
            }
            Weighting::Full(factor) => {
                let rows = Mat::from_fn(chosen.len(), factor.ncols(), |row, column| {
                    // Only the lower triangle belongs to the factor.
                    if column <= chosen[row] { factor[(chosen[row], column)] } else { 0.0 }
                });
                Weighting::from_covariance((&rows * rows.transpose()).as_ref())?
            }
        })
    }
}

#[cfg(test)]
mod tests;
