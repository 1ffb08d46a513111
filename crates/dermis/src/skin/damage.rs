//! What a skin file says of telling damage from touch.

use serde::{Deserialize, Serialize};

use super::refused;
use crate::Error;

/// The table `[damage]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DamageSettings {
    /// Whether damage is watched: for skins whose image falls where they are damaged and rises where they are pressed.
    pub watch: bool,
    /// Damage is suspected below minus this many standard deviations of the image's noise.
    pub begin_sigma: f64,
    /// Drop of the image (relative conductivity change) below which nothing counts.
    pub smallest_depth: f64,
    /// How long it must be seen before it is believed.
    pub confirm_s: f64,
    /// Length of intact sheet that a healed scar is worth, by which progress of healing is told.
    pub healed_scar_mm: f64,
}

impl Default for DamageSettings {
    fn default() -> Self {
        Self { watch: false, begin_sigma: 8.0, smallest_depth: 0.05, confirm_s: 1.5, healed_scar_mm: 8.7 }
    }
}

impl DamageSettings {
    pub(super) fn is_default(&self) -> bool {
        *self == Self::default()
    }

    pub(super) fn check(&self, file: &str) -> Result<(), Error> {
        for (field, value) in [("damage.begin_sigma", self.begin_sigma), ("damage.smallest_depth", self.smallest_depth)]
        {
            if !(value > 0.0 && value.is_finite()) {
                return Err(refused(file, field, value, "a positive number"));
            }
        }
        if !(self.confirm_s >= 0.0 && self.confirm_s.is_finite()) {
            return Err(refused(file, "damage.confirm_s", self.confirm_s, "0 or more"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Skin, builtin_text};

    #[test]
    fn the_table_is_read_and_checked() {
        let text = builtin_text("ionic-disc").unwrap();
        let with = |table: &str| Skin::parse(&format!("{text}\n[damage]\n{table}\n"), "a page");
        let skin = with("watch = true\nconfirm_s = 3.0").unwrap();
        assert!(skin.damage.watch && skin.damage.confirm_s == 3.0);
        assert_eq!(Skin::parse(&skin.to_toml(), "written").unwrap(), skin);
        assert!(!Skin::parse(text, "plain").unwrap().to_toml().contains("damage"));
        let error = with("smallest_depth = 0.0").unwrap_err().to_string();
        assert_eq!(error, "a page: damage.smallest_depth = 0: expected a positive number");
        assert!(with("confirm_s = -1.0").is_err() && with("seen = 1").is_err());
    }
}
