//! Peak amplitudes of presses. A press that is much weaker than it was is only the remnant of one: it is being released,
//! or it lasts as a set of the layer, which belongs in the baseline.

use dermis_estimate::Press;
use dermis_tomo::mesh::{Point, distance};

/// A press below this share of its own peak amplitude is only a remnant: layers creep, and take a set of a few per
/// cent. The peak is remembered for this long, nanoseconds.
const REMNANT_SHARE: f64 = 0.1;
const REMEMBERED_NS: u64 = 5_000_000_000;
/// A remnant that lasts as long as this is a set, nanoseconds. A hand that lets go has left the skin before.
const SET_NS: u64 = 500_000_000;

/// The highest amplitude that a press has reached.
#[derive(Clone, Copy, Debug)]
struct Peak {
    position_m: Point,
    radius_m: f64,
    amplitude: f64,
    seen_ns: u64,
    /// Since when the press has been a remnant.
    remnant_since_ns: Option<u64>,
}

/// A press compared with its peak.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Remains {
    /// It still presses.
    Press,
    /// Only a remnant is left.
    Remnant,
    /// The remnant has lasted: the layer has taken a set.
    Set,
}

/// The peaks of recent presses.
#[derive(Debug, Default)]
pub(super) struct Peaks(Vec<Peak>);

impl Peaks {
    /// Forgets presses that have not been seen for long.
    pub fn drop_old(&mut self, time_ns: u64) {
        self.0.retain(|peak| time_ns.saturating_sub(peak.seen_ns) < REMEMBERED_NS);
    }

    /// Adds a press, and tells what remains of it.
    pub fn judge(&mut self, time_ns: u64, press: &Press, amplitude: f64) -> Remains {
        let is_there = |peak: &&mut Peak| {
            let reach_m = peak.radius_m.max(press.radius_m) + 2.0 * press.place_sigma_m();
            distance(peak.position_m, press.position_m) <= reach_m
        };
        let Press { position_m, radius_m, .. } = *press;
        let now = Peak { position_m, radius_m, amplitude, seen_ns: time_ns, remnant_since_ns: None };
        let Some(peak) = self.0.iter_mut().find(is_there) else {
            self.0.push(now);
            return Remains::Press;
        };
        if amplitude > peak.amplitude {
            *peak = now;
        }
        peak.seen_ns = time_ns;
        if amplitude >= REMNANT_SHARE * peak.amplitude {
            peak.remnant_since_ns = None;
            return Remains::Press;
        }
        let since_ns = *peak.remnant_since_ns.get_or_insert(time_ns);
        if time_ns.saturating_sub(since_ns) >= SET_NS { Remains::Set } else { Remains::Remnant }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn only_a_remnant_that_lasts_is_a_set() {
        let press = Press { radius_m: 0.01, ..Press::default() };
        let mut peaks = Peaks::default();
        assert_eq!(peaks.judge(0, &press, 1.0), Remains::Press);
        // Released: the last tenth of the amplitude passes within a few frames.
        assert_eq!(peaks.judge(40 * MS, &press, 0.05), Remains::Remnant);
        assert_eq!(peaks.judge(80 * MS, &press, 0.5), Remains::Press);
        assert_eq!(peaks.judge(120 * MS, &press, 0.05), Remains::Remnant);
        assert_eq!(peaks.judge(600 * MS, &press, 0.05), Remains::Remnant);
        assert_eq!(peaks.judge(640 * MS, &press, 0.05), Remains::Set);
        let elsewhere = Press { position_m: [0.05, 0.0], ..press };
        assert_eq!(peaks.judge(640 * MS, &elsewhere, 0.05), Remains::Press);
    }
}
