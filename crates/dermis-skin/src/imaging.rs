//! Settings in a skin file for turning difference data into images.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::Checker;
use crate::error::Error;
use crate::refinement::Refinement;

/// Settings for turning difference data into images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Imaging {
    /// Pixels along the longer side.
    pub grid: usize,
    /// Number of elements of the reconstruction mesh.
    pub elements: usize,
    /// Prior of an image.
    pub prior: PriorChoice,
    /// Unknowns that are solved for.
    pub solve: Solve,
    /// How to choose lambda.
    pub hyperparameter: HyperparameterChoice,
    /// Weight of each channel.
    pub weights: WeightChoice,
    /// How to match the measured baseline to the model.
    pub gain: GainMatch,
    /// Sign of conductivity change shown as positive.
    pub polarity: Polarity,
    /// Refinement steps for offline images of large contrasts; live images are always linear.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refinement: Option<Refinement>,
}

impl Default for Imaging {
    fn default() -> Self {
        Self {
            grid: 64,
            elements: 4000,
            prior: PriorChoice::default(),
            solve: Solve::default(),
            hyperparameter: HyperparameterChoice::default(),
            weights: WeightChoice::default(),
            gain: GainMatch::default(),
            polarity: Polarity::default(),
            refinement: None,
        }
    }
}

/// Unknowns that are solved for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Solve {
    /// Pixels, by one linear operator.
    #[default]
    Pixels,
    /// The lift-off of every element of a magnetic induction skin, by a nonlinear fit.
    LiftOff,
}

/// Priors by name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PriorChoice {
    /// Zeroth-order Tikhonov.
    Identity,
    /// Graph Laplacian of the pixels.
    Laplace,
    /// NOSER with this exponent.
    Noser(f64),
    /// Gaussian smoothness with this correlation length, mm.
    GaussianMm(f64),
    /// Gaussian smoothness balanced by sensitivity.
    Balanced {
        /// Correlation length relative to half the shorter side of the skin.
        relative_length: f64,
        /// NOSER exponent of the balance.
        exponent: f64,
    },
    /// Weighted sum.
    Mixture(Vec<MixturePart>),
}

impl Default for PriorChoice {
    fn default() -> Self {
        PriorChoice::Balanced { relative_length: 0.2, exponent: 1.0 }
    }
}

/// A part of a mixture of priors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MixturePart {
    /// Weight of this part.
    pub weight: f64,
    /// The prior.
    pub prior: PriorChoice,
}

/// Rules for the hyperparameter, by name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum HyperparameterChoice {
    /// A fixed lambda.
    Number(f64),
    /// lambda^2 relative to the mean eigenvalue of the data-space matrix.
    Relative(f64),
    /// Corner of the L-curve of the given frames.
    LCurve,
    /// Generalised cross-validation on the given frames.
    Gcv,
    /// Noise figure for a small touch in the middle.
    NoiseFigure(f64),
    /// Expected mean squared whitened residual of the given frames.
    KnownNoise(f64),
}

impl Default for HyperparameterChoice {
    fn default() -> Self {
        HyperparameterChoice::Relative(0.1)
    }
}

/// Weight of each channel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum WeightChoice {
    /// Equal weights.
    Identity,
    /// Model and instrument error as a floor plus a share of the channel: standard deviation
    /// `sqrt((floor max|v|)^2 + (share v)^2)` for model voltages v.
    FloorAndShare {
        /// Relative to the largest voltage.
        floor: f64,
        /// Relative to the channel's own voltage.
        share: f64,
    },
    /// Standard deviations of the baseline frames, with this floor.
    Measured {
        /// Relative to the largest voltage.
        floor: f64,
    },
    /// Full covariance of the baseline frames, shrunk towards its diagonal.
    MeasuredFull,
    /// Disagreement of reciprocal channels in the baseline.
    Reciprocity {
        /// Relative to the largest voltage.
        floor: f64,
    },
}

impl Default for WeightChoice {
    fn default() -> Self {
        WeightChoice::FloorAndShare { floor: 0.02, share: 0.1 }
    }
}

