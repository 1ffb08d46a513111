//! Durations of the stages of the live path: a histogram with logarithmic buckets that records without allocating,
//! and a stopwatch that feeds it.
//!
//! Buckets divide every octave of nanoseconds into 32 equal parts, so that a quantile is at most 1/32 = 3.1 % above
//! the true one and never below it.

use std::collections::VecDeque;
use std::time::Duration;

use serde::Serialize;

use crate::instant::Instant;

/// Parts of an octave, as a power of two.
const PART_BITS: u32 = 5;
const PARTS: u64 = 1 << PART_BITS;
/// Durations of 2^LAST_BIT ns or more (18 minutes) share the last bucket.
const LAST_BIT: u32 = 40;
const BUCKETS: usize = ((LAST_BIT - PART_BITS + 1) as usize) * PARTS as usize + 1;

/// Durations counted in buckets of 3.1 % relative width, in fixed memory (9 kB).
///
/// ```
/// use std::time::Duration;
///
/// use dermis_live::latency::LatencyHistogram;
///
/// let mut histogram = LatencyHistogram::new();
/// for microseconds in 1..=1000 {
///     histogram.record(Duration::from_micros(microseconds));
/// }
/// let summary = histogram.summary();
/// assert_eq!((summary.count, summary.max_us), (1000, 1000.0));
/// assert!((500.0..=516.0).contains(&summary.p50_us), "{summary:?}");
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LatencyHistogram {
    counts: Box<[u64; BUCKETS]>,
    count: u64,
    max_ns: u64,
}

/// Summary of a [`LatencyHistogram`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct LatencySummary {
    /// Number of durations recorded. Without any, the other fields are 0.
    pub count: u64,
    /// Half of the durations are at most this long, microseconds.
    pub p50_us: f64,
    /// 90 % of the durations are at most this long, microseconds.
    pub p90_us: f64,
    /// 99 % of the durations are at most this long, microseconds.
    pub p99_us: f64,
    /// The longest duration, exact, microseconds.
    pub max_us: f64,
}

impl Default for LatencyHistogram {
    fn default() -> Self {
        Self::new()
    }
}

impl LatencyHistogram {
    /// An empty histogram; the only call that allocates.
    #[must_use]
    pub fn new() -> Self {
        Self { counts: Box::new([0; BUCKETS]), count: 0, max_ns: 0 }
    }

    /// Counts one duration.
    pub fn record(&mut self, duration: Duration) {
        let ns = u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX);
        self.counts[bucket(ns)] += 1;
        self.count += 1;
        self.max_ns = self.max_ns.max(ns);
    }

    /// Adds the counts of another histogram.
    pub fn merge(&mut self, other: &Self) {
        for (count, more) in self.counts.iter_mut().zip(other.counts.iter()) {
            *count += more;
        }
        self.count += other.count;
        self.max_ns = self.max_ns.max(other.max_ns);
    }

    /// Keeps only the counts since `earlier`, an earlier state of this histogram. The longest duration is then known
    /// only to within its bucket.
    pub fn forget_before(&mut self, earlier: &Self) {
        for (count, before) in self.counts.iter_mut().zip(earlier.counts.iter()) {
            *count -= (*before).min(*count);
        }
        self.count = self.counts.iter().sum();
        let longest = self.counts.iter().rposition(|count| *count > 0);
        self.max_ns = longest.map_or(0, |index| upper_edge_ns(index).min(self.max_ns));
    }

    /// Clears all counts and keeps the memory.
    pub fn clear(&mut self) {
        self.counts.fill(0);
        self.count = 0;
        self.max_ns = 0;
    }

    /// Number of durations recorded.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Duration in microseconds that `fraction` of the recorded ones do not exceed: the upper edge of the bucket that
    /// holds rank ceil(fraction * count), but never more than the longest. `fraction` is clamped to 0..=1; 0 without
    /// any duration.
    #[must_use]
    pub fn quantile_us(&self, fraction: f64) -> f64 {
        let rank = ((fraction.clamp(0.0, 1.0) * self.count as f64).ceil() as u64).max(1);
        let mut below = 0;
        for (index, count) in self.counts.iter().enumerate() {
            below += count;
            if below >= rank {
                return upper_edge_ns(index).min(self.max_ns) as f64 / 1e3;
            }
        }
        self.max_ns as f64 / 1e3
    }

    /// Count, median, 90th and 99th percentile and maximum.
    #[must_use]
    pub fn summary(&self) -> LatencySummary {
        LatencySummary {
            count: self.count,
            p50_us: self.quantile_us(0.5),
            p90_us: self.quantile_us(0.9),
            p99_us: self.quantile_us(0.99),
            max_us: self.max_ns as f64 / 1e3,
        }
    }
}

