//! The search for the presses that explain a frame, if it takes longer than a frame may: it goes on in the background
//! with a copy of the estimator.

use dermis_estimate::{Estimate, Estimator, Memory, Meter, Press};

use crate::beside::Beside;

/// Longest part of a search within a frame, nanoseconds: for the first presses, at most the time between two frames, and
/// once presses are followed or frames stay unexplained, at most half of it. A longer search goes on in the background.
const AT_FIRST_NS: u64 = 50_000_000;
const AT_ONCE_NS: u64 = 3_000_000;
/// A frame whose presses leave less than this share of its energy unexplained is not searched for presses that have
/// ended but are still part of the baseline.
const CLEARLY_EXPLAINED: f64 = 0.005;

/// Pause after frames that no presses explain, nanoseconds: initial and maximum. It doubles each time.
const PAUSE_NS: [u64; 2] = [30_000_000, 450_000_000];

/// A frame to explain.
struct TouchSearch {
    estimator: Estimator,
    /// The frame, model volts.
    frame: Vec<f64>,
    /// Presses to try first.
    hints: Vec<Press>,
    /// Presses that are part of the baseline may have ended.
    is_gone_possible: bool,
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
    /// What the quick response of the present presses lacks, model volts.
    pub lack: Option<Vec<f64>>,
}

impl TouchSearch {
    /// Searches as long as the estimator allows itself.
    fn run(mut self) -> Searched {
        let estimate = self.estimator.explain(&self.frame, &self.hints);
        let memory = self.estimator.memory().clone();
        let lack = estimate.as_ref().and_then(|found| self.estimator.fit_mut().lack(&found.presses));
        let is_unexplained = estimate.as_ref().is_some_and(|estimate| !is_clearly_explained(estimate));
        let with_gone = (is_unexplained && self.is_gone_possible).then(|| self.estimator.explain_with_gone());
        Searched { estimate, with_gone, memory, lack }
    }
}

/// Work of one kind in the background, one piece at a time.
#[derive(Debug)]
struct Background<T> {
    beside: Beside<T>,
    meter: Meter,
}

impl<T: Send + 'static> Background<T> {
    fn new() -> Self {
        Self { beside: Beside::new(), meter: Meter::default() }
    }

    /// Starts work with a copy of the estimator, unless fits are too quick for that.
    fn begin(&mut self, time_ns: u64, estimator: &Estimator, work: impl FnOnce(Estimator) -> T + Send + 'static) {
        let meter = Meter::default();
        if let Some(estimator) = estimator.copy(&meter) {
            self.meter = meter.clone();
            self.beside.begin_counted(time_ns, meter, move |_| Some(work(estimator)));
        }
    }
}

/// Searches in the background, and fits with the full response while presses are followed with the quick one.
#[derive(Debug)]
pub(super) struct BackgroundSearch {
    search: Background<Searched>,
    renewal: Background<Option<Vec<f64>>>,
    /// The image showed contacts when the search began, and has shown none since.
    is_of_contacts: bool,
    is_stale: bool,
    /// No renewal before this time: the last one took as long.
    rest_until_ns: u64,
}

impl BackgroundSearch {
    pub fn new() -> Self {
        let (search, renewal) = (Background::new(), Background::new());
        Self { search, renewal, is_of_contacts: false, is_stale: false, rest_until_ns: 0 }
    }

    /// Explains a frame (model volts) by a copy of the estimator with this memory of the frames before it.
    pub fn begin(
        &mut self,
        time_ns: u64,
        (estimator, memory): (&Estimator, Memory),
        frame: &[f64],
        hints: &[Press],
        is_gone_possible: bool,
    ) {
        (self.is_stale, self.is_of_contacts) = (false, !hints.is_empty());
        let (frame, hints) = (frame.to_vec(), hints.to_vec());
        self.search.begin(time_ns, estimator, move |mut estimator| {
            estimator.set_memory(memory);
            TouchSearch { estimator, frame, hints, is_gone_possible }.run()
        });
    }

    /// Takes notice of whether the image shows contacts: a search for contacts that have gone is in vain.
    pub fn see(&mut self, has_contacts: bool) {
        self.is_stale |= !has_contacts && self.is_of_contacts;
    }

    /// The result of a search, once it is due, unless it has become stale.
    pub fn take(&mut self, time_ns: u64) -> Option<Searched> {
        self.search.beside.take(time_ns).filter(|_| !self.is_stale)
    }

    /// Fits the presses of the last frame to this one (model volts) with the full response, unless it is too early.
    pub fn renew(&mut self, time_ns: u64, estimator: &Estimator, frame: &[f64]) {
        if self.renewal.beside.is_under_way() || time_ns < self.rest_until_ns {
            return;
        }
        let frame = frame.to_vec();
        self.renewal.begin(time_ns, estimator, move |mut estimator| {
            let estimate = estimator.follow(&frame)?;
            estimator.fit_mut().lack(&estimate.presses)
        });
    }

    /// The result of a renewal, once it is due: what the quick response lacks, if the presses take longer to fit with
    /// the full one than `at_once_ns`.
    pub fn take_renewal(&mut self, time_ns: u64, at_once_ns: u64) -> Option<Option<Vec<f64>>> {
        let lack = self.renewal.beside.take(time_ns)?;
        let spent_ns = self.renewal.meter.spent_ns();
        self.rest_until_ns = time_ns.saturating_add(spent_ns);
        Some(lack.filter(|_| spent_ns > at_once_ns))
    }

    /// True if the last search took longer than this.
    pub fn took_longer_than(&self, time_ns: u64) -> bool {
        self.search.meter.spent_ns() > time_ns
    }

    /// True while a search is under way.
    pub fn is_under_way(&self) -> bool {
        self.search.beside.is_under_way()
    }

    /// Number of frames that had to wait for results.
    pub fn waits(&self) -> u64 {
        self.search.beside.waits() + self.renewal.beside.waits()
    }

    pub fn cancel_renewal(&mut self) {
        self.renewal.beside.cancel();
        self.rest_until_ns = 0;
    }

    pub fn cancel(&mut self) {
        self.search.beside.cancel();
        self.cancel_renewal();
    }
}

/// The time that a search may take within a frame.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pace {
    last_ns: Option<u64>,
    interval_ns: u64,
}

impl Pace {
    /// Takes the time of a frame.
    pub fn observe(&mut self, time_ns: u64) {
        self.interval_ns = self.last_ns.replace(time_ns).map_or(0, |last_ns| time_ns.saturating_sub(last_ns));
    }

    /// Longest part of a search for the first presses within this frame, nanoseconds.
    pub fn at_first_ns(&self) -> u64 {
        if self.interval_ns == 0 { AT_FIRST_NS } else { AT_FIRST_NS.min(self.interval_ns) }
    }

    /// Longest part of any other search within this frame, nanoseconds.
    pub fn at_once_ns(&self) -> u64 {
        if self.interval_ns == 0 { AT_ONCE_NS } else { AT_ONCE_NS.min(self.interval_ns / 2) }
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
    /// Presses that are followed with the quick response.
    Followed(Estimate),
    /// The frame cannot be fitted.
    Nothing,
    /// The search takes longer than a frame allows. Holds the presses found by then, if any.
    Later(Option<Estimate>),
}

/// True if nothing is left that presses that have ended could explain.
pub(super) fn is_clearly_explained(estimate: &Estimate) -> bool {
    estimate.is_at_rest || estimate.unexplained < CLEARLY_EXPLAINED
}
