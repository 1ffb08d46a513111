//! Compares inverse operators with their definitions, solved directly, and hyperparameter rules with their promises.

use dermis_tomo::eit::{Drive, Driven, ForwardModel, Jacobian, Measure, Order, Protocol, ProtocolSpec};
use dermis_tomo::inverse::{
    GreitSpec, Hyperparameter, ImageBasis, LinearProblem, MissingChannels, Prior, QuantisedOperator, TotalVariation,
    Weighting,
};
use dermis_tomo::mesh::{Direction, Outline, SheetSpec};
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use rand::{Rng, SeedableRng, rngs::StdRng};

struct Skin {
    model: ForwardModel,
    jacobian: Jacobian,
    basis: ImageBasis,
}

fn skin() -> Skin {
    let electrodes = Outline::rim_arcs(8, 0.02, 0.0, Direction::CounterClockwise);
    let spec = SheetSpec::new(Outline::Disc { radius_m: 0.1 }, electrodes, 0.02).with_target_elements(300).unwrap();
    let protocol = Protocol::generate(&ProtocolSpec {
        electrode_count: 8,
        drive: Drive::Adjacent,
        measure: Measure::Adjacent,
        order: Order::Absolute,
        driven: Driven::Drop,
        amplitude_a: 1.0,
    })
    .unwrap();
    let model = ForwardModel::new(spec.build(&[0.01]).unwrap().0, protocol).unwrap();
    let jacobian = model.solve(&vec![1.0; model.body().mesh.element_count()]).unwrap().jacobian();
    let basis = ImageBasis::of_elements(&model.body().mesh);
    Skin { model, jacobian, basis }
}

fn priors() -> Vec<Prior> {
    vec![
        Prior::Identity,
        Prior::Noser { exponent: 0.5 },
        Prior::Laplace,
        Prior::Gaussian { correlation_length_m: 0.02 },
        Prior::GaussianNoser { correlation_length_m: 0.02, exponent: 1.0 },
        Prior::Mixture(vec![(1.0, Prior::Laplace), (0.3, Prior::Noser { exponent: 0.5 })]),
    ]
}

fn variances(channels: usize) -> Vec<f64> {
    (0..channels).map(|c| 1.0 + 0.5 * (c as f64).sin()).collect()
}

fn largest_difference(a: &Mat<f64>, b: &Mat<f64>) -> f64 {
    (a - b).norm_max() / b.norm_max()
}

#[test]
fn every_form_equals_the_operator_of_the_definition() {
    let skin = skin();
    // Fewer channels than unknowns, and more, which use different forms of the operator.
    let few = 15;
    let neighbours = skin.basis.neighbours.iter().filter(|pair| pair.iter().all(|k| (*k as usize) < few));
    let corner =
        ImageBasis { positions: skin.basis.positions[..few].to_vec(), neighbours: neighbours.copied().collect() };
    let jacobian = skin.jacobian.as_mat();
    check_forms(&jacobian.to_owned(), &skin.basis);
    check_forms(&jacobian.subcols(0, few).to_owned(), &corner);
}

fn check_forms(j: &Mat<f64>, basis: &ImageBasis) {
    let weights: Vec<f64> = variances(j.nrows()).iter().map(|v| 1.0 / v).collect();
    for prior in priors() {
        let weighting = Weighting::Diagonal(weights.clone());
        let matrix = prior.matrix(j.as_ref(), &weighting, basis).unwrap();
        let r = matrix.dense().unwrap();
        let problem = LinearProblem::new(j.as_ref(), weighting, matrix).unwrap();
        let lambda = problem.choose(&Hyperparameter::Relative(0.1), &[]).unwrap();
        let operator = problem.operator(lambda).unwrap();
        let w = Mat::from_fn(j.nrows(), j.nrows(), |a, b| if a == b { weights[a] } else { 0.0 });
        let jw = j.transpose() * &w;
        let system = &jw * j + faer::Scale(lambda * lambda) * &r;
        let plain = system.llt(Side::Lower).unwrap().solve(&jw);
        let error = largest_difference(&operator.matrix, &plain);
        // The inverse of a Gaussian covariance is itself only accurate to its jitter of 1e-6.
        let tolerance = if matches!(prior, Prior::Gaussian { .. } | Prior::GaussianNoser { .. }) { 1e-3 } else { 1e-8 };
        assert!(error < tolerance, "{prior:?}: {error:e}");
        let covariance = system.llt(Side::Lower).unwrap().solve(Mat::<f64>::identity(j.ncols(), j.ncols()));
        let posterior = problem.posterior_deviation(lambda).unwrap();
        for (k, deviation) in posterior.iter().enumerate() {
            assert!((deviation / covariance[(k, k)].sqrt() - 1.0).abs() < tolerance.max(1e-6), "{prior:?} {k}");
        }
    }
}

