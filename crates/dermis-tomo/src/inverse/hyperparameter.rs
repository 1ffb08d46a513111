//! Choice of lambda: as a number, relative to the problem, or by L-curve, generalised cross-validation (GCV), noise
//! figure or known noise level. All use the eigenvalues of the whitened data-space matrix `W^1/2 J P J' W^1/2'`, so
//! one decomposition serves every candidate.

use faer::Mat;

use super::error::positive;
use super::{InverseError, LCurvePoint, LinearProblem, Spectrum};

/// Rule for the hyperparameter.
#[derive(Clone, Debug, PartialEq)]
pub enum Hyperparameter {
    /// A fixed lambda.
    Number(f64),
    /// `lambda^2 = factor * trace(W^1/2 J P J' W^1/2') / channels`. Scale-free: one factor suits skins of any unit,
    /// gain or number of channels.
    Relative(f64),
    /// Corner (largest curvature) of log residual against log solution norm (Hansen, SIAM Rev. 34, 1992).
    LCurve,
    /// Minimum of the GCV function (Golub, Heath and Wahba, Technometrics 21, 1979).
    Gcv,
    /// Ratio of data SNR to image SNR for a small target (Adler and Guardo, IEEE TMI 15, 1996).
    NoiseFigure {
        /// Target figure; 0.5 to 1 is customary.
        target: f64,
        /// Noise-free difference data of the target, e.g. a small central touch.
        signal: Vec<f64>,
    },
    /// Discrepancy principle (Morozov): the mean squared whitened residual equals `factor` (1 if W is the true
    /// inverse noise covariance).
    KnownNoise {
        /// Expected mean squared residual of whitened data.
        factor: f64,
    },
}

impl Hyperparameter {
    /// Applies the rule. `data` are difference frames; rules that do not use data ignore them.
    ///
    /// # Errors
    /// A number that is not positive, missing data, or an unreachable noise figure.
    pub fn choose(&self, problem: &LinearProblem, data: &[Vec<f64>]) -> Result<f64, InverseError> {
        match self {
            Hyperparameter::Number(value) => positive("hyperparameter", *value),
            Hyperparameter::Relative(factor) => {
                let factor = positive("relative hyperparameter", *factor)?;
                Ok((factor * problem.gram_trace()? / problem.channels() as f64).sqrt())
            }
            Hyperparameter::LCurve => l_curve_corner(&problem.spectrum()?, &problem.whiten_all(data)?),
            Hyperparameter::Gcv => {
                let spectrum = problem.spectrum()?;
                let components: Vec<_> = problem.whiten_all(data)?.iter().map(|d| spectrum.components(d)).collect();
                let score = |lambda: f64| components.iter().map(|c| spectrum.gcv(c, lambda)).sum::<f64>();
                let best = spectrum.candidates().into_iter().min_by(|a, b| score(*a).total_cmp(&score(*b)));
                Ok(best.unwrap_or(1.0))
            }
            Hyperparameter::KnownNoise { factor } => {
                let factor = positive("expected squared residual", *factor)?;
                let spectrum = problem.spectrum()?;
                let components: Vec<_> = problem.whiten_all(data)?.iter().map(|d| spectrum.components(d)).collect();
                let count = (components.len() * problem.channels()) as f64;
                let residual = |l: f64| components.iter().map(|c| spectrum.residual_squared(c, l)).sum::<f64>() / count;
                // The smoothest candidate that explains the data; the sharpest if none does.
                let candidates = spectrum.candidates();
                let found = candidates.iter().find(|&&lambda| residual(lambda) <= factor);
                Ok(found.or(candidates.last()).copied().unwrap_or(1.0))
            }
            Hyperparameter::NoiseFigure { target, signal } => {
                noise_figure_search(problem, positive("noise figure", *target)?, signal)
            }
        }
    }
}

