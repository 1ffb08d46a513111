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
pub(super) struct Peaks {
    peaks: Vec<Peak>,
    time_ns: u64,
}

impl Peaks {
    /// Begins the explanation of a frame. Forgets presses that have not been seen for long; a remnant that was not seen
    /// in the last explanation has not lasted.
    pub fn begin(&mut self, time_ns: u64) {
        let last_ns = std::mem::replace(&mut self.time_ns, time_ns);
        self.peaks.retain(|peak| time_ns.saturating_sub(peak.seen_ns) < REMEMBERED_NS);
        self.peaks.iter_mut().filter(|peak| peak.seen_ns < last_ns).for_each(|peak| peak.remnant_since_ns = None);
    }

    /// Adds a press of this explanation, and tells what remains of it.
    pub fn judge(&mut self, press: &Press, amplitude: f64) -> Remains {
        let time_ns = self.time_ns;
        let is_there = |peak: &&mut Peak| {
            let reach_m = peak.radius_m.max(press.radius_m) + 2.0 * press.place_sigma_m();
            distance(peak.position_m, press.position_m) <= reach_m
        };
        let Press { position_m, radius_m, .. } = *press;
        let now = Peak { position_m, radius_m, amplitude, seen_ns: time_ns, remnant_since_ns: None };
        let Some(peak) = self.peaks.iter_mut().find(is_there) else {
            self.peaks.push(now);
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
        if time_ns.saturating_sub(since_ns) < SET_NS {
            return Remains::Remnant;
        }
        peak.remnant_since_ns = None;
        Remains::Set
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
        let mut judge = |ms: u64, press: &Press, amplitude| {
            peaks.begin(ms * MS);
            peaks.judge(press, amplitude)
        };
        assert_eq!(judge(0, &press, 1.0), Remains::Press);
        // A release passes the last tenth of the amplitude within a few frames. Then it is pressed again.
        assert_eq!(judge(40, &press, 0.05), Remains::Remnant);
        assert_eq!(judge(80, &press, 0.5), Remains::Press);
        assert_eq!(judge(120, &press, 0.05), Remains::Remnant);
        assert_eq!(judge(600, &press, 0.05), Remains::Remnant);
        assert_eq!(judge(640, &press, 0.05), Remains::Set);
        assert_eq!(judge(680, &press, 0.05), Remains::Remnant);
        // Seen again after another frame without it, or elsewhere.
        let elsewhere = Press { position_m: [0.05, 0.0], ..press };
        assert_eq!(judge(1160, &elsewhere, 0.05), Remains::Press);
        assert_eq!(judge(1200, &press, 0.05), Remains::Remnant);
    }
}
