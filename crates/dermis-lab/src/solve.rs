//! One-shot computations on a [`Case`], for comparison with other software: its forward model, and difference
//! images by the one-step inverse `x = (J'WJ + lambda^2 R)^-1 J'W dv` with the conventions of EIDORS.

use dermis_tomo::eit::{ForwardModel, Jacobian};
use dermis_tomo::inverse::{ImageBasis, InverseError, LinearProblem, Prior, Weighting};
use dermis_tomo::sparse::{Ordering, SpdStructure};
use faer::{Mat, Side, linalg::solvers::Solve};

use crate::Error;
use crate::case::Case;

/// Prior of a difference image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DifferencePrior {
    /// R = I.
    Identity,
    /// Twice the graph Laplacian over shared faces.
    Laplace,
    /// `R = diag(J'J)^0.5`.
    Noser,
}

/// Settings of a difference image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DifferenceSpec {
    /// The prior.
    pub prior: DifferencePrior,
    /// lambda, which enters squared.
    pub hyperparameter: f64,
    /// If false, `dv = v - v0` and W = I. If true, `dv = v/v0 - 1`, the rows of J are divided by v0, and `W =
    /// diag(v1^2)`, where v1 are the voltages at conductivity 1 everywhere.
    pub normalised: bool,
}

impl Case {
    /// The forward model of the case.
    ///
    /// # Errors
    /// The numbers of electrodes disagree, or the system's structure is rejected.
    pub fn forward_model(&self) -> Result<ForwardModel, Error> {
        Ok(ForwardModel::new(self.body.clone(), self.protocol.clone())?)
    }
}

/// The change of conductivity per element that explains the difference between the model's voltages at `reference`
/// and at `changed`, linearised at `reference`.
///
/// Exact for every prior and size. The Laplace prior doesn't penalise constants, so these are solved for separately.
///
/// # Errors
/// A conductivity is rejected by the model, a reference voltage is zero although differences are normalised, the
/// hyperparameter is not positive and finite, or the system is singular.
pub fn difference_image(
    model: &ForwardModel,
    reference: &[f64],
    changed: &[f64],
    spec: &DifferenceSpec,
) -> Result<Vec<f64>, Error> {
    let at_reference = model.solve(reference)?;
    let (v0, v) = (at_reference.voltages(), model.solve(changed)?.voltages());
    let mut jacobian = at_reference.jacobian();
    let mut dv: Vec<f64> = v.iter().zip(&v0).map(|(v, v0)| v - v0).collect();
    let mut weighting = Weighting::Identity;
    if spec.normalised {
        normalise(&mut jacobian, &mut dv, &v0)?;
        let unit = model.solve(&vec![1.0; reference.len()])?.voltages();
        weighting = Weighting::Diagonal(unit.iter().map(|v| v * v).collect());
    }
    let basis = ImageBasis::of_elements(&model.body().mesh);
    let prior = match spec.prior {
        DifferencePrior::Laplace => return laplace_image(&jacobian, &weighting, &basis, spec.hyperparameter, &dv),
        DifferencePrior::Identity => Prior::Identity,
        DifferencePrior::Noser => Prior::Noser { exponent: 0.5 },
    };
    let matrix = prior.matrix(jacobian.as_mat(), &weighting, &basis)?;
    let problem = LinearProblem::new(jacobian.as_mat(), weighting, matrix)?;
    Ok(problem.operator(spec.hyperparameter)?.apply(&dv)?)
}

fn normalise(jacobian: &mut Jacobian, dv: &mut [f64], v0: &[f64]) -> Result<(), Error> {
    if let Some(index) = v0.iter().position(|v| *v == 0.0) {
        let what = "reference voltage of channel";
        return Err(InverseError::Value { what, index: Some(index), value: 0.0, expected: "other than 0" }.into());
    }
    dv.iter_mut().zip(v0).for_each(|(dv, v0)| *dv /= v0);
    for (row, v0) in jacobian.values.chunks_exact_mut(jacobian.columns).zip(v0) {
        row.iter_mut().for_each(|value| *value /= v0);
    }
    Ok(())
}

