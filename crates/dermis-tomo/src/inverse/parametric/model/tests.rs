use faer::Mat;
use rand::{Rng, SeedableRng, rngs::StdRng};

use super::*;
use crate::inverse::SpotShape;
use crate::mesh::{Point, distance};

/// A square of 20 x 20 pixels, seen by 60 smooth channels that all differ.
fn skin() -> (Mat<f64>, Vec<[f64; 2]>) {
    let positions: Vec<Point> =
        (0..400).map(|k| [0.005 * ((k % 20) as f64 - 9.5), 0.005 * ((k / 20) as f64 - 9.5)]).collect();
    let jacobian = Mat::from_fn(60, 400, |c, p| {
        let ([x, y], c) = (positions[p], c as f64);
        let wave = |k: f64| (40.0 + 3.0 * k) * (x * (0.7 * k).cos() + y * (0.7 * k).sin());
        (wave(c).sin() + 0.5 * (wave(c + 0.5) + 1.0).cos()) * 1e-3
    });
    (jacobian, positions)
}

/// Response to a uniform change.
fn uniform(jacobian: &Mat<f64>) -> Vec<f64> {
    jacobian.row_iter().map(|row| row.iter().sum()).collect()
}

fn model(noise_v: f64) -> (SpotModel, Mat<f64>, Vec<[f64; 2]>) {
    model_of(noise_v, None)
}

fn model_of(noise_v: f64, smoothing_m: Option<f64>) -> (SpotModel, Mat<f64>, Vec<[f64; 2]>) {
    let (jacobian, positions) = skin();
    let options = SpotOptions {
        smallest_radius_m: 0.006,
        largest_radius_m: 0.03,
        typical_radius_m: 0.012,
        smoothing_m,
        most_spots: 4,
    };
    let model =
        SpotModel::new(jacobian.as_ref(), &uniform(&jacobian), &vec![noise_v; 60], &positions, 0.005, options).unwrap();
    (model, jacobian, positions)
}

fn frame(jacobian: &Mat<f64>, positions: &[Point], spots: &[([f64; 2], f64, f64)]) -> Vec<f64> {
    frame_of(jacobian, positions, spots, None)
}

fn frame_of(
    jacobian: &Mat<f64>,
    positions: &[Point],
    spots: &[([f64; 2], f64, f64)],
    smoothing_m: Option<f64>,
) -> Vec<f64> {
    let sigma: Vec<f64> = positions
        .iter()
        .map(|q| {
            let of = |(p, r, a): &([f64; 2], f64, f64)| {
                a * SpotShape::new(*r, smoothing_m).at((q[0] - p[0]).powi(2) + (q[1] - p[1]).powi(2))
            };
            spots.iter().map(of).sum()
        })
        .collect();
    (jacobian * faer::ColRef::from_slice(&sigma)).iter().copied().collect()
}

fn normal(random: &mut StdRng) -> f64 {
    (-2.0 * (1.0 - random.random::<f64>()).ln()).sqrt() * (std::f64::consts::TAU * random.random::<f64>()).cos()
}

#[test]
fn spots_without_noise_are_recovered_together() {
    for smoothing_m in [None, Some(0.01)] {
        let (model, jacobian, positions) = model_of(1e-6, smoothing_m);
        let truth = [([0.012, -0.02], 0.011, 0.2), ([-0.017, 0.013], 0.016, 0.1)];
        let mut scratch = model.scratch();
        let starts = [[0.016, -0.016], [-0.021, 0.01]];
        let outcome = model.fit(&frame_of(&jacobian, &positions, &truth, smoothing_m), &starts, &mut scratch).unwrap();
        for (spot, (place, radius, amplitude)) in scratch.spots().iter().zip(&truth) {
            // Interpolation error of the cubics between tabulated positions (5 mm steps, spots of 11 mm and more) and
            // radii (a factor of up to 1.4 apart).
            assert!(distance(spot.position_m, *place) < 1e-4, "{spot:?} {outcome:?}");
            assert!((spot.radius_m / radius - 1.0).abs() < 0.03 && (spot.amplitude / amplitude - 1.0).abs() < 0.03);
        }
        // 1.2 % of the frame, from the same cubics.
        assert!(outcome.residual < 3e-4 * outcome.energy, "{outcome:?}");
    }
}