#[test]
fn a_full_noise_covariance_is_whitened() {
    let skin = skin();
    let j = skin.jacobian.as_mat().to_owned();
    let m = j.nrows();
    let covariance =
        Mat::from_fn(m, m, |a, b| if a == b { 1.0 + a as f64 / m as f64 } else { 0.3 / (1.0 + a.abs_diff(b) as f64) });
    let weighting = Weighting::from_covariance(covariance.as_ref()).unwrap();
    let matrix = Prior::Identity.matrix(j.as_ref(), &weighting, &skin.basis).unwrap();
    let problem = LinearProblem::new(j.as_ref(), weighting, matrix).unwrap();
    let operator = problem.operator(0.05).unwrap();
    let w = covariance.llt(Side::Lower).unwrap().solve(Mat::<f64>::identity(m, m));
    let jw = j.transpose() * &w;
    let system = &jw * &j + faer::Scale(0.05 * 0.05) * Mat::<f64>::identity(j.ncols(), j.ncols());
    let plain = system.llt(Side::Lower).unwrap().solve(&jw);
    assert!(largest_difference(&operator.matrix, &plain) < 1e-8);
}

#[test]
fn filled_channels_give_the_image_without_them() {
    let skin = skin();
    let j = skin.jacobian.as_mat().to_owned();
    let missing = [3_u32, 17, 18, 30];
    let kept: Vec<usize> = (0..j.nrows()).filter(|c| !missing.contains(&(*c as u32))).collect();
    let weights: Vec<f64> = variances(j.nrows()).iter().map(|v| 1.0 / v).collect();
    for prior in [Prior::Noser { exponent: 0.5 }, Prior::Laplace] {
        let weighting = Weighting::Diagonal(weights.clone());
        // The prior is that of the full set in both cases: the expected image does not change with the channels.
        let matrix = prior.matrix(j.as_ref(), &weighting, &skin.basis).unwrap();
        let operator = LinearProblem::new(j.as_ref(), weighting, matrix.clone()).unwrap().operator(0.02).unwrap();
        let fewer = Mat::from_fn(kept.len(), j.ncols(), |row, column| j[(kept[row], column)]);
        let fewer_weights = Weighting::Diagonal(kept.iter().map(|&c| weights[c]).collect());
        let rebuilt = LinearProblem::new(fewer.as_ref(), fewer_weights, matrix).unwrap().operator(0.02).unwrap();
        let mut frame: Vec<f64> = (0..j.nrows()).map(|c| (0.7 * c as f64).cos()).collect();
        let expected = rebuilt.apply(&kept.iter().map(|&c| frame[c]).collect::<Vec<_>>()).unwrap();
        missing.iter().for_each(|&c| frame[c as usize] = f64::NAN);
        MissingChannels::new(&operator, &missing).unwrap().fill_in(&mut frame);
        let found = operator.apply(&frame).unwrap();
        let size = expected.iter().map(|v| v.abs()).fold(0.0, f64::max);
        let error = found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(error < 1e-8 * size, "{prior:?}: {error:e} of {size:e}");
    }
}

