//! How a skin's channels use its electrodes, and the limits of its health.

use dermis_skin::Modality;
use dermis_tomo::eit::{Pattern, Protocol};
use dermis_touch::health::{HealthParams, Wiring};

use crate::Error;
use crate::prepare::Prepared;

/// An electrode belongs to a pattern if its weight is at least this share of the largest: a mean reference contains
/// all.
const LEAST_WEIGHT: f64 = 0.5;

/// How the protocol's channels use the electrodes, for a [`dermis_touch::health::HealthMonitor`].
///
/// # Errors
/// None for a valid protocol.
pub fn wiring(prepared: &Prepared) -> Result<Wiring, Error> {
    let protocol: &Protocol = &prepared.protocol;
    let electrodes = |patterns: &[Pattern]| patterns.iter().map(main_electrodes).collect::<Vec<_>>();
    let channels = protocol.measurements().iter().map(|m| [m.stimulation, m.pattern]).collect();
    // A readout circuit mixes lines, and coils are read in one direction only.
    let reciprocal = prepared.skin.backend.circuit.is_none() && prepared.skin.modality == Modality::Eit;
    let partners = if reciprocal { protocol.reciprocal_channels() } else { vec![None; protocol.channel_count()] };
    let (drives, patterns) = (electrodes(protocol.stimulations()), electrodes(protocol.patterns()));
    Ok(Wiring::new(protocol.electrode_count(), drives, patterns, channels, partners)?)
}

/// The limits of health from the skin file.
pub fn health_params(prepared: &Prepared) -> HealthParams {
    let settings = &prepared.skin.health;
    HealthParams {
        clean_frames: settings.recover_frames,
        full_scale: settings.full_scale_mv.map(|mv| 1e-3 * mv),
        ..HealthParams::default()
    }
}

fn main_electrodes(pattern: &Pattern) -> Vec<u32> {
    let largest = pattern.entries().iter().map(|(_, w)| w.abs()).fold(0.0, f64::max);
    pattern.entries().iter().filter(|(_, w)| w.abs() >= LEAST_WEIGHT * largest).map(|(e, _)| *e).collect()
}