#[test]
fn large_spots_are_recovered_if_the_model_includes_them() {
    let (linear, jacobian, positions) = model(1e-5);
    // Every pixel responds like a disc in the plane. The Jacobian is that of lowered conductivity.
    let lowered = jacobian.clone();
    let response = ChangeResponse::new(1.0, move |changes: &[f64]| {
        let answered: Vec<f64> = changes.iter().map(|u| -u / (1.0 + 0.5 * u)).collect();
        Some((&lowered * faer::ColRef::from_slice(&answered)).iter().copied().collect())
    });
    let large = |positions: &[Point]| {
        linear.clone().with_large_changes(response.clone(), jacobian.as_ref(), None, positions, -1.0)
    };
    let truth = ([0.012, -0.02], 0.013, 0.5);
    let changes: Vec<f64> = positions
        .iter()
        .map(|q| {
            let square = (q[0] - truth.0[0]).powi(2) + (q[1] - truth.0[1]).powi(2);
            -truth.2 * (-square / (2.0 * truth.1 * truth.1)).exp()
        })
        .collect();
    let frame = response.to(&changes).unwrap();
    let fit = |model: &SpotModel| {
        let mut scratch = model.scratch();
        let outcome = model.fit(&frame, &[[0.016, -0.016]], &mut scratch).unwrap();
        (scratch.spots()[0], outcome.residual / outcome.energy)
    };
    let ((as_linear, left_by_linear), (spot, left)) = (fit(&linear), fit(&large(&positions).unwrap()));
    // As exact as the cubics allow. The linear fit finds a narrower spot and explains the frame less well.
    assert!((spot.radius_m / truth.1 - 1.0).abs() < 0.03 && left < left_by_linear, "{spot:?} {left} {left_by_linear}");
    assert!(as_linear.radius_m < 0.95 * truth.1, "{as_linear:?}");
    // Amplitudes are defined by the channels' response.
    assert!((spot.amplitude / (truth.2 / (1.0 - 0.5 * truth.2)) - 1.0).abs() < 0.05, "{spot:?}");
    assert!(distance(spot.position_m, truth.0) < 1e-4, "{spot:?}");
    assert!(large(&positions[1..]).is_err());
    // From its own result, a fit is settled within two steps; from the linear one, it takes more.
    let (model, mut scratch) = (large(&positions).unwrap(), linear.scratch());
    assert!(linear.take_frame(&frame, &mut scratch).is_ok() && linear.left_by(&[spot], &mut scratch).is_none());
    let mut scratch = model.scratch();
    let uniform = model.take_frame(&frame, &mut scratch).unwrap().uniform;
    let [again, afresh] = [spot, as_linear].map(|start| {
        let outcome = model.fit_in_full(&[start], uniform, &mut scratch).unwrap();
        assert!(distance(scratch.spots()[0].position_m, spot.position_m) < 1e-5, "{:?}", scratch.spots());
        outcome.steps
    });
    assert!(again <= 2 && again < afresh, "{again} and {afresh} steps");
}

