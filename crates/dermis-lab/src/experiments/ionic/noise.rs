//! The signal-to-noise ratio at rest, under both readings of the paper's figure.

use dermis_skin::Skin;
use dermis_touch::{RunningStats, SnrDefinition, average_snr_db};

use super::bench::{SKIN, row};
use crate::Error;
use crate::report::{Experiment, Kind, Report};
use crate::twin_bench::Rig;

pub(super) const NOISE: Experiment = Experiment { id: "I-SNR", title: "signal-to-noise ratio at rest", run: noise };

/// The paper's average signal-to-noise ratio, dB, over this many frames.
const SNR_DB: f64 = 59.7;
const SNR_FRAMES: f64 = 100.0;

/// Relative noise at which the formula as printed in the paper, `10 log10(mean / deviation)`, gives the paper's
/// figure. The mean logarithm of a deviation estimated from n + 1 frames is low by `1/(2n) + 1/(6n^2)`.
fn printed_noise() -> f64 {
    let n = SNR_FRAMES - 1.0;
    let logarithm = SNR_DB / 10.0 * std::f64::consts::LN_10 + (-0.5 / n - 1.0 / (6.0 * n * n));
    (-logarithm).exp()
}

/// The paper's figure under both readings: its printed formula takes ten times the logarithm of a ratio of
/// amplitudes.
fn noise() -> Result<Report, Error> {
    let at_rest = |noise_share, definition| -> Result<f64, Error> {
        let mut skin = Skin::open(SKIN)?;
        skin.backend.electronics.noise_share = Some(noise_share);
        let mut rig = Rig::of(skin)?;
        let mut stats = RunningStats::new(rig.prepared().channels());
        for frame in rig.frames(&[], 100)? {
            stats.push(&frame)?;
        }
        Ok(average_snr_db(definition, &stats).mean_db)
    };
    let printed = at_rest(printed_noise(), SnrDefinition::IonicAsPrinted)?;
    let amplitude = at_rest(10_f64.powf(-SNR_DB / 20.0), SnrDefinition::Amplitude)?;
    let rows = vec![
        row("10 log10(mean / std) as printed, noise set by it", "dB", Some(59.7), printed, Kind::Fitted),
        row("20 log10(mean / std), noise set by it", "dB", Some(59.7), amplitude, Kind::Fitted),
    ];
    let notes = vec![
        "By the printed formula noise would be 1.1e-6 of a reading, less than a step of a 16-bit converter; all other \
         replays use the thousandfold noise of the usual formula."
            .into(),
    ];
    Ok(Report { id: NOISE.id, title: NOISE.title, rows, figures: Vec::new(), notes })
}
