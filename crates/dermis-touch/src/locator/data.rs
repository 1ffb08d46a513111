//! Inputs and outputs of a locator: pokes with known positions, predicted signatures over the skin, options, and
//! located touches. Plain arrays in SI units, independent of how they were obtained.

use super::error::{LocatorError, check_finite, check_length, check_positions};

/// Minimum number of examples for fitting a locator; leave-one-out is meaningless for fewer.
pub const MIN_EXAMPLES: usize = 5;
/// Minimum number of usable channels in a frame.
pub const MIN_CHANNELS: usize = 3;

/// Pokes at known positions: what the skin measured, and where it was touched.
///
/// A frame holds difference data, either v - v0 or v/v0 - 1, but the same here, in the [`SignatureMap`] and at
/// prediction. A channel that was not measured is NaN.
#[derive(Debug, Clone, PartialEq)]
pub struct Examples {
    pub(super) channels: usize,
    pub(super) frames: Vec<f64>,
    pub(super) positions_m: Vec<[f64; 2]>,
    pub(super) loads: Option<Vec<f64>>,
    pub(super) channel_noise: Option<Vec<f64>>,
    /// Number of examples, the last ones, of an earlier session.
    pub(super) earlier: usize,
}

impl Examples {
    /// Takes `frames`, row-major, one row of `channels` values for each of `positions_m` (x, y in metres).
    ///
    /// # Errors
    /// Fewer than [`MIN_EXAMPLES`] examples or [`MIN_CHANNELS`] channels, lengths that do not match, an infinite
    /// value, or a position that is not finite.
    pub fn new(channels: usize, frames: Vec<f64>, positions_m: Vec<[f64; 2]>) -> Result<Self, LocatorError> {
        check_channels(channels)?;
        let count = positions_m.len();
        if count < MIN_EXAMPLES {
            return Err(LocatorError::Count { field: "examples", got: count, expected: "at least 5" });
        }
        check_length("frames", count * channels, frames.len())?;
        check_positions("positions_m", &positions_m)?;
        if let Some(index) = frames.iter().position(|v| v.is_infinite()) {
            let expected = "a finite number, or NaN where the channel is missing";
            return Err(LocatorError::Value { field: "frames", index, value: frames[index], expected });
        }
        Ok(Self { channels, frames, positions_m, loads: None, channel_noise: None, earlier: 0 })
    }

    /// Adds the load of each poke: a force in newtons, a depth in metres, or any other positive quantity that grows
    /// with the amplitude of the frame. The locator then estimates the same quantity.
    ///
    /// # Errors
    /// Different numbers of loads and examples, or a load that is not finite and positive.
    pub fn with_loads(mut self, loads: Vec<f64>) -> Result<Self, LocatorError> {
        check_length("loads", self.len(), loads.len())?;
        if let Some(index) = loads.iter().position(|v| !(v.is_finite() && *v > 0.0)) {
            let expected = "a finite number above zero";
            return Err(LocatorError::Value { field: "loads", index, value: loads[index], expected });
        }
        self.loads = Some(loads);
        Ok(self)
    }

    /// Adds the standard deviation of each channel's noise, in the unit of the frames. Channels are weighted by its
    /// inverse; one with an infinite or NaN deviation is never used. Without it all channels have equal weight.
    ///
    /// # Errors
    /// Different numbers of deviations and channels, a negative deviation, or too few that are finite and above zero.
    pub fn with_channel_noise(mut self, noise: Vec<f64>) -> Result<Self, LocatorError> {
        check_length("channel_noise", self.channels, noise.len())?;
        if let Some(index) = noise.iter().position(|v| *v < 0.0) {
            let expected = "a standard deviation, zero or above";
            return Err(LocatorError::Value { field: "channel_noise", index, value: noise[index], expected });
        }
        let usable = noise.iter().filter(|v| v.is_finite() && **v > 0.0).count();
        if usable < MIN_CHANNELS {
            return Err(LocatorError::TooFewChannels { frame: 0, got: usable, expected: MIN_CHANNELS });
        }
        self.channel_noise = Some(noise);
        Ok(self)
    }

