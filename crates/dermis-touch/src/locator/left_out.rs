//! Summary of the examples that were left out one by one.

use super::data::{LeaveOneOut, LeftOut};
use super::posterior::{Trial, log_student, quantile};

impl LeaveOneOut {
    /// Mean log density of the true coordinates (metres) under a Student t with 4 degrees of freedom and the predicted
    /// standard deviations, so that an outlier costs little more than a miss; without constants.
    pub fn mean_log_density(&self) -> f64 {
        let density = |example: &LeftOut, axis: usize| {
            log_student(example.located_m[axis] - example.position_m[axis], example.sigma_m[axis])
        };
        let sum: f64 = self.examples.iter().map(|example| density(example, 0) + density(example, 1)).sum();
        sum / (2 * self.examples.len()).max(1) as f64
    }

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
