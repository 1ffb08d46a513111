//! A body file as written, with the position of every value that could be wrong.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dermis_skin::GuardSettings;
use serde::Deserialize;
use toml::Spanned;

use crate::error::Error;

/// The files of a demonstration without hardware, name and text: an arm of primitives with four skins, each played by
/// its twin. They belong in one folder.
pub const DEMO_FILES: [(&str, &str); 2] =
    [("arm.toml", include_str!("../demo/arm.toml")), ("arm.urdf", include_str!("../demo/arm.urdf"))];

/// Largest body file, bytes.
const MOST_BYTES: u64 = 4 << 20;

/// A body file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct BodyText {
    pub name: Option<String>,
    pub urdf: Option<Spanned<PathBuf>>,
    #[serde(default)]
    pub packages: BTreeMap<String, PathBuf>,
    #[serde(default)]
    pub joints: JointsText,
    #[serde(default)]
    pub patch: Vec<PatchText>,
}

/// Source of joint values.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct JointsText {
    pub source: Option<Spanned<String>>,
    pub stale_after_ms: Option<Spanned<f64>>,
    #[serde(default)]
    pub at: BTreeMap<String, Spanned<f64>>,
}

/// One skin on the body.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PatchText {
    pub name: Spanned<String>,
    pub skin: Spanned<String>,
    pub source: Option<Spanned<String>>,
    pub link: Option<Spanned<String>>,
    pub xyz_mm: Option<Spanned<[f64; 3]>>,
    pub rpy_deg: Option<Spanned<[f64; 3]>>,
    pub baseline: Option<String>,
    pub calibration: Option<PathBuf>,
    pub forces: Option<PathBuf>,
    pub guard: Option<Spanned<GuardSettings>>,
}

/// A body file's text, for converting positions of values into line numbers.
#[derive(Debug)]
pub(crate) struct Source {
    pub file: PathBuf,
    text: String,
}

impl Source {
    /// Reads and parses a file.
    pub fn open(file: &Path) -> Result<(Self, BodyText), Error> {
        Self::parse(crate::files::read_text(file, MOST_BYTES)?, file)
    }

    pub fn parse(text: String, file: &Path) -> Result<(Self, BodyText), Error> {
        let body = toml::from_str(&text).map_err(|error| Error::BodyFile {
            file: file.to_path_buf(),
            message: error.to_string().trim_end().to_owned(),
        })?;
        Ok((Self { file: file.to_path_buf(), text }, body))
    }

    /// Folder that paths in the file are relative to.
    pub fn folder(&self) -> &Path {
        self.file.parent().unwrap_or(Path::new(""))
    }

    /// Line of a value, from 1.
    pub fn line_of<T>(&self, value: &Spanned<T>) -> usize {
        let start = value.span().start.min(self.text.len());
        1 + self.text.as_bytes()[..start].iter().filter(|&&byte| byte == b'\n').count()
    }

    /// An error about a value.
    pub fn refused<T>(
        &self,
        at: &Spanned<T>,
        field: impl Into<String>,
        value: impl ToString,
        expected: impl Into<String>,
    ) -> Error {
        Error::BodyField {
            file: self.file.clone(),
            line: self.line_of(at),
            field: field.into(),
            value: value.to_string(),
            expected: expected.into(),
        }
    }
}

/// True for body files: TOML with a `[[patch]]` or a `urdf`. A broken file counts if it has a line `[[patch]]`.
pub fn is_body_file(file: &Path) -> bool {
    if !file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("toml")) {
        return false;
    }
    let Ok(text) = crate::files::read_text(file, MOST_BYTES) else { return false };
    match text.parse::<toml::Table>() {
        Ok(table) => table.contains_key("patch") || table.contains_key("urdf"),
        Err(_) => text.lines().any(|line| line.trim() == "[[patch]]"),
    }
}