    /// Appends the examples of an earlier session of the same skin. Their weight follows from how well the frames of
    /// the two sessions agree. Loads are kept if both sets have them. The channel noise stays that of the new session.
    ///
    /// # Errors
    /// Different numbers of channels.
    pub fn with_earlier(mut self, earlier: &Self) -> Result<Self, LocatorError> {
        check_length("channels of the earlier examples", self.channels, earlier.channels)?;
        self.frames.extend_from_slice(&earlier.frames);
        self.positions_m.extend_from_slice(&earlier.positions_m);
        self.loads = self.loads.zip(earlier.loads.as_ref()).map(|(mut loads, others)| {
            loads.extend_from_slice(others);
            loads
        });
        self.earlier += earlier.len();
        Ok(self)
    }

    /// Frames, row-major: one row of channels for each example.
    pub fn frames(&self) -> &[f64] {
        &self.frames
    }

    /// Position of each example, metres.
    pub fn positions_m(&self) -> &[[f64; 2]] {
        &self.positions_m
    }

    /// Load of each example, if known.
    pub fn loads(&self) -> Option<&[f64]> {
        self.loads.as_deref()
    }

    /// Standard deviation of each channel's noise, if known.
    pub fn channel_noise(&self) -> Option<&[f64]> {
        self.channel_noise.as_deref()
    }

    /// Number of examples.
    pub fn len(&self) -> usize {
        self.positions_m.len()
    }

    /// True if there are no examples. Never true for a value made by [`Examples::new`].
    pub fn is_empty(&self) -> bool {
        self.positions_m.is_empty()
    }

    /// Number of channels in a frame.
    pub fn channels(&self) -> usize {
        self.channels
    }
}

/// Prediction by physics: for each candidate position, the frame that a small touch there would give.
///
/// Touches are searched for at these positions, so they should cover the skin about evenly, at a spacing of at most
/// about twice the accuracy wanted; the image's pixel centres work well. The scale of signatures does not matter,
/// only their direction, and a common sign is determined from the examples.
#[derive(Debug, Clone, PartialEq)]
pub struct SignatureMap {
    pub(super) channels: usize,
    pub(super) positions_m: Vec<[f64; 2]>,
    pub(super) signatures: Vec<f64>,
}

impl SignatureMap {
    /// Takes `signatures`, row-major, one row of `channels` values for each of `positions_m` (x, y in metres).
    ///
    /// # Errors
    /// Fewer than four positions, lengths that do not match, or a value that is not finite.
    pub fn new(channels: usize, positions_m: Vec<[f64; 2]>, signatures: Vec<f64>) -> Result<Self, LocatorError> {
        check_channels(channels)?;
        let count = positions_m.len();
        if count < 4 {
            return Err(LocatorError::Count { field: "map positions", got: count, expected: "at least 4" });
        }
        check_length("signatures", count * channels, signatures.len())?;
        check_positions("map positions", &positions_m)?;
        check_finite("signatures", &signatures)?;
        Ok(Self { channels, positions_m, signatures })
    }

    /// A map that predicts nothing. The locator then learns from the examples alone, which takes more of them.
    ///
    /// # Errors
    /// As [`SignatureMap::new`].
    pub fn without_physics(channels: usize, positions_m: Vec<[f64; 2]>) -> Result<Self, LocatorError> {
        let signatures = vec![0.0; channels * positions_m.len()];
        Self::new(channels, positions_m, signatures)
    }

    /// Number of candidate positions.
    pub fn len(&self) -> usize {
        self.positions_m.len()
    }

    /// True if there are no candidate positions. Never true for a value made by [`SignatureMap::new`].
    pub fn is_empty(&self) -> bool {
        self.positions_m.is_empty()
    }
}

fn check_channels(channels: usize) -> Result<(), LocatorError> {
    if channels < MIN_CHANNELS {
        return Err(LocatorError::Count { field: "channels", got: channels, expected: "at least 3" });
    }
    Ok(())
}

/// The quantities that shape the map from position to frame.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hyperparameters {
    /// Length over which the deviation of the measured from the physical signature varies, metres.
    pub length_m: f64,
    /// Variance of a frame of median amplitude around the smooth map, relative to the variance of that deviation.
    pub noise: f64,
    /// Weight, from 0 to 1, of the diagonal in the covariance between channels; the rest is the sample covariance.
    pub shrinkage: f64,
}

