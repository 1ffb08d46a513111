//! Inverse operators: `x = (J'WJ + lambda^2 R)^-1 J'W dv` in its cheapest form, the choice of its hyperparameter,
//! operation without some channels, and uncertainty.
//! `J` is channels x unknowns (pixels or elements), `W` the inverse noise covariance of the channels, `R` the prior's
//! inverse covariance up to `lambda^2` (the hyperparameter enters squared, as in EIDORS), `dv` the difference data.

mod about_guess;
mod error;
mod greit;
mod hyperparameter;
mod leave_one_out_residual;
mod linear;
mod measured;
mod missing;
mod nonlinear;
mod parametric;
mod prior;
mod quantised_operator;
mod reciprocity;
mod self_calibration;
mod smooth_covariance;
mod spectrum;
mod total_variation;
mod weighting;

pub use about_guess::{Guess, GuessCorrelations};
pub(crate) use error::check_finite;
pub use error::{InverseError, check_hyperparameter};
pub use greit::{Greit, GreitSpec};
pub use hyperparameter::Hyperparameter;
pub use leave_one_out_residual::LeaveOneOutResidual;
pub use linear::{DataPrecision, LinearProblem, Operator};
pub use measured::MeasuredJacobian;
pub use missing::MissingChannels;
pub use nonlinear::{GaussNewton, GaussNewtonResult, NonlinearProblem, ReducedChannels};
pub use parametric::{
    ChangeResponse, FitOutcome, FitScratch, Spot, SpotFilter, SpotModel, SpotOptions, SpotProposal, SpotShape,
};
pub use prior::{ImageBasis, MOST_NESTED, Prior, PriorMatrix};
pub use quantised_operator::QuantisedOperator;
pub use self_calibration::{
    CalibrationOptions, LEAST_CALIBRATION_FRAMES, MatchedPair, MatchedTouch, PairSearch, SelfCalibration, TouchEffect,
    TouchTemplates,
};
pub use smooth_covariance::SmoothCovariance;
pub use spectrum::{LCurvePoint, Spectrum};
pub use total_variation::{TotalVariation, TotalVariationResult};
pub use weighting::Weighting;
