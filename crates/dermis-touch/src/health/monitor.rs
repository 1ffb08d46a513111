//! The monitor that judges one frame after another.

use super::channel_state::ChannelState;
use super::electrode_faults::ElectrodeFaults;
use super::frame_judge::FrameJudge;
use super::wiring::Wiring;
use super::{ChannelFault, ChannelFaultKind, ElectrodeFault, ElectrodeFaultKind, Health, HealthParams};
use crate::error::{TouchError, require_length};

/// Resting values below this many standard deviations cannot show whether a channel is dead.
const LEAST_SIGNAL: f64 = 50.0;
/// Minimum number of channels whose agreement counts.
pub(super) const FEWEST_TOGETHER: usize = 3;
/// Blame only one of two reciprocal channels if its residual against the others is this many times the other's.
const FARTHER: f64 = 3.0;
/// Suspect a channel only if its residual is at least this share of the largest: one bad channel disturbs all
/// residuals.
const BESIDE: f64 = 0.3;
/// Residual beyond the tolerance from which a channel looks faulty, in standard deviations.
const SUSPECT: f64 = 3.0;
/// Number of frames that look like faults in which presses are asked about. The next may bring the verdict.
const ASKED: u32 = 3;
/// Largest step that a touch can cause, as a share of the largest resting value. Used if there is nothing to compare
/// with.
const GROSS_STEP: f64 = 0.5;

/// Judges channels and electrodes frame by frame. Allocates nothing after construction. The result depends only on
/// the frames and their order: no clock and no randomness.
#[derive(Debug, Clone)]
pub struct HealthMonitor {
    pub(super) wiring: Wiring,
    pub(super) params: HealthParams,
    pub(super) channels: Vec<ChannelState>,
    electrodes: ElectrodeFaults,
    pub(super) frame: FrameJudge,
    faults: Vec<ChannelFault>,
    electrode_faults: Vec<ElectrodeFault>,
    /// Declared channels: bad, or using a lost electrode.
    declared: Vec<bool>,
    /// Declared channels, and those suspect in this frame.
    excluded: Vec<bool>,
    recovered: Vec<u32>,
    dead: Vec<bool>,
    spared: Vec<bool>,
    previous: Vec<f64>,
    sizes: Vec<f64>,
    pub(super) largest_rest: f64,
    has_expectation: bool,
    pub(super) begun: bool,
    /// Consecutive frames that look like faults, and whether presses explained the last of them.
    suspect_frames: u32,
    is_explained: bool,
}

/// A frame to judge.
#[derive(Debug, Clone, Copy)]
pub struct JudgedFrame<'a> {
    /// Time in nanoseconds, and sequence number.
    pub at: (u64, u64),
    /// Difference data, model volts; NaN where missing.
    pub difference: &'a [f64],
    /// Each channel's residual against the value expected from the good channels (model volts), if available.
    pub unexplained: Option<&'a [f64]>,
    /// The skin is touched. A channel that has settled at another value is then not acquitted: how much of it is the
    /// touch is not known.
    pub is_touched: bool,
}

impl HealthMonitor {
    /// A monitor for channels with this wiring.
    #[must_use]
    pub fn new(wiring: Wiring, params: HealthParams) -> Self {
        let count = wiring.channel_count();
        Self {
            electrodes: ElectrodeFaults::new(&wiring),
            frame: FrameJudge::new(count, params.full_scale),
            channels: vec![ChannelState::new(); count],
            faults: Vec::with_capacity(count),
            electrode_faults: Vec::with_capacity(2 * wiring.electrode_count()),
            declared: vec![false; count],
            excluded: vec![false; count],
            recovered: Vec::with_capacity(count),
            dead: vec![false; count],
            spared: vec![false; count],
            previous: vec![f64::NAN; count],
            sizes: Vec::with_capacity(count),
            largest_rest: 0.0,
            has_expectation: false,
            begun: false,
            suspect_frames: 0,
            is_explained: false,
            wiring,
            params,
        }
    }

