//! Per-channel levels that drift, and permanent changes. A gel that dries and warms changes its readings by amounts
//! that no common factor describes. [`LevelWatch`] tracks level and slope of every channel, compares each frame's
//! innovations with their own noise, and freezes when they jump. Once the readings have come to rest at new levels,
//! it reports the change and whether a load was released on the way: a press takes its change with it, a cut leaves
//! one behind.
//!
//! Level and slope follow the innovation `e = raw - (level + slope dt)` by `level += a e`, `slope += a^2 e / (4 dt)`
//! with `a = 1 - exp(-dt / follow_s)`. The noise of a channel is the mean of `|e|` over recent frames, scaled to the
//! standard deviation of a Gaussian.

use crate::blob::seconds_between;
use crate::error::{TouchError, require, require_length};
use crate::statistics::median;

/// Maximum number of frames that initialise levels, slopes and noise.
const MOST_AT_START: usize = 32;
/// Number of these frames at each end that determine level and slope.
const AT_AN_END: usize = 8;
/// Averaging length of the noise, frames.
const NOISE_FRAMES: f64 = 64.0;
/// Maximum gain of the level, so that it averages several frames even at low frame rates.
const MOST_FOLLOWED: f64 = 0.25;
/// Clip innovations to this many standard deviations when updating levels and noise.
const CLIPPED: f64 = 4.0;
/// Clip a channel's contribution to a jump to this many standard deviations.
const LARGEST: f64 = 30.0;
/// Minimum relative noise of a channel, as a share of the median channel's.
const QUIETEST: f64 = 0.1;
/// Initial mean deviation of the innovations' RMS, as a share of that RMS, until enough frames have been seen.
const FIRST_SPREAD: f64 = 0.2;
/// Minimum RMS of the innovations, in standard deviations, for a jump, however quiet the skin has been.
const LEAST_JUMP: f64 = 1.5;
/// Number of consecutive means compared to detect rest.
const SEGMENTS: usize = 3;
/// Consecutive means may differ by this share of the change, or by `RESTING_SIGMA` times the usual RMS of the
/// innovations. Two frames of white noise differ by 1.4 times that RMS.
const RESTING: f64 = 0.1;
const RESTING_SIGMA: f64 = 2.0;
/// A load was released if the change is below this share of its peak.
const RELEASED: f64 = 0.5;
/// Below this share, the remainder is the material's slow recovery.
const REMAINDER: f64 = 0.1;
/// A change that has grown by more than this factor since it first rested developed slowly.
const CREPT: f64 = 1.5;
/// Time constant at which slopes decay during a disturbance, in multiples of `follow_s`.
const SLOPES_FADE: f64 = 10.0;
/// Ratio of a Gaussian's standard deviation to its mean absolute deviation.
const OF_MEAN_DEVIATION: f64 = 1.253_314_137_315_500_3;
/// Ratio of a Gaussian's standard deviation to its median absolute deviation.
const OF_MEDIAN_DEVIATION: f64 = 1.482_602_218_505_602;

/// How drift is followed, and which changes count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LevelParams {
    /// Time constant of the levels, seconds, above 0; infinite to freeze them.
    pub follow_s: f64,
    /// Threshold of a jump: this many standard deviations above the usual RMS of the innovations. It is also the
    /// minimum size of a change that counts, in standard deviations of the channels' noise (RMS over the channels).
    /// Above 0.
    pub jump_sigma: f64,
    /// Readings have come to rest if they are steady for this long and for at least three frames, seconds. At least
    /// 0.
    pub rest_s: f64,
}

impl LevelParams {
    fn validate(&self) -> Result<(), TouchError> {
        require(self.follow_s > 0.0, "follow_s", self.follow_s, "above 0")?;
        let above = self.jump_sigma.is_finite() && self.jump_sigma > 0.0;
        require(above, "jump_sigma", self.jump_sigma, "finite and above 0")?;
        let least = self.rest_s.is_finite() && self.rest_s >= 0.0;
        require(least, "rest_s", self.rest_s, "finite and at least 0")
    }
}

