//! Frames that are wrong as a whole: frozen, saturated, with opposite sign, or larger than any press could make them.
//! Reciprocity and residuals cannot detect these, since the channels agree with each other.
//!
//! Frames are compared with the resting frame in the unit of the readings, before any processing.

use super::{FrameFault, FrameFaultKind};

/// Consecutive repetitions of a whole frame that count as frozen, unless start-up saw longer runs.
const FROZEN_REPEATS: u32 = 4;
/// Number of start-up frames, which show whether readings move and how often frames repeat.
const START_FRAMES: u32 = 32;
/// Allow runs of repetitions this many times as long as any in start-up, since start-up sees only a few dozen frames.
const LONGER_THAN_SEEN: u32 = 3;
/// Largest probability of repeating by chance at which a run of equal frames still counts as frozen.
const FROZEN_CHANCE: f64 = 1e-12;
/// Consecutive suspect frames needed for a verdict. A single one may be interference on the wire.
const SUSPECT_FRAMES: u32 = 3;
/// Consecutive sound frames that end a verdict.
const SOUND_FRAMES: u32 = 3;
/// Share of the channels that must flip sign or vanish together. One wild channel or a lost electrode cannot reach
/// it.
const TOGETHER: f64 = 0.8;
/// Share of the channels that must be out of range together. Channels that rest near zero may remain in range.
const OUT_TOGETHER: f64 = 0.5;
/// A reading has flipped its sign if it is between these multiples of minus its resting value.
const FLIPPED: [f64; 2] = [0.1, 10.0];
/// A reading is out of range above this multiple of its resting value, or of `LEAST_OF_FRAME` times the RMS of the
/// resting frame if that is larger. Presses change voltages only by factors of several.
const OUT_OF_RANGE: f64 = 100.0;
const LEAST_OF_FRAME: f64 = 0.1;
/// A reading has vanished below this share of its resting value.
const BLANK: f64 = 0.02;
/// It has also vanished within this many standard deviations of zero.
const BLANK_DEVIATIONS: f64 = 3.0;
/// Share of the channels at the largest magnitude in a saturated frame.
const SATURATED_SHARE: f64 = 0.5;
/// Relative tolerance for being at that magnitude.
const AT_THE_END: f64 = 1e-3;
/// A resting value within this many standard deviations of zero has neither a reliable sign nor size.
const LEAST_REST: f64 = 10.0;
/// Minimum number of channels for judging a frame as a whole.
const FEWEST_CHANNELS: usize = 2;

/// Judges whole frames, one after another. Allocates nothing after construction.
#[derive(Debug, Clone)]
pub(super) struct FrameJudge {
    last: Vec<f64>,
    rest: Vec<f64>,
    deviation: Vec<f64>,
    /// RMS of the resting frame.
    rest_size: f64,
    /// At least half of the channels are at one magnitude in the resting frame too.
    rests_at_one_magnitude: bool,
    full_scale: Option<f64>,
    repeats: u32,
    /// Number of start-up frames seen.
    started: u32,
    /// Longest run of repetitions in start-up, and whether any frame differed from the previous one.
    longest_at_start: u32,
    has_moved: bool,
    begun: bool,
    suspect: Option<FrameFaultKind>,
    suspect_frames: u32,
    sound_frames: u32,
    suspect_since: Option<(u64, u64)>,
    fault: Option<FrameFault>,
}

impl FrameJudge {
    pub fn new(channels: usize, full_scale: Option<f64>) -> Self {
        Self {
            last: vec![f64::NAN; channels],
            rest: vec![f64::NAN; channels],
            deviation: vec![f64::NAN; channels],
            rest_size: 0.0,
            rests_at_one_magnitude: false,
            full_scale,
            repeats: 0,
            started: 0,
            longest_at_start: 0,
            has_moved: false,
            begun: false,
            suspect: None,
            suspect_frames: 0,
            sound_frames: 0,
            suspect_since: None,
            fault: None,
        }
    }

    /// Sets the resting frame for comparison, in the unit of the readings (NaN where missing), with the standard
    /// deviations of its channels.
    pub fn begin(&mut self, rest: &[f64], deviation: &[f64]) {
        self.rest.copy_from_slice(rest);
        self.deviation.copy_from_slice(deviation);
        let present = || rest.iter().filter(|value| value.is_finite());
        self.rest_size = (present().map(|value| value * value).sum::<f64>() / present().count().max(1) as f64).sqrt();
        self.rests_at_one_magnitude = self.stands_at_one_magnitude(rest, |_| true);
        self.begun = true;
    }

