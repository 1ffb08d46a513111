//! GREIT (Adler et al., Physiol. Meas. 30, S35, 2009): a reconstruction matrix that maps the data of many small
//! training targets to the desired round images, with noise limited by a noise figure:
//! `RM = D Y' (Y Y' + mu^2 Sigma)^-1` with the training data Y, the desired images D and the noise covariance Sigma.

use faer::{Mat, Side, linalg::solvers::Solve};

use super::error::positive;
use super::{DataPrecision, ImageBasis, InverseError, LinearProblem, Operator};

/// Training targets and permitted noise.
#[derive(Clone, Debug, PartialEq)]
pub struct GreitSpec {
    /// Radius of the training targets, metres.
    pub target_radius_m: f64,
    /// Radius of the desired blobs, metres. A desired image is 1 inside and falls off smoothly over a quarter of the
    /// radius.
    pub desired_radius_m: f64,
    /// Target noise figure (0.5 in the consensus paper).
    pub noise_figure: f64,
    /// Every n-th unknown is the centre of a target; 1 uses all.
    pub stride: usize,
}

/// A GREIT operator with its noise figure.
#[derive(Clone, Debug)]
pub struct Greit {
    /// The operator; `hyperparameter` is mu.
    pub operator: Operator,
    /// Noise figure reached.
    pub noise_figure: f64,
}

impl GreitSpec {
    /// Trains on the problem's Jacobian (linear targets) and noise.
    ///
    /// # Errors
    /// Radii or figures that are not positive, or an unreachable noise figure.
    pub fn train(&self, problem: &LinearProblem, basis: &ImageBasis) -> Result<Greit, InverseError> {
        for (what, value) in [
            ("target radius (m)", self.target_radius_m),
            ("desired radius (m)", self.desired_radius_m),
            ("noise figure", self.noise_figure),
        ] {
            positive(what, value)?;
        }
        if basis.len() != problem.unknowns() {
            return Err(InverseError::Size { what: "image basis", expected: problem.unknowns(), got: basis.len() });
        }
        let centres: Vec<usize> = (0..basis.len()).step_by(self.stride.max(1)).collect();
        let targets = Mat::from_fn(basis.len(), centres.len(), |pixel, column| {
            let distance = self.distance(basis, pixel, centres[column]);
            if distance <= self.target_radius_m { 1.0 } else { 0.0 }
        });
        let desired = Mat::from_fn(basis.len(), centres.len(), |pixel, column| {
            let distance = self.distance(basis, pixel, centres[column]);
            let edge = 0.25 * self.desired_radius_m;
            1.0 / (1.0 + ((distance - self.desired_radius_m) / edge).min(50.0).exp())
        });
        let whitened = problem.whitened();
        let data = &whitened * &targets;
        let covariance = &data * data.transpose();
        let cross = &desired * data.transpose();
        let centre = self.central_target(basis);
        let signal: Vec<f64> =
            (0..data.nrows()).map(|row| (0..basis.len()).map(|p| whitened[(row, p)] * centre[p]).sum()).collect();
        let trace: f64 = (0..covariance.nrows()).map(|k| covariance[(k, k)]).sum::<f64>();
        let scale = trace / covariance.nrows() as f64;
        let (mut high, mut low) = ((scale * 1e3).sqrt(), (scale * 1e-9).sqrt());
        let (first, last) = (figure(&covariance, &cross, &signal, high)?, figure(&covariance, &cross, &signal, low)?);
        if !(first <= self.noise_figure && self.noise_figure <= last) {
            return Err(InverseError::NoiseFigure { target: self.noise_figure, low: first, high: last });
        }
        while high / low > 1.002 {
            let middle = (high * low).sqrt();
            if figure(&covariance, &cross, &signal, middle)? > self.noise_figure { low = middle } else { high = middle }
        }
        let mu = (high * low).sqrt();
        let noise_figure = figure(&covariance, &cross, &signal, mu)?;
        Ok(Greit { operator: assemble(problem, &covariance, &cross, mu)?, noise_figure })
    }

    fn distance(&self, basis: &ImageBasis, a: usize, b: usize) -> f64 {
        let offset = crate::mesh::subtract(basis.positions[a], basis.positions[b]);
        crate::mesh::dot(offset, offset).sqrt()
    }

    fn central_target(&self, basis: &ImageBasis) -> Vec<f64> {
        let mut mean = [0.0; 3];
        for position in &basis.positions {
            (0..3).for_each(|axis| mean[axis] += position[axis] / basis.len() as f64);
        }
        let inside = |p: &[f64; 3]| {
            let offset = crate::mesh::subtract(*p, mean);
            crate::mesh::dot(offset, offset).sqrt() <= self.target_radius_m
        };
        basis.positions.iter().map(|p| if inside(p) { 1.0 } else { 0.0 }).collect()
    }
}

fn white_matrix(covariance: &Mat<f64>, cross: &Mat<f64>, mu: f64) -> Result<(Mat<f64>, Mat<f64>), InverseError> {
    let mut system = covariance.clone();
    for k in 0..system.nrows() {
        system[(k, k)] += mu * mu;
    }
    let factor = system
        .llt(Side::Lower)
        .map_err(|_| InverseError::Singular { what: "the training covariance", hint: "allow a lower noise figure" })?;
    let precision = factor.solve(Mat::<f64>::identity(system.nrows(), system.nrows()));
    Ok((cross * &precision, precision))
}

fn figure(covariance: &Mat<f64>, cross: &Mat<f64>, signal: &[f64], mu: f64) -> Result<f64, InverseError> {
    let (matrix, _) = white_matrix(covariance, cross, mu)?;
    let image = &matrix * faer::ColRef::from_slice(signal);
    let mean_abs = |values: &mut dyn Iterator<Item = f64>, count: usize| values.sum::<f64>() / count as f64;
    let image_mean = mean_abs(&mut image.iter().map(|v| v.abs()), image.nrows());
    let signal_mean = mean_abs(&mut signal.iter().map(|v| v.abs()), signal.len());
    let mut variance = vec![0.0; matrix.nrows()];
    for column in matrix.col_iter() {
        variance.iter_mut().zip(column.iter()).for_each(|(sum, value)| *sum += value * value);
    }
    let noise = mean_abs(&mut variance.iter().map(|v| v.sqrt()), variance.len());
    Ok(signal_mean / (image_mean / noise))
}

fn assemble(
    problem: &LinearProblem,
    covariance: &Mat<f64>,
    cross: &Mat<f64>,
    mu: f64,
) -> Result<Operator, InverseError> {
    let (white, mut precision) = white_matrix(covariance, cross, mu)?;
    let noise_deviation = (0..white.nrows()).map(|row| white.row(row).squared_norm_l2().sqrt()).collect();
    let mut transposed = white.transpose().to_owned();
    problem.weighting.whiten_adjoint(transposed.as_mut());
    problem.weighting.whiten_adjoint(precision.as_mut());
    let mut other_side = precision.transpose().to_owned();
    problem.weighting.whiten_adjoint(other_side.as_mut());
    Ok(Operator {
        matrix: transposed.transpose().to_owned(),
        data_precision: DataPrecision::Whole(other_side),
        hyperparameter: mu,
        noise_deviation,
    })
}