/// Readings that have come to rest at new levels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LevelChange {
    /// When the readings left the levels, nanoseconds.
    pub since_ns: u64,
    /// RMS of the change over the channels, in standard deviations of their noise; each channel is clipped at 30.
    pub significance: f64,
    /// Mean absolute change over the channels, also in standard deviations, as a share of its peak since the readings
    /// left the levels.
    pub share_of_peak: f64,
    /// Mean absolute change divided by its value when the readings first came to rest at new levels.
    pub growth: f64,
}

impl LevelChange {
    /// True if a load was released on the way. The release explains the part of the change that is gone, not the
    /// rest.
    #[must_use]
    pub fn was_released(&self) -> bool {
        self.share_of_peak <= RELEASED
    }

    /// True if most of the change developed while the readings seemed to rest, as drift does under a resting load.
    #[must_use]
    pub fn has_crept(&self) -> bool {
        self.growth > CREPT
    }

    /// True if the remainder is small enough to be the material's slow recovery.
    #[must_use]
    pub fn is_remainder(&self) -> bool {
        self.share_of_peak < REMAINDER
    }
}

/// State while the readings are away from the levels.
#[derive(Debug, Clone, Copy)]
struct Disturbance {
    since_ns: u64,
    /// Peak of the mean absolute change.
    peak: f64,
    /// Mean absolute change when the readings first came to rest.
    first: Option<f64>,
}

/// Mean over one part of the rest period.
#[derive(Debug, Clone, Default)]
struct Segment {
    mean: Vec<f64>,
    frames: usize,
    since_ns: u64,
}

/// Tracks the levels of all channels, frame by frame. Owns its working memory.
#[derive(Debug, Clone)]
pub struct LevelWatch {
    params: LevelParams,
    /// The last frames before the start.
    start: Vec<(u64, Vec<f64>)>,
    started: bool,
    levels: Vec<f64>,
    /// Change per second.
    slopes: Vec<f64>,
    noise: Vec<f64>,
    /// Mean RMS of the innovations, and its mean deviation.
    usual: f64,
    spread: f64,
    time_ns: Option<u64>,
    disturbance: Option<Disturbance>,
    segments: [Segment; SEGMENTS],
    /// Lower bound on each channel's noise.
    least_noise: Vec<f64>,
    /// Mean change over the segments, in measured units; NaN for excluded channels.
    change: Vec<f64>,
    /// Accumulated relative drift of each channel.
    drift: Vec<f64>,
}

impl LevelWatch {
    /// A watch over `channels` channels that collects frames until [`LevelWatch::start`].
    ///
    /// # Errors
    /// [`TouchError::Parameter`] when a parameter is out of range.
    pub fn new(channels: usize, params: LevelParams) -> Result<Self, TouchError> {
        params.validate()?;
        Ok(Self {
            params,
            start: Vec::new(),
            started: false,
            levels: vec![f64::NAN; channels],
            slopes: vec![0.0; channels],
            noise: vec![f64::NAN; channels],
            usual: 1.0,
            spread: 0.0,
            time_ns: None,
            disturbance: None,
            segments: Default::default(),
            least_noise: vec![0.0; channels],
            change: vec![f64::NAN; channels],
            drift: vec![0.0; channels],
        })
    }

    /// Current levels of the undisturbed skin, in measured units.
    #[must_use]
    pub fn levels(&self) -> &[f64] {
        &self.levels
    }

    /// Standard deviation of each channel's innovations, in measured units.
    #[must_use]
    pub fn noise(&self) -> &[f64] {
        &self.noise
    }

    /// Last change found in each channel, in measured units: resting value minus level. NaN for excluded channels.
    #[must_use]
    pub fn change(&self) -> &[f64] {
        &self.change
    }

    /// Relative drift followed since the start, averaged over the channels. Excludes changes that were accepted.
    #[must_use]
    pub fn drift(&self) -> f64 {
        let finite = self.drift.iter().filter(|share| share.is_finite());
        let (sum, count) = finite.fold((0.0, 0.0), |(sum, count), share| (sum + share, count + 1.0));
        if count > 0.0 { sum / count } else { 0.0 }
    }

