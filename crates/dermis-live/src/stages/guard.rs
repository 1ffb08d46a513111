//! The guard of a skin, with the limits of its file.

use dermis_device::Frame;
use dermis_skin::{GuardSettings, Skin};
use dermis_touch::Touch;
use dermis_touch::damage::{Damage, DamageState};
use dermis_touch::guard::{Guard, GuardFrame, GuardLimits, GuardReport};
use dermis_touch::health::Health;

use crate::clock::FrameAnomalies;

/// A frame after all other stages.
#[derive(Clone, Debug)]
pub(crate) struct SeenFrame<'a> {
    /// The host's monotonic clock, nanoseconds.
    pub now_ns: u64,
    pub frame: &'a Frame,
    pub anomalies: FrameAnomalies,
    pub has_baseline: bool,
    pub is_baseline_trusted: bool,
    /// The touches were seen in this frame.
    pub is_seen: bool,
    pub health: Health<'a>,
    /// Readings of all channels.
    pub readings: &'a [f64],
    pub touches: &'a [Touch],
    pub damages: &'a [Damage],
}

/// The guard, and whether it may compare the device's clock with the host's.
#[derive(Clone, Debug)]
pub(crate) struct GuardStage {
    guard: Guard,
    watches_lag: bool,
}

impl GuardStage {
    pub fn new(settings: &GuardSettings, skin: &Skin) -> Self {
        let nanoseconds = |ms: f64| (1e6 * ms) as u64;
        let limits = GuardLimits {
            force_n: settings.force_n,
            pressure_pa: settings.pressure_kpa.map(|kpa| 1e3 * kpa),
            any_touch: settings.stops_at_any_touch(),
            damage: settings.damage,
            stale_after_ns: nanoseconds(settings.stale_after_ms(skin.backend.frames_per_s)),
            hold_ns: nanoseconds(settings.hold_ms),
            most_left_out: 1e-2 * settings.most_left_out_percent,
        };
        Self { guard: Guard::new(limits), watches_lag: false }
    }

    pub fn limits(&self) -> GuardLimits {
        *self.guard.limits()
    }

    pub fn watch_lag(&mut self, watch: bool) {
        self.watches_lag = watch;
    }

    pub fn before_frames(&self, now_ns: u64) -> GuardReport {
        GuardReport::before_frames(now_ns, self.guard.limits().stale_after_ns)
    }

    pub fn judge(&mut self, seen: &SeenFrame<'_>) -> GuardReport {
        let is_there = |damage: &Damage| !matches!(damage.state, DamageState::Suspected | DamageState::Healed);
        self.guard.judge(&GuardFrame {
            now_ns: seen.now_ns,
            frame_ns: seen.frame.host_monotonic_ns,
            device_ns: seen.frame.device_time_ns.filter(|_| self.watches_lag),
            is_clock_odd: seen.anomalies.renumbered || seen.anomalies.clock_jump_ns != 0,
            has_baseline: seen.has_baseline,
            is_baseline_trusted: seen.is_baseline_trusted,
            is_seen: seen.is_seen,
            health: seen.health.clone(),
            readings: seen.readings,
            touches: seen.touches,
            is_damaged: seen.damages.iter().any(is_there),
        })
    }
}
