//! Tests the loop on problems with known solutions.

use super::*;

/// Rosenbrock's valley as a sum of squares, `r = (10 (y - x^2), 1 - x)`, with its minimum at (1, 1).
struct Valley {
    at: [f64; 2],
    tried: [f64; 2],
    /// Steps to points with x above this are refused.
    wall: f64,
}

impl Valley {
    fn new() -> Self {
        Self { at: [-1.2, 1.0], tried: [0.0; 2], wall: f64::INFINITY }
    }

    fn residual([x, y]: [f64; 2]) -> [f64; 2] {
        [10.0 * (y - x * x), 1.0 - x]
    }

    fn cost_at(at: [f64; 2]) -> f64 {
        0.5 * Self::residual(at).iter().map(|r| r * r).sum::<f64>()
    }
}

impl Problem for Valley {
    type Error = Error;

    fn unknowns(&self) -> usize {
        2
    }

    fn cost(&mut self) -> Result<f64, Error> {
        Ok(Self::cost_at(self.at))
    }

    fn linearise(&mut self, equations: &mut NormalEquations) -> Result<bool, Error> {
        let jacobian = [[-20.0 * self.at[0], 10.0], [-1.0, 0.0]];
        let residual = Self::residual(self.at);
        for a in 0..2 {
            equations.right[a] = -(0..2).map(|row| jacobian[row][a] * residual[row]).sum::<f64>();
            for b in 0..2 {
                equations.normal[2 * a + b] = (0..2).map(|row| jacobian[row][a] * jacobian[row][b]).sum();
            }
        }
        Ok(true)
    }

    fn try_step(&mut self, step: &[f64]) -> Result<Option<Trial>, Error> {
        self.tried = [self.at[0] + step[0], self.at[1] + step[1]];
        let trial = Trial { cost: Self::cost_at(self.tried), moved: step[0].hypot(step[1]) };
        Ok((self.tried[0] <= self.wall).then_some(trial))
    }

    fn accept(&mut self) {
        self.at = self.tried;
    }
}

fn distance(valley: &Valley) -> f64 {
    (valley.at[0] - 1.0).hypot(valley.at[1] - 1.0)
}

#[test]
fn damped_and_shortened_steps_reach_the_end_of_the_valley() {
    let settles = Tolerances { moved: Some(1e-9), ..Tolerances::default() };
    for control in [Control::Damping(Damping::default()), Control::Shortening { factor: 0.5 }] {
        let (mut valley, mut scratch) = (Valley::new(), Scratch::new(2));
        let params = Params { control, tolerances: settles, ..Params::default() };
        let info = minimise(&mut valley, &params, &mut scratch).unwrap();
        assert_eq!(info.outcome, Outcome::Settled, "{info:?}");
        assert!(distance(&valley) < 1e-8, "{:?}", valley.at);
        assert!(info.steps <= info.trials && info.linearisations <= info.trials && info.cost < 1e-16, "{info:?}");
    }
}

#[test]
fn the_last_steps_lower_the_cost_as_predicted() {
    let tolerances = Tolerances { agreement: Some(1e-6), predicted: Some(1e-6), ..Tolerances::default() };
    let (mut valley, mut scratch) = (Valley::new(), Scratch::default());
    let info = minimise(&mut valley, &Params { tolerances, ..Params::default() }, &mut scratch).unwrap();
    assert_eq!(info.outcome, Outcome::Settled);
    assert!((info.actual - info.predicted).abs() < 1e-6 || info.predicted < 1e-6, "{info:?}");
}

#[test]
fn limits_end_a_fit_where_it_is() {
    let mut valley = Valley::new();
    let before = Valley::cost_at(valley.at);
    let info = minimise(&mut valley, &Params { most_trials: 3, ..Params::default() }, &mut Scratch::default()).unwrap();
    assert_eq!((info.outcome, info.trials), (Outcome::Limit, 3));
    assert!(info.cost < before && info.cost == Valley::cost_at(valley.at));
    let params = Params { most_linearisations: 2, ..Params::default() };
    let info = minimise(&mut Valley::new(), &params, &mut Scratch::default()).unwrap();
    assert_eq!((info.outcome, info.linearisations), (Outcome::Limit, 2));
}

#[test]
fn a_fit_without_a_useful_step_stalls() {
    let mut valley = Valley { wall: -5.0, ..Valley::new() };
    let info = minimise(&mut valley, &Params::default(), &mut Scratch::default()).unwrap();
    assert_eq!((info.outcome, info.steps, valley.at), (Outcome::Stalled, 0, [-1.2, 1.0]));
    let params = Params { most_rejections: 4, ..Params::default() };
    let info = minimise(&mut valley, &params, &mut Scratch::default()).unwrap();
    assert_eq!((info.outcome, info.trials, info.linearisations), (Outcome::Stalled, 4, 1));
    let control = Control::Damping(Damping { refused: None, ..Damping::default() });
    let info = minimise(&mut valley, &Params { control, ..Params::default() }, &mut Scratch::default()).unwrap();
    assert_eq!(info.outcome, Outcome::Unsolvable);
}

#[test]
fn a_factor_solves_and_indefinite_matrices_are_detected() {
    let equations = NormalEquations { normal: vec![4.0, 2.0, 2.0, 3.0], right: vec![2.0, -1.0] };
    let (mut factor, mut step) = (vec![0.0; 4], vec![0.0; 2]);
    assert!(equations.solve_damped(0.0, &mut factor, &mut step));
    // Exact up to the floor of 1e-12.
    assert!((step[0] - 1.0).abs() < 1e-11 && (step[1] + 1.0).abs() < 1e-11, "{step:?}");
    let indefinite = NormalEquations { normal: vec![1.0, 2.0, 2.0, 1.0], right: vec![0.0; 2] };
    assert!(!indefinite.solve_damped(0.0, &mut factor, &mut step));
}

#[test]
fn impossible_parameters_are_named() {
    let params = Params { control: Control::Shortening { factor: 1.0 }, ..Params::default() };
    let error = minimise(&mut Valley::new(), &params, &mut Scratch::default()).unwrap_err();
    assert_eq!(error.to_string(), "factor of a least-squares fit = 1: expected above 0 and below 1");
    let damping = Damping { increase: f64::NAN, ..Damping::default() };
    assert!(Params { control: Control::Damping(damping), ..Params::default() }.check().is_err());
}
