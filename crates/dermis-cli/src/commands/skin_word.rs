//! SKIN, in the same place in every command: the first word. `--skin`, as some commands had it, is understood as well.

use std::path::Path;

use dermis::record::is_recording;
use dermis::skin::Skin;

use super::hint;
use crate::exit::UsageError;

/// Which skin, where one may be named.
#[derive(clap::Args)]
pub(super) struct SkinWord {
    /// Built-in skin or skin file.
    #[arg(value_name = "SKIN")]
    skin: Option<String>,
    /// As SKIN; for scripts written for earlier versions.
    #[arg(long = "skin", value_name = "SKIN", hide = true)]
    option: Option<String>,
}

impl SkinWord {
    /// What was given.
    ///
    /// # Errors
    /// Two skins.
    pub fn given(&self) -> Result<Option<String>, UsageError> {
        if let Some(option) = &self.option {
            if let Some(word) = &self.skin {
                return Err(UsageError(format!("{word} and --skin {option}: expected one skin, as the first word")));
            }
            hint(&format!("--skin {option} is the first word now, without --skin"));
        }
        Ok(self.skin.clone().or_else(|| self.option.clone()))
    }

    /// The skin, which must be given.
    ///
    /// # Errors
    /// Two skins, none, or one that cannot be read.
    pub fn open(&self) -> anyhow::Result<Skin> {
        skin(&self.needed()?)
    }

    /// What was given, or a default.
    ///
    /// # Errors
    /// Two skins.
    pub fn or(&self, default: &str) -> Result<String, UsageError> {
        Ok(self.given()?.unwrap_or_else(|| default.to_owned()))
    }

    /// What was given.
    ///
    /// # Errors
    /// Two skins, or none.
    pub fn needed(&self) -> Result<String, UsageError> {
        let expected =
            "SKIN is missing: expected a built-in skin (`dermis skins list`) or a skin file as the first word";
        self.given()?.ok_or_else(|| UsageError(expected.into()))
    }
}

/// The skin that a name or path stands for. Of a recording or another source it is said where that goes.
pub(super) fn skin(name: &str) -> anyhow::Result<Skin> {
    let path = Path::new(name);
    let is_source = ["tcp:", "serial:", "twin:", "file:"].iter().any(|scheme| name.starts_with(scheme));
    if path.is_file() && is_recording(path) {
        let text = format!("{name}: a recording and no skin file; it has its skin in it: dermis run --source {name}");
        return Err(UsageError(text).into());
    }
    if is_source {
        let text = format!("{name}: a source and no skin; expected SKIN first, and then --source {name}");
        return Err(UsageError(text).into());
    }
    Ok(Skin::open(name)?)
}
