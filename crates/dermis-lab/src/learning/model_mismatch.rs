//! Skins as actually built: electrodes slightly displaced and of other widths, other contact impedances, and a mesh
//! that differs from the imaging model's. This way no simulation is inverted with the model that made it.

use dermis_tomo::mesh::ElectrodeShape;
use rand::Rng;
use rand::rngs::StdRng;
use rand_distr::{Distribution, Normal};
use serde::{Deserialize, Serialize};

use crate::Error;
use dermis_skin::{Skin, SkinBody};

/// Deviations of skins and instruments from the skin file, as standard deviations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Jitter {
    /// Electrode position, relative to half the shorter side of the skin.
    pub place: f64,
    /// Electrode width, relative.
    pub width: f64,
    /// Logarithm of the contact impedances.
    pub contact: f64,
    /// Gain of the instrument, relative; the same for baseline and frame.
    pub gain: f64,
    /// Change of each drive's gain between baseline and frame, relative.
    pub drift: f64,
    /// Change of the whole body's log conductivity between baseline and frame.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub background: f64,
    /// Noise, dB below the root mean square of a frame.
    pub noise_db: f64,
}

impl Default for Jitter {
    fn default() -> Self {
        Self { place: 0.003, width: 0.03, contact: 0.5, gain: 0.03, drift: 3e-4, background: 0.0, noise_db: 56.8 }
    }
}

// Takes a reference because serde requires one.
#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde calls it with a reference")]
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Smallest step of the gap between a pad and the rim, as a share of half the skin's shorter side.
const GRAIN: f64 = 0.005;

/// A draw from a normal distribution with mean 0; a deviation of 0 gives 0.
pub(super) fn normal(deviation: f64, random: &mut StdRng) -> f64 {
    Normal::new(0.0, deviation.max(0.0)).map_or(0.0, |normal| normal.sample(random))
}

/// A jittered body with 0.55 to 0.9 times the reconstruction's number of elements, so that its mesh differs and is
/// quick to make. If electrodes would leave the skin or touch each other, the displacement is halved until they
/// don't.
pub(super) fn body(skin: &Skin, jitter: &Jitter, random: &mut StdRng) -> Result<SkinBody, Error> {
    let elements = (skin.imaging.elements as f64 * random.random_range(0.55..0.9)) as usize;
    let (low, high) = skin.outline().bounds_m();
    let half_m = 0.5 * (high[0] - low[0]).min(high[1] - low[1]);
    let nominal = skin.electrode_shapes();
    let contact: Vec<f64> = nominal.iter().map(|_| normal(jitter.contact, random).exp()).collect();
    let draws: Vec<[f64; 3]> = nominal
        .iter()
        .map(|_| {
            [normal(jitter.place, random) * half_m, normal(jitter.place, random) * half_m, normal(jitter.width, random)]
        })
        .collect();
    let mut share = 1.0;
    loop {
        let moved = nominal.iter().zip(&draws).map(|(shape, draw)| moved(shape, draw, share, half_m)).collect();
        match skin.body_with_electrodes(elements, moved, &contact) {
            Err(dermis_skin::Error::Mesh { .. }) if share > 0.0 => share = if share < 0.2 { 0.0 } else { 0.5 * share },
            outcome => return Ok(outcome?),
        }
    }
}

fn moved(shape: &ElectrodeShape, draw: &[f64; 3], share: f64, half_m: f64) -> ElectrodeShape {
    let [along, across, wider] = draw.map(|value| share * value);
    let factor = (1.0 + wider).clamp(0.8, 1.2);
    match *shape {
        ElectrodeShape::RimArc { centre_rad, width_m } => {
            ElectrodeShape::RimArc { centre_rad: centre_rad + along / half_m, width_m: factor * width_m }
        }
        ElectrodeShape::RimSegment { centre_m, width_m } => {
            ElectrodeShape::RimSegment { centre_m: centre_m + along, width_m: factor * width_m }
        }
        ElectrodeShape::RimPoint { position_m } => ElectrodeShape::RimPoint { position_m: position_m + along },
        ElectrodeShape::PadCircle { centre_m: [x, y], radius_m } => {
            ElectrodeShape::PadCircle { centre_m: [x + along, y + across], radius_m: factor * radius_m }
        }
        ElectrodeShape::PadRectangle { centre_m: [x, y], width_m, height_m, angle_rad } => {
            // Pads may lie flush with the rim. They only shrink and move inward, so they never leave the skin. The
            // gap between pad and rim is rounded to multiples of a step, because meshing a thin sliver could take any
            // number of elements.
            let factor = factor.min(1.0);
            let grain_m = GRAIN * half_m;
            let inward = |at: f64, side_m: f64, step: f64| {
                let shrunk_m = 0.5 * (1.0 - factor) * side_m;
                let gap_m = ((step.abs() + shrunk_m) / grain_m).round() * grain_m;
                if at == 0.0 { step } else { at - at.signum() * (gap_m - shrunk_m) }
            };
            ElectrodeShape::PadRectangle {
                centre_m: [inward(x, width_m, along), inward(y, height_m, across)],
                width_m: factor * width_m,
                height_m: factor * height_m,
                angle_rad,
            }
        }
        ElectrodeShape::Point { position_m: [x, y] } => ElectrodeShape::Point { position_m: [x + along, y + across] },
    }
}
