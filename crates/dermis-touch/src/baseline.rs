//! The baseline that difference data refer to: compensated = raw - baseline, per channel.
//!
//! The baseline starts as a robust mean of the first frames. Later an explicit tare or the caller can replace it. It
//! may follow slow drift as an exponential mean, `b += (1 - exp(-dt/tau)) (raw - b)`, but only while nothing touches
//! the skin. Under contact it is frozen, so a held touch keeps its value for any length of time.
//!
//! If touch and damage may develop as slowly as drift, only the uniform part of the change is followed:
//! `b += (1 - exp(-dt/tau)) a b`, where a is the least-squares share of (raw - b) along b. Warming a sheet under
//! constant current changes all its voltages by the same share; a touch or a cut does not. Every baseline that was in
//! use is kept with its time and reason, and can be restored.

mod types;

pub use types::{
    BaselineChange, BaselineParams, BaselineState, DriftCompensation, Load, ReferenceOrigin, ReferenceRecord, TareGuard,
};

use crate::error::{TouchError, require, require_length};
use crate::statistics::robust_mean_and_std;

/// Minimum share of a change's energy in its uniform part for the change to count as uniform.
const UNIFORM_SHARE: f64 = 0.9;
/// A change also counts as uniform if its remainder is below this many standard deviations of the noise (RMS).
const UNIFORM_REST: f64 = 3.0;
/// For this long after a touch, the baseline catches up fast on the drift it missed, seconds.
const CATCH_UP_S: f64 = 2.0;
const CATCH_UP_TIME_CONSTANT_S: f64 = 0.5;
/// Mean square by which readings at rest differ from those before them, in variances of the noise: at most this. Two
/// frames differ by 2, and the noise is only known to a third.
const MOST_NOISE: f64 = 3.0;
/// Beyond the noise, they differ by at most this share of the energy of the change that the tare makes.
const STILL: f64 = 0.02;
/// Number of baselines whose values are kept, in addition to the first.
const MOST_KEPT: usize = 64;

/// A tare in progress.
#[derive(Debug, Clone)]
struct Tare {
    want: usize,
    have: usize,
    guard: TareGuard,
    reason: String,
}

/// Raw values, baseline and compensated values of one stream of frames.
///
/// Each frame goes through [`Baseline::observe`], which compensates it with the current baseline. Once the caller has
/// judged the load, it goes through [`Baseline::learn`]. NaN affects only its own channel: the compensated value is
/// NaN and the baseline stays. A channel without any value during start-up or tare has a NaN baseline until the next
/// tare.
#[derive(Debug, Clone)]
pub struct Baseline {
    params: BaselineParams,
    raw: Vec<f64>,
    baseline: Vec<f64>,
    compensated: Vec<f64>,
    noise_std: Vec<f64>,
    /// Start-up frames, one after another.
    startup: Vec<f64>,
    started: bool,
    sorted: Vec<f64>,
    tare: Option<Tare>,
    tare_sum: Vec<f64>,
    tare_count: Vec<u32>,
    records: Vec<ReferenceRecord>,
    /// Values of each record; empty once they have been dropped.
    kept: Vec<Vec<f64>>,
    /// Product of all uniform drift factors since the start.
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
    /// A baseline for frames of `channels` values, learned from the first frames.
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

    /// The last frame as received. NaN before the first.
    #[must_use]
    pub fn raw(&self) -> &[f64] {
        &self.raw
    }

    /// The baseline. NaN until start-up is over.
    #[must_use]
    pub fn baseline(&self) -> &[f64] {
        &self.baseline
    }

    /// Last frame minus the baseline that was current when it arrived. NaN until start-up is over.
    #[must_use]
    pub fn compensated(&self) -> &[f64] {
        &self.compensated
    }

    /// Standard deviation of each channel during start-up: 1.4826 times the median absolute deviation, the factor for
    /// a Gaussian. NaN during start-up and for channels without values; 0 for constant channels.
    #[must_use]
    pub fn noise_std(&self) -> &[f64] {
        &self.noise_std
    }

    /// All baselines since the start, oldest first.
    #[must_use]
    pub fn records(&self) -> &[ReferenceRecord] {
        &self.records
    }

    /// The values of a past baseline as they were set, by its index in [`Baseline::records`]. `None` if there is no
    /// such record or its values are no longer kept (only the first and the last 64 are).
    #[must_use]
    pub fn kept(&self, record: usize) -> Option<&[f64]> {
        self.kept.get(record).map(Vec::as_slice).filter(|values| !values.is_empty())
    }

    /// Factor by which uniform drift has changed the baseline since the start, ignoring tares. To bring an old
    /// baseline up to date, multiply it by today's factor over the factor at that time.
    #[must_use]
    pub fn drift_factor(&self) -> f64 {
        self.drift_factor
    }

    /// Suspends or resumes drift compensation regardless of load. Suspend it while something other than drift is
    /// suspected.
    pub fn hold_drift(&mut self, held: bool) {
        self.drift_held = held;
    }

    /// Makes uniform compensation follow non-uniform changes too, as exponential compensation does, or stops it doing
    /// so. A healing sheet changes locally.
    pub fn follow_rest(&mut self, follows: bool) {
        self.follows_rest = follows;
    }

    /// Enables or disables fast catch-up of exponential compensation after a touch. Enable it only if residuals in
    /// frames without touches are known to be drift.
    pub fn catch_up(&mut self, catches_up: bool) {
        self.catches_up = catches_up;
    }

    /// Progress of start-up or tare.
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