    /// Time when the readings left the levels, nanoseconds.
    #[must_use]
    pub fn disturbed_since_ns(&self) -> Option<u64> {
        self.disturbance.map(|disturbance| disturbance.since_ns)
    }

    /// Starts tracking. Level, slope and noise come from the last frames, or from `levels` and `noise` (in measured
    /// units) if fewer than eight frames were seen.
    ///
    /// # Errors
    /// [`TouchError::Length`].
    pub fn start(&mut self, levels: &[f64], noise: &[f64]) -> Result<(), TouchError> {
        require_length("levels", self.levels.len(), levels.len())?;
        require_length("noise of the levels", self.levels.len(), noise.len())?;
        self.levels.copy_from_slice(levels);
        self.noise.copy_from_slice(noise);
        self.slopes.fill(0.0);
        self.drift.fill(0.0);
        if self.start.len() >= AT_AN_END {
            self.begin_from_frames();
        }
        self.limit_noise();
        self.usual = self.usual_at_start();
        self.spread = FIRST_SPREAD * self.usual;
        self.start = Vec::new();
        (self.disturbance, self.started) = (None, true);
        Ok(())
    }

    /// Continues from other levels (those of a tare), keeping slopes and noise.
    ///
    /// # Errors
    /// [`TouchError::Length`].
    pub fn set_levels(&mut self, levels: &[f64]) -> Result<(), TouchError> {
        require_length("levels", self.levels.len(), levels.len())?;
        self.levels.copy_from_slice(levels);
        self.disturbance = None;
        Ok(())
    }

    /// Takes one frame. `has_part` says whether a channel is sound. Returns a change for every frame in which the
    /// readings rest away from the levels.
    ///
    /// # Errors
    /// [`TouchError::Length`], [`TouchError::TimeReversed`]; the state is then unchanged.
    pub fn process(
        &mut self,
        time_ns: u64,
        raw: &[f64],
        has_part: impl Fn(usize) -> bool,
    ) -> Result<Option<LevelChange>, TouchError> {
        require_length("frame", self.levels.len(), raw.len())?;
        if let Some(previous_ns) = self.time_ns.filter(|previous| time_ns < *previous) {
            return Err(TouchError::TimeReversed { time_ns, previous_ns });
        }
        let elapsed_s = self.time_ns.map_or(0.0, |before| seconds_between(before, time_ns));
        self.time_ns = Some(time_ns);
        if !self.started {
            if self.start.len() == MOST_AT_START {
                self.start.remove(0);
            }
            self.start.push((time_ns, raw.to_vec()));
            return Ok(None);
        }
        self.extrapolate(elapsed_s);
        let innovation = |channel: usize| raw[channel] - self.levels[channel];
        let jump = self.deviation(innovation, &has_part);
        let size = self.mean_over(innovation, &has_part, f64::abs);
        if jump <= self.limit() {
            // The readings are back, or never left.
            self.disturbance = None;
            self.follow(raw, jump, elapsed_s);
            return Ok(None);
        }
        let disturbance = self.disturbance.get_or_insert_with(|| {
            self.segments.iter_mut().for_each(|segment| segment.frames = 0);
            Disturbance { since_ns: time_ns, peak: 0.0, first: None }
        });
        disturbance.peak = disturbance.peak.max(size);
        self.gather(time_ns, raw);
        Ok(self.rest(&has_part))
    }

    /// Adds the last change found to the levels.
    pub fn accept(&mut self) {
        for (level, change) in self.levels.iter_mut().zip(&self.change).filter(|(_, change)| change.is_finite()) {
            *level += change;
        }
        self.disturbance = None;
    }

    /// Threshold of a jump, on the RMS of the innovations.
    fn limit(&self) -> f64 {
        let usual = self.usual + self.params.jump_sigma * OF_MEAN_DEVIATION * self.spread;
        usual.clamp(LEAST_JUMP, self.params.jump_sigma.max(LEAST_JUMP))
    }

