//! Drift over a session. Compares two errors: the first half of the pokes, in the order they were made, predicting
//! the second half, and every other poke predicting those in between.

use super::features::Features;
use super::inverse::{Memory, Regression};
use super::report::Accuracy;
use crate::locator::data::{Examples, MIN_EXAMPLES};
use crate::locator::error::LocatorError;
use crate::plane::distance;
use crate::statistics::evenly;

/// Maximum number of pokes used. The statistic needs no more, and its time grows with their cube.
const MOST: usize = 2000;

/// Result of [`SessionDrift::measure`].
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SessionDrift {
    /// Errors in the second half of the session, as located from the first half.
    pub later: Accuracy,
    /// Errors of every other poke, as located from those in between.
    pub interleaved: Accuracy,
    /// Ratio of the medians, later to interleaved: about 1 without drift.
    pub ratio: f64,
    /// Mean difference of the logarithms of the errors over its standard error. Above 3 there is drift.
    pub z: f64,
}

impl SessionDrift {
    /// Measures the drift of examples in the order they were made. Uses only the inverse expert.
    ///
    /// # Errors
    /// Fewer than twenty examples, or examples that cannot be fitted.
    pub fn measure(examples: &Examples) -> Result<Self, LocatorError> {
        let n = examples.len();
        if n < 4 * MIN_EXAMPLES {
            return Err(LocatorError::Count { field: "examples in a session", got: n, expected: "at least 20" });
        }
        let features = Features::new(examples)?;
        let mut unit = vec![0.0; examples.channels];
        let mut rows = Vec::with_capacity(n.min(MOST));
        let mut places = Vec::with_capacity(n.min(MOST));
        for i in evenly(n, MOST) {
            features.unit(&examples.frames[i * unit.len()..(i + 1) * unit.len()], &mut unit)?;
            let mut row = vec![0.0; features.inverse_len()];
            Features::inverse(&unit, &mut row);
            rows.push(row);
            places.push(examples.positions_m[i]);
        }
        let n = rows.len();
        let first: Vec<usize> = (0..n / 2).collect();
        let second: Vec<usize> = (n / 2..n).collect();
        let even: Vec<usize> = (0..n).step_by(2).collect();
        let odd: Vec<usize> = (1..n).step_by(2).collect();
        let later = errors(&rows, &places, &first, &second)?;
        let between = errors(&rows, &places, &even, &odd)?;
        let (a, b) = (moments(&later.1), moments(&between.1));
        Ok(Self {
            later: later.0,
            interleaved: between.0,
            ratio: later.0.median_m / between.0.median_m.max(f64::MIN_POSITIVE),
            z: (a.0 - b.0) / (a.1 + b.1).sqrt().max(f64::MIN_POSITIVE),
        })
    }
}

/// Errors of `tested` as located from `learnt`, and their logarithms.
fn errors(
    rows: &[Vec<f64>],
    places: &[[f64; 2]],
    learnt: &[usize],
    tested: &[usize],
) -> Result<(Accuracy, Vec<f64>), LocatorError> {
    let some: Vec<Vec<f64>> = learnt.iter().map(|&i| rows[i].clone()).collect();
    let there: Vec<[f64; 2]> = learnt.iter().map(|&i| places[i]).collect();
    let all: Vec<usize> = (0..learnt.len()).collect();
    let (regression, _) = Regression::fit(&some, &there, super::inverse_fit::PLAIN_RANK, &all, None)?;
    let mut memory = Memory::default();
    let mut found = Vec::with_capacity(tested.len());
    for &i in tested {
        let row: Vec<f32> = rows[i].iter().map(|v| *v as f32).collect();
        found.push(regression.guess(&row, &mut memory, None).mean_m);
    }
    let truth: Vec<[f64; 2]> = tested.iter().map(|&i| places[i]).collect();
    let logarithms = found.iter().zip(&truth).map(|(a, b)| distance(*a, *b).max(1e-12).ln()).collect();
    Ok((Accuracy::of(found.iter().copied(), &truth), logarithms))
}

/// Mean, and the square of its standard error.
fn moments(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (mean, values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n * (n - 1.0).max(1.0)))
}
