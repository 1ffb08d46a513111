//! The search for the presses that explain a frame, if it takes longer than a frame may: it goes on in the background
//! with a copy of the estimator.

use dermis_estimate::{Allowance, Estimate, Estimator, MOST_NOISE, Memory, Press};
use dermis_touch::{Contact, ContactStrength};

/// Most operations within a frame. A search for one press on most sandwiches takes fewer, some 0.5 ms on one core.
/// Three that move are followed with twice as many.
pub(super) const AT_ONCE: Allowance = Allowance { to_follow: 7e6, to_search: 3.5e6 };
/// The first searches in the background: most operations, which suffice for three presses on most sandwiches, and the
/// delay after which they take effect, nanoseconds. At up to 60 frames per second, that is by the next frame.
const SOON: Allowance = Allowance::of(5e7);
const SOON_NS: u64 = 15_000_000;
/// Delay after which longer searches take effect, nanoseconds. They take up to 150 ms on one slow core.
const LATER_NS: u64 = 160_000_000;
/// A frame whose presses leave less than this share of its energy unexplained is not searched for presses that have
/// ended but are still part of the baseline.
const CLEARLY_EXPLAINED: f64 = 0.005;

/// If a peak is this many times as high as the image's lowest value is deep, it begins a touch even if nothing explains
/// it: a press on a cut, or a hard press.
const OUTSTANDING: f64 = 2.0;

/// Pause after a frame that no presses explain, nanoseconds: initial and maximum. It doubles each time.
const PAUSE_NS: [u64; 2] = [30_000_000, 450_000_000];

/// Frames that nothing explains are remembered for this long, nanoseconds, and at most this many.
const REMEMBERED_NS: u64 = 5_000_000_000;
const MOST_REMEMBERED: usize = 8;
/// Two frames are the same if their difference, beyond the noise, has less than this share of the energy.
const SAME: f64 = 0.02;

/// How long a search in the background may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Patience {
    Short,
    Long,
}

impl Patience {
    /// Delay after which the search takes effect, nanoseconds.
    pub fn delay_ns(self) -> u64 {
        match self {
            Self::Short => SOON_NS,
            Self::Long => LATER_NS,
        }
    }
}

/// A frame to search, and the state in which its search begins.
#[derive(Clone, Debug)]
pub(super) struct Asked {
    /// Time of the frame.
    pub time_ns: u64,
    /// The frame, model volts.
    pub frame: Vec<f64>,
    /// The estimator's memory of the frames before it.
    pub memory: Memory,
    /// Presses to try first.
    pub hints: Vec<Press>,
    /// Presses that are part of the baseline may have ended.
    pub is_gone_possible: bool,
}

/// A search for the presses that explain a frame.
pub(super) struct TouchSearch {
    pub estimator: Estimator,
    pub asked: Asked,
    pub patience: Patience,
}

/// The result of a search.
#[derive(Debug)]
pub(super) struct Searched {
    /// The explanation by present presses; `None` if the frame cannot be fitted.
    pub estimate: Option<Estimate>,
    /// The explanation by present presses and presses that have ended; `None` if they were not looked for.
    pub with_gone: Option<Option<Estimate>>,
    /// The estimator's memory.
    pub memory: Memory,
    /// Input of a longer search, if this one ended early.
    pub goes_on: Option<Asked>,
}

impl TouchSearch {
    /// Searches as long as its patience allows, or the estimator itself.
    pub fn run(mut self) -> Searched {
        if self.patience == Patience::Short {
            self.estimator.allow(SOON);
        }
        let Asked { frame, memory, hints, is_gone_possible, .. } = &self.asked;
        self.estimator.set_memory(memory.clone());
        let estimate = self.estimator.explain(frame, hints);
        let memory = self.estimator.memory().clone();
        let is_unexplained = estimate.as_ref().is_some_and(|estimate| !is_clearly_explained(estimate));
        let is_out_of_work = self.estimator.is_out_of_work();
        let looks_for_gone = is_unexplained && *is_gone_possible && !is_out_of_work;
        let with_gone = looks_for_gone.then(|| self.estimator.explain_with_gone());
        let is_out_of_work = is_out_of_work || self.estimator.is_out_of_work();
        let goes_on = (is_out_of_work && self.patience == Patience::Short).then_some(self.asked);
        Searched { estimate, with_gone, memory, goes_on }
    }
}

/// A pause in the search for presses.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pause {
    until_ns: u64,
    length_ns: u64,
}

impl Pause {
    /// Begins another pause, longer than the last.
    pub fn begin(&mut self, time_ns: u64) {
        self.length_ns = (2 * self.length_ns).clamp(PAUSE_NS[0], PAUSE_NS[1]);
        self.until_ns = time_ns.saturating_add(self.length_ns);
    }

    /// True once frames have been left unexplained, until one is explained.
    pub fn has_begun(&self) -> bool {
        self.length_ns > 0
    }

