//! The baseline that difference data are taken against: compensated = raw - baseline, channel by channel.
//!
//! It is set at the start from the median of the first frames, later by an explicit tare or by the caller, and may
//! follow slow drift as an exponential mean, b += (1 - exp(-dt/tau)) (raw - b), but only while nothing touches the
//! skin: under contact it stands still, so that a held touch keeps its value however long it is held. Where touch and
//! damage may come on as slowly as drift, only the part of the change that is alike everywhere is followed, b += (1 -
//! exp(-dt/tau)) a b with a the least-squares share of (raw - b) along b: a sheet that grows warmer under a constant
//! current changes all its voltages by the same share, a touch or a cut does not. Every baseline that was in use is
//! kept with its time and reason, and can be taken up again.

mod statistics;
mod types;

pub use types::{
    BaselineChange, BaselineParams, BaselineState, DriftCompensation, Load, ReferenceOrigin, ReferenceRecord, TareGuard,
};

use crate::error::{TouchError, require, require_length};
use statistics::robust_mean_and_std;

/// A change counts as alike everywhere where its uniform part has this share of its energy.
const UNIFORM_SHARE: f64 = 0.9;
/// Or where what is left without it is below so many standard deviations of the noise (root mean square).
const UNIFORM_REST: f64 = 3.0;
/// What drifted while the baseline stood still under a touch is caught up after it: for this long, at this time constant,
/// seconds.
const CATCH_UP_S: f64 = 2.0;
const CATCH_UP_TIME_CONSTANT_S: f64 = 0.5;
/// Values of so many baselines are kept; of older ones only the first.
const MOST_KEPT: usize = 64;

/// A tare under way.
#[derive(Debug, Clone)]
struct Tare {
    want: usize,
    have: usize,
    guard: TareGuard,
    reason: String,
}

/// Raw values, baseline and compensated values of one stream of frames.
///
/// Each frame goes through [`Baseline::observe`], which compensates it by the baseline as it stood, and, once the
/// caller has judged the load, through [`Baseline::learn`]. A NaN value belongs to its channel alone: it is compensated
/// to NaN and moves no baseline. A channel without any value during start-up or tare has the baseline NaN until the
/// next tare.
#[derive(Debug, Clone)]
pub struct Baseline {
    params: BaselineParams,
    raw: Vec<f64>,
    baseline: Vec<f64>,
    compensated: Vec<f64>,
    noise_std: Vec<f64>,
    /// Start-up frames, frame by frame.
    startup: Vec<f64>,
    started: bool,
    sorted: Vec<f64>,
    tare: Option<Tare>,
    tare_sum: Vec<f64>,
    tare_count: Vec<u32>,
    records: Vec<ReferenceRecord>,
    /// Values of each record; empty where they are no longer kept.
    kept: Vec<Vec<f64>>,
    /// Product of the shares that uniform drift was followed by.
    drift_factor: f64,
    drift_held: bool,
    follows_rest: bool,
    catches_up: bool,
    time_ns: Option<u64>,
    learned_time_ns: Option<u64>,
    load: Load,
    frozen_until_ns: u64,
}

impl Baseline {
    /// A baseline for frames of `channels` values, to be learnt from the first frames.
    ///
    /// # Errors
    /// [`TouchError::Parameter`] when a parameter is out of range.
    pub fn new(channels: usize, params: BaselineParams) -> Result<Self, TouchError> {
        require(params.startup_frames > 0, "startup_frames", params.startup_frames as f64, "at least 1")?;
        check_drift(params.drift)?;
        Ok(Self {
            params,
            raw: vec![f64::NAN; channels],
            baseline: vec![f64::NAN; channels],
            compensated: vec![f64::NAN; channels],
            noise_std: vec![f64::NAN; channels],
            startup: Vec::with_capacity(channels * params.startup_frames),
            started: false,
            sorted: Vec::with_capacity(params.startup_frames),
            tare: None,
            tare_sum: vec![0.0; channels],
            tare_count: vec![0; channels],
            records: Vec::new(),
            kept: Vec::new(),
            drift_factor: 1.0,
            drift_held: false,
            follows_rest: false,
            catches_up: false,
            time_ns: None,
            learned_time_ns: None,
            load: Load::Free,
            frozen_until_ns: 0,
        })
    }