/// The image with the Laplace prior, whose R has the constants as its null space: `x = c 1 + z` with z zero at the
/// last element. Without that element's row and column R is positive definite, with inverse P. In whitened data, with
/// `K = J P J' + lambda^2`, c is the generalised least-squares fit of `J 1` to dv, and `z = P J' K^-1 (dv - c J 1)`.
fn laplace_image(
    jacobian: &Jacobian,
    weighting: &Weighting,
    basis: &ImageBasis,
    lambda: f64,
    dv: &[f64],
) -> Result<Vec<f64>, Error> {
    if !(lambda > 0.0 && lambda.is_finite()) {
        let (what, expected) = ("hyperparameter", "positive and finite");
        return Err(InverseError::Value { what, index: None, value: lambda, expected }.into());
    }
    let (channels, unknowns) = (jacobian.rows, jacobian.columns);
    let root = |channel: usize| match weighting {
        Weighting::Diagonal(weights) => weights[channel].sqrt(),
        _ => 1.0,
    };
    let whitened = Mat::from_fn(channels, unknowns, |row, column| root(row) * jacobian.row(row)[column]);
    let data = Mat::from_fn(channels, 1, |row, _| root(row) * dv[row]);
    let constant = Mat::from_fn(channels, 1, |row, _| root(row) * jacobian.row(row).iter().sum::<f64>());
    let spread = grounded_laplace_inverse(basis, whitened.transpose().to_owned())?;
    let mut gram = &whitened * &spread;
    for k in 0..channels {
        gram[(k, k)] += lambda * lambda;
    }
    let singular = InverseError::Singular { what: "the data-space system", hint: "raise the hyperparameter" };
    let factor = gram.llt(Side::Lower).map_err(|_| singular)?;
    let weighted = factor.solve(&constant);
    let share = |column: &Mat<f64>| (0..channels).map(|k| weighted[(k, 0)] * column[(k, 0)]).sum::<f64>();
    let level = share(&data) / share(&constant);
    let residual = &data - faer::Scale(level) * &constant;
    let image = &spread * factor.solve(&residual);
    Ok((0..unknowns).map(|k| level + image[(k, 0)]).collect())
}

/// `P B` for the Laplace prior with its last unknown held at zero.
fn grounded_laplace_inverse(basis: &ImageBasis, mut b: Mat<f64>) -> Result<Mat<f64>, Error> {
    let held = basis.len() - 1;
    let mut entries: Vec<(u32, u32, f64)> = Vec::with_capacity(3 * basis.neighbours.len() + 1);
    for &[first, second] in &basis.neighbours {
        let inside = [first, second].map(|k| (k as usize) < held);
        entries.extend([first, second].into_iter().zip(inside).filter(|(_, inside)| *inside).map(|(k, _)| (k, k, 2.0)));
        if inside == [true, true] {
            entries.push((first.max(second), first.min(second), -2.0));
        }
    }
    // Keep a row for the held unknown so that the numbering stays. Its right-hand side is zero, and so is its
    // solution.
    entries.push((held as u32, held as u32, 1.0));
    for column in 0..b.ncols() {
        b[(held, column)] = 0.0;
    }
    let refuse = |_| {
        let hint = "elements that touch at a node only are not neighbours; use another prior";
        Error::from(InverseError::Singular { what: "the Laplace prior", hint })
    };
    let positions: Vec<(u32, u32)> = entries.iter().map(|&(row, column, _)| (row, column)).collect();
    let (structure, slots) =
        SpdStructure::new(basis.len(), &positions, Ordering::Dissection(&basis.positions)).map_err(refuse)?;
    let mut values = vec![0.0; structure.value_count()];
    for (slot, entry) in slots.iter().zip(&entries) {
        values[*slot as usize] += entry.2;
    }
    let factor = structure.factor(&values).map_err(refuse)?;
    structure.solve_in_place(&factor, b.as_mut());
    Ok(b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_skin::Skin;

    #[test]
    fn the_laplace_image_equals_the_model_form() {
        let skin = Skin::open("golfball-tank").unwrap();
        let body = skin.body_with_elements(300).unwrap().mesh;
        let model = ForwardModel::new(body, skin.protocol().unwrap()).unwrap();
        let elements = model.body().mesh.element_count();
        let sigma: Vec<f64> = (0..elements).map(|k| 0.02 * (1.0 + 0.3 * (0.7 * k as f64).sin())).collect();
        let solution = model.solve(&sigma).unwrap();
        let jacobian = solution.jacobian();
        let dv: Vec<f64> = solution.voltages().iter().enumerate().map(|(k, v)| v * (0.3 * k as f64).cos()).collect();
        let basis = ImageBasis::of_elements(&model.body().mesh);
        let weights: Vec<f64> = (0..jacobian.rows).map(|k| 1.0 + (k % 5) as f64).collect();
        for weighting in [Weighting::Identity, Weighting::Diagonal(weights)] {
            // Small enough for the dense form of the linear problem, which is exact for a singular prior.
            let matrix = Prior::Laplace.matrix(jacobian.as_mat(), &weighting, &basis).unwrap();
            let problem = LinearProblem::new(jacobian.as_mat(), weighting.clone(), matrix).unwrap();
            for lambda in [1e-3, 1e-1] {
                let expected = problem.operator(lambda).unwrap().apply(&dv).unwrap();
                let found = laplace_image(&jacobian, &weighting, &basis, lambda, &dv).unwrap();
                let scale = expected.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
                let error = found.iter().zip(&expected).fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
                // Both forms lose digits as lambda^2 falls below the largest eigenvalue of J J'.
                assert!(error < 1e-7 * scale, "{lambda}: off by {error:e} of {scale:e}");
            }
        }
    }
}
