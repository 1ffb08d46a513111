use super::*;
use crate::eit::{Drive, Driven, Measure, Order, ProtocolSpec};
use crate::inverse::{Guess, GuessCorrelations, ImageBasis, LinearProblem, Prior};
use crate::mesh::{Direction, Outline, PixelGrid, Point, SheetSpec};

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

    /// Difference data for a blob with this log conductivity.
    fn blob(&self, log_conductivity: f64) -> (Vec<f64>, Vec<f64>) {
        let inside = |p: &Point| (p[0] - 0.03).hypot(p[1] + 0.02) < 0.03;
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
fn impossible_input_is_refused() {
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

#[test]
fn an_image_about_a_guess_improves_it_for_any_common_factor() {
    let tank = Tank::new();
    let (_, weighting, prior) = tank.parts();
    let problem =
        NonlinearProblem::new(tank.body.clone(), &tank.protocol, &tank.map, REST, &weighting, &prior).unwrap();
    let reduced = problem.reduce(&[]).unwrap();
    let (dv, truth) = tank.blob(1.5);
    let rest = tank.model().solve(&vec![REST; tank.map.element_count()]).unwrap().voltages();
    // Half of the blob, with large uncertainty around it.
    let centres = tank.map.inside_centres_m();
    let guess: Vec<f64> = centres.iter().zip(&truth).map(|(p, y)| if p[0] < 0.03 { *y } else { 0.0 }).collect();
    let near = |p: &Point| (p[0] - 0.03).hypot(p[1] + 0.02) < 0.045;
    let deviation: Vec<f64> = centres.iter().map(|p| if near(p) { 1.0 } else { 0.05 }).collect();
    let positions: Vec<[f64; 3]> = centres.iter().map(|p| [p[0], p[1], 0.0]).collect();
    let covariance = SmoothCovariance::new(&positions, 0.04, None).unwrap();
    let correlations = GuessCorrelations::new(&covariance, 0.01).unwrap();
    let solve = |frame: &[f64], guess: &[f64]| {
        let guess = Guess { log_conductivity: guess, deviation: &deviation, common_deviation: 0.05 };
        problem.solve_about(&GaussNewton::new(3, 0.05), &reduced, frame, &guess, &correlations)
    };
    for factor in [0.95, 1.0, 1.05] {
        let frame: Vec<f64> = dv.iter().zip(&rest).map(|(dv, v)| factor * (dv + v) - v).collect();
        let found = solve(&frame, &guess).unwrap();
        let (before, after) = (distance(&guess, &truth), distance(&found, &truth));
        assert!(after < 0.9 * before, "factor {factor}: {after} of {before}");
    }
    let message = solve(&dv, &guess[1..]).unwrap_err().to_string();
    assert!(message.contains("pixels of the guess"), "{message}");
}