    fn extrapolate(&mut self, elapsed_s: f64) {
        let fade =
            if self.disturbance.is_some() { (-elapsed_s / (SLOPES_FADE * self.params.follow_s)).exp() } else { 1.0 };
        for ((level, slope), drift) in self.levels.iter_mut().zip(&mut self.slopes).zip(&mut self.drift) {
            let step = *slope * elapsed_s;
            *drift += if *level == 0.0 { 0.0 } else { step / *level };
            *level += step;
            *slope *= fade;
        }
    }

    fn follow(&mut self, raw: &[f64], jump: f64, elapsed_s: f64) {
        let gain = (-(-elapsed_s / self.params.follow_s).exp_m1()).min(MOST_FOLLOWED);
        let of_slope = if elapsed_s > 0.0 { 0.25 * gain * gain / elapsed_s } else { 0.0 };
        for (channel, &value) in raw.iter().enumerate() {
            let (level, noise) = (&mut self.levels[channel], &mut self.noise[channel]);
            if !value.is_finite() {
                continue;
            }
            if !level.is_finite() {
                *level = value;
                continue;
            }
            let most = CLIPPED * *noise;
            let innovation = if most.is_finite() { (value - *level).clamp(-most, most) } else { value - *level };
            self.drift[channel] += if *level == 0.0 { 0.0 } else { gain * innovation / *level };
            *level += gain * innovation;
            self.slopes[channel] += of_slope * innovation;
            let seen = OF_MEAN_DEVIATION * innovation.abs();
            *noise = if noise.is_finite() { *noise + (seen - *noise) / NOISE_FRAMES } else { seen };
            *noise = noise.max(self.least_noise[channel]);
        }
        self.spread += ((jump - self.usual).abs() - self.spread) / NOISE_FRAMES;
        self.usual += (jump - self.usual) / NOISE_FRAMES;
    }

    /// Computes level and slope from the ends of the frames before the start, noise from their differences.
    fn begin_from_frames(&mut self) {
        let frames = self.start.len();
        let time_s = |frame: usize| seconds_between(self.start[0].0, self.start[frame].0);
        let mean_time_s = |from: usize| (from..from + AT_AN_END).map(time_s).sum::<f64>() / AT_AN_END as f64;
        let apart_s = mean_time_s(frames - AT_AN_END) - mean_time_s(0);
        let since_mean_s = time_s(frames - 1) - mean_time_s(frames - AT_AN_END);
        for channel in 0..self.levels.len() {
            let values = |from: usize, to: usize| -> Vec<f64> {
                let values = self.start[from..to].iter().map(|(_, frame)| frame[channel]);
                values.filter(|value| value.is_finite()).collect()
            };
            let ends = [values(0, AT_AN_END), values(frames - AT_AN_END, frames)];
            let [first, last] = ends.map(|end| median(&end));
            if !first.is_finite() || !last.is_finite() {
                continue;
            }
            let slope = if apart_s > 0.0 { (last - first) / apart_s } else { 0.0 };
            let all = values(0, frames);
            let steps: Vec<f64> = all.windows(2).map(|pair| pair[1] - pair[0]).collect();
            let middle = median(&steps);
            let sizes: Vec<f64> = steps.iter().map(|step| (step - middle).abs()).collect();
            (self.levels[channel], self.slopes[channel]) = (last + slope * since_mean_s, slope);
            // For a wandering level the differences are the innovations; for white noise they have twice the
            // variance.
            self.noise[channel] = OF_MEDIAN_DEVIATION * median(&sizes);
        }
    }

    /// RMS deviation of the last frames before the start from level and slope.
    fn usual_at_start(&self) -> f64 {
        let last_ns = self.start.last().map_or(0, |(time_ns, _)| *time_ns);
        let frames = self.start.iter().rev().take(AT_AN_END);
        let squares = frames.map(|(time_ns, frame)| {
            let before_s = seconds_between(*time_ns, last_ns);
            let change = |channel: usize| frame[channel] - self.levels[channel] + self.slopes[channel] * before_s;
            self.deviation(change, &|_| true).powi(2)
        });
        let (sum, count) = squares.fold((0.0, 0.0), |(sum, count), square| (sum + square, count + 1.0));
        if count > 0.0 && sum > 0.0 { f64::sqrt(sum / count) } else { 1.0 }
    }