    /// Takes the readings of a frame. `left_out` marks channels known to be broken. `repeat_chance` is the log
    /// probability that a channel repeats itself.
    pub fn read(&mut self, readings: &[f64], left_out: &[bool], repeat_chance: impl Fn(usize) -> f64) {
        let is_in = |channel: usize| !left_out[channel] && readings[channel].is_finite();
        let mut counted = 0_usize;
        let mut equal = 0_usize;
        let mut chance = 0.0;
        for channel in (0..readings.len()).filter(|&channel| is_in(channel)) {
            counted += 1;
            if readings[channel] == self.last[channel] {
                equal += 1;
                chance += repeat_chance(channel);
            }
        }
        let repeats = counted >= FEWEST_CHANNELS && equal == counted;
        self.repeats = if repeats { self.repeats.saturating_add(1) } else { 0 };
        if self.started < START_FRAMES && counted > 0 {
            self.started += 1;
            self.has_moved |= !repeats && self.last.iter().any(|value| value.is_finite());
            self.longest_at_start = self.longest_at_start.max(self.repeats);
        }
        self.last.copy_from_slice(readings);
        let limit = FROZEN_REPEATS.max(LONGER_THAN_SEEN * self.longest_at_start);
        // An instrument that did not move at rest has no noise, so a repeated frame means nothing.
        let is_started = self.started == START_FRAMES && self.has_moved;
        let is_frozen = is_started && self.repeats >= limit && f64::from(self.repeats) * chance < FROZEN_CHANCE.ln();
        self.suspect = if !self.begun || counted < FEWEST_CHANNELS {
            None
        } else if is_frozen {
            Some(FrameFaultKind::Frozen)
        } else {
            self.compare(readings, is_in)
        };
    }

    fn compare(&self, readings: &[f64], is_in: impl Fn(usize) -> bool) -> Option<FrameFaultKind> {
        let at_full_scale = |end: f64| {
            let of = |(at, all): (usize, usize), channel: usize| {
                (at + usize::from(readings[channel].abs() >= (1.0 - AT_THE_END) * end), all + 1)
            };
            let (at, all) = (0..readings.len()).filter(|&channel| is_in(channel)).fold((0, 0), of);
            at as f64 >= SATURATED_SHARE * all as f64
        };
        if self.full_scale.is_some_and(at_full_scale)
            || (!self.rests_at_one_magnitude && self.stands_at_one_magnitude(readings, &is_in))
        {
            return Some(FrameFaultKind::Saturated);
        }
        // Channels whose resting value has a reliable sign and size.
        let tells = |&c: &usize| is_in(c) && self.rest[c].abs() > LEAST_REST * self.deviation[c];
        let (mut all, mut flipped, mut blank, mut out) = (0_usize, 0, 0, 0);
        for channel in (0..readings.len()).filter(tells) {
            let (reading, rest) = (readings[channel], self.rest[channel]);
            let share = -reading / rest;
            all += 1;
            flipped += usize::from((FLIPPED[0]..=FLIPPED[1]).contains(&share));
            blank += usize::from(reading.abs() < (BLANK * rest.abs()).max(BLANK_DEVIATIONS * self.deviation[channel]));
            out += usize::from(reading.abs() > OUT_OF_RANGE * rest.abs().max(LEAST_OF_FRAME * self.rest_size));
        }
        let are = |some: usize, share: f64| all >= FEWEST_CHANNELS && some as f64 >= share * all as f64;
        if are(out, OUT_TOGETHER) {
            Some(FrameFaultKind::OutOfRange)
        } else if are(blank, TOGETHER) {
            Some(FrameFaultKind::Blank)
        } else {
            are(flipped, TOGETHER).then_some(FrameFaultKind::Flipped)
        }
    }

    /// True if at least half of the channels are at the largest magnitude, and that is not zero.
    fn stands_at_one_magnitude(&self, readings: &[f64], is_in: impl Fn(usize) -> bool) -> bool {
        let sizes = || (0..readings.len()).filter(|&c| is_in(c) && readings[c].is_finite()).map(|c| readings[c].abs());
        let (largest, count) = sizes().fold((0.0_f64, 0_usize), |(most, count), size| (most.max(size), count + 1));
        let at_end = sizes().filter(|size| *size >= (1.0 - AT_THE_END) * largest).count();
        largest > 0.0 && at_end > FEWEST_CHANNELS && at_end as f64 >= SATURATED_SHARE * count as f64
    }

    /// Judges the last frame read. True if the verdict has changed.
    pub fn judge(&mut self, at: (u64, u64)) -> bool {
        let Some(kind) = self.suspect else {
            self.suspect_frames = 0;
            self.suspect_since = None;
            self.sound_frames = self.sound_frames.saturating_add(1);
            return self.sound_frames >= SOUND_FRAMES && self.fault.take().is_some();
        };
        self.sound_frames = 0;
        self.suspect_frames = self.suspect_frames.saturating_add(1);
        let (since_ns, since_sequence) = *self.suspect_since.get_or_insert(at);
        match &mut self.fault {
            // Keep the first verdict: a frame at the converter's limit, for example, is soon frozen too.
            Some(_) => false,
            None if kind == FrameFaultKind::Frozen || self.suspect_frames >= SUSPECT_FRAMES => {
                self.fault = Some(FrameFault { kind, since_ns, since_sequence });
                true
            }
            None => false,
        }
    }

    /// Current fault of whole frames.
    pub fn fault(&self) -> Option<FrameFault> {
        self.fault
    }

    /// True if the last frame read is suspect, or if earlier frames were and it is too early to trust this one.
    pub fn is_suspect(&self) -> bool {
        self.suspect.is_some() || self.fault.is_some()
    }
}