/// Bucket of a duration: below 64 ns one per nanosecond, above that 32 per octave.
fn bucket(ns: u64) -> usize {
    let top_bit = u64::BITS - 1 - (ns | 1).leading_zeros();
    if top_bit >= LAST_BIT {
        return BUCKETS - 1;
    }
    let octave = top_bit.saturating_sub(PART_BITS);
    ((u64::from(octave) << PART_BITS) + (ns >> octave)) as usize
}

/// The longest duration of a bucket, nanoseconds.
fn upper_edge_ns(index: usize) -> u64 {
    if index == BUCKETS - 1 {
        return u64::MAX;
    }
    let index = index as u64;
    let octave = (index >> PART_BITS).saturating_sub(1);
    let part = index - (octave << PART_BITS);
    ((part + 1) << octave) - 1
}

/// A stopwatch for consecutive stages.
///
/// ```
/// use dermis_live::latency::{LatencyHistogram, StageTimer};
///
/// let (mut image, mut touches) = (LatencyHistogram::new(), LatencyHistogram::new());
/// let mut timer = StageTimer::start();
/// // make the image
/// timer.lap(&mut image);
/// // find the touches
/// timer.lap(&mut touches);
/// assert_eq!((image.count(), touches.count()), (1, 1));
/// ```
#[derive(Debug, Clone, Copy)]
pub struct StageTimer {
    stage_start: Instant,
    start: Instant,
}

impl StageTimer {
    /// Starts the first stage.
    #[must_use]
    pub fn start() -> Self {
        let now = Instant::now();
        Self { stage_start: now, start: now }
    }

    /// Ends a stage, counts its duration and starts the next.
    pub fn lap(&mut self, histogram: &mut LatencyHistogram) {
        let now = Instant::now();
        histogram.record(now.saturating_duration_since(self.stage_start));
        self.stage_start = now;
    }

    /// Counts the time since the start of the first stage.
    pub fn total(&self, histogram: &mut LatencyHistogram) {
        histogram.record(self.start.elapsed());
    }
}

/// Length of the window, seconds.
const WINDOW: usize = 10;
const SECOND_NS: u64 = 1_000_000_000;

/// Latencies of the last ten seconds: differences of histograms from their snapshots ten seconds ago. One snapshot per
/// second is kept.
#[derive(Debug)]
pub struct RecentLatencies<const COUNT: usize> {
    /// Oldest first.
    states: VecDeque<[LatencyHistogram; COUNT]>,
    last_ns: Option<u64>,
}

impl<const COUNT: usize> Default for RecentLatencies<COUNT> {
    fn default() -> Self {
        Self { states: VecDeque::new(), last_ns: None }
    }
}

impl<const COUNT: usize> RecentLatencies<COUNT> {
    /// Median and 99th percentile of each histogram over the last ten seconds, microseconds; `now` is the snapshot at
    /// `now_ns`. `None` if less than a second has passed since the last call that returned values.
    pub fn quantiles_us(&mut self, now: [&LatencyHistogram; COUNT], now_ns: u64) -> Option<[[f64; 2]; COUNT]> {
        if self.last_ns.is_some_and(|last| now_ns.saturating_sub(last) < SECOND_NS) {
            return None;
        }
        self.last_ns = Some(now_ns);
        let oldest = if self.states.len() >= WINDOW { self.states.pop_front() } else { None };
        let mut recent = now.map(LatencyHistogram::clone);
        self.states.push_back(recent.clone());
        if let Some(oldest) = &oldest {
            recent.iter_mut().zip(oldest).for_each(|(histogram, before)| histogram.forget_before(before));
        }
        Some(recent.map(|histogram| [histogram.quantile_us(0.5), histogram.quantile_us(0.99)]))
    }
}

/// Time spent in each stage, in order.
#[derive(Debug, Default)]
pub struct StageLatencies {
    /// From the first byte of the frame to the start of processing.
    pub queue: LatencyHistogram,
    /// Channels, baseline, difference.
    pub condition: LatencyHistogram,
    /// Difference to image.
    pub image: LatencyHistogram,
    /// Image to touches.
    pub touches: LatencyHistogram,
    /// First byte to touches.
    pub total: LatencyHistogram,
}