    /// Applies a lower bound on noise for coarse converters and channels that happen to repeat a value.
    fn limit_noise(&mut self) {
        let relative = |(noise, level): (&f64, &f64)| noise / level.abs();
        let shares = self.noise.iter().zip(&self.levels).map(relative);
        let shares: Vec<f64> = shares.filter(|share| share.is_finite()).collect();
        let usual = median(&shares);
        let usual = if usual.is_finite() { usual } else { 0.0 };
        for ((least, noise), level) in self.least_noise.iter_mut().zip(&mut self.noise).zip(&self.levels) {
            *least = if level.is_finite() { QUIETEST * usual * level.abs() } else { 0.0 };
            *noise = noise.max(*least);
        }
    }

    /// RMS over the sound channels of changes from the levels, in standard deviations.
    fn deviation(&self, change: impl Fn(usize) -> f64, has_part: &impl Fn(usize) -> bool) -> f64 {
        self.mean_over(change, has_part, |ratio| ratio.clamp(-LARGEST, LARGEST).powi(2)).sqrt()
    }

    fn mean_over(
        &self,
        change: impl Fn(usize) -> f64,
        has_part: &impl Fn(usize) -> bool,
        term: impl Fn(f64) -> f64,
    ) -> f64 {
        let sound = (0..self.noise.len()).filter(|channel| has_part(*channel));
        let ratios = sound.map(|channel| change(channel) / self.noise[channel]).filter(|ratio| ratio.is_finite());
        let (sum, count) = ratios.fold((0.0, 0.0), |(sum, count), ratio| (sum + term(ratio), count + 1.0));
        if count > 0.0 { sum / count } else { 0.0 }
    }

    /// Adds a frame to the last segment, or starts a new one.
    fn gather(&mut self, time_ns: u64, raw: &[f64]) {
        let last = &self.segments[SEGMENTS - 1];
        let long_s = self.params.rest_s / SEGMENTS as f64;
        if last.frames == 0 || seconds_between(last.since_ns, time_ns) >= long_s {
            self.segments.rotate_left(1);
            let next = &mut self.segments[SEGMENTS - 1];
            (next.frames, next.since_ns) = (0, time_ns);
            next.mean.clear();
            next.mean.resize(raw.len(), 0.0);
        }
        let segment = &mut self.segments[SEGMENTS - 1];
        segment.frames += 1;
        let share = 1.0 / segment.frames as f64;
        segment.mean.iter_mut().zip(raw).for_each(|(mean, value)| *mean += share * (value - *mean));
    }

    /// The change, if the readings are at rest.
    fn rest(&mut self, has_part: &impl Fn(usize) -> bool) -> Option<LevelChange> {
        let Disturbance { since_ns, peak, first } = self.disturbance?;
        if self.segments.iter().any(|segment| segment.frames == 0) {
            return None;
        }
        // The last segment counts once it is half as long as the others.
        let together_s = seconds_between(self.segments[0].since_ns, self.time_ns?);
        if together_s < self.params.rest_s * (1.0 - 0.5 / SEGMENTS as f64) {
            return None;
        }
        for channel in 0..self.change.len() {
            let mean = self.segments.iter().map(|segment| segment.mean[channel]).sum::<f64>() / SEGMENTS as f64;
            self.change[channel] = if has_part(channel) { mean - self.levels[channel] } else { f64::NAN };
        }
        let change = |channel: usize| self.change[channel];
        let significance = self.deviation(change, has_part);
        let most = (RESTING * significance).max(RESTING_SIGMA * self.usual);
        let apart =
            |pair: &[Segment]| self.deviation(|channel| pair[1].mean[channel] - pair[0].mean[channel], has_part);
        if self.segments.windows(2).any(|pair| apart(pair) > most) {
            return None;
        }
        let size = self.mean_over(change, has_part, f64::abs);
        let share_of_peak = if peak > 0.0 { size / peak } else { 1.0 };
        let first = first.unwrap_or(size);
        self.disturbance = Some(Disturbance { since_ns, peak, first: Some(first) });
        let growth = if first > 0.0 { size / first } else { 1.0 };
        Some(LevelChange { since_ns, significance, share_of_peak, growth })
    }
}
