//! Checks for two exchanged electrodes. The model's voltages are computed for every pair exchanged, from the transfer
//! impedances of one solution, `v = m' Z s`, and compared with the measured baseline.

use dermis_tomo::eit::{ForwardModel, Pattern, correlation};

use super::Seen;
use dermis_skin::{Modality, Reads};

/// Minimum gain in correlation.
const MARGIN: f64 = 0.02;
/// Largest share of the stated wiring's unexplained part that may remain.
const LEFT: f64 = 0.3;
/// Maximum number of electrodes for which pairs are tried.
const MOST_ELECTRODES: usize = 64;

/// Two electrodes whose exchange explains a baseline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Swap {
    /// Electrode indices from 0.
    pub electrodes: [u32; 2],
    /// Correlation of the baseline with the model after the exchange.
    pub correlation: f64,
}

impl Seen {
    /// The best exchange of two electrodes, if it fits clearly better than the stated wiring, whose correlation is
    /// `stated`.
    pub(super) fn swapped(&self, stated: f64) -> Option<Swap> {
        let prepared = self.pipeline.prepared();
        let (protocol, skin) = (&prepared.protocol, &prepared.skin);
        let count = protocol.electrode_count();
        if skin.modality != Modality::Eit || skin.backend.circuit.is_some() || count > MOST_ELECTRODES {
            return None;
        }
        let sigma = vec![skin.sheet_conductance_s(); prepared.body.mesh.mesh.element_count()];
        let model = ForwardModel::new(prepared.body.mesh.clone(), protocol.clone()).ok()?;
        let solution = model.solve(&sigma).ok()?;
        let impedance = solution.transfer_impedance();
        let magnitudes = skin.backend.reads == Reads::Magnitude;
        let measured: Vec<f64> = self.pipeline.baseline().0.iter().map(|v| sized(*v, magnitudes)).collect();
        let voltage = |channel: usize, [a, b]: [u32; 2]| -> f64 {
            let exchanged = |e: u32| match e {
                e if e == a => b as usize,
                e if e == b => a as usize,
                e => e as usize,
            };
            let entries = |pattern: &Pattern| pattern.entries().to_vec();
            let (drive, read) = (entries(protocol.stimulation_of(channel)), entries(protocol.pattern_of(channel)));
            let of = |(m, weight): &(u32, f64)| -> f64 {
                drive.iter().map(|(s, current)| weight * current * impedance[(exchanged(*m), exchanged(*s))]).sum()
            };
            read.iter().map(of).sum()
        };
        let pairs = (0..count as u32).flat_map(|a| (a + 1..count as u32).map(move |b| [a, b]));
        let fits = pairs.map(|electrodes| {
            let expected: Vec<f64> = (0..measured.len()).map(|c| sized(voltage(c, electrodes), magnitudes)).collect();
            Swap { electrodes, correlation: correlation(&expected, &measured) }
        });
        let best = fits.max_by(|x, y| x.correlation.total_cmp(&y.correlation))?;
        let clearly = best.correlation > stated + MARGIN && 1.0 - best.correlation < LEFT * (1.0 - stated);
        clearly.then_some(best)
    }
}

fn sized(value: f64, magnitudes: bool) -> f64 {
    if magnitudes { value.abs() } else { value }
}
