//! Evidence about one channel from one frame, and how it accumulates over frames.

use super::{ChannelFaultKind, HEALTH_WINDOW, HealthParams};

/// Weight of a new frame in running means.
const RECENT: f64 = 0.3;
/// Weight of a new frame in the offset at which a bad channel settles.
const SETTLING: f64 = 0.1;
/// Upper bound on the contribution of one difference of successive readings, in variances.
const MOST_FLICKER: f64 = 100.0;
/// A channel is back where it was within this many standard deviations beyond the tolerance.
const BACK: f64 = 3.0;
/// A channel is noisy if its squared differences reach this many times their usual size.
const NOISY: f64 = 6.0;
/// Halve the counts of repetitions and pairs at this many pairs, so that they describe the recent past.
const MOST_PAIRS: f64 = 4096.0;

/// State of one channel.
#[derive(Debug, Clone)]
pub(super) struct ChannelState {
    last: f64,
    /// Consecutive readings equal to their predecessor.
    run: u32,
    repeats: f64,
    pairs: f64,
    window: [f32; HEALTH_WINDOW],
    next: usize,
    pub sum: f32,
    /// Standard deviation of a reading, model volts.
    pub sigma: f64,
    /// Resting value, model volts.
    pub rest: f64,
    /// Standard deviation of the residual that the other channels leave unexplained.
    pub unexplained_sigma: f64,
    /// Offset from the other channels at which a bad channel settles.
    offset: f64,
    /// Mean square of successive differences over its value for noise alone.
    flicker: f64,
    /// Mean size of the residual that the other channels leave unexplained.
    pub unexplained: f64,
    last_difference: f64,
    /// It reads what it should by its baseline, as far as other channels tell.
    pub is_back: bool,
    /// Consecutive frames without fault.
    pub clean: u32,
    /// First frame of the evidence being gathered.
    pub suspect_since: Option<(u64, u64)>,
    pub bad: Option<(ChannelFaultKind, u64, u64)>,
    /// Fault that this frame shows without comparison to other channels.
    pub direct: Option<ChannelFaultKind>,
    /// Evidence of this frame alone.
    pub now: f32,
    /// It has repeated itself for long enough to be declared at once.
    pub frozen: bool,
}

impl ChannelState {
    pub fn new() -> Self {
        Self {
            last: f64::NAN,
            run: 0,
            repeats: 0.0,
            pairs: 0.0,
            window: [0.0; HEALTH_WINDOW],
            next: 0,
            sum: 0.0,
            sigma: f64::NAN,
            rest: f64::NAN,
            unexplained_sigma: f64::NAN,
            offset: 0.0,
            flicker: 1.0,
            unexplained: 0.0,
            last_difference: f64::NAN,
            is_back: true,
            clean: 0,
            suspect_since: None,
            bad: None,
            direct: None,
            now: 0.0,
            frozen: false,
        }
    }

    /// Clears comparisons, which a new baseline invalidates. A bad channel stays bad.
    pub fn restart(&mut self, rest: f64, sigma: f64, unexplained_sigma: f64) {
        (self.rest, self.sigma, self.unexplained_sigma) = (rest, sigma, unexplained_sigma);
        self.window = [0.0; HEALTH_WINDOW];
        (self.next, self.sum, self.offset, self.flicker, self.unexplained) = (0, 0.0, 0.0, 1.0, 0.0);
        self.last_difference = f64::NAN;
        self.suspect_since = None;
    }

    /// Share of readings equal to their predecessor.
    pub fn repeat_share(&self) -> f64 {
        (self.repeats + f64::from(self.run)) / (self.pairs + f64::from(self.run)).max(1.0)
    }

    /// True if no reading has differed from the first.
    pub fn never_moved(&self) -> bool {
        self.pairs == 0.0 && self.run > 0
    }

    pub fn equals_last(&self, reading: f64) -> bool {
        reading == self.last
    }