    /// True during a pause.
    pub fn is_on(&self, time_ns: u64) -> bool {
        time_ns < self.until_ns
    }
}

/// Frames that were searched in vain lately. The same frame is not searched again at once, even if others come between:
/// a bad contact may spoil every other frame.
#[derive(Debug, Default)]
pub(super) struct InVain {
    frames: Vec<Unexplained>,
}

/// A frame that no presses explain.
#[derive(Debug)]
struct Unexplained {
    /// Over the noise of its channels.
    frame: Vec<f64>,
    energy: f64,
    pause: Pause,
    seen_ns: u64,
}

impl InVain {
    /// The pause for a frame (over the noise) that was searched in vain before.
    pub fn pause_of(&mut self, time_ns: u64, frame: &[f64]) -> Option<&Pause> {
        self.frames.retain(|known| time_ns.saturating_sub(known.seen_ns) < REMEMBERED_NS);
        let known = self.frames.iter_mut().find(|known| known.is(frame))?;
        known.seen_ns = time_ns;
        Some(&known.pause)
    }

    /// Begins a pause after a search of this frame.
    pub fn begin(&mut self, time_ns: u64, frame: &[f64]) {
        if let Some(known) = self.frames.iter_mut().find(|known| known.is(frame)) {
            known.pause.begin(time_ns);
            return;
        }
        if self.frames.len() == MOST_REMEMBERED {
            self.frames.remove(0);
        }
        let mut pause = Pause::default();
        pause.begin(time_ns);
        let energy = frame.iter().map(|value| value * value).sum();
        self.frames.push(Unexplained { frame: frame.to_vec(), energy, pause, seen_ns: time_ns });
    }

    /// Forgets a frame: presses explain it now.
    pub fn forget(&mut self, frame: &[f64]) {
        self.frames.retain(|known| !known.is(frame));
    }

    pub fn clear(&mut self) {
        self.frames.clear();
    }
}

impl Unexplained {
    /// True if another frame is the same but for noise and a small change.
    fn is(&self, frame: &[f64]) -> bool {
        let apart: f64 = self.frame.iter().zip(frame).map(|(a, b)| (a - b) * (a - b)).sum();
        apart <= MOST_NOISE * 2.0 * frame.len() as f64 + SAME * self.energy
    }
}

/// Result of a frame's search.
#[derive(Debug)]
pub(super) enum Explained {
    /// The presses, and true if presses that have ended explain the frame as well.
    By(Estimate, bool),
    /// The frame cannot be fitted.
    Nothing,
    /// The search takes longer than a frame allows. Holds the presses found by then, if any.
    Later(Option<Estimate>),
}

/// True if nothing is left that presses that have ended could explain.
pub(super) fn is_clearly_explained(estimate: &Estimate) -> bool {
    estimate.is_at_rest || estimate.unexplained < CLEARLY_EXPLAINED
}

/// True if a contact of an image stands out.
pub(super) fn is_outstanding(contacts: &[Contact], lowest: f64) -> bool {
    contacts.first().is_some_and(|contact| contact.amplitude > OUTSTANDING * -lowest)
}

/// Contacts of an image that nothing explains begin no touch, unless one stands out.
pub(super) fn doubt(contacts: &mut Vec<Contact>, lowest: f64) {
    if is_outstanding(contacts, lowest) {
        contacts.truncate(1);
    } else {
        contacts.iter_mut().for_each(|contact| contact.strength = ContactStrength::Weak);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn frames_searched_in_vain_pause_although_others_come_between() {
        let mut in_vain = InVain::default();
        let frame = |size: f64, noise: f64| (0..100).map(|k| size + noise * f64::from(k % 3 - 1)).collect::<Vec<_>>();
        in_vain.begin(0, &frame(50.0, 1.0));
        in_vain.begin(40 * MS, &frame(50.0, -1.0));
        // The second pause of the same frame is twice as long as the first, 30 ms.
        let is_on = |in_vain: &mut InVain, ms: u64, size: f64| {
            in_vain.pause_of(ms * MS, &frame(size, 1.0)).map(|pause| pause.is_on(ms * MS))
        };
        assert_eq!(is_on(&mut in_vain, 99, 50.0), Some(true));
        assert_eq!(is_on(&mut in_vain, 101, 50.0), Some(false));
        assert_eq!(is_on(&mut in_vain, 101, 70.0), None);
        // It is forgotten once presses explain it, or after five seconds.
        in_vain.begin(120 * MS, &frame(70.0, 1.0));
        in_vain.forget(&frame(50.0, 0.5));
        assert_eq!(is_on(&mut in_vain, 121, 50.0), None);
        assert_eq!(is_on(&mut in_vain, 121, 70.0), Some(true));
        assert_eq!(is_on(&mut in_vain, 5_122, 70.0), None);
    }
}