    /// Number of channels.
    #[must_use]
    pub fn channels(&self) -> usize {
        self.raw.len()
    }

    /// The last frame as it came. NaN before the first.
    #[must_use]
    pub fn raw(&self) -> &[f64] {
        &self.raw
    }

    /// The baseline. NaN before it is there.
    #[must_use]
    pub fn baseline(&self) -> &[f64] {
        &self.baseline
    }

    /// Raw less baseline for the last frame, with the baseline as it stood when the frame came. NaN before it was
    /// there.
    #[must_use]
    pub fn compensated(&self) -> &[f64] {
        &self.compensated
    }

    /// Standard deviation of each channel during start-up, from the median absolute deviation (times 1.4826, which
    /// makes it that of a Gaussian). NaN before start-up is over and for channels without values; 0 for constant
    /// channels.
    #[must_use]
    pub fn noise_std(&self) -> &[f64] {
        &self.noise_std
    }

    /// Every baseline set so far, oldest first.
    #[must_use]
    pub fn records(&self) -> &[ReferenceRecord] {
        &self.records
    }

    /// The values of a baseline that was in use, as they were set, by its place in [`Baseline::records`]; none where
    /// there is no such record, or where its values are no longer kept (the first and the last 64 are).
    #[must_use]
    pub fn kept(&self, record: usize) -> Option<&[f64]> {
        self.kept.get(record).map(Vec::as_slice).filter(|values| !values.is_empty())
    }

    /// By what factor uniform drift has changed the baseline since the start, tares left aside: a baseline of then,
    /// times the ratio of the factors of now and then, is what it would be now.
    #[must_use]
    pub fn drift_factor(&self) -> f64 {
        self.drift_factor
    }

    /// Holds drift compensation still, or lets it go on, whatever the load: something is suspected that is no drift.
    pub fn hold_drift(&mut self, held: bool) {
        self.drift_held = held;
    }

    /// Lets uniform compensation follow all other changes too, as exponential compensation does, or no longer: while a
    /// sheet heals, it changes here and there.
    pub fn follow_rest(&mut self, follows: bool) {
        self.follows_rest = follows;
    }

    /// Lets exponential compensation catch up fast after a touch, or not: only where what is left of a frame without
    /// touches is known to be none.
    pub fn catch_up(&mut self, catches_up: bool) {
        self.catches_up = catches_up;
    }

    /// How far the baseline is.
    #[must_use]
    pub fn state(&self) -> BaselineState {
        match &self.tare {
            _ if !self.started => {
                let have = self.startup.len().checked_div(self.channels()).unwrap_or(0);
                BaselineState::Starting { have, want: self.params.startup_frames }
            }
            Some(tare) => BaselineState::Taring { have: tare.have, want: tare.want },
            None => BaselineState::Ready,
        }
    }

    /// The drift compensation in force.
    #[must_use]
    pub fn drift(&self) -> DriftCompensation {
        self.params.drift
    }

    /// Switches drift compensation on, off or to another time constant. The baseline itself stays.
    ///
    /// # Errors
    /// [`TouchError::Parameter`] when a time is out of range.
    pub fn set_drift(&mut self, drift: DriftCompensation) -> Result<(), TouchError> {
        check_drift(drift)?;
        self.params.drift = drift;
        Ok(())
    }

