//! The output file of the tables: a Markdown page whose tables are replaced, an HTML page, or JSON.

use std::path::{Path, PathBuf};

use dermis_device::write_atomic;

use super::tables::Evidence;
use crate::exit::UsageError;

/// Markers before and after the tables of a page.
const BEGIN: &str = "<!-- evidence:begin -->";
const END: &str = "<!-- evidence:end -->";
/// Largest page accepted, bytes.
const MOST_BYTES: u64 = 8 << 20;
const STYLE: &str = "body{font:16px/1.5 sans-serif;max-width:80em;margin:2em auto;padding:0 1em;color:#282c34}\
table{border-collapse:collapse}td,th{padding:.3em .8em;border-bottom:1px solid #ddd;text-align:left;vertical-align:top}\
pre{background:#f6f6f6;padding:1em}.wide{overflow-x:auto}";

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Markdown,
    Html,
    Json,
}

/// An output file for the tables.
pub(super) struct OutFile {
    path: PathBuf,
    kind: Kind,
}

impl OutFile {
    /// Refuses unknown endings, missing folders, and pages without a place for the tables.
    pub(super) fn checked(path: &Path) -> anyhow::Result<Self> {
        let refuse = |reason: &str| UsageError(format!("--out {}: {reason}", path.display()));
        let kind = match path.extension().and_then(|end| end.to_str()) {
            Some("md") => Kind::Markdown,
            Some("html") => Kind::Html,
            Some("json") => Kind::Json,
            _ => return Err(refuse("expected a name that ends in .md, .html or .json").into()),
        };
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if !folder.is_dir() {
            return Err(refuse("its folder does not exist").into());
        }
        let file = Self { path: path.to_path_buf(), kind };
        if kind == Kind::Markdown {
            file.around()?;
        }
        Ok(file)
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The parts of a page before and after its tables, including the markers; for a new page, the defaults.
    fn around(&self) -> anyhow::Result<[String; 2]> {
        let refuse = |reason: &str| UsageError(format!("--out {}: {reason}", self.path.display()));
        let Ok(found) = std::fs::metadata(&self.path) else {
            return Ok([format!("# What has been measured\n\n{BEGIN}\n"), format!("{END}\n")]);
        };
        if !found.is_file() || found.len() > MOST_BYTES {
            return Err(refuse("expected a page in Markdown").into());
        }
        let text = std::fs::read_to_string(&self.path).map_err(|error| refuse(&error.to_string()))?;
        let parts = text.split_once(BEGIN).and_then(|(before, rest)| Some((before, rest.split_once(END)?.1)));
        let Some((before, after)) = parts else {
            return Err(refuse(&format!("expected the lines {BEGIN} and {END} around the tables")).into());
        };
        Ok([format!("{before}{BEGIN}\n"), format!("{END}{after}")])
    }

    /// Writes the tables.
    pub(super) fn write(&self, evidence: &Evidence) -> anyhow::Result<()> {
        let text = match self.kind {
            Kind::Markdown => {
                let [before, after] = self.around()?;
                format!("{before}\n{}\n{after}", evidence.markdown())
            }
            Kind::Html => format!(
                "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n\
                 <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
                 <title>What has been measured</title>\n<style>{STYLE}</style></head><body>\n\
                 <h1>What has been measured</h1>\n{}</body></html>\n",
                evidence.html()
            ),
            Kind::Json => serde_json::to_string_pretty(&evidence.as_json())? + "\n",
        };
        write_atomic(&self.path, |file| file.write_all(text.as_bytes()))?;
        Ok(())
    }
}
