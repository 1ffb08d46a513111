//! Settings in a skin file for telling damage from touch.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::Checker;
use crate::error::Error;

/// The table `[damage]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DamageSettings {
    /// True to watch for damage: in the image if pressing raises the conductivity, by lasting changes if pressing
    /// lowers it.
    pub watch: bool,
    /// Damage is suspected below minus this many standard deviations of the image's noise.
    pub begin_sigma: f64,
    /// Minimum drop of the image (relative conductivity change) that counts as damage.
    pub smallest_depth: f64,
    /// Time that damage must be visible before it is reported, seconds.
    pub confirm_s: f64,
    /// Length of intact sheet with the same resistance as a healed scar; used to measure the progress of healing.
    pub healed_scar_mm: f64,
}

impl Default for DamageSettings {
    fn default() -> Self {
        Self { watch: false, begin_sigma: 8.0, smallest_depth: 0.05, confirm_s: 1.5, healed_scar_mm: 8.7 }
    }
}

impl DamageSettings {
    pub(crate) fn is_default(&self) -> bool {
        *self == Self::default()
    }

    pub(crate) fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        checker.within("damage.begin_sigma", self.begin_sigma, 1e-3, 1e6)?;
        checker.within("damage.smallest_depth", self.smallest_depth, 1e-9, 1e3)?;
        checker.within("damage.confirm_s", self.confirm_s, 0.0, 1e6)?;
        checker.within("damage.healed_scar_mm", self.healed_scar_mm, 1e-3, 1e4)
    }
}

#[cfg(test)]
mod tests {
    use crate::{Skin, builtin_text};

    #[test]
    fn the_table_is_read_and_checked() {
        let text = builtin_text("ionic-disc").unwrap();
        let with = |table: &str| Skin::parse(&format!("{text}\n[damage]\n{table}\n"), "a page");
        let skin = with("watch = true\nconfirm_s = 3.0").unwrap();
        assert!(skin.damage.watch && skin.damage.confirm_s == 3.0);
        assert_eq!(Skin::parse(&skin.to_toml(), "written").unwrap(), skin);
        assert!(!Skin::parse(text, "plain").unwrap().to_toml().contains("damage"));
        let error = with("smallest_depth = 0.0").unwrap_err().to_string();
        assert_eq!(error, "a page: damage.smallest_depth = 0: expected 1e-9 to 1000");
        assert!(with("confirm_s = -1.0").is_err() && with("seen = 1").is_err());
    }
}
