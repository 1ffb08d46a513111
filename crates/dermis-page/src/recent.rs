//! Latencies of the last ten seconds: the difference from a snapshot ten seconds ago. One snapshot per second is
//! kept.

use std::collections::VecDeque;

use dermis_live::latency::LatencyHistogram;

/// Length of the window, seconds.
const WINDOW: usize = 10;
const SECOND_NS: u64 = 1_000_000_000;

/// Stages of a frame.
const STAGES: usize = 5;

/// Snapshots of the stages' histograms, one per second, oldest first.
#[derive(Debug, Default)]
pub(crate) struct Recent {
    states: VecDeque<[LatencyHistogram; STAGES]>,
    last_ns: Option<u64>,
}

impl Recent {
    /// Median and 99th percentile of each stage over the last ten seconds, microseconds; `now` is the snapshot at
    /// `now_ns`. `None` if less than a second has passed since the last call that returned values.
    pub(crate) fn quantiles_us(&mut self, now: [&LatencyHistogram; STAGES], now_ns: u64) -> Option<[[f64; 2]; STAGES]> {
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

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_slow_second_is_forgotten_after_ten() {
        let mut histogram = LatencyHistogram::new();
        let mut recent = Recent::default();
        let mut p99_us = Vec::new();
        for second in 0..15_u64 {
            let us = if second == 2 { 50_000 } else { 100 };
            for _ in 0..50 {
                histogram.record(Duration::from_micros(us));
            }
            let seen = recent.quantiles_us([&histogram; STAGES], second * SECOND_NS).expect("a second has passed");
            p99_us.push(seen[4][1]);
            assert!(recent.quantiles_us([&histogram; STAGES], second * SECOND_NS + 1).is_none());
        }
        let is_slow: Vec<bool> = p99_us.iter().map(|us| *us > 40_000.0).collect();
        let slow_from = |second: usize| (2..12).contains(&second);
        assert_eq!(is_slow, (0..15).map(slow_from).collect::<Vec<_>>(), "{p99_us:?}");
    }
}
