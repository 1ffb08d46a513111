//! Drift since the last update of the baseline, as a covariance that grows with time.
//!
//! While something touches a skin its baseline is frozen, but instrument, temperature and contacts go on drifting.
//! The effect of drift on a frame is no press, and its possible size is known. The covariance of a frame is the noise
//! plus the drift, and presses are fitted under it: a change that drift explains as well as a press does not move the
//! press.

use dermis_tomo::mesh::{Contact, Electrode, ElectrodedMesh, distance};

use crate::prepare::Prepared;

/// Independent gain drift of each channel, as a share of its voltage per second: 0.3 % in ten minutes.
const CHANNEL_PER_S: f64 = 5e-6;
/// Drift of the conductance at each electrode, share per second: 1 % in ten minutes.
const ELECTRODE_PER_S: f64 = 1.7e-5;
/// Conductance up to this distance from an electrode, in electrode sizes, counts as that of its contact.
const ELECTRODE_REACH: f64 = 1.0;
/// The weights are updated each time the age doubles. Below this age, in seconds, there is no drift.
const LEAST_S: f64 = 8.0;
/// Time after a touch ends from which drift no longer counts as noise, seconds: the baseline has caught up by then.
const CAUGHT_UP_S: f64 = 5.0;

/// Effects of drift on one skin.
#[derive(Debug)]
pub(crate) struct Drift {
    /// Voltage of each channel at rest, model volts.
    voltages: Vec<f64>,
    /// Change of the channels per relative change of the conductance at each electrode, model volts.
    electrodes: Vec<Vec<f64>>,
    touched_ns: Option<u64>,
    released_ns: Option<u64>,
    /// Age in seconds for which the current weights were made.
    age_s: f64,
}

impl Drift {
    pub fn new(prepared: &Prepared) -> Self {
        let places = electrode_places(prepared);
        let electrodes = places
            .iter()
            .map(|(place, size)| {
                let near = |at: &[f64; 3]| distance([at[0], at[1]], *place) <= ELECTRODE_REACH * size;
                let pixels: Vec<usize> =
                    (0..prepared.basis.positions.len()).filter(|&k| near(&prepared.basis.positions[k])).collect();
                (0..prepared.channels())
                    .map(|channel| pixels.iter().map(|&k| prepared.jacobian.row(channel)[k]).sum())
                    .collect()
            })
            .collect();
        Self { voltages: prepared.voltages.clone(), electrodes, touched_ns: None, released_ns: None, age_s: 0.0 }
    }

    /// Records whether presses are being followed. `is_noise` tells whether the frame is noise; it is asked only after a
    /// touch. True if the weights have changed.
    pub fn observe(&mut self, time_ns: u64, is_touched: bool, is_noise: impl FnOnce() -> bool) -> bool {
        let since_s = |ns: u64| time_ns.saturating_sub(ns) as f64 * 1e-9;
        if is_touched {
            self.released_ns = None;
        } else if self.touched_ns.is_some() && is_noise() {
            // The skin has not drifted since the last update of the baseline.
            (self.touched_ns, self.released_ns) = (None, None);
        } else if self.touched_ns.is_some() && since_s(*self.released_ns.get_or_insert(time_ns)) >= CAUGHT_UP_S {
            (self.touched_ns, self.released_ns) = (None, None);
        }
        let age_s = match (self.touched_ns, is_touched) {
            (Some(since), _) => since_s(since),
            (None, true) => since_s(*self.touched_ns.insert(time_ns)),
            (None, false) => 0.0,
        };
        let level = if age_s < LEAST_S { 0.0 } else { LEAST_S * (age_s / LEAST_S).log2().floor().exp2() * 2.0 };
        let is_new = level != self.age_s;
        self.age_s = level;
        is_new
    }

    /// Restarts with an up-to-date baseline.
    pub fn forget(&mut self) {
        (self.touched_ns, self.released_ns, self.age_s) = (None, None, 0.0);
    }

    /// True if drift has had time to show.
    pub fn is_aged(&self) -> bool {
        self.age_s > 0.0
    }

    /// Weights of the channels, with this noise (model volts).
    pub fn weights(&self, noise: &[f64]) -> Weights {
        let (own, share) = (CHANNEL_PER_S * self.age_s, ELECTRODE_PER_S * self.age_s);
        let deviations = noise.iter().zip(&self.voltages).map(|(noise, volts)| noise.hypot(own * volts)).collect();
        let scaled = |channels: &Vec<f64>| channels.iter().map(|volts| share * volts).collect();
        let nuisances = if self.is_aged() { self.electrodes.iter().map(scaled).collect() } else { Vec::new() };
        Weights { deviations, nuisances }
    }
}

/// Weights of the channels: their noise and drift, model volts.
#[derive(Debug)]
pub(crate) struct Weights {
    /// Standard deviations of the channels: their noise combined with their own drift.
    pub deviations: Vec<f64>,
    /// Correlated effects of drift on the channels, one entry per cause, for one standard deviation.
    pub nuisances: Vec<Vec<f64>>,
}

/// Centre and size of each electrode, metres. On a bent skin, positions are those on the flat one.
fn electrode_places(prepared: &Prepared) -> Vec<([f64; 2], f64)> {
    let ElectrodedMesh { mesh, electrodes } = &prepared.body.mesh;
    let of = |electrode: &Electrode| {
        let nodes: Vec<u32> = match &electrode.contact {
            Contact::Faces(faces) => faces.concat(),
            Contact::Area(elements) => {
                let nodes = |element: &u32| mesh.elements().nth(*element as usize).unwrap_or_default().to_vec();
                elements.iter().flat_map(nodes).collect()
            }
            Contact::Point(node) => vec![*node],
        };
        let at = |node: &u32| {
            let place = mesh.nodes()[*node as usize];
            [place[0], place[1]]
        };
        let count = nodes.len().max(1) as f64;
        let sum = nodes.iter().map(at).fold([0.0; 2], |sum, at| [sum[0] + at[0], sum[1] + at[1]]);
        let middle = sum.map(|value| value / count);
        let reach = nodes.iter().map(|node| distance(at(node), middle)).fold(0.0_f64, f64::max);
        (middle, (2.0 * reach).max(prepared.map.grid().pixel_m))
    };
    electrodes.iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;

    #[test]
    fn a_frame_of_noise_shows_that_nothing_has_drifted() {
        let mut drift =
            Drift { voltages: vec![1.0], electrodes: Vec::new(), touched_ns: None, released_ns: None, age_s: 0.0 };
        let held = |drift: &mut Drift, from_s: u64| {
            (from_s..from_s + 6).for_each(|s| _ = drift.observe(s * S, true, || false))
        };
        // Two presses of six seconds each, with and without drift between them.
        held(&mut drift, 0);
        drift.observe(6 * S, false, || true);
        held(&mut drift, 7);
        assert!(!drift.is_aged());
        drift.observe(13 * S, false, || false);
        held(&mut drift, 14);
        assert!(drift.is_aged());
    }
}
