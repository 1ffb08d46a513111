//! Frames with the deviations that fits of patches judge them by.

/// Model error that frames are judged by: shares of the channel's own change and of the frame's root mean square.
const SHARE: f64 = 0.02;
const FLOOR: f64 = 0.005;

/// The change of the channels in one frame, with its deviations.
#[derive(Debug, Default)]
pub(super) struct Whitened {
    /// Model volts, NaN where channels are left out.
    pub change: Vec<f64>,
    /// Standard deviations, model volts.
    pub deviation: Vec<f64>,
}

/// What frames are weighed by.
#[derive(Debug)]
pub(super) struct Channels {
    noise: Vec<f64>,
    absent: Vec<bool>,
}

impl Channels {
    pub fn new(noise: &[f64]) -> Self {
        Self { noise: noise.to_vec(), absent: vec![false; noise.len()] }
    }

    /// Replaces the noise (model volts).
    pub fn set_noise(&mut self, noise: &[f64]) {
        self.noise.clear();
        self.noise.extend_from_slice(noise);
    }

    /// Goes on without these channels.
    pub fn leave_out(&mut self, channels: &[u32]) {
        self.absent.fill(false);
        channels.iter().for_each(|&channel| self.absent[channel as usize] = true);
    }

    /// Which channels are left out.
    pub fn absent(&self) -> &[bool] {
        &self.absent
    }

    /// The change of the channels and its deviations, for difference data that are all finite.
    pub fn weigh(&self, difference: &[f64], whitened: &mut Whitened) {
        let Whitened { change, deviation } = whitened;
        let square = difference.iter().map(|v| v * v).sum::<f64>() / difference.len() as f64;
        deviation.clear();
        deviation.extend(self.noise.iter().zip(difference).map(|(noise, change)| {
            (noise * noise + (SHARE * change).powi(2) + FLOOR * FLOOR * square).sqrt().max(f64::MIN_POSITIVE)
        }));
        change.clear();
        change.extend(difference.iter().zip(&self.absent).map(|(v, absent)| if *absent { f64::NAN } else { *v }));
    }
}
