//! What one frame says of one channel, and how evidence adds up over frames.

use super::{ChannelFaultKind, HEALTH_WINDOW, HealthParams};

/// Weight of a new frame in running means.
const RECENT: f64 = 0.3;
/// Weight of a new frame in the offset that a bad channel settles at.
const SETTLING: f64 = 0.1;
/// A difference of successive readings counts up to so many variances.
const MOST_FLICKER: f64 = 100.0;
/// Differences this many times as large as usual, in variances, are noise.
const NOISY: f64 = 6.0;
/// Repetitions and pairs are halved when so many pairs have been counted, so that they are of the recent past.
const MOST_PAIRS: f64 = 4096.0;

/// Everything that is remembered of a channel.
#[derive(Debug, Clone)]
pub(super) struct ChannelState {
    last: f64,
    /// Readings in a row equal to the one before.
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
    /// Standard deviation of what the others leave unexplained.
    pub unexplained_sigma: f64,
    /// What the comparison with others settles at while the channel is bad.
    offset: f64,
    /// Mean square of successive differences over what noise makes of it.
    flicker: f64,
    /// Mean size of what the others leave unexplained.
    pub unexplained: f64,
    last_difference: f64,
    /// Frames in a row without fault.
    pub clean: u32,
    /// The first frame of the evidence that is being gathered.
    pub suspect_since: Option<(u64, u64)>,
    pub bad: Option<(ChannelFaultKind, u64, u64)>,
    /// What this frame shows without comparison to other channels.
    pub direct: Option<ChannelFaultKind>,
    /// Evidence of this frame alone.
    pub now: f32,
    /// It has read the same for so long that nothing more need be waited for.
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
            clean: 0,
            suspect_since: None,
            bad: None,
            direct: None,
            now: 0.0,
            frozen: false,
        }
    }

    /// Forgets comparisons, which a new baseline puts on another footing; what is bad stays so.
    pub fn restart(&mut self, rest: f64, sigma: f64, unexplained_sigma: f64) {
        (self.rest, self.sigma, self.unexplained_sigma) = (rest, sigma, unexplained_sigma);
        self.window = [0.0; HEALTH_WINDOW];
        (self.next, self.sum, self.offset, self.flicker, self.unexplained) = (0, 0.0, 0.0, 1.0, 0.0);
        self.last_difference = f64::NAN;
        self.suspect_since = None;
    }

    /// Share of readings that are equal to the one before.
    pub fn repeat_share(&self) -> f64 {
        (self.repeats + f64::from(self.run)) / (self.pairs + f64::from(self.run)).max(1.0)
    }

    /// True where all readings so far were the same.
    pub fn never_moved(&self) -> bool {
        self.pairs == 0.0 && self.run > 0
    }

    pub fn equals_last(&self, reading: f64) -> bool {
        reading == self.last
    }

    /// Takes in a reading. In a frame that repeats the one before as a whole, `whole_frame_repeats`, runs do not grow:
    /// that says nothing of a channel.
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
            // The run's repetitions count once it is over, so that a frozen channel does not look usual.
            self.repeats += f64::from(self.run);
            self.pairs += f64::from(self.run) + 1.0;
            self.run = 0;
            if self.pairs > MOST_PAIRS {
                (self.repeats, self.pairs) = (0.5 * self.repeats, 0.5 * self.pairs);
            }
        }
        self.last = reading;
        // A channel that never moved is known from the baseline, and stays so until it does.
        let known = matches!(self.bad, Some((ChannelFaultKind::Stuck | ChannelFaultKind::Saturated, ..)));
        self.frozen = self.is_frozen(params) || (known && self.run as usize > HEALTH_WINDOW);
        let at_end = params.full_scale.is_some_and(|end| reading.abs() >= 0.999 * end);
        if at_end || (self.frozen && reading.abs() >= largest) {
            self.direct = Some(ChannelFaultKind::Saturated);
        } else if self.frozen {
            self.direct = Some(ChannelFaultKind::Stuck);
        }
    }

    /// Chance that the next reading equals this one, by those that did; three more are allowed than were seen, for luck.
    pub fn repeat_chance(&self) -> f64 {
        (self.repeats + 3.0) / (self.pairs + 4.0)
    }

    /// True where so long a run of equal readings is no chance, by [`Self::repeat_chance`].
    fn is_frozen(&self, params: &HealthParams) -> bool {
        let usual = self.repeat_chance();
        usual < 1.0 && self.pairs > 0.0 && f64::from(self.run) * usual.ln() < params.stuck_chance.ln()
    }

    /// Follows successive differences, which tell noise from steps.
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

    /// Deviation from what others let expect, in standard deviations beyond what is tolerated.
    pub fn excess(&mut self, apart: f64, tolerated: f64, deviation: f64) -> f64 {
        if !apart.is_finite() {
            return 0.0;
        }
        let from_offset = apart - self.offset;
        if self.bad.is_some() {
            self.offset += SETTLING * from_offset;
        }
        // Back where it was, or settled where it is.
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
            // Against the rounding of many additions.
            self.sum = self.window.iter().sum();
        }
        if evidence > 9.0 {
            self.suspect_since.get_or_insert(at);
        } else if self.sum < 9.0 {
            self.suspect_since = None;
        }
        self.clean = if evidence < 16.0 && self.direct.is_none() { self.clean + 1 } else { 0 };
    }

    /// What the channel suffers from, as far as can be told now.
    pub fn kind(&self) -> ChannelFaultKind {
        let noisy = if self.is_noisy() { ChannelFaultKind::Noisy } else { ChannelFaultKind::Inconsistent };
        self.direct.unwrap_or(noisy)
    }

    /// Takes the channel back.
    pub fn acquit(&mut self) {
        self.bad = None;
        self.window = [0.0; HEALTH_WINDOW];
        (self.sum, self.offset, self.suspect_since) = (0.0, 0.0, None);
    }
}
