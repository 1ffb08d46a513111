//! The state machine: frames in, verdicts out.

use super::limits::{GuardLimits, judge_touch};
use super::report::{GuardReason, GuardReasons, GuardReport, GuardVerdict};
use crate::health::Health;
use crate::touch::Touch;

/// A frame as the guard sees it. Times are nanoseconds.
#[derive(Clone, Debug)]
pub struct GuardFrame<'a> {
    /// The host's monotonic clock now; never earlier than for the frame before.
    pub now_ns: u64,
    /// The frame's arrival on the same clock.
    pub frame_ns: u64,
    /// The frame's time on the device's clock; `None` without such a clock, or if it runs at another rate.
    pub device_ns: Option<u64>,
    /// The device's clock or its frame numbers jumped at this frame.
    pub is_clock_odd: bool,
    /// There is a baseline.
    pub has_baseline: bool,
    /// The baseline is believed to be that of the untouched skin.
    pub is_baseline_trusted: bool,
    /// The touches were seen in this frame and explain it. False if they are repeated from an earlier one because this
    /// one is in doubt, or if something is pressing that is not yet reported as a touch.
    pub is_seen: bool,
    /// Known faults.
    pub health: Health<'a>,
    /// Readings of all channels; NaN where missing.
    pub readings: &'a [f64],
    /// Touches on the skin.
    pub touches: &'a [Touch],
    /// The skin has confirmed damage.
    pub is_damaged: bool,
}

/// Judges frame after frame.
#[derive(Clone, Debug)]
pub struct Guard {
    limits: GuardLimits,
    lag: LagMeter,
    /// Arrival of the last frame.
    last_ns: Option<u64>,
    /// Arrival of the last frame whose own image was seen.
    seen_ns: Option<u64>,
    /// The last verdict other than `ok`.
    held: Option<Held>,
}

/// A verdict that lasts for a while after its cause has gone.
#[derive(Clone, Copy, Debug)]
struct Held {
    verdict: GuardVerdict,
    reasons: GuardReasons,
    /// End of the hold time on the host's monotonic clock, nanoseconds.
    until_ns: u64,
}

impl Guard {
    /// A guard with these limits that has not seen a frame.
    #[must_use]
    pub fn new(limits: GuardLimits) -> Self {
        Self { limits, lag: LagMeter::default(), last_ns: None, seen_ns: None, held: None }
    }

    /// The limits.
    #[must_use]
    pub fn limits(&self) -> &GuardLimits {
        &self.limits
    }

    /// The verdict on the next frame. Allocates nothing.
    pub fn judge(&mut self, frame: &GuardFrame<'_>) -> GuardReport {
        let mut reasons = GuardReasons::default();
        self.judge_times(frame, &mut reasons);
        self.judge_trust(frame, &mut reasons);
        for touch in frame.touches {
            judge_touch(touch, &self.limits, &mut reasons);
        }
        if self.limits.damage && frame.is_damaged {
            reasons.insert(GuardReason::Damage);
        }
        let (verdict, reasons) = self.hold(reasons, frame.now_ns);
        let stale_after_ns = self.limits.stale_after_ns;
        GuardReport { verdict, reasons, frame_ns: frame.frame_ns, stale_after_ns }
    }

    fn judge_times(&mut self, frame: &GuardFrame<'_>, reasons: &mut GuardReasons) {
        let limit_ns = self.limits.stale_after_ns;
        let is_old = |since_ns: u64, until_ns: u64| until_ns.saturating_sub(since_ns) > limit_ns;
        if is_old(frame.frame_ns, frame.now_ns) {
            reasons.insert(GuardReason::Late);
        }
        if self.last_ns.is_some_and(|last_ns| is_old(last_ns, frame.frame_ns)) {
            reasons.insert(GuardReason::Gap);
        }
        self.last_ns = Some(frame.frame_ns);
        if frame.is_clock_odd {
            reasons.insert(GuardReason::Clock);
            self.lag.reset();
        }
        if let Some(device_ns) = frame.device_ns
            && self.lag.lag_ns(device_ns, frame.frame_ns) > limit_ns
        {
            reasons.insert(GuardReason::Late);
        }
        if frame.is_seen && frame.has_baseline {
            self.seen_ns = Some(frame.frame_ns);
        }
        if frame.has_baseline && self.seen_ns.is_none_or(|seen_ns| is_old(seen_ns, frame.now_ns)) {
            reasons.insert(GuardReason::InDoubt);
        }
    }