    /// Takes in one frame and compensates it. `time_ns` must not run backwards.
    ///
    /// # Errors
    /// [`TouchError::Length`], [`TouchError::TimeReversed`]; nothing has then changed.
    pub fn observe(&mut self, time_ns: u64, raw: &[f64]) -> Result<BaselineState, TouchError> {
        require_length("frame", self.channels(), raw.len())?;
        if let Some(previous_ns) = self.time_ns.filter(|previous| time_ns < *previous) {
            return Err(TouchError::TimeReversed { time_ns, previous_ns });
        }
        self.time_ns = Some(time_ns);
        for (to, &from) in self.raw.iter_mut().zip(raw) {
            *to = if from.is_finite() { from } else { f64::NAN };
        }
        for ((to, raw), baseline) in self.compensated.iter_mut().zip(&self.raw).zip(&self.baseline) {
            *to = raw - baseline;
        }
        Ok(self.state())
    }

    /// Learns from the frame observed last, given whether the skin is touched in it: start-up, tare or drift.
    ///
    /// Before start-up is over the load is ignored, since there is no image to judge it from. Call it once a frame.
    pub fn learn(&mut self, load: Load) -> BaselineChange {
        let Some(time_ns) = self.time_ns else { return BaselineChange::None };
        let elapsed_s = self.learned_time_ns.map_or(0.0, |before| time_ns.saturating_sub(before) as f64 * 1e-9);
        self.learned_time_ns = Some(time_ns);
        if !self.started {
            return self.learn_startup(time_ns);
        }
        self.load = load;
        let change = self.learn_tare(time_ns, load);
        if change != BaselineChange::Tared {
            self.follow_drift(time_ns, elapsed_s, load);
        }
        change
    }

    /// Begins a tare: the mean of the next `frames` frames becomes the baseline. One already under way is replaced.
    ///
    /// # Errors
    /// [`TouchError::TareUnderLoad`] while touched, unless forced; [`TouchError::Parameter`] for 0 frames.
    pub fn tare(&mut self, frames: usize, guard: TareGuard, reason: &str) -> Result<(), TouchError> {
        require(frames > 0, "tare frames", frames as f64, "at least 1")?;
        if self.load == Load::Touched && guard == TareGuard::RefuseUnderLoad {
            return Err(TouchError::TareUnderLoad);
        }
        self.tare_sum.fill(0.0);
        self.tare_count.fill(0);
        self.tare = Some(Tare { want: frames, have: 0, guard, reason: reason.to_owned() });
        Ok(())
    }

    /// Sets the baseline to given values (a recorded reference frame, say), and ends start-up. NaN leaves a channel
    /// out.
    ///
    /// # Errors
    /// [`TouchError::Length`].
    pub fn set_baseline(&mut self, time_ns: u64, values: &[f64], reason: &str) -> Result<(), TouchError> {
        require_length("baseline", self.channels(), values.len())?;
        self.baseline.copy_from_slice(values);
        self.started = true;
        self.tare = None;
        self.record(time_ns, 0, ReferenceOrigin::Given, reason.to_owned());
        Ok(())
    }

    /// Goes on with a baseline that was in use before and the noise measured with it, and ends start-up.
    ///
    /// # Errors
    /// [`TouchError::Length`]; nothing has then changed.
    pub fn restore(&mut self, record: ReferenceRecord, values: &[f64], noise_std: &[f64]) -> Result<(), TouchError> {
        require_length("baseline", self.channels(), values.len())?;
        require_length("noise of the baseline", self.channels(), noise_std.len())?;
        self.baseline.copy_from_slice(values);
        self.noise_std.copy_from_slice(noise_std);
        self.started = true;
        self.tare = None;
        self.startup.clear();
        self.keep(record);
        Ok(())
    }

    /// Takes a mean of frames at rest, made by the caller, as the baseline that includes a damage. A tare under way
    /// goes on.
    ///
    /// # Errors
    /// [`TouchError::Length`].
    pub fn adopt(&mut self, time_ns: u64, values: &[f64], frames: usize, reason: &str) -> Result<(), TouchError> {
        require_length("baseline", self.channels(), values.len())?;
        self.baseline.copy_from_slice(values);
        self.record(time_ns, frames, ReferenceOrigin::Damage, reason.to_owned());
        Ok(())
    }

