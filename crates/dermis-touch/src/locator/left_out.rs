//! Summary of the examples that were left out one by one.

use super::data::{LeaveOneOut, LeftOut};
use super::posterior::{Trial, quantile};

impl LeaveOneOut {
    /// Summarises left-out examples: their positions as located by the others, and the standard deviations stated for
    /// them, metres.
    pub(super) fn of(
        truth: &[[f64; 2]],
        trials: &[Trial],
        sigma_m: impl Fn(&Trial) -> [f64; 2],
        misfits: &[f64],
        physics_cosine: f64,
        load_error: Option<f64>,
    ) -> Self {
        let usual = quantile(misfits, 0.95);
        let example = |(i, trial): (usize, &Trial)| LeftOut {
            position_m: truth[i],
            located_m: [0, 1].map(|axis| truth[i][axis] + trial.error_m[axis]),
            sigma_m: sigma_m(trial),
            error_m: trial.error_m[0].hypot(trial.error_m[1]),
            novelty: misfits[i] / usual,
        };
        let examples: Vec<LeftOut> = trials.iter().enumerate().map(example).collect();
        let errors: Vec<f64> = examples.iter().map(|e| e.error_m).collect();
        let within = |axis: usize| {
            let inside = |e: &&LeftOut| (e.located_m[axis] - e.position_m[axis]).abs() <= e.sigma_m[axis];
            examples.iter().filter(inside).count() as f64 / examples.len() as f64
        };
        Self {
            median_error_m: quantile(&errors, 0.5),
            p90_error_m: quantile(&errors, 0.9),
            coverage: [within(0), within(1)],
            physics_cosine,
            load_error,
            examples,
        }
    }
}
