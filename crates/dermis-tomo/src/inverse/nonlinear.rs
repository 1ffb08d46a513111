//! Gauss-Newton for large contrasts, in `y = log(sigma / sigma_rest)` on pixels: conductivity stays positive, and an
//! insulator and a metal are equally far from rest. With `F(y)` the forward model, `J = dF/dy` at the iterate and the
//! prior's covariance `P = R^-1` and lambda held fixed, every step solves the linearised problem anew (Tarantola,
//! Inverse Problem Theory, 2005, eq. 3.51): `y+ = P J'(J P J' + lambda^2 W^-1)^-1 (dv - F(y) + F(0) + J y)`.
//!
//! Channels are never handled singly. With one current pattern after another made of neighbouring pairs, every voltage
//! is a combination `v = B u` of the L(L-1)/2 transfer impedances u between neighbouring pairs of L electrodes
//! (reciprocity makes the others equal). `B'WB = Q e Q'` then gives `e^1/2 Q'` for `W^1/2 B` with the same normal
//! equations, so that 2356 channels of 32 electrodes are 496 rows and nothing is lost.
//!
//! Nor are pixels, where the prior is smooth: with `P = U U'` of few columns (pivoted Cholesky) the step is
//! `y+ = U (U'J'J U + lambda^2)^-1 U'J' b`, over those columns alone.

use faer::{ColRef, Mat, Side, linalg::solvers::Solve};

use super::check::positive;
use super::{InverseError, PriorMatrix, SmoothCovariance, Weighting};
use crate::eit::{EitError, ForwardModel, Jacobian, Pattern, Protocol, ProtocolError};
use crate::mesh::{ElectrodedMesh, PixelMap};

/// Directions of `B'WB` below this share of the largest eigenvalue are noise of the arithmetic.
const SMALLEST_EIGENVALUE: f64 = 1e-10;

/// Share of the largest prior variance that a smooth prior's factor may leave out of any pixel's.
const NEGLECTED: f64 = 1e-9;

/// Parameters of the iteration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaussNewton {
    /// Steps; the first is the linear image. At least 1.
    pub steps: usize,
    /// lambda, the same in every step.
    pub hyperparameter: f64,
    /// A step that would change any pixel by more than this (in log conductivity) is shortened as a whole.
    pub largest_step: f64,
    /// Pixels are held within plus and minus this log conductivity.
    pub limit: f64,
}

impl GaussNewton {
    /// The customary step rules: shortened to 1.5, held within 3 (factors of 4.5 and 20 in conductivity).
    pub fn new(steps: usize, hyperparameter: f64) -> Self {
        Self { steps, hyperparameter, largest_step: 1.5, limit: 3.0 }
    }