fn l_curve_corner(spectrum: &Spectrum, data: &[Vec<f64>]) -> Result<f64, InverseError> {
    let curves: Vec<Vec<LCurvePoint>> = data.iter().map(|d| spectrum.l_curve(d)).collect();
    let candidates = spectrum.candidates();
    let mean_log = |k: usize, of: &dyn Fn(&LCurvePoint) -> f64| {
        curves.iter().map(|curve| of(&curve[k]).max(1e-300).ln()).sum::<f64>() / curves.len() as f64
    };
    let points: Vec<(f64, f64)> =
        (0..candidates.len()).map(|k| (mean_log(k, &|p| p.residual), mean_log(k, &|p| p.solution))).collect();
    // Curvature by central differences over uniform steps of log lambda.
    let curvature = |k: usize| {
        let (a, b, c) = (points[k - 2], points[k], points[k + 2]);
        let (d1, d2) =
            (((c.0 - a.0) / 4.0, (c.1 - a.1) / 4.0), ((a.0 - 2.0 * b.0 + c.0) / 4.0, (a.1 - 2.0 * b.1 + c.1) / 4.0));
        (d1.0 * d2.1 - d1.1 * d2.0) / (d1.0 * d1.0 + d1.1 * d1.1).powf(1.5).max(1e-12)
    };
    let corner = (2..points.len() - 2).max_by(|&a, &b| curvature(a).abs().total_cmp(&curvature(b).abs()));
    Ok(candidates[corner.unwrap_or(candidates.len() / 2)])
}

/// Bisection over log lambda: the noise figure falls as lambda grows.
fn noise_figure_search(problem: &LinearProblem, target: f64, signal: &[f64]) -> Result<f64, InverseError> {
    let candidates = problem.spectrum()?.candidates();
    let (mut high, mut low) = (candidates[0], candidates[candidates.len() / 2]);
    let (figure_high, figure_low) = (problem.noise_figure(high, signal)?, problem.noise_figure(low, signal)?);
    if !(figure_high <= target && target <= figure_low) {
        return Err(InverseError::NoiseFigure { target, low: figure_high, high: figure_low });
    }
    for _ in 0..40 {
        let middle = (high * low).sqrt();
        if problem.noise_figure(middle, signal)? > target {
            low = middle;
        } else {
            high = middle;
        }
        if high / low < 1.001 {
            break;
        }
    }
    Ok((high * low).sqrt())
}

impl LinearProblem {
    /// Chooses the hyperparameter by the given rule. `data` (difference data of example frames) is used by rules that
    /// need data.
    ///
    /// # Errors
    /// See [`Hyperparameter`].
    pub fn choose(&self, rule: &Hyperparameter, data: &[Vec<f64>]) -> Result<f64, InverseError> {
        rule.choose(self, data)
    }

    /// `W^1/2 dv`, with the frame checked.
    pub(super) fn whiten_frame(&self, frame: &[f64]) -> Result<Vec<f64>, InverseError> {
        if frame.len() != self.channels() {
            return Err(InverseError::Size {
                what: "channels of the frame",
                expected: self.channels(),
                got: frame.len(),
            });
        }
        super::check_finite("channel", frame)?;
        let mut column = Mat::from_fn(frame.len(), 1, |row, _| frame[row]);
        self.weighting.whiten(column.as_mut());
        Ok((0..frame.len()).map(|row| column[(row, 0)]).collect())
    }

    fn whiten_all(&self, data: &[Vec<f64>]) -> Result<Vec<Vec<f64>>, InverseError> {
        if data.is_empty() {
            return Err(InverseError::Size {
                what: "frames for the choice of the hyperparameter",
                expected: 1,
                got: 0,
            });
        }
        data.iter().map(|frame| self.whiten_frame(frame)).collect()
    }

    /// Noise figure at lambda for a target's data: `(mean|z| / mean std z) / (mean|x| / mean std x)` with whitened
    /// data z and image x (Adler and Guardo 1996, eq. 14; here with unit noise on every whitened channel).
    ///
    /// # Errors
    /// As [`LinearProblem::operator`].
    pub fn noise_figure(&self, hyperparameter: f64, signal: &[f64]) -> Result<f64, InverseError> {
        let operator = self.operator(hyperparameter)?;
        let image = operator.apply(signal)?;
        let whitened = self.whiten_frame(signal)?;
        let mean_abs = |values: &[f64]| values.iter().map(|v| v.abs()).sum::<f64>() / values.len() as f64;
        let image_noise = operator.noise_deviation.iter().sum::<f64>() / operator.noise_deviation.len() as f64;
        Ok(mean_abs(&whitened) / (mean_abs(&image) / image_noise))
    }
}
