//! Peak amplitudes of presses. A press that is much weaker than it was is only the remnant of one: a set of the layer,
//! which belongs in the baseline.

use dermis_estimate::Press;
use dermis_tomo::mesh::{Point, distance};

/// A press below this share of its own peak amplitude is only a remnant: layers creep, and take a set of a few per
/// cent. The peak is remembered for this long, nanoseconds.
const REMNANT_SHARE: f64 = 0.1;
const REMEMBERED_NS: u64 = 5_000_000_000;

/// The highest amplitude that a press has reached.
#[derive(Clone, Copy, Debug)]
struct Peak {
    position_m: Point,
    radius_m: f64,
    amplitude: f64,
    seen_ns: u64,
}

/// The peaks of recent presses.
#[derive(Debug, Default)]
pub(super) struct Peaks(Vec<Peak>);

impl Peaks {
    /// Forgets presses that have not been seen for long.
    pub fn drop_old(&mut self, time_ns: u64) {
        self.0.retain(|peak| time_ns.saturating_sub(peak.seen_ns) < REMEMBERED_NS);
    }

    /// Adds a press; true if it is only the remnant of one that was much stronger.
    pub fn is_remnant(&mut self, time_ns: u64, press: &Press, amplitude: f64) -> bool {
        let is_there = |peak: &&mut Peak| {
            let reach_m = peak.radius_m.max(press.radius_m) + 2.0 * press.place_sigma_m();
            distance(peak.position_m, press.position_m) <= reach_m
        };
        let Press { position_m, radius_m, .. } = *press;
        if let Some(peak) = self.0.iter_mut().find(is_there) {
            peak.seen_ns = time_ns;
            if amplitude > peak.amplitude {
                *peak = Peak { position_m, radius_m, amplitude, seen_ns: time_ns };
            }
            return amplitude < REMNANT_SHARE * peak.amplitude;
        }
        self.0.push(Peak { position_m, radius_m, amplitude, seen_ns: time_ns });
        false
    }
}
