//! The nonlinear part of the response near the spots for which it was last computed: its value there, and derivatives
//! learnt from the steps of fits.

use super::spot::{OF_SPOT, State};
use crate::inner_product;

/// Farthest move of a spot for which derivatives are kept, in its radii, and largest change of its log radius.
const NEAR: f64 = 0.5;
/// The nonlinear part is extrapolated if it changes by two standard deviations of the noise at most, and the whole
/// response by five; both are squared here. Errors of presses on gel, foam and liquid are the same as with 1 and 3.
const LITTLE: f32 = 4.0;
const LITTLE_IN_ALL: f32 = 25.0;

/// The nonlinear part of the response near some spots.
#[derive(Clone, Debug, Default)]
pub(super) struct Beyond {
    length: usize,
    at: Vec<State>,
    /// The nonlinear and the linear part of the response to these spots.
    value: Vec<f32>,
    linear: Vec<f32>,
    /// Derivatives of the nonlinear part, one column per parameter, and what the responses to each parameter weigh.
    slopes: Vec<f32>,
    weights: Vec<f32>,
    /// The step to the spots asked for last, and the changes that it causes.
    step: Vec<f32>,
    change: Vec<f32>,
    at_step: Vec<f32>,
}

impl Beyond {
    /// Nothing known yet, of `length` values for at most `spots` spots.
    pub fn new(length: usize, spots: usize) -> Self {
        let parameters = OF_SPOT * spots;
        let empty = || vec![0.0; length];
        Self {
            length,
            at: Vec::with_capacity(spots),
            value: empty(),
            linear: empty(),
            slopes: vec![0.0; length * parameters],
            weights: vec![0.0; parameters],
            step: Vec::with_capacity(parameters),
            change: empty(),
            at_step: empty(),
        }
    }

    /// Derivatives by one parameter.
    pub fn slope(&self, parameter: usize) -> &[f32] {
        &self.slopes[parameter * self.length..(parameter + 1) * self.length]
    }

    /// Sets the weight of a parameter in steps: the square of the response to it.
    pub fn weigh(&mut self, parameter: usize, response: &[f32]) {
        self.weights[parameter] = inner_product(response, response);
    }

    /// Extrapolates the nonlinear part of the response to these spots; `None` if it may differ by more than noise does.
    /// `rows` are the responses to single spots of amplitude 1 and their derivatives.
    pub fn extrapolated(&mut self, to: &[State], rows: &[f32]) -> Option<()> {
        self.at_step.fill(0.0);
        for (state, row) in to.iter().zip(rows.chunks_exact(OF_SPOT * self.length)) {
            let amplitude = state.amplitude as f32;
            self.at_step.iter_mut().zip(row).for_each(|(sum, value)| *sum += amplitude * value);
        }
        self.change.fill(0.0);
        self.step.clear();
        if !self.is_near(to) {
            return None;
        }
        self.step.extend(self.at.iter().zip(to).flat_map(|(from, to)| from.step_to(to)).map(|value| value as f32));
        for (step, slope) in self.step.iter().zip(self.slopes.chunks_exact(self.length)) {
            self.change.iter_mut().zip(slope).for_each(|(sum, value)| *sum += step * value);
        }
        let in_all = self.change.iter().zip(&self.at_step).zip(&self.linear);
        let in_all: f32 = in_all.map(|((change, to), from)| (change + to - from).powi(2)).sum();
        if inner_product(&self.change, &self.change) > LITTLE || in_all > LITTLE_IN_ALL {
            return None;
        }
        self.change.iter_mut().zip(&self.value).for_each(|(change, value)| *change += value);
        Some(())
    }

    /// The part that was extrapolated last.
    pub fn last(&self) -> &[f32] {
        &self.change
    }

    /// Learns the nonlinear part of the response to the spots asked for last: corrects the derivatives by what the step
    /// has changed, in the direction of the step (Broyden, Math. Comp. 19, 1965, 577, eq. 4.5).
    pub fn learn(&mut self, at: &[State], value: &[f32]) {
        let square: f32 = self.step.iter().zip(&self.weights).map(|(step, weight)| weight * step * step).sum();
        if self.step.is_empty() {
            self.slopes.fill(0.0);
        } else if square > 0.0 && square.is_finite() {
            // The part that the derivatives missed.
            for ((change, to), from) in self.change.iter_mut().zip(value).zip(&self.value) {
                *change = to - from - *change;
            }
            for (k, slope) in (0..self.step.len()).zip(self.slopes.chunks_exact_mut(self.length)) {
                let share = self.weights[k] * self.step[k] / square;
                slope.iter_mut().zip(&self.change).for_each(|(slope, change)| *slope += share * change);
            }
        }
        self.at.clear();
        self.at.extend_from_slice(at);
        self.value.copy_from_slice(value);
        self.linear.copy_from_slice(&self.at_step);
    }

    /// True if derivatives at the last spots are roughly those at these.
    fn is_near(&self, to: &[State]) -> bool {
        let is_near = |from: &State, to: &State| {
            let [x, y, _, wider] = from.step_to(to);
            x.hypot(y) <= NEAR * from.log_radius.exp() && wider.abs() <= NEAR && from.amplitude * to.amplitude > 0.0
        };
        !to.is_empty() && self.at.len() == to.len() && self.at.iter().zip(to).all(|(from, to)| is_near(from, to))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_part_is_extrapolated_once_steps_have_shown_it() {
        // The nonlinear part as a linear function of amplitude and log radius; the response is the amplitude.
        let part = |state: &State| {
            let [_, _, amplitude, wider] = State { amplitude: 1.0, ..State::default() }.step_to(state);
            [amplitude + 2.0 * wider, -0.5 * wider].map(|value| value as f32)
        };
        let rows = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let state = |amplitude, log_radius| State { amplitude, log_radius, ..State::default() };
        let mut beyond = Beyond::new(2, 3);
        for parameter in 0..4 {
            beyond.weigh(parameter, &[1.0 + parameter as f32, 0.0]);
        }
        for at in [state(1.0, 0.0), state(200.0, 0.0), state(200.0 * 0.04_f64.exp(), -0.02)] {
            assert!(beyond.extrapolated(&[at], &rows).is_none());
            beyond.learn(&[at], &part(&at));
        }
        let near = state(208.6, -0.0202);
        beyond.extrapolated(&[near], &rows).unwrap();
        let expected = part(&near);
        // The amplitude is that at the radius of the last spots, which is 2 % less than at first.
        assert!(beyond.last().iter().zip(expected).all(|(value, expected)| (value - expected).abs() < 0.02));
        // Changes that noise would not hide, other spots, and moves beyond half a radius are computed.
        assert!(beyond.extrapolated(&[state(220.0, -0.0202)], &rows).is_none());
        assert!(beyond.extrapolated(&[near, near], &[rows, rows].concat()).is_none());
        assert!(beyond.extrapolated(&[State { position_m: [0.6, 0.0], ..near }], &rows).is_none());
    }
}