/// How to match a measured baseline to the model before differences are imaged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum GainMatch {
    /// One factor for the whole frame (unknown gain or conductivity).
    #[default]
    Global,
    /// One factor for the whole frame, from a regression with an intercept. The instrument's offset cancels in
    /// differences but would bias the factor.
    GlobalWithOffset,
    /// One factor per drive (drive amplitudes differ).
    Drive,
    /// One factor per channel: normalised differences, v/v0 - 1.
    Channel,
}

/// Sign of conductivity change that counts as positive in images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Polarity {
    /// A touch raises conductivity.
    #[default]
    RaisesConductivity,
    /// A touch lowers conductivity.
    LowersConductivity,
}

impl Polarity {
    /// +1 or -1.
    pub fn sign(self) -> f64 {
        match self {
            Polarity::RaisesConductivity => 1.0,
            Polarity::LowersConductivity => -1.0,
        }
    }
}

impl Imaging {
    /// Checks the table. `coils`: the skin has coils and elements; `circuit`: it has a readout circuit.
    pub(crate) fn check(&self, coils: bool, circuit: bool, checker: &Checker<'_>) -> Result<(), Error> {
        if !(4..=512).contains(&self.grid) {
            return Err(checker.refused("imaging.grid", self.grid, "4 to 512 pixels"));
        }
        if !(50..=500_000).contains(&self.elements) {
            return Err(checker.refused("imaging.elements", self.elements, "50 to 500000 elements"));
        }
        self.prior.check(0, checker)?;
        match &self.hyperparameter {
            HyperparameterChoice::Number(value)
            | HyperparameterChoice::Relative(value)
            | HyperparameterChoice::NoiseFigure(value)
            | HyperparameterChoice::KnownNoise(value) => {
                checker.within("imaging.hyperparameter", *value, 1e-30, 1e30)?;
            }
            HyperparameterChoice::LCurve | HyperparameterChoice::Gcv => {}
        }
        match self.weights {
            WeightChoice::FloorAndShare { floor, share } => {
                // Without a floor, a channel that reads zero would have infinite weight.
                checker.within("imaging.weights.floor-and-share.floor", floor, 1e-12, 1e3)?;
                checker.within("imaging.weights.floor-and-share.share", share, 0.0, 1e3)?;
            }
            WeightChoice::Measured { floor } | WeightChoice::Reciprocity { floor } => {
                checker.within("imaging.weights.floor", floor, 1e-12, 1e3)?;
            }
            WeightChoice::Identity | WeightChoice::MeasuredFull => {}
        }
        if coils && self.refinement.is_some() {
            let expected = "none with layer.kind = \"elements\"";
            return Err(checker.refused("imaging.refinement", "given", expected));
        }
        if !coils && self.solve == Solve::LiftOff {
            let expected = "pixels, except with layer.kind = \"elements\"";
            return Err(checker.refused("imaging.solve", "lift-off", expected));
        }
        self.refinement.as_ref().map_or(Ok(()), |refinement| refinement.check(circuit, checker))
    }
}

impl PriorChoice {
    pub(crate) fn check(&self, depth: usize, checker: &Checker<'_>) -> Result<(), Error> {
        match self {
            Self::Identity | Self::Laplace => Ok(()),
            Self::Noser(exponent) => checker.within("imaging.prior.noser", *exponent, 0.0, 10.0),
            Self::GaussianMm(length) => checker.within("imaging.prior.gaussian-mm", *length, 1e-3, 1e4),
            Self::Balanced { relative_length, exponent } => {
                checker.within("imaging.prior.balanced.relative_length", *relative_length, 1e-3, 10.0)?;
                checker.within("imaging.prior.balanced.exponent", *exponent, 0.0, 10.0)
            }
            Self::Mixture(parts) => {
                checker.count("imaging.prior.mixture", parts.len(), 1, 16)?;
                if depth >= 4 {
                    let expected = "mixtures nested at most four deep";
                    return Err(checker.refused("imaging.prior.mixture", "nested deeper", expected));
                }
                parts.iter().try_for_each(|part| {
                    checker.within("imaging.prior.mixture.weight", part.weight, 1e-30, 1e30)?;
                    part.prior.check(depth + 1, checker)
                })
            }
        }
    }
}