    /// Takes a reading. If `whole_frame_repeats`, the run of repetitions does not grow, since the frame as a whole
    /// repeats the previous one and that says nothing about a single channel.
    pub fn read(&mut self, reading: f64, whole_frame_repeats: bool, largest: f64, params: &HealthParams) {
        (self.direct, self.frozen) = (None, false);
        if !reading.is_finite() {
            (self.run, self.last) = (0, f64::NAN);
            self.direct = Some(ChannelFaultKind::Missing);
            return;
        }
        if reading == self.last {
            self.run += u32::from(!whole_frame_repeats);
        } else if self.last.is_finite() {
            // Count a run's repetitions only when it ends, so that a frozen channel does not make repetition look
            // usual.
            self.repeats += f64::from(self.run);
            self.pairs += f64::from(self.run) + 1.0;
            self.run = 0;
            if self.pairs > MOST_PAIRS {
                (self.repeats, self.pairs) = (0.5 * self.repeats, 0.5 * self.pairs);
            }
        }
        self.last = reading;
        // A channel that never moved is declared at the baseline, and stays so until it moves.
        let known = matches!(self.bad, Some((ChannelFaultKind::Stuck | ChannelFaultKind::Saturated, ..)));
        self.frozen = self.is_frozen(params) || (known && self.run as usize > HEALTH_WINDOW);
        let at_end = params.full_scale.is_some_and(|end| reading.abs() >= 0.999 * end);
        if at_end || (self.frozen && reading.abs() >= largest) {
            self.direct = Some(ChannelFaultKind::Saturated);
        } else if self.frozen {
            self.direct = Some(ChannelFaultKind::Stuck);
        }
    }

    /// Probability that the next reading equals this one, from past repetitions plus three for safety.
    pub fn repeat_chance(&self) -> f64 {
        (self.repeats + 3.0) / (self.pairs + 4.0)
    }

    /// True if a run of equal readings this long cannot be chance, given [`Self::repeat_chance`].
    fn is_frozen(&self, params: &HealthParams) -> bool {
        let usual = self.repeat_chance();
        usual < 1.0 && self.pairs > 0.0 && f64::from(self.run) * usual.ln() < params.stuck_chance.ln()
    }

    /// Tracks successive differences, which distinguish noise from steps.
    pub fn follow(&mut self, difference: f64) {
        let step = difference - self.last_difference;
        self.last_difference = difference;
        if step.is_finite() {
            let size = (0.5 * (step / self.sigma).powi(2)).min(MOST_FLICKER);
            self.flicker += RECENT * (size - self.flicker);
        }
    }

    pub fn is_noisy(&self) -> bool {
        self.flicker > NOISY
    }

    /// Deviation from the value expected from other channels, beyond the tolerance, in standard deviations.
    pub fn excess(&mut self, apart: f64, tolerated: f64, deviation: f64) -> f64 {
        if !apart.is_finite() {
            return 0.0;
        }
        self.is_back = apart.abs() <= tolerated + BACK * deviation;
        let from_offset = apart - self.offset;
        if self.bad.is_some() {
            self.offset += SETTLING * from_offset;
        }
        // Either back where it was, or settled at its offset.
        (from_offset.abs().min(apart.abs()) - tolerated).max(0.0) / deviation
    }

    pub fn expect_unexplained(&mut self, size: f64) {
        if size.is_finite() {
            self.unexplained += RECENT * (size - self.unexplained);
        }
    }

    /// Adds this frame's evidence.
    pub fn add(&mut self, evidence: f32, at: (u64, u64)) {
        self.now = evidence;
        self.sum += evidence - self.window[self.next];
        self.window[self.next] = evidence;
        self.next = (self.next + 1) % HEALTH_WINDOW;
        if self.next == 0 {
            // Recompute now and then, to limit accumulated rounding.
            self.sum = self.window.iter().sum();
        }
        if evidence > 9.0 {
            self.suspect_since.get_or_insert(at);
        } else if self.sum < 9.0 {
            self.suspect_since = None;
        }
        self.clean = if evidence < 16.0 && self.direct.is_none() { self.clean + 1 } else { 0 };
    }

    /// The most likely fault of the channel.
    pub fn kind(&self) -> ChannelFaultKind {
        let noisy = if self.is_noisy() { ChannelFaultKind::Noisy } else { ChannelFaultKind::Inconsistent };
        self.direct.unwrap_or(noisy)
    }

    /// Acquits the channel.
    pub fn acquit(&mut self) {
        self.bad = None;
        self.window = [0.0; HEALTH_WINDOW];
        (self.sum, self.offset, self.suspect_since) = (0.0, 0.0, None);
    }
}
