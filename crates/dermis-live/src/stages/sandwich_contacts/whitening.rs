//! Frames with the standard deviations that fits of patches use.

/// Model error assumed for each channel: a share of its own change, plus a share of the frame's root mean square.
const SHARE: f64 = 0.02;
const FLOOR: f64 = 0.005;
/// Typical ratio of the squared model error to the assumed one, from twins of sandwiches with one to three presses at
/// random.
const USUAL_MODEL_SHARE: f64 = 0.1;

/// The change of the channels in one frame, with its deviations.
#[derive(Debug, Default)]
pub(super) struct Whitened {
    /// Model volts, NaN where channels are left out.
    pub change: Vec<f64>,
    /// Standard deviations, model volts.
    pub deviation: Vec<f64>,
    /// Mean share of the noise in the variances.
    pub noise_share: f64,
}

impl Whitened {
    /// Factor on the covariance of a fit with this misfit (mean squared residual over variance). The deviations
    /// include a generous model error, so that good fits are not rejected. On a sound skin the real error is smaller;
    /// the misfit shows if it is not.
    pub fn covariance_factor(&self, misfit: f64) -> f64 {
        misfit.max(self.noise_share + USUAL_MODEL_SHARE * (1.0 - self.noise_share))
    }
}

/// Noise and drift of the channels, which weight the frames.
#[derive(Debug)]
pub(super) struct Channels {
    noise: Vec<f64>,
    /// Independent drift of each channel since the last update of the baseline, model volts.
    drift: Vec<f64>,
    absent: Vec<bool>,
}

impl Channels {
    pub fn new(noise: &[f64]) -> Self {
        Self { noise: noise.to_vec(), drift: vec![0.0; noise.len()], absent: vec![false; noise.len()] }
    }

    /// Replaces the noise (model volts).
    pub fn set_noise(&mut self, noise: &[f64]) {
        self.noise.clear();
        self.noise.extend_from_slice(noise);
    }

    /// Replaces the drift of the channels (model volts).
    pub fn set_drift(&mut self, drift: Vec<f64>) {
        self.drift = drift;
    }

    /// Noise of the channels, model volts.
    pub fn noise(&self) -> &[f64] {
        &self.noise
    }

    /// Leaves out these channels from now on.
    pub fn leave_out(&mut self, channels: &[u32]) {
        self.absent.fill(false);
        channels.iter().for_each(|&channel| self.absent[channel as usize] = true);
    }

    /// True for each channel that is left out.
    pub fn absent(&self) -> &[bool] {
        &self.absent
    }

    /// Sets the change of the channels and its deviations from difference data, which must be finite.
    pub fn weigh(&self, difference: &[f64], whitened: &mut Whitened) {
        let Whitened { change, deviation, noise_share } = whitened;
        let square = difference.iter().map(|v| v * v).sum::<f64>() / difference.len() as f64;
        deviation.clear();
        deviation.extend(self.noise.iter().zip(&self.drift).zip(difference).map(|((noise, drift), change)| {
            (noise * noise + drift * drift + (SHARE * change).powi(2) + FLOOR * FLOOR * square)
                .sqrt()
                .max(f64::MIN_POSITIVE)
        }));
        let shares = self.noise.iter().zip(&*deviation).map(|(noise, deviation)| (noise / deviation).powi(2));
        *noise_share = shares.sum::<f64>() / difference.len() as f64;
        change.clear();
        change.extend(difference.iter().zip(&self.absent).map(|(v, absent)| if *absent { f64::NAN } else { *v }));
    }
}