    fn judge_trust(&self, frame: &GuardFrame<'_>, reasons: &mut GuardReasons) {
        if !frame.has_baseline {
            reasons.insert(GuardReason::NoBaseline);
        } else if !frame.is_baseline_trusted {
            reasons.insert(GuardReason::BaselineUntrusted);
        }
        if frame.health.frame.is_some() {
            reasons.insert(GuardReason::FrameFault);
        }
        // A missing reading counts at once; health waits for several before it leaves the channel out.
        let left_out = &frame.health.channels;
        let is_used = |channel: usize| left_out.binary_search_by_key(&channel, |fault| fault.channel as usize).is_err();
        let readings = frame.readings.iter().enumerate();
        let missing = readings.filter(|(channel, reading)| !reading.is_finite() && is_used(*channel)).count();
        // Without channels, a share of them means nothing.
        let left_out = (left_out.len() + missing) as f64 / frame.readings.len() as f64;
        let is_allowed = left_out <= self.limits.most_left_out;
        if !is_allowed {
            reasons.insert(GuardReason::ChannelsLeftOut);
        }
    }

    /// Keeps an earlier verdict until its hold time has passed. A stop lasts through faults that follow it.
    fn hold(&mut self, reasons: GuardReasons, now_ns: u64) -> (GuardVerdict, GuardReasons) {
        let verdict = reasons.verdict();
        let earlier = self.held.filter(|held| now_ns < held.until_ns);
        let lasts = earlier.filter(|held| held.verdict > verdict);
        let mut shown = reasons;
        if let Some(held) = &lasts {
            shown.insert(GuardReason::Held);
            if verdict == GuardVerdict::Ok {
                held.reasons.iter().for_each(|reason| shown.insert(reason));
            }
        }
        if verdict == GuardVerdict::Ok {
            self.held = earlier;
        } else {
            let until_ns = now_ns.saturating_add(self.limits.hold_ns);
            self.held = Some(Held { until_ns, ..lasts.unwrap_or(Held { verdict, reasons, until_ns }) });
        }
        (lasts.map_or(verdict, |held| held.verdict), shown)
    }
}

/// Rate at which a lag is forgotten, so that clocks that drift apart don't look like one: 1 %. The resonators and RC
/// oscillators of microcontrollers are within 1 %, crystals within 0.01 %.
const FORGOTTEN_NS_PER_S: u64 = 10_000_000;

/// Measures how much later than its predecessors a frame arrives. Frames that queue up anywhere between device and
/// host, for example while the host was suspended, arrive with increasing lag although their arrival times look fresh.
#[derive(Clone, Copy, Debug, Default)]
pub struct LagMeter {
    /// Smallest host time minus device time so far, and the host time of the last frame.
    fastest: Option<(i128, u64)>,
}

impl LagMeter {
    /// Takes a frame's times, nanoseconds, and returns its lag behind the fastest frame so far. 0 for the first one.
    pub fn lag_ns(&mut self, device_ns: u64, host_ns: u64) -> u64 {
        let offset = i128::from(host_ns) - i128::from(device_ns);
        let fastest = match self.fastest {
            None => offset,
            Some((fastest, last_ns)) => {
                let passed_ns = u128::from(host_ns.saturating_sub(last_ns));
                let forgotten = passed_ns * u128::from(FORGOTTEN_NS_PER_S) / 1_000_000_000;
                offset.min(fastest.saturating_add(i128::try_from(forgotten).unwrap_or(i128::MAX)))
            }
        };
        self.fastest = Some((fastest, host_ns));
        u64::try_from(offset - fastest).unwrap_or(u64::MAX)
    }

    /// Starts over, after the device's clock was set.
    pub fn reset(&mut self) {
        self.fastest = None;
    }
}
