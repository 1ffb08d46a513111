//! Settings in a skin file for its guard.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::backend::Backend;
use crate::check::Checker;
use crate::error::Error;
use crate::health::HealthSettings;

/// Frame periods after which a frame is stale, if the file doesn't say.
const STALE_PERIODS: f64 = 5.0;
/// Minimum of that age, which a busy desktop system can still keep; also used if the frame rate is unknown.
const LEAST_STALE_MS: f64 = 100.0;
/// Longest time in the table: a minute.
const MOST_MS: f64 = 60_000.0;

/// The table `[guard]`: limits at which a machine should stop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GuardSettings {
    /// Force of a touch that stops, N.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_n: Option<f64>,
    /// Mean pressure of a touch that stops, kPa.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pressure_kpa: Option<f64>,
    /// True if any touch stops. If left out, any touch stops unless a force or pressure is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub any_touch: Option<bool>,
    /// True if confirmed damage stops.
    pub damage: bool,
    /// Age at which a frame is stale, ms. If left out, five frame periods, at least 100 ms.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stale_after_ms: Option<f64>,
    /// How long a verdict other than `ok` lasts after its cause has gone, ms.
    pub hold_ms: f64,
    /// Largest share of the channels that may be left out because of faults, percent.
    pub most_left_out_percent: f64,
}

impl Default for GuardSettings {
    /// Any touch stops. A verdict is held for 100 ms, so that a reader at 20 Hz sees it twice.
    fn default() -> Self {
        Self {
            force_n: None,
            pressure_kpa: None,
            any_touch: None,
            damage: false,
            stale_after_ms: None,
            hold_ms: 100.0,
            most_left_out_percent: 0.0,
        }
    }
}

impl GuardSettings {
    /// True if any touch stops.
    pub fn stops_at_any_touch(&self) -> bool {
        self.any_touch.unwrap_or(self.force_n.is_none() && self.pressure_kpa.is_none())
    }

    /// Age at which a frame is stale, milliseconds, on a skin with this frame rate.
    pub fn stale_after_ms(&self, frames_per_s: Option<f64>) -> f64 {
        let periods_ms = frames_per_s.map_or(0.0, |rate| 1e3 * STALE_PERIODS / rate);
        self.stale_after_ms.unwrap_or(periods_ms.clamp(LEAST_STALE_MS, MOST_MS))
    }

    pub(crate) fn check(&self, health: &HealthSettings, backend: &Backend, checker: &Checker<'_>) -> Result<(), Error> {
        checker.within("guard.force_n", self.force_n.unwrap_or(1.0), 1e-6, 1e6)?;
        checker.within("guard.pressure_kpa", self.pressure_kpa.unwrap_or(1.0), 1e-6, 1e6)?;
        checker.within("guard.stale_after_ms", self.stale_after_ms.unwrap_or(1.0), 1.0, MOST_MS)?;
        checker.within("guard.hold_ms", self.hold_ms, 0.0, MOST_MS)?;
        checker.within("guard.most_left_out_percent", self.most_left_out_percent, 0.0, 100.0)?;
        // Frames with unnoticed faults would be called ok.
        let needs = [
            ("health.watch", health.watch, "false", "true with a [guard], which relies on it"),
            ("backend.differences", !backend.differences, "true", "false with a [guard]: differences hide faults"),
            ("backend.wiring", backend.wiring.is_known(), "unknown", "known wiring with a [guard], to see faults"),
        ];
        let missing = needs.into_iter().find(|(_, is_met, ..)| !is_met);
        missing.map_or(Ok(()), |(field, _, value, expected)| Err(checker.refused(field, value, expected)))
    }
}

#[cfg(test)]
mod tests {
    use super::GuardSettings;
    use crate::{Skin, builtin_text};

    #[test]
    fn the_table_is_read_checked_and_optional() {
        let text = builtin_text("healing-square").unwrap();
        let with = |table: &str| Skin::parse(&format!("{text}\n[guard]\n{table}\n"), "a page");
        let skin = with("force_n = 5.0\npressure_kpa = 40.0\nstale_after_ms = 80.0").unwrap();
        let guard = skin.guard.unwrap();
        assert!(guard.force_n == Some(5.0) && !guard.stops_at_any_touch() && guard.stale_after_ms(None) == 80.0);
        assert_eq!(Skin::parse(&skin.to_toml(), "written").unwrap(), skin);
        assert!(Skin::parse(text, "plain").unwrap().guard.is_none());
        assert_eq!(with("").unwrap().guard, Some(GuardSettings::default()));
        let error = |table: &str| with(table).unwrap_err().to_string();
        assert_eq!(error("force_n = -1.0"), "a page: guard.force_n = -1: expected 1e-6 to 1e6");
        assert!(error("hold_ms = nan").contains("guard.hold_ms = NaN: expected 0 to 60000"));
        assert!(error("[health]\nwatch = false").contains("health.watch = false: expected true with a [guard]"));
    }

    #[test]
    fn without_limits_any_touch_stops() {
        let guard = GuardSettings::default();
        assert!(guard.stops_at_any_touch());
        assert!(!GuardSettings { any_touch: Some(false), ..guard }.stops_at_any_touch());
        assert_eq!([None, Some(1000.0), Some(20.0)].map(|rate| guard.stale_after_ms(rate)), [100.0, 100.0, 250.0]);
    }
}
