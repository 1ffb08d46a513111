//! Settings in a skin file for watching its channels.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::Checker;
use crate::error::Error;

/// The table `[health]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct HealthSettings {
    /// True to watch the channels.
    pub watch: bool,
    /// Full scale of the converter; readings there are saturated. If left out, saturation is detected only on a
    /// channel that stays at full scale.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub full_scale_mv: Option<f64>,
    /// Number of consecutive frames without a fault before a channel is used again.
    pub recover_frames: u32,
}

impl Default for HealthSettings {
    fn default() -> Self {
        Self { watch: true, full_scale_mv: None, recover_frames: 50 }
    }
}

impl HealthSettings {
    pub(crate) fn is_default(&self) -> bool {
        *self == Self::default()
    }

    pub(crate) fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        checker.count("health.recover_frames", self.recover_frames as usize, 1, 1_000_000)?;
        checker.within("health.full_scale_mv", self.full_scale_mv.unwrap_or(1.0), 1e-6, 1e9)
    }
}

#[cfg(test)]
mod tests {
    use crate::{Skin, builtin_text};

    #[test]
    fn the_table_is_read_checked_and_optional() {
        let text = builtin_text("healing-square").unwrap();
        let with = |table: &str| Skin::parse(&format!("{text}\n[health]\n{table}\n"), "a page");
        let skin = with("watch = false\nfull_scale_mv = 125.0\nrecover_frames = 20").unwrap();
        assert!(!skin.health.watch && skin.health.full_scale_mv == Some(125.0) && skin.health.recover_frames == 20);
        assert_eq!(Skin::parse(&skin.to_toml(), "written").unwrap(), skin);
        assert!(!Skin::parse(text, "plain").unwrap().to_toml().contains("health"));
        let error = |table: &str| with(table).unwrap_err().to_string();
        assert_eq!(error("full_scale_mv = -1.0"), "a page: health.full_scale_mv = -1: expected 1e-6 to 1e9");
        assert!(error("recover_frames = 0").contains("health.recover_frames = 0: expected 1 to 1000000"));
    }
}