    /// Number of channels.
    #[must_use]
    pub fn channel_count(&self) -> usize {
        self.channels.len()
    }

    /// All known faults.
    #[must_use]
    pub fn health(&self) -> Health<'_> {
        Health {
            frame: self.frame.fault(),
            channels: (&self.faults).into(),
            electrodes: (&self.electrode_faults).into(),
        }
    }

    /// Channels to exclude permanently: those of [`HealthMonitor::health`].
    #[must_use]
    pub fn declared(&self) -> &[bool] {
        &self.declared
    }

    /// Channels to exclude from the last frame judged: the declared ones, and any that are far off in this frame.
    #[must_use]
    pub fn excluded(&self) -> &[bool] {
        &self.excluded
    }

    /// True if the last frame judged has channels that are far off but not declared yet, which makes its results
    /// doubtful.
    #[must_use]
    pub fn is_doubtful(&self) -> bool {
        self.excluded.iter().zip(&self.declared).any(|(excluded, declared)| *excluded && !*declared)
    }

    /// True if the last frame read is wrong as a whole, or follows frames that were. Do not process it.
    #[must_use]
    pub fn is_frame_suspect(&self) -> bool {
        self.frame.is_suspect()
    }

    /// True if the last frame judged shows no fault of a channel.
    #[must_use]
    pub fn is_clean(&self, channel: usize) -> bool {
        self.channels.get(channel).is_some_and(|state| state.clean > 0)
    }

    /// Channels acquitted by the last frame.
    #[must_use]
    pub fn recovered(&self) -> &[u32] {
        &self.recovered
    }

    /// Takes the raw readings of a frame (NaN where missing). Call it for every frame, including those before the
    /// baseline: they show how often a channel repeats itself.
    ///
    /// # Errors
    /// [`TouchError::Length`].
    pub fn read(&mut self, readings: &[f64]) -> Result<(), TouchError> {
        require_length("readings", self.channels.len(), readings.len())?;
        let pairs = || self.channels.iter().zip(readings);
        let repeated = pairs().filter(|(state, reading)| state.equals_last(**reading)).count();
        let whole_frame_repeats = 2 * repeated > readings.len() && repeated > FEWEST_TOGETHER;
        let channels = &self.channels;
        self.frame.read(readings, &self.declared, |channel| channels[channel].repeat_chance().ln());
        let largest = readings.iter().map(|v| v.abs()).filter(|v| v.is_finite()).fold(0.0, f64::max);
        for (state, &reading) in self.channels.iter_mut().zip(readings) {
            state.read(reading, whole_frame_repeats, largest, &self.params);
        }
        Ok(())
    }

    /// Judges the last frame read. True if the known faults changed. A frame that is wrong as a whole says nothing
    /// about its channels. `is_explained` tells whether presses explain the frame. It is asked only about frames that
    /// look like faults: a press on electrodes can short them.
    ///
    /// # Errors
    /// [`TouchError::Length`].
    pub fn judge(&mut self, frame: &JudgedFrame<'_>, is_explained: impl FnMut() -> bool) -> Result<bool, TouchError> {
        let JudgedFrame { at, difference, unexplained, is_touched } = *frame;
        require_length("difference data", self.channels.len(), difference.len())?;
        require_length(
            "unexplained differences",
            difference.len(),
            unexplained.map_or(difference.len(), <[f64]>::len),
        )?;
        self.recovered.clear();
        if !self.begun {
            return Ok(false);
        }
        let verdict = self.frame.judge(at);
        if self.frame.is_suspect() {
            self.previous.fill(f64::NAN);
            return Ok(verdict);
        }
        self.find_dead(difference);
        self.ask(difference, unexplained, is_explained);
        self.gather(at, difference, unexplained);
        self.previous.copy_from_slice(difference);
        let declared = self.declare(at, is_touched);
        let changed = declared || verdict;
        if declared {
            self.conclude();
        }
        for ((excluded, declared), state) in self.excluded.iter_mut().zip(&self.declared).zip(&self.channels) {
            *excluded = *declared || state.now >= self.params.most_per_frame;
        }
        Ok(changed)
    }

    /// Finds groups of channels (of a drive, a measuring pair or an electrode) whose signals have vanished together.
    fn find_dead(&mut self, difference: &[f64]) {
        self.dead.fill(false);
        for group in &self.wiring.groups {
            let gone = |c: usize| is_gone(&self.channels[c], difference[c], &self.params);
            let telling = group.iter().filter(|&&c| tells(&self.channels[c as usize])).count();
            let silent = group.iter().filter(|&&c| tells(&self.channels[c as usize]) && gone(c as usize)).count();
            if telling >= FEWEST_TOGETHER && silent as f64 >= self.params.dead_agreement * telling as f64 {
                group.iter().filter(|&&c| gone(c as usize)).for_each(|&c| self.dead[c as usize] = true);
            }
        }
    }

    /// Asks whether presses explain a frame that looks like faults: in the first such frames, since the answer may take
    /// longer than one of them, and as long as they do.
    fn ask(&mut self, difference: &[f64], unexplained: Option<&[f64]>, mut is_explained: impl FnMut() -> bool) {
        let is_suspect = self.looks_faulty(difference, unexplained);
        self.suspect_frames = if is_suspect { self.suspect_frames.saturating_add(1) } else { 0 };
        let asks = is_suspect && (self.is_explained || self.suspect_frames <= ASKED);
        self.is_explained = asks && is_explained();
        if self.is_explained {
            self.dead.fill(false);
        }
    }

    /// True if a channel not declared yet shows a fault for which a press could be the cause.
    fn looks_faulty(&mut self, difference: &[f64], unexplained: Option<&[f64]>) -> bool {
        if self.dead.iter().zip(&self.declared).any(|(dead, declared)| *dead && !*declared) {
            return true;
        }
        let Some(all) = unexplained.filter(|_| self.has_expectation) else { return false };
        let median = self.median_size(difference);
        (0..all.len()).filter(|&channel| !self.declared[channel]).any(|channel| {
            let state = &self.channels[channel];
            all[channel].abs() > self.tolerated(state, median) + SUSPECT * state.unexplained_sigma
                && self.usable_partner(channel).is_none()
        })
    }

    /// Gathers the evidence of one frame for each channel.
    fn gather(&mut self, at: (u64, u64), difference: &[f64], unexplained: Option<&[f64]>) {
        for (state, _) in self.channels.iter_mut().zip(&self.dead).filter(|(_, dead)| **dead) {
            state.direct.get_or_insert(ChannelFaultKind::Dead);
        }
        let median = self.median_size(difference);
        let farthest = unexplained.map_or(0.0, |all| all.iter().map(|v| v.abs()).fold(0.0, f64::max));
        for channel in 0..difference.len() {
            self.channels[channel].follow(difference[channel]);
            if let Some(all) = unexplained {
                self.channels[channel].expect_unexplained(all[channel].abs());
            }
            let excess = match (self.usable_partner(channel), unexplained) {
                (Some((partner, ratio)), _) => self.against_partner(channel, partner, ratio, difference),
                // Presses account for what the linear image does not.
                (None, Some(_)) if self.is_explained => 0.0,
                (None, Some(all)) if self.has_expectation => {
                    if all[channel].abs() >= BESIDE * farthest || self.declared[channel] {
                        self.against_expectation(channel, all[channel], median)
                    } else {
                        0.0
                    }
                }
                _ => self.against_itself(channel, difference),
            };
            let state = &mut self.channels[channel];
            let squared = if state.direct.is_some() { f64::INFINITY } else { excess * excess };
            state.add((squared as f32).min(self.params.most_per_frame), at);
        }
    }

    /// The reciprocal channel, unless it is known to be faulty and this one is not.
    fn usable_partner(&self, channel: usize) -> Option<(usize, f64)> {
        let (partner, ratio) = self.wiring.partners[channel]?;
        let (this, other) = (&self.channels[channel], &self.channels[partner as usize]);
        let of_its_own = |state: &ChannelState| {
            state.direct.is_some() || state.bad.is_some_and(|(kind, ..)| kind > ChannelFaultKind::Inconsistent)
        };
        let lost = self.declared[partner as usize] && !self.declared[channel];
        (!lost && (of_its_own(this) || !of_its_own(other))).then_some((partner as usize, ratio))
    }

    fn against_partner(&mut self, channel: usize, partner: usize, ratio: f64, difference: &[f64]) -> f64 {
        let (own, others) = (difference[channel], ratio * difference[partner]);
        let rest = self.channels[channel].rest.abs();
        // The two are read at different moments of a frame, so their common change since the previous frame may come
        // between.
        let steps = [own - self.previous[channel], others - ratio * self.previous[partner]];
        let moved = steps.map(f64::abs).into_iter().fold(f64::INFINITY, f64::min);
        let tolerated = self.params.share_of_change * own.abs().max(others.abs())
            + self.params.share_of_rest * rest
            + if moved.is_finite() { self.params.share_of_motion * moved } else { 0.0 };
        let deviation = self.channels[channel].sigma.hypot(ratio * self.channels[partner].sigma);
        self.channels[channel].excess(own - others, tolerated, deviation)
    }

    fn against_expectation(&mut self, channel: usize, apart: f64, median: f64) -> f64 {
        let tolerated = self.tolerated(&self.channels[channel], median);
        let state = &mut self.channels[channel];
        let deviation = state.unexplained_sigma;
        state.excess(apart, tolerated, deviation)
    }

    /// Tolerated residual of a channel without a partner.
    fn tolerated(&self, state: &ChannelState, median: f64) -> f64 {
        self.params.unpartnered_share_of_rest * state.rest.abs() + self.params.unpartnered_changes * median
    }

    fn against_itself(&mut self, channel: usize, difference: &[f64]) -> f64 {
        let step = difference[channel] - self.previous[channel];
        let state = &self.channels[channel];
        if step.is_finite() { (step.abs() - GROSS_STEP * self.largest_rest).max(0.0) / state.sigma } else { 0.0 }
    }

    fn median_size(&mut self, difference: &[f64]) -> f64 {
        self.sizes.clear();
        self.sizes.extend(difference.iter().map(|v| v.abs()).filter(|v| v.is_finite()));
        let middle = self.sizes.len() / 2;
        if self.sizes.is_empty() {
            return 0.0;
        }
        *self.sizes.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// Declares and acquits channels. True if any changed.
    fn declare(&mut self, at: (u64, u64), is_touched: bool) -> bool {
        for channel in 0..self.channels.len() {
            self.spared[channel] = self.is_convicted(channel) && self.partner_is_to_blame(channel);
        }
        let mut changed = false;
        for channel in 0..self.channels.len() {
            let convicted = self.is_convicted(channel) && !self.spared[channel];
            let state = &mut self.channels[channel];
            if self.spared[channel] {
                state.acquit();
            } else if let Some((known, since, sequence)) = state.bad {
                let kind = known.max(state.kind());
                if state.clean >= self.params.clean_frames && (state.is_back || !is_touched) {
                    state.acquit();
                    changed = true;
                } else if kind != known {
                    state.bad = Some((kind, since, sequence));
                    changed = true;
                }
            } else if convicted {
                let (since, sequence) = state.suspect_since.unwrap_or(at);
                state.bad = Some((state.kind(), since, sequence));
                changed = true;
            }
        }
        changed
    }

    fn is_convicted(&self, channel: usize) -> bool {
        let state = &self.channels[channel];
        state.bad.is_none() && (state.frozen || state.sum >= self.params.bad_sum)
    }

    /// True if the partner is the faulty one of two contradicting reciprocal channels. A partner with its own fault
    /// was not used for comparison.
    fn partner_is_to_blame(&self, channel: usize) -> bool {
        let Some((partner, _)) = self.usable_partner(channel) else { return false };
        let (this, other) = (&self.channels[channel], &self.channels[partner]);
        if this.direct.is_some() || !(other.bad.is_some() || self.is_convicted(partner)) {
            return false;
        }
        (other.is_noisy() && !this.is_noisy())
            || (self.has_expectation && other.unexplained > FARTHER * this.unexplained)
    }

    /// Derives faulty electrodes and the lists of faults from the channels.
    pub(super) fn conclude(&mut self) {
        let channels = &self.channels;
        let bad = |channel: u32| channels[channel as usize].bad;
        self.electrodes.judge(&self.wiring, &self.params, bad, &mut self.electrode_faults);
        self.excluded.copy_from_slice(&self.declared);
        for (declared, state) in self.declared.iter_mut().zip(&self.channels) {
            *declared = state.bad.is_some();
        }
        for electrode in (0..self.electrodes.lost().len()).filter(|&e| self.electrodes.lost()[e]) {
            self.wiring.channels_of(electrode as u32).iter().for_each(|&c| self.declared[c as usize] = true);
        }
        self.faults.clear();
        for (channel, _) in self.declared.iter().enumerate().filter(|(_, declared)| **declared) {
            let electrode = self.electrode_faults.iter().find(|fault| self.explains(fault, channel));
            let of_electrode =
                electrode.map(|fault| (ChannelFaultKind::Electrode, fault.since_ns, fault.since_sequence));
            if let Some((kind, since_ns, since_sequence)) = of_electrode.or(self.channels[channel].bad) {
                self.faults.push(ChannelFault { channel: channel as u32, kind, since_ns, since_sequence });
            }
        }
        let before = self.excluded.iter().zip(&self.declared).enumerate();
        self.recovered.extend(before.filter(|(_, (was, is))| **was && !**is).map(|(channel, _)| channel as u32));
    }

    /// True if an electrode fault explains a channel: it uses a lost electrode, or is driven or read across a short.
    fn explains(&self, fault: &ElectrodeFault, channel: usize) -> bool {
        let [drive, pattern] = self.wiring.channels[channel];
        let [driven, read] = [&self.wiring.drives[drive as usize], &self.wiring.patterns[pattern as usize]];
        let across = |pair: &Vec<u32>| match fault.kind {
            ElectrodeFaultKind::Lost => pair.contains(&fault.electrode),
            ElectrodeFaultKind::Shorted { with } => pair.contains(&fault.electrode) && pair.contains(&with),
        };
        across(driven) || across(read)
    }

    /// Resets comparisons for a new baseline.
    pub(super) fn restart(&mut self, rest: &[f64], sigma: &[f64], unexplained_sigma: Option<&[f64]>) {
        self.has_expectation = unexplained_sigma.is_some();
        self.largest_rest = rest.iter().map(|v| v.abs()).filter(|v| v.is_finite()).fold(0.0, f64::max);
        for (channel, state) in self.channels.iter_mut().enumerate() {
            let unexplained = unexplained_sigma.map_or(f64::NAN, |all| all[channel]);
            state.restart(rest[channel], sigma[channel], unexplained);
        }
        self.previous.fill(f64::NAN);
        self.begun = true;
    }
}

/// True if a channel's resting value is large enough to notice its loss.
fn tells(state: &ChannelState) -> bool {
    state.rest.abs() > LEAST_SIGNAL * state.sigma
}

fn is_gone(state: &ChannelState, difference: f64, params: &HealthParams) -> bool {
    (state.rest + difference).abs() <= params.dead_share * state.rest.abs() + 5.0 * state.sigma
}
