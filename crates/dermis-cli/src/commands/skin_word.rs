//! The argument SKIN, which is the first word in every command. The older option `--skin` of some commands is still
//! accepted.

use std::path::Path;

use dermis_record::is_recording;
use dermis_skin::Skin;

use super::hint;
use crate::exit::UsageError;

/// An optional skin.
#[derive(clap::Args)]
pub(super) struct SkinWord {
    /// Built-in skin or skin file.
    #[arg(value_name = "SKIN")]
    skin: Option<String>,
    /// Same as SKIN; for scripts written for earlier versions.
    #[arg(long = "skin", value_name = "SKIN", hide = true)]
    option: Option<String>,
}

impl SkinWord {
    /// The given skin, if any.
    ///
    /// # Errors
    /// Two skins are given.
    pub fn given(&self) -> Result<Option<String>, UsageError> {
        if let Some(option) = &self.option {
            if let Some(word) = &self.skin {
                return Err(UsageError(format!("{word} and --skin {option}: expected one skin, as the first word")));
            }
            hint(&format!("--skin {option} is now written as the first word, without --skin"));
        }
        Ok(self.skin.clone().or_else(|| self.option.clone()))
    }

    /// The given skin, which is required.
    ///
    /// # Errors
    /// Two skins or none are given, or the skin cannot be read.
    pub fn open(&self) -> anyhow::Result<Skin> {
        skin(&self.needed()?)
    }

    /// The given skin, or a default.
    ///
    /// # Errors
    /// Two skins are given.
    pub fn or(&self, default: &str) -> Result<String, UsageError> {
        Ok(self.given()?.unwrap_or_else(|| default.to_owned()))
    }

    /// The given skin, which is required.
    ///
    /// # Errors
    /// Two skins or none are given.
    pub fn needed(&self) -> Result<String, UsageError> {
        let expected =
            "SKIN is missing: expected a built-in skin (`dermis skins list`) or a skin file as the first word";
        self.given()?.ok_or_else(|| UsageError(expected.into()))
    }
}

/// The skin with a name or path. If it is a recording or another source, the error says where that belongs.
pub(super) fn skin(name: &str) -> anyhow::Result<Skin> {
    let path = Path::new(name);
    let is_source = ["tcp:", "serial:", "twin:", "file:"].iter().any(|scheme| name.starts_with(scheme));
    if path.is_file() && is_recording(path) {
        let text = format!("{name}: a recording, not a skin file; it contains its skin: dermis run --source {name}");
        return Err(UsageError(text).into());
    }
    if is_source {
        let text = format!("{name}: a source, not a skin; expected SKIN first, then --source {name}");
        return Err(UsageError(text).into());
    }
    Ok(Skin::open(name)?)
}