    fn check(&self) -> Result<(), InverseError> {
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

/// What the iteration arrived at.
#[derive(Clone, Debug, PartialEq)]
pub struct GaussNewtonResult {
    /// `log(sigma / sigma_rest)` of every inside pixel.
    pub log_conductivity: Vec<f64>,
    /// Norm of the whitened data that the iterate at the start of each step left unexplained; the first is that of the
    /// data themselves.
    pub residuals: Vec<f64>,
}

/// A forward model with weights and prior, to be inverted frame by frame.
#[derive(Debug)]
pub struct NonlinearProblem {
    model: ForwardModel,
    map: PixelMap,
    rest_conductivity: f64,
    weighting: Weighting,
    prior: FactoredPrior,
    /// B: channels x transfer impedances.
    combination: Mat<f64>,
    at_rest: Linearisation,
}

/// The prior, as steps use it.
#[derive(Debug)]
struct FactoredPrior {
    matrix: PriorMatrix,
    /// U with `P = U U'`, unknowns x rank, where that is low.
    factor: Option<Mat<f64>>,
}

/// Weighted data of a set of channels, reduced to as many rows as there are independent transfer impedances.
#[derive(Clone, Debug)]
pub struct ReducedChannels {
    /// `e^-1/2 Q' B'W`: rows x channels, zero for missing ones.
    project: Mat<f64>,
    /// `e^1/2 Q'`: rows x transfer impedances.
    combine: Mat<f64>,
}

/// Transfer impedances and their derivative with respect to log conductivity.
#[derive(Debug)]
struct Linearisation {
    transfers: Vec<f64>,
    jacobian: Jacobian,
    /// `J U` of a smooth prior.
    along_prior: Option<Mat<f64>>,
}

impl NonlinearProblem {
    /// Brings the parts together. `rest_conductivity` is uniform, in S/m (S on sheets); `map` belongs to the mesh of
    /// `body`; the prior is over the inside pixels, for relative changes of conductivity; frames will have the channels
    /// of `protocol`.
    ///
    /// # Errors
    /// Sizes that disagree, or a body that cannot be solved.
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

    /// Prepares the data side without the missing channels (any order): once for all frames that lack the same ones.
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

    /// Inverts one frame of difference data (volts of the model; missing channels may hold anything, `NaN` too).
    /// `step_done` is told how many steps are done.
    ///
    /// # Errors
    /// Parameters that are not positive, a frame of the wrong length or with values that are not finite where the
    /// reduced channels expect some, or a forward problem that cannot be solved.
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

    /// `P A'(A P A' + lambda^2)^-1 b` with A the Jacobian of the reduced channels.
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

    fn conductivity(&self, log_conductivity: &[f64]) -> Vec<f64> {
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
    fn data(&self, dv: &[f64]) -> Result<faer::Col<f64>, InverseError> {
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

/// Toward `next`, by the whole step or as much of it as allowed.
fn advance(image: &mut [f64], next: &[f64], parameters: &GaussNewton) {
    let largest = image.iter().zip(next).map(|(old, new)| (new - old).abs()).fold(0.0, f64::max);
    let share = if largest > parameters.largest_step { parameters.largest_step / largest } else { 1.0 };
    for (old, new) in image.iter_mut().zip(next) {
        *old = (*old + share * (new - *old)).clamp(-parameters.limit, parameters.limit);
    }
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
            PriorMatrix::Covariance(covariance) => pivoted_cholesky(covariance),
            _ => None,
        };
        Self { matrix: matrix.clone(), factor }
    }
}

/// U with `U U'` a covariance up to a [`NEGLECTED`] share of its largest variance in every variance; `None` where that
/// takes more than half as many columns as rows (Higham, Wiley Interdiscip. Rev. Comput. Stat. 1, 2009, algorithm 3).
fn pivoted_cholesky(covariance: &SmoothCovariance) -> Option<Mat<f64>> {
    let size = covariance.len();
    let mut left: Vec<f64> = (0..size).map(|k| covariance.variance(k)).collect();
    let enough = NEGLECTED * left.iter().copied().fold(0.0, f64::max);
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

/// `du/dy` of pixels from `du/dsigma` of elements: `dsigma/dy = sigma`, and an element's y is the mean of its pixels'
/// weighted by overlap.
fn log_jacobian(of_elements: &Jacobian, map: &PixelMap, conductivity: &[f64]) -> Jacobian {
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

/// One ampere through every neighbouring pair (k, k+1) but the last, read at every pair from itself on.
fn transfer_protocol(electrodes: usize) -> Result<Protocol, ProtocolError> {
    let pairs: Vec<Pattern> = (1..electrodes as u32).map(|k| Pattern::pair(k - 1, k, 1.0)).collect();
    let channels = transfer_pairs(pairs.len()).map(|(drive, read)| (pairs[read].clone(), drive)).collect();
    Protocol::from_patterns(electrodes, pairs.clone(), channels)
}

fn transfer_pairs(pairs: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..pairs).flat_map(move |a| (a..pairs).map(move |b| (a, b)))
}

/// B: every channel in terms of the transfer impedances.
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

/// Coefficients of a pattern (its mean over all electrodes removed) over the pairs e_k - e_(k+1): its running sum.
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
    /// The weights of some of the channels: from a full covariance, those of its block.
    fn of_channels(&self, chosen: &[usize]) -> Result<Weighting, InverseError> {
        Ok(match self {
            Weighting::Identity => Weighting::Identity,
            Weighting::Diagonal(weights) => {
                Weighting::Diagonal(chosen.iter().map(|&channel| weights[channel]).collect())
            }
            Weighting::Full(factor) => {
                let rows = Mat::from_fn(chosen.len(), factor.ncols(), |row, column| {
                    // Only the lower triangle is the factor's.
                    if column <= chosen[row] { factor[(chosen[row], column)] } else { 0.0 }
                });
                Weighting::from_covariance((&rows * rows.transpose()).as_ref())?
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::eit::{Drive, Driven, Measure, Order, ProtocolSpec};
    use crate::inverse::{ImageBasis, LinearProblem, Prior};
    use crate::mesh::{Direction, Outline, PixelGrid, SheetSpec};

    const REST: f64 = 0.4;

    struct Tank {
        body: ElectrodedMesh,
        protocol: Protocol,
        map: PixelMap,
    }

    impl Tank {
        fn new() -> Self {
            let outline = Outline::Disc { radius_m: 0.1 };
            let electrodes = Outline::rim_arcs(8, 0.02, 0.0, Direction::CounterClockwise);
            let spec = SheetSpec::new(outline, electrodes, 0.015).with_target_elements(500).unwrap();
            let (body, _) = spec.build(&[0.001; 8]).unwrap();
            let protocol = Protocol::generate(&ProtocolSpec {
                electrode_count: 8,
                drive: Drive::Opposite,
                measure: Measure::Adjacent,
                order: Order::Absolute,
                driven: Driven::Keep,
                amplitude_a: 0.001,
            })
            .unwrap();
            let map = PixelMap::new(PixelGrid::covering([-0.1; 2], [0.1; 2], 12).unwrap(), &body.mesh).unwrap();
            Self { body, protocol, map }
        }

        fn model(&self) -> ForwardModel {
            ForwardModel::new(self.body.clone(), self.protocol.clone()).unwrap()
        }

        /// Difference data of a blob of the given log conductivity.
        fn blob(&self, log_conductivity: f64) -> (Vec<f64>, Vec<f64>) {
            let inside = |p: &[f64; 2]| (p[0] - 0.03).hypot(p[1] + 0.02) < 0.03;
            let image: Vec<f64> =
                self.map.inside_centres_m().iter().map(|p| if inside(p) { log_conductivity } else { 0.0 }).collect();
            let sigma: Vec<f64> = self.map.to_elements(&image).unwrap().iter().map(|y| REST * y.exp()).collect();
            let rest = vec![REST; sigma.len()];
            let model = self.model();
            let (after, before) = (model.solve(&sigma).unwrap().voltages(), model.solve(&rest).unwrap().voltages());
            (after.iter().zip(&before).map(|(a, b)| a - b).collect(), image)
        }

        fn parts(&self) -> (Jacobian, Weighting, PriorMatrix) {
            let model = self.model();
            let solution = model.solve(&vec![REST; self.map.element_count()]).unwrap();
            let mut jacobian = solution.jacobian_to_pixels(&self.map);
            jacobian.values.iter_mut().for_each(|value| *value *= REST);
            let weights = solution.voltages().iter().map(|v| 1.0 / (1e-8 + 0.01 * v * v)).collect();
            let weighting = Weighting::Diagonal(weights);
            let positions = self.map.inside_centres_m().into_iter().map(|p| [p[0], p[1], 0.0]).collect();
            let basis = ImageBasis { positions, neighbours: Vec::new() };
            let prior = Prior::GaussianNoser { correlation_length_m: 0.02, exponent: 1.0 };
            let prior = prior.matrix(jacobian.as_mat(), &weighting, &basis).unwrap();
            (jacobian, weighting, prior)
        }
    }

    fn distance(a: &[f64], b: &[f64]) -> f64 {
        let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
        norm(&mut a.iter().zip(b).map(|(a, b)| a - b)) / norm(&mut b.iter().copied())
    }

    #[test]
    fn the_first_step_is_the_linear_image_with_and_without_channels() {
        let tank = Tank::new();
        let (jacobian, weighting, prior) = tank.parts();
        let (dv, _) = tank.blob(0.01);
        let problem =
            NonlinearProblem::new(tank.body.clone(), &tank.protocol, &tank.map, REST, &weighting, &prior).unwrap();
        for missing in [vec![], vec![3, 17, 18, 40]] {
            let mut frame = dv.clone();
            missing.iter().for_each(|&channel: &u32| frame[channel as usize] = f64::NAN);
            let reduced = problem.reduce(&missing).unwrap();
            let parameters = GaussNewton::new(1, 0.3);
            let found = problem.solve(&parameters, &reduced, &frame, |_| {}).unwrap();
            let present: Vec<usize> = (0..dv.len()).filter(|&c| !missing.contains(&(c as u32))).collect();
            let rows = Mat::from_fn(present.len(), jacobian.columns, |r, c| jacobian.row(present[r])[c]);
            let values: Vec<f64> = present.iter().map(|&channel| dv[channel]).collect();
            let linear = LinearProblem::new(rows.as_ref(), weighting.of_channels(&present).unwrap(), prior.clone());
            let expected = linear.unwrap().operator(0.3).unwrap().apply(&values).unwrap();
            // The reduction drops directions below 1e-10 of the largest.
            let error = distance(&found.log_conductivity, &expected);
            assert!(error < 1e-6, "{error:e} without {missing:?}");
        }
    }

    #[test]
    fn steps_explain_large_contrasts_that_one_does_not() {
        let tank = Tank::new();
        let (_, weighting, prior) = tank.parts();
        let problem =
            NonlinearProblem::new(tank.body.clone(), &tank.protocol, &tank.map, REST, &weighting, &prior).unwrap();
        let reduced = problem.reduce(&[]).unwrap();
        for contrast in [-2.5, 2.5] {
            let (dv, truth) = tank.blob(contrast);
            let solve = |steps| problem.solve(&GaussNewton::new(steps, 0.05), &reduced, &dv, |_| {}).unwrap();
            let (linear, refined) = (solve(1), solve(6));
            let residuals = &refined.residuals;
            assert!(residuals[5] < 0.2 * residuals[1], "contrast {contrast}: {residuals:?}");
            let error = |result: &GaussNewtonResult| distance(&result.log_conductivity, &truth);
            assert!(error(&refined) < 0.9 * error(&linear), "{} {}", error(&refined), error(&linear));
        }
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let tank = Tank::new();
        let (_, weighting, prior) = tank.parts();
        let problem =
            NonlinearProblem::new(tank.body.clone(), &tank.protocol, &tank.map, REST, &weighting, &prior).unwrap();
        let channels = tank.protocol.channel_count();
        assert_eq!(
            problem.reduce(&(0..channels as u32).collect::<Vec<_>>()).unwrap_err(),
            InverseError::NoChannels { channels }
        );
        let reduced = problem.reduce(&[2]).unwrap();
        let mut frame = vec![0.0; channels];
        frame[1] = f64::NAN;
        let message = problem.solve(&GaussNewton::new(1, 1.0), &reduced, &frame, |_| {}).unwrap_err().to_string();
        assert_eq!(message, "channel 1: NaN is not finite");
        let none = GaussNewton::new(0, 1.0);
        assert!(problem.solve(&none, &reduced, &vec![0.0; channels], |_| {}).is_err());
    }
}