    /// Takes up a baseline that was in use before, by its place in [`Baseline::records`], as it was then.
    ///
    /// # Errors
    /// [`TouchError::Parameter`] where its values are not kept.
    pub fn reuse(&mut self, time_ns: u64, record: usize, reason: &str) -> Result<(), TouchError> {
        let values = self.kept(record).map(<[f64]>::to_vec);
        let kept = "the number of a baseline whose values are kept";
        let values = values.ok_or(TouchError::Parameter { name: "baseline", value: record as f64, expected: kept })?;
        self.set_baseline(time_ns, &values, reason)
    }

    /// Moves the baseline of one channel, which was left out for a while, to a value at which it agrees with the
    /// others; no record is made, and a value that is not finite changes nothing.
    pub fn move_channel(&mut self, channel: usize, value: f64) {
        if let Some(baseline) = self.baseline.get_mut(channel).filter(|_| value.is_finite()) {
            *baseline = value;
        }
    }

    /// Moves the baseline by changes of the channels that are no touch; no record is made. Changes that are not finite
    /// move nothing.
    pub fn shift(&mut self, changes: impl Iterator<Item = f64>) {
        for (baseline, change) in self.baseline.iter_mut().zip(changes).filter(|(_, change)| change.is_finite()) {
            *baseline += change;
        }
    }

    /// Forgets a start-up baseline that is of no use, and its record: start-up begins anew with the next frame.
    pub fn start_over(&mut self) {
        if self.records.last().is_some_and(|record| record.origin == ReferenceOrigin::Startup) {
            self.records.pop();
            self.kept.pop();
        }
        self.started = false;
        self.startup.clear();
        self.baseline.fill(f64::NAN);
        self.noise_std.fill(f64::NAN);
    }

    fn record(&mut self, time_ns: u64, frames: usize, origin: ReferenceOrigin, reason: String) {
        self.keep(ReferenceRecord { time_ns, frames, origin, reason });
    }

    fn keep(&mut self, record: ReferenceRecord) {
        self.records.push(record);
        self.kept.push(self.baseline.clone());
        // The first stays: it is what the skin was when it was new.
        if self.kept.len() > MOST_KEPT + 1 {
            let oldest = self.kept.len() - MOST_KEPT - 1;
            self.kept[oldest.max(1)] = Vec::new();
        }
    }

    fn learn_startup(&mut self, time_ns: u64) -> BaselineChange {
        // A tare asked for before start-up is over is start-up.
        self.tare = None;
        self.startup.extend_from_slice(&self.raw);
        if self.startup.len() < self.params.startup_frames * self.channels() {
            return BaselineChange::None;
        }
        for channel in 0..self.channels() {
            let values = self.startup.iter().skip(channel).step_by(self.raw.len().max(1)).copied();
            (self.baseline[channel], self.noise_std[channel]) = robust_mean_and_std(values, &mut self.sorted);
        }
        self.startup.clear();
        self.started = true;
        self.record(time_ns, self.params.startup_frames, ReferenceOrigin::Startup, String::new());
        BaselineChange::Started
    }

