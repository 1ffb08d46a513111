//! Measurements of pokes, as frames and baselines or as differences, and the difference data computed from them.

use dermis_touch::health::RestScatter;
use serde::{Deserialize, Deserializer};

use crate::Error;
use crate::prepare::Prepared;
use crate::reference::{Reference, are_pairs, check_frames};

/// Measurements of a skin when it was poked, channels in the protocol's order.
#[derive(Clone, Copy, Debug)]
pub enum PokeFrames<'a> {
    /// Frames of the pressed skin, one per poke, and of the untouched skin: one for each poke, or some for all.
    Readings {
        /// Frames of the untouched skin.
        baselines: &'a [Vec<f64>],
        /// Frames of the pressed skin.
        frames: &'a [Vec<f64>],
    },
    /// Differences of both, one per poke.
    Differences(&'a [Vec<f64>]),
}

impl PokeFrames<'_> {
    /// Scatter of the channels at rest, if each poke has its own baseline and there are enough.
    pub(super) fn rest_scatter(&self) -> Option<RestScatter> {
        match self {
            PokeFrames::Readings { baselines, frames } if baselines.len() == frames.len() => RestScatter::of(baselines),
            _ => None,
        }
    }

    /// The frames of the pressed skin, or their differences.
    pub(super) fn frames(&self) -> &[Vec<f64>] {
        match self {
            PokeFrames::Readings { frames, .. } | PokeFrames::Differences(frames) => frames,
        }
    }

    /// Differences of successive baselines, without those that are zero everywhere.
    pub(super) fn at_rest(&self, reference: &Reference) -> Vec<Vec<f64>> {
        let PokeFrames::Readings { baselines, .. } = self else { return Vec::new() };
        let differences = baselines.windows(2).map(|pair| reference.difference(&pair[1], Some(&pair[0])));
        differences.filter(|difference| difference.iter().any(|v| v.is_finite() && *v != 0.0)).collect()
    }

    /// Noise of a poke's difference as a share of that of successive baselines: less if the baseline is a mean.
    pub(super) fn noise_share(&self) -> f64 {
        match self {
            PokeFrames::Readings { baselines, .. } if !self.has_pairs() => (0.5 + 0.5 / baselines.len() as f64).sqrt(),
            _ => 1.0,
        }
    }

    /// True if each poke has its own baseline.
    fn has_pairs(&self) -> bool {
        matches!(self, PokeFrames::Readings { baselines, frames } if are_pairs(baselines, frames))
    }
}

/// The reference of the pokes and their difference data.
pub(crate) fn differences_of(
    prepared: &Prepared,
    measured: PokeFrames<'_>,
) -> Result<(Reference, Vec<Vec<f64>>), Error> {
    match measured {
        PokeFrames::Differences(frames) => {
            let reference = Reference::of_differences(prepared, frames)?;
            let differences = frames.iter().map(|frame| reference.difference(frame, None)).collect();
            Ok((reference, differences))
        }
        PokeFrames::Readings { baselines, frames } => {
            check_frames("poke", frames, prepared.channels())?;
            let paired = are_pairs(baselines, frames);
            let reference = if paired { Reference::of_pairs } else { Reference::of }(prepared, baselines)?;
            let own = |index: usize| paired.then(|| baselines[index].as_slice());
            let differences = frames.iter().enumerate().map(|(i, frame)| reference.difference(frame, own(i))).collect();
            Ok((reference, differences))
        }
    }
}

/// Sets these channels of all frames to a value: NaN to exclude them. The channels must exist.
pub fn set_channels(frames: &mut [Vec<f64>], channels: &[u32], value: f64) {
    for &channel in channels {
        frames.iter_mut().for_each(|frame| frame[channel as usize] = value);
    }
}

/// A frame in which the change of channels without any reading is set to zero.
pub(super) fn without_silence(frame: &[f64], dead_channels: &[u32]) -> Vec<f64> {
    let mut frame = frame.to_vec();
    for &channel in dead_channels {
        let value = &mut frame[channel as usize];
        *value = if value.is_finite() { *value } else { 0.0 };
    }
    frame
}

/// A frame as stored in JSON: missing values are `null`.
pub(super) fn frame_with_gaps<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<f64>, D::Error> {
    Ok(without_null(Vec::deserialize(from)?))
}

pub(super) fn frames_with_gaps<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Vec<f64>>, D::Error> {
    Ok(Vec::deserialize(from)?.into_iter().map(without_null).collect())
}

fn without_null(row: Vec<Option<f64>>) -> Vec<f64> {
    row.into_iter().map(|value| value.unwrap_or(f64::NAN)).collect()
}