    /// The current drift compensation.
    #[must_use]
    pub fn drift(&self) -> DriftCompensation {
        self.params.drift
    }

    /// Switches drift compensation on or off, or changes its time constant. Keeps the baseline.
    ///
    /// # Errors
    /// [`TouchError::Parameter`] when a time is out of range.
    pub fn set_drift(&mut self, drift: DriftCompensation) -> Result<(), TouchError> {
        check_drift(drift)?;
        self.params.drift = drift;
        Ok(())
    }

    /// Takes one frame and compensates it. `time_ns` must not run backwards.
    ///
    /// # Errors
    /// [`TouchError::Length`], [`TouchError::TimeReversed`]; the state is then unchanged.
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

    /// Learns from the last observed frame, given whether the skin is touched in it: start-up, tare or drift.
    ///
    /// Load is ignored during start-up, since there is no image to judge it from. Call this once per frame.
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

    /// Starts a tare: the mean of the next `frames` frames becomes the baseline. Replaces a tare in progress.
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

    /// Sets the baseline to given values, such as a recorded reference frame, and ends start-up. NaN disables a
    /// channel.
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

    /// Restores an earlier baseline and the noise measured with it, and ends start-up.
    ///
    /// # Errors
    /// [`TouchError::Length`]; the state is then unchanged.
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

    /// Adopts the caller's mean of frames at rest as a baseline that includes damage. Does not interrupt a tare.
    ///
    /// # Errors
    /// [`TouchError::Length`].
    pub fn adopt(&mut self, time_ns: u64, values: &[f64], frames: usize, reason: &str) -> Result<(), TouchError> {
        require_length("baseline", self.channels(), values.len())?;
        self.baseline.copy_from_slice(values);
        self.record(time_ns, frames, ReferenceOrigin::Damage, reason.to_owned());
        Ok(())
    }

    /// Switches back to an earlier baseline, by its index in [`Baseline::records`].
    ///
    /// # Errors
    /// [`TouchError::Parameter`] if its values are no longer kept.
    pub fn reuse(&mut self, time_ns: u64, record: usize, reason: &str) -> Result<(), TouchError> {
        let values = self.kept(record).map(<[f64]>::to_vec);
        let kept = "the number of a baseline whose values are kept";
        let values = values.ok_or(TouchError::Parameter { name: "baseline", value: record as f64, expected: kept })?;
        self.set_baseline(time_ns, &values, reason)
    }

    /// Moves the baseline of one channel, which was excluded for a while, to a value that agrees with the others.
    /// Makes no record. A non-finite value changes nothing.
    pub fn move_channel(&mut self, channel: usize, value: f64) {
        if let Some(baseline) = self.baseline.get_mut(channel).filter(|_| value.is_finite()) {
            *baseline = value;
        }
    }

    /// Shifts the baseline by changes that are not touch, one per channel. Makes no record. Non-finite changes are
    /// ignored.
    pub fn shift(&mut self, changes: impl Iterator<Item = f64>) {
        for (baseline, change) in self.baseline.iter_mut().zip(changes).filter(|(_, change)| change.is_finite()) {
            *baseline += change;
        }
    }

    /// Discards an unusable start-up baseline and its record, and restarts start-up with the next frame.
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
        // Never drop the first: it describes the skin when it was new.
        if self.kept.len() > MOST_KEPT + 1 {
            let oldest = self.kept.len() - MOST_KEPT - 1;
            self.kept[oldest.max(1)] = Vec::new();
        }
    }

    fn learn_startup(&mut self, time_ns: u64) -> BaselineChange {
        // A tare requested during start-up is satisfied by start-up itself.
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
        let Some(tare) = &self.tare else { return BaselineChange::None };
        let is_off = match tare.guard {
            TareGuard::RefuseUnderLoad => load == Load::Touched,
            TareGuard::Still => !self.is_still(),
            TareGuard::Force => false,
        };
        if is_off {
            self.tare = None;
            return BaselineChange::TareCancelled;
        }
        let Some(tare) = self.tare.as_mut() else { return BaselineChange::None };
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
            let forced = guard != TareGuard::RefuseUnderLoad;
            let origin = if forced { ReferenceOrigin::ForcedTare } else { ReferenceOrigin::Tare };
            self.record(time_ns, have, origin, reason);
        }
        BaselineChange::Tared
    }

    /// True if the last frame agrees with the mean of the tare so far, within the noise and [`STILL`].
    fn is_still(&self) -> bool {
        let (mut apart, mut change, mut count) = (0.0, 0.0, 0.0);
        for (channel, sigma) in self.noise_std.iter().enumerate().filter(|(_, sigma)| **sigma > 0.0) {
            let mean = self.tare_sum[channel] / f64::from(self.tare_count[channel]);
            let (off, all) = (self.raw[channel] - mean, mean - self.baseline[channel]);
            if off.is_finite() && all.is_finite() {
                apart += (off / sigma).powi(2);
                change += (all / sigma).powi(2);
                count += 1.0;
            }
        }
        apart <= MOST_NOISE * count + STILL * change
    }

    fn follow_drift(&mut self, time_ns: u64, elapsed_s: f64, load: Load) {
        let (time_constant_s, settle_s) = match self.params.drift {
            DriftCompensation::Off => return,
            DriftCompensation::Exponential { time_constant_s, settle_s }
            | DriftCompensation::Uniform { time_constant_s, settle_s } => (time_constant_s, settle_s),
        };
        if load == Load::Touched {
            // The cast saturates.
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

    /// Share by which the last frame differs from the baseline, if the difference is uniform.
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