impl StageLatencies {
    /// Names and histograms, in order.
    pub fn stages(&self) -> [(&'static str, &LatencyHistogram); 5] {
        [
            ("queue", &self.queue),
            ("condition", &self.condition),
            ("image", &self.image),
            ("touches", &self.touches),
            ("total", &self.total),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buckets_are_contiguous_and_no_wider_than_stated() {
        let mut previous = None;
        for index in 0..BUCKETS - 1 {
            let edge = upper_edge_ns(index);
            assert_eq!(bucket(edge), index);
            assert_eq!(bucket(edge + 1), index + 1, "the next bucket begins where this one ends");
            let first = previous.map_or(0, |edge: u64| edge + 1);
            assert!(edge - first <= first / PARTS, "bucket {index}: {first}..={edge}");
            previous = Some(edge);
        }
        assert_eq!(bucket(u64::MAX), BUCKETS - 1);
    }

    #[test]
    fn quantiles_agree_with_sorted_durations_within_a_bucket() {
        let mut state = 1_u64;
        let mut durations: Vec<u64> = (0..5000)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                1 << (state >> 60) | (state >> 40)
            })
            .collect();
        let mut histogram = LatencyHistogram::new();
        durations.iter().for_each(|&ns| histogram.record(Duration::from_nanos(ns)));
        durations.sort_unstable();
        for fraction in [0.0, 0.01, 0.5, 0.9, 0.99, 0.999, 1.0] {
            let rank = ((fraction * 5000.0_f64).ceil() as usize).max(1);
            let exact_us = durations[rank - 1] as f64 / 1e3;
            let found_us = histogram.quantile_us(fraction);
            // One bucket: 1/32 of its first value.
            assert!(
                found_us >= exact_us && found_us <= exact_us * (1.0 + 1.0 / 32.0),
                "{fraction}: {exact_us} {found_us}"
            );
        }
    }

    #[test]
    fn merging_is_recording_everything_in_one() {
        let (mut left, mut right, mut both) =
            (LatencyHistogram::new(), LatencyHistogram::new(), LatencyHistogram::new());
        for us in [3, 70, 900] {
            left.record(Duration::from_micros(us));
            both.record(Duration::from_micros(us));
        }
        for us in [5, 2_000_000_000_000] {
            right.record(Duration::from_micros(us));
            both.record(Duration::from_micros(us));
        }
        left.merge(&right);
        assert_eq!(left, both);
        assert_eq!(left.summary().max_us, 2e12);
        left.clear();
        assert_eq!(left, LatencyHistogram::new());
    }

    #[test]
    fn forgetting_leaves_only_later_records() {
        let (mut all, mut recent) = (LatencyHistogram::new(), LatencyHistogram::new());
        for us in [900, 80_000, 3] {
            all.record(Duration::from_micros(us));
        }
        let earlier = all.clone();
        for us in [5, 7, 7, 410] {
            all.record(Duration::from_micros(us));
            recent.record(Duration::from_micros(us));
        }
        all.forget_before(&earlier);
        assert_eq!(all.count(), 4);
        for fraction in [0.0, 0.5, 0.75] {
            assert_eq!(all.quantile_us(fraction), recent.quantile_us(fraction));
        }
        // The longest duration is 410 us, known to within its bucket.
        assert!((410.0..=410.0 * (1.0 + 1.0 / 32.0)).contains(&all.quantile_us(1.0)), "{}", all.quantile_us(1.0));
        all.forget_before(&all.clone());
        assert_eq!(all.summary(), LatencySummary::default());
    }

    #[test]
    fn an_empty_record_is_zero_everywhere() {
        assert_eq!(LatencyHistogram::new().summary(), LatencySummary::default());
    }

    #[test]
    fn a_slow_second_is_forgotten_after_ten() {
        let mut histogram = LatencyHistogram::new();
        let mut recent = RecentLatencies::default();
        let mut p99_us = Vec::new();
        for second in 0..15_u64 {
            let us = if second == 2 { 50_000 } else { 100 };
            for _ in 0..50 {
                histogram.record(Duration::from_micros(us));
            }
            let seen = recent.quantiles_us([&histogram; 5], second * SECOND_NS).expect("a second has passed");
            p99_us.push(seen[4][1]);
            assert!(recent.quantiles_us([&histogram; 5], second * SECOND_NS + 1).is_none());
        }
        let is_slow: Vec<bool> = p99_us.iter().map(|us| *us > 40_000.0).collect();
        let slow_from = |second: usize| (2..12).contains(&second);
        assert_eq!(is_slow, (0..15).map(slow_from).collect::<Vec<_>>(), "{p99_us:?}");
    }
}