#[test]
fn errors_of_noisy_fits_agree_with_their_covariances() {
    let noise_v = 1e-4;
    let (model, jacobian, positions) = model(noise_v);
    let truth = ([0.007, -0.0135], 0.012, 0.1);
    let clean = frame(&jacobian, &positions, &[truth]);
    let mut random = StdRng::seed_from_u64(3);
    let mut scratch = model.scratch();
    let bound = model.bound(truth.0, truth.2, truth.1).unwrap();
    let (mut squares, mut expected, runs) = ([0.0; 3], [0.0; 3], 500);
    for _ in 0..runs {
        let noisy: Vec<f64> = clean.iter().map(|v| v + noise_v * normal(&mut random)).collect();
        model.fit(&noisy, &[[0.01, -0.01]], &mut scratch).unwrap();
        let spot = scratch.spots()[0];
        let off = [spot.position_m[0] - truth.0[0], spot.position_m[1] - truth.0[1], spot.amplitude - truth.2];
        (0..3).for_each(|k| {
            squares[k] += off[k] * off[k];
            expected[k] += spot.covariance[k][k];
        });
    }
    for k in 0..3 {
        let ratio: f64 = (squares[k] / expected[k]).sqrt();
        // 500 fits give a standard deviation within 3.2 % (one standard error). The covariances are the bound times
        // the residual.
        assert!((ratio - 1.0).abs() < 0.15, "{k}: {ratio}");
        let ratio = (squares[k] / f64::from(runs) / bound[k][k]).sqrt();
        assert!((ratio - 1.0).abs() < 0.15, "{k}: {ratio} of the bound");
    }
    assert!(model.bound([1.0, 0.0], 0.1, 0.012).is_err() && model.bound(truth.0, 0.0, 0.012).is_err());
}

#[test]
fn a_model_with_changed_noise_equals_one_built_for_it() {
    let (first, jacobian, positions) = model(1e-4);
    let noise: Vec<f64> = (0..60).map(|c| 1e-4 * (1.0 + 0.8 * (c as f64).sin())).collect();
    let direct =
        SpotModel::new(jacobian.as_ref(), &uniform(&jacobian), &noise, &positions, 0.005, *first.options()).unwrap();
    let again = first.reweighted(&noise).unwrap();
    let mut random = StdRng::seed_from_u64(5);
    let clean = frame(&jacobian, &positions, &[([0.01, 0.02], 0.012, 0.1)]);
    let noisy: Vec<f64> = clean.iter().zip(&noise).map(|(v, n)| v + n * normal(&mut random)).collect();
    let fit = |model: &SpotModel| {
        let mut scratch = model.scratch();
        model.fit(&noisy, &[[0.012, 0.017]], &mut scratch).unwrap();
        scratch.spots()[0]
    };
    let (a, b) = (fit(&direct), fit(&again));
    let sigma = b.covariance[0][0].sqrt();
    // The combinations kept differ a little, and the estimates by a fraction of their standard deviation.
    assert!((a.position_m[0] - b.position_m[0]).abs() < 0.2 * sigma, "{a:?} {b:?}");
    assert!((a.covariance[0][0] / b.covariance[0][0] - 1.0).abs() < 0.1, "{a:?} {b:?}");
    assert!(first.reweighted(&noise[1..]).is_err());
}

#[test]
fn derivatives_agree_with_differences_of_the_values() {
    let (model, ..) = model(1e-4);
    let length = model.combinations();
    let at = |p: Point, log_r: f64| {
        let mut out = vec![0.0; 4 * length];
        model.responses.evaluate(p, log_r, &mut [], &mut out).unwrap();
        out
    };
    let (p, log_r, step) = ([0.0031, -0.0123], 0.0125_f64.ln(), 2e-4);
    let here = at(p, log_r);
    let pairs = [
        (at([p[0] + step, p[1]], log_r), at([p[0] - step, p[1]], log_r), step),
        (at([p[0], p[1] + step], log_r), at([p[0], p[1] - step], log_r), step),
        (at(p, log_r + 0.02), at(p, log_r - 0.02), 0.02),
    ];
    for (k, (more, less, step)) in pairs.iter().enumerate() {
        let of = |n: usize| f64::from(here[(k + 1) * length + n]);
        let scale = (0..length).map(|n| of(n).abs()).fold(0.0, f64::max);
        for n in 0..length {
            let difference = f64::from(more[n] - less[n]) / (2.0 * step);
            // Single precision over the step, and the third derivative of the cubic.
            assert!((difference - of(n)).abs() < 0.01 * scale, "{k} {n}: {difference} {}", of(n));
        }
    }
}