/// How hyperparameters are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Selection {
    /// Coordinate search from a default, by the leave-one-out predictive score of the examples.
    #[default]
    LeaveOneOut,
    /// As given.
    Fixed(Hyperparameters),
}

/// Options of [`Locator::fit`](super::Locator::fit).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocatorOptions {
    /// How hyperparameters are chosen.
    pub selection: Selection,
    /// Maximum number of examples, evenly drawn, used for choosing the hyperparameters. The final fit uses all.
    pub selection_examples: usize,
    /// Frames with more channels than this are projected on this many principal directions of examples and physics.
    pub max_rank: usize,
}

impl Default for LocatorOptions {
    fn default() -> Self {
        Self { selection: Selection::LeaveOneOut, selection_examples: 250, max_rank: 256 }
    }
}

/// A located touch, in the skin's frame (x right, y up), metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Located {
    /// Posterior mean, x in metres.
    pub x_m: f64,
    /// Posterior mean, y in metres.
    pub y_m: f64,
    /// Calibrated standard deviation of `x_m`: 68 % of left-out examples were within it.
    pub sigma_x_m: f64,
    /// Calibrated standard deviation of `y_m`.
    pub sigma_y_m: f64,
    /// Covariance of x and y, square metres.
    pub covariance_xy_m2: f64,
    /// Most probable of the map's positions, x in metres; far from `x_m` if the posterior has several peaks.
    pub peak_x_m: f64,
    /// Most probable of the map's positions, y in metres.
    pub peak_y_m: f64,
    /// RMS of the weighted frame, in units of the channel noise if that was given.
    pub amplitude: f64,
    /// Estimated load, if the examples had loads and amplitude was found to follow them.
    pub load: Option<LoadEstimate>,
    /// Logarithm of the mean likelihood of the frame's direction over the map, untempered. Comparable between frames
    /// with the same missing channels.
    pub log_evidence: f64,
    /// Share of the map's prior variance that the examples leave around the located position: near 0 among pokes,
    /// near 1 where nothing was poked and physics stands alone.
    pub unexplained: f64,
    /// Misfit of the frame at its peak over the 95 % quantile of left-out examples. Well above 1, the frame resembles
    /// no single touch in the training data (two touches, damage, a loose electrode) and the position is not
    /// reliable.
    pub novelty: f64,
}

/// An estimate of the load, in the unit of the examples' loads.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoadEstimate {
    /// The load.
    pub value: f64,
    /// Its standard deviation, from the left-out examples.
    pub sigma: f64,
}

/// One example as located by the locator fitted to all the others.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeftOut {
    /// True position of the poke, metres.
    pub position_m: [f64; 2],
    /// Position located from the others, metres.
    pub located_m: [f64; 2],
    /// Predicted standard deviations of x and y, metres.
    pub sigma_m: [f64; 2],
    /// Distance between the two positions, metres.
    pub error_m: f64,
    /// Misfit at the peak over the 95 % quantile of all examples.
    pub novelty: f64,
}

/// Accuracy of a locator, judged on each example by the others.
///
/// Position, signature map and covariance between channels are all found without the example. The hyperparameters and
/// the channel gains of the physics are not; the sigma allows for that (see the module's documentation).
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeaveOneOut {
    /// Every example, in the given order.
    pub examples: Vec<LeftOut>,
    /// Median distance, metres.
    pub median_error_m: f64,
    /// Distance that nine in ten examples stay below, metres.
    pub p90_error_m: f64,
    /// Share of examples whose error in x, and in y, is within one sigma.
    pub coverage: [f64; 2],
    /// Mean cosine between measured and physical signatures at the examples, which shows what physics alone explains;
    /// 0 without physics.
    pub physics_cosine: f64,
    /// RMS relative error of the load, if loads were given and could be fitted.
    pub load_error: Option<f64>,
}

/// A position where one more poke would help.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SuggestedPoke {
    /// Position to poke, metres.
    pub position_m: [f64; 2],
    /// Expected position uncertainty there now: RMS over x and y, metres.
    pub sigma_m: f64,
    /// Share of the map's prior variance that the examples leave there: 1 if nothing is known yet.
    pub unexplained: f64,
}