    fn learn_tare(&mut self, time_ns: u64, load: Load) -> BaselineChange {
        let Some(tare) = self.tare.as_mut() else { return BaselineChange::None };
        if load == Load::Touched && tare.guard == TareGuard::RefuseUnderLoad {
            self.tare = None;
            return BaselineChange::TareCancelled;
        }
        for ((sum, count), raw) in self.tare_sum.iter_mut().zip(&mut self.tare_count).zip(&self.raw) {
            if raw.is_finite() {
                *sum += raw;
                *count += 1;
            }
        }
        tare.have += 1;
        if tare.have < tare.want {
            return BaselineChange::None;
        }
        for ((to, sum), &count) in self.baseline.iter_mut().zip(&self.tare_sum).zip(&self.tare_count) {
            *to = if count > 0 { sum / f64::from(count) } else { f64::NAN };
        }
        if let Some(Tare { have, guard, reason, .. }) = self.tare.take() {
            let forced = guard == TareGuard::Force;
            let origin = if forced { ReferenceOrigin::ForcedTare } else { ReferenceOrigin::Tare };
            self.record(time_ns, have, origin, reason);
        }
        BaselineChange::Tared
    }

    fn follow_drift(&mut self, time_ns: u64, elapsed_s: f64, load: Load) {
        let (time_constant_s, settle_s) = match self.params.drift {
            DriftCompensation::Off => return,
            DriftCompensation::Exponential { time_constant_s, settle_s }
            | DriftCompensation::Uniform { time_constant_s, settle_s } => (time_constant_s, settle_s),
        };
        if load == Load::Touched {
            // Casting saturates.
            self.frozen_until_ns = time_ns.saturating_add((settle_s * 1e9) as u64);
            return;
        }
        if time_ns < self.frozen_until_ns || self.drift_held {
            return;
        }
        let after_touch_s = time_ns.saturating_sub(self.frozen_until_ns) as f64 * 1e-9;
        let is_exponential = matches!(self.params.drift, DriftCompensation::Exponential { .. });
        let catches_up = self.catches_up && is_exponential && self.frozen_until_ns > 0 && after_touch_s < CATCH_UP_S;
        let time_constant_s = if catches_up { time_constant_s.min(CATCH_UP_TIME_CONSTANT_S) } else { time_constant_s };
        let gain = -(-elapsed_s / time_constant_s).exp_m1();
        if matches!(self.params.drift, DriftCompensation::Uniform { .. }) {
            if let Some(share) = self.uniform_share() {
                let factor = 1.0 + gain * share;
                self.baseline.iter_mut().for_each(|baseline| *baseline *= factor);
                self.drift_factor *= factor;
            }
            if !self.follows_rest {
                return;
            }
        }
        for (baseline, raw) in self.baseline.iter_mut().zip(&self.raw) {
            if raw.is_finite() {
                *baseline += gain * (raw - *baseline);
            }
        }
    }

    /// By which share the last frame is off the baseline as a whole, where it is so alike everywhere.
    fn uniform_share(&self) -> Option<f64> {
        let (mut cross, mut square, mut change, mut noise, mut count) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for ((raw, baseline), sigma) in self.raw.iter().zip(&self.baseline).zip(&self.noise_std) {
            let difference = raw - baseline;
            if difference.is_finite() {
                cross += difference * baseline;
                square += baseline * baseline;
                change += difference * difference;
                noise += if sigma.is_finite() { sigma * sigma } else { 0.0 };
                count += 1.0;
            }
        }
        if count == 0.0 || square == 0.0 || change == 0.0 {
            return None;
        }
        let (share, uniform) = (cross / square, cross * cross / square);
        let rest = change - uniform;
        let alike = uniform >= UNIFORM_SHARE * change || rest <= UNIFORM_REST * UNIFORM_REST * noise;
        alike.then_some(share)
    }
}

fn check_drift(drift: DriftCompensation) -> Result<(), TouchError> {
    let (time_constant_s, settle_s) = match drift {
        DriftCompensation::Off => return Ok(()),
        DriftCompensation::Exponential { time_constant_s, settle_s }
        | DriftCompensation::Uniform { time_constant_s, settle_s } => (time_constant_s, settle_s),
    };
    let tau = time_constant_s;
    require(tau.is_finite() && tau > 0.0, "time_constant_s", tau, "finite and above 0")?;
    require(settle_s.is_finite() && settle_s >= 0.0, "settle_s", settle_s, "finite and at least 0")
}
