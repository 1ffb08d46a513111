//! The search for the presses that explain a frame, if it takes longer than a frame may: it goes on in the background
//! with a copy of the estimator.

use dermis_estimate::{Estimate, Estimator, Memory, Press};
use dermis_touch::{Contact, ContactStrength};

/// Most operations of a search within a frame: some 15 ms on one core. It suffices for two presses on most sandwiches.
pub(super) const AT_ONCE: f64 = 1e8;
/// The same while no presses explain the frames: the search fails or takes long, and goes on in the background anyway.
pub(super) const AT_ONCE_IN_VAIN: f64 = 2e7;
/// Delay after which a search in the background takes effect, nanoseconds. It takes up to 150 ms on one slow core.
pub(super) const READY_NS: u64 = 160_000_000;
/// A frame whose presses leave less than this share of its energy unexplained is not searched for presses that have
/// ended but are still part of the baseline.
const CLEARLY_EXPLAINED: f64 = 0.005;

/// If a peak is this many times as high as the image's lowest value is deep, it begins a touch even if nothing explains
/// it: a press on a cut, or a hard press.
const OUTSTANDING: f64 = 2.0;

/// Pause after frames that no presses explain, nanoseconds: initial and maximum. It doubles each time.
const PAUSE_NS: [u64; 2] = [30_000_000, 450_000_000];

/// A frame to explain.
pub(super) struct TouchSearch {
    pub estimator: Estimator,
    /// The frame, model volts.
    pub frame: Vec<f64>,
    /// Presses to try first.
    pub hints: Vec<Press>,
    /// Presses that are part of the baseline may have ended.
    pub is_gone_possible: bool,
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
}

impl TouchSearch {
    /// Searches as long as the estimator allows itself.
    pub fn run(mut self) -> Searched {
        let estimate = self.estimator.explain(&self.frame, &self.hints);
        let memory = self.estimator.memory().clone();
        let is_unexplained = estimate.as_ref().is_some_and(|estimate| !is_clearly_explained(estimate));
        let with_gone = (is_unexplained && self.is_gone_possible).then(|| self.estimator.explain_with_gone());
        Searched { estimate, with_gone, memory }
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

/// Result of a frame's search.
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