#[test]
fn live_images_are_the_operators_within_their_rounding() {
    let skin = skin();
    let j = skin.jacobian.as_mat();
    let matrix = Prior::Identity.matrix(j, &Weighting::Identity, &skin.basis).unwrap();
    let operator = LinearProblem::new(j, Weighting::Identity, matrix).unwrap().operator(0.1).unwrap();
    let mut live = QuantisedOperator::new(&operator, -2.0);
    let frame: Vec<f64> = (0..j.nrows()).map(|c| (c as f64).sin()).collect();
    let mut image = vec![0.0; live.unknowns()];
    live.apply(&frame.iter().map(|v| *v as f32).collect::<Vec<_>>(), &mut image);
    let expected = operator.apply(&frame).unwrap();
    let size = expected.iter().map(|v| v.abs()).fold(0.0, f64::max);
    // Uniform rounding to 1/32767 of a row's largest entry, in a sum over 208 values that mostly cancel.
    assert!(image.iter().zip(&expected).all(|(a, b)| (f64::from(*a) + 2.0 * b).abs() < 1e-4 * size));
}

/// Data of a touch with noise of known variance.
fn noisy_touch(skin: &Skin, noise: f64, seed: u64) -> (Vec<f64>, Vec<f64>) {
    let mut random = StdRng::seed_from_u64(seed);
    let truth: Vec<f64> =
        skin.basis.positions.iter().map(|p| if (p[0] - 0.04).hypot(p[1] + 0.01) < 0.03 { 0.5 } else { 0.0 }).collect();
    let data = (0..skin.jacobian.rows)
        .map(|channel| {
            let clean: f64 = skin.jacobian.row(channel).iter().zip(&truth).map(|(j, x)| j * x).sum();
            // Sum of twelve uniforms: close enough to normal, without another crate.
            let normal: f64 = (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
            clean + noise * normal
        })
        .collect();
    (truth, data)
}

#[test]
fn rules_for_the_hyperparameter_keep_their_promises() {
    let skin = skin();
    let j = skin.jacobian.as_mat();
    let noise: f64 = 2e-3;
    let weighting = Weighting::Diagonal(vec![noise.powi(-2); j.nrows()]);
    let matrix = Prior::Noser { exponent: 0.5 }.matrix(j, &weighting, &skin.basis).unwrap();
    let problem = LinearProblem::new(j, weighting, matrix).unwrap();
    let frames: Vec<Vec<f64>> = (0..20).map(|seed| noisy_touch(&skin, noise, seed).1).collect();
    let truth = noisy_touch(&skin, noise, 0).0;
    let error = |lambda: f64| {
        let operator = problem.operator(lambda).unwrap();
        frames.iter().map(|f| distance(&operator.apply(f).unwrap(), &truth)).sum::<f64>() / frames.len() as f64
    };
    let scan: Vec<f64> = (0..60).map(|k| 10f64.powf(-2.0 + 0.1 * f64::from(k))).collect();
    let best = scan.iter().map(|&lambda| error(lambda)).fold(f64::INFINITY, f64::min);
    for rule in [Hyperparameter::Gcv, Hyperparameter::LCurve, Hyperparameter::KnownNoise { factor: 1.0 }] {
        let lambda = problem.choose(&rule, &frames).unwrap();
        let found = error(lambda);
        println!("{rule:?}: lambda {lambda:.3}, error {found:.3} where the best is {best:.3}");
        // None of the rules knows the truth; they are expected to come within a quarter of the best error.
        assert!(found < 1.25 * best, "{rule:?}: {found} against {best}");
    }
    let signal: Vec<f64> = noisy_touch(&skin, 0.0, 0).1;
    for target in [1.0, 2.0] {
        let rule = Hyperparameter::NoiseFigure { target, signal: signal.clone() };
        let lambda = problem.choose(&rule, &[]).unwrap();
        let figure = problem.noise_figure(lambda, &signal).unwrap();
        assert!((figure / target - 1.0).abs() < 0.01, "{figure} for {target}");
    }
    assert!(problem.choose(&Hyperparameter::Gcv, &[]).is_err());
    assert!(problem.choose(&Hyperparameter::Number(-1.0), &[]).is_err());
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum();
    (sum / b.iter().map(|y| y * y).sum::<f64>()).sqrt()
}

#[test]
fn greit_reaches_its_noise_figure_and_places_targets() {
    let skin = skin();
    let j = skin.jacobian.as_mat();
    let matrix = Prior::Identity.matrix(j, &Weighting::Identity, &skin.basis).unwrap();
    let problem = LinearProblem::new(j, Weighting::Identity, matrix).unwrap();
    let spec = GreitSpec { target_radius_m: 0.015, desired_radius_m: 0.025, noise_figure: 2.0, stride: 1 };
    let greit = spec.train(&problem, &skin.basis).unwrap();
    assert!((greit.noise_figure / 2.0 - 1.0).abs() < 0.01, "{}", greit.noise_figure);
    let (_, data) = noisy_touch(&skin, 0.0, 0);
    let image = greit.operator.apply(&data).unwrap();
    let peak = image.iter().copied().fold(0.0, f64::max);
    let above = || image.iter().zip(&skin.basis.positions).filter(|(value, _)| **value > 0.5 * peak);
    let weight: f64 = above().map(|(value, _)| value).sum();
    let centroid = |axis: usize| above().map(|(value, p)| value * p[axis]).sum::<f64>() / weight;
    // The target's centre is at (40, -10) mm; eight electrodes resolve about a fifth of the diameter.
    let error = (centroid(0) - 0.04).hypot(centroid(1) + 0.01);
    assert!(error < 0.02, "{error} at ({}, {})", centroid(0), centroid(1));
}

#[test]
fn total_variation_is_closer_to_a_sharp_touch_than_smoothing() {
    let skin = skin();
    let j = skin.jacobian.as_mat();
    let noise: f64 = 5e-4;
    let weighting = Weighting::Diagonal(vec![noise.powi(-2); j.nrows()]);
    let (truth, data) = noisy_touch(&skin, noise, 3);
    let matrix = Prior::Laplace.matrix(j, &weighting, &skin.basis).unwrap();
    let problem = LinearProblem::new(j, weighting.clone(), matrix).unwrap();
    let scan = || (0..40).map(|k| 10f64.powf(-2.0 + 0.1 * f64::from(k)));
    let smooth = scan().map(|l| distance(&problem.operator(l).unwrap().apply(&data).unwrap(), &truth));
    let smooth = smooth.fold(f64::INFINITY, f64::min);
    let sharp = scan().step_by(4).map(|hyperparameter| {
        let settings = TotalVariation { hyperparameter, ..TotalVariation::default() };
        distance(&settings.solve(j, &weighting, &skin.basis, &data).unwrap().image, &truth)
    });
    let sharp = sharp.fold(f64::INFINITY, f64::min);
    println!("best errors: Laplace {smooth:.3}, total variation {sharp:.3}");
    assert!(sharp < smooth, "{sharp} against {smooth}");
    assert_eq!(skin.model.protocol().channel_count(), 40);
}

#[test]
fn bad_input_is_refused_with_its_place() {
    let skin = skin();
    let j = skin.jacobian.as_mat();
    let matrix = || Prior::Identity.matrix(j, &Weighting::Identity, &skin.basis).unwrap();
    let mut weights = vec![1.0; j.nrows()];
    weights[7] = f64::NAN;
    let error = LinearProblem::new(j, Weighting::Diagonal(weights), matrix()).unwrap_err().to_string();
    assert_eq!(error, "weight 7: NaN is not finite");
    let error = LinearProblem::new(j, Weighting::Diagonal(vec![1.0; 3]), matrix()).unwrap_err().to_string();
    assert_eq!(error, "weights: expected 40, got 3");
    let operator = LinearProblem::new(j, Weighting::Identity, matrix()).unwrap().operator(0.1).unwrap();
    assert_eq!(operator.apply(&[0.0]).unwrap_err().to_string(), "channels of the frame: expected 40, got 1");
    assert!(MissingChannels::new(&operator, &[99]).is_err());
    assert!(MissingChannels::new(&operator, &(0..40).collect::<Vec<_>>()).is_err());
}