#[test]
fn impossible_input_is_refused() {
    let (jacobian, positions) = skin();
    let good = SpotOptions {
        smallest_radius_m: 0.006,
        largest_radius_m: 0.03,
        typical_radius_m: 0.012,
        smoothing_m: None,
        most_spots: 2,
    };
    let make = |noise: &[f64], options| {
        SpotModel::new(jacobian.as_ref(), &uniform(&jacobian), noise, &positions, 0.005, options)
    };
    assert!(make(&[1.0; 3], good).is_err());
    assert!(make(&[0.0; 60], good).is_err());
    assert!(make(&[1.0; 60], SpotOptions { largest_radius_m: 0.006, ..good }).is_err());
    assert!(make(&[1.0; 60], SpotOptions { smallest_radius_m: f64::NAN, ..good }).is_err());
    let model = make(&[1.0; 60], good).unwrap();
    let mut scratch = model.scratch();
    let clean = vec![0.0; 60];
    assert!(model.fit(&clean[1..], &[[0.0; 2]], &mut scratch).is_err());
    assert!(model.fit(&clean, &[], &mut scratch).is_err());
    assert!(model.fit(&clean, &[[0.0; 2]; 3], &mut scratch).is_err());
    assert!(model.fit(&clean, &[[1.0, 0.0]], &mut scratch).is_err());
    let mut broken = clean.clone();
    broken[4] = f64::NAN;
    assert!(model.fit(&broken, &[[0.0; 2]], &mut scratch).is_err());
    // An empty frame has a solution: amplitude zero.
    model.fit(&clean, &[[0.0; 2]], &mut scratch).unwrap();
    assert!(scratch.spots()[0].amplitude.abs() < 1e-9);
}

#[test]
fn a_model_without_channels_is_the_one_made_without_them() {
    let (model, jacobian, positions) = model(1e-6);
    let missing: Vec<u32> = (0..60).step_by(4).collect();
    let deviations: Vec<f64> = (0..60).map(|c| 1e-6 * (1.0 + 0.05 * f64::from(c))).collect();
    let mut left_out = deviations.clone();
    missing.iter().for_each(|&c| left_out[c as usize] = f64::NAN);
    let uniform = uniform(&jacobian);
    let made = SpotModel::new(jacobian.as_ref(), &uniform, &left_out, &positions, 0.005, *model.options()).unwrap();
    let truth = [([0.012, -0.02], 0.011, 0.2), ([-0.017, 0.013], 0.016, 0.1)];
    let starts = [[0.016, -0.016], [-0.021, 0.01]];
    let mut data = frame(&jacobian, &positions, &truth);
    // Garbage in the channels that are left out.
    missing.iter().for_each(|&c| data[c as usize] = 0.3);
    let noisy = model.reweighted(&vec![2e-6; 60]).unwrap();
    for model in [&model, &noisy] {
        let without = model.without(&missing, &deviations).unwrap();
        let (mut one, mut other) = (without.scratch(), made.scratch());
        without.fit(&data, &starts, &mut one).unwrap();
        made.fit(&data, &starts, &mut other).unwrap();
        for (a, b) in one.spots().iter().zip(other.spots()) {
            // The combinations kept differ only by weak ones, and sums are in single precision.
            assert!(distance(a.position_m, b.position_m) < 2e-5, "{a:?} {b:?}");
            assert!((a.covariance[0][0] / b.covariance[0][0] - 1.0).abs() < 0.02, "{a:?} {b:?}");
        }
    }
    assert!(model.without(&Vec::from_iter(0..60), &deviations).is_err());
}
