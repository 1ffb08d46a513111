//! The description at the start of a recording, as MCAP metadata records.

use std::collections::BTreeMap;

use dermis_device::Layout;
use mcap::records::Metadata;
use serde::{Deserialize, Serialize};

use crate::Error;

/// Names of the metadata records.
pub(super) const RECORDING: &str = "dermis.recording";
pub(super) const SKIN: &str = "dermis.skin";
pub(super) const CALIBRATION: &str = "dermis.calibration";
pub(super) const FINISHED: &str = "dermis.finished";
/// Name of the metadata record with the reason why a recording stopped early.
pub(super) const STOPPED: &str = "dermis.stopped";

/// Version of the format that [`super`] describes.
const VERSION: &str = "2";

/// Description of a recording's frames.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordingHead {
    /// The skin file's text.
    pub skin_toml: String,
    /// Assignment of channels in a raw frame.
    pub layout: Layout,
    /// A name for every channel, or empty.
    pub labels: Vec<String>,
    /// Source of the frames: a port, an address, a twin.
    pub source: String,
    /// The text of the calibration that images were made with, if any.
    pub calibration: Option<String>,
    /// The text of the force calibration, if any.
    pub forces: Option<String>,
}

impl RecordingHead {
    /// A head without channel labels.
    pub fn new(skin_toml: impl Into<String>, layout: Layout, source: impl Into<String>) -> Self {
        let (skin_toml, source) = (skin_toml.into(), source.into());
        Self { skin_toml, layout, labels: Vec::new(), source, calibration: None, forces: None }
    }

    /// # Errors
    /// An error unless there are no labels or one per channel.
    pub(super) fn validate(&self) -> Result<(), Error> {
        let channels = self.layout.channels();
        if self.labels.is_empty() || self.labels.len() == channels {
            return Ok(());
        }
        Err(Error::Live(dermis_live::Error::Frames {
            what: "channel labels of a recording".to_owned(),
            expected: format!("none or {channels}"),
            got: self.labels.len().to_string(),
        }))
    }

    pub(super) fn metadata(&self) -> Vec<Metadata> {
        let layout = LayoutText::from(&self.layout);
        let json = |value: serde_json::Result<String>| value.unwrap_or_default();
        let recording = record(
            RECORDING,
            [
                ("version", VERSION.to_owned()),
                ("software", concat!("dermis ", env!("CARGO_PKG_VERSION")).to_owned()),
                ("source", self.source.clone()),
                ("layout", json(serde_json::to_string(&layout))),
                ("labels", json(serde_json::to_string(&self.labels))),
            ],
        );
        let mut all = vec![recording, record(SKIN, [("toml", self.skin_toml.clone())])];
        let calibrations = [("image", &self.calibration), ("forces", &self.forces)];
        let given = calibrations.into_iter().filter_map(|(key, text)| Some((key.to_owned(), text.clone()?)));
        let metadata: BTreeMap<String, String> = given.collect();
        if !metadata.is_empty() {
            all.push(Metadata { name: CALIBRATION.to_owned(), metadata });
        }
        all
    }

    /// Files attached to a recording for human readers: name, media type, text.
    pub(super) fn attachments(&self) -> Vec<(&'static str, &'static str, &str)> {
        let mut all = vec![("skin.toml", "application/toml", self.skin_toml.as_str())];
        let calibrations = [("calibration.json", &self.calibration), ("forces.json", &self.forces)];
        all.extend(
            calibrations.into_iter().filter_map(|(name, text)| Some((name, "application/json", text.as_deref()?))),
        );
        all
    }

    /// Reads both records back. The error names the key and its fault.
    pub(super) fn from_metadata(found: &BTreeMap<String, BTreeMap<String, String>>) -> Result<Self, (String, String)> {
        let entry = |name: &str, key: &str| {
            let absent = || (format!("metadata {name}, key {key}"), "expected in a dermis recording, not found".into());
            found.get(name).and_then(|record| record.get(key)).map(String::as_str).ok_or_else(absent)
        };
        let wrong = |key: &str, reason: String| (format!("metadata {RECORDING}, key {key}"), reason);
        let version = entry(RECORDING, "version")?;
        if version != VERSION {
            return Err(wrong("version", format!("expected {VERSION}, found {version:?}")));
        }
        let layout: LayoutText =
            serde_json::from_str(entry(RECORDING, "layout")?).map_err(|error| wrong("layout", error.to_string()))?;
        let labels: Vec<String> =
            serde_json::from_str(entry(RECORDING, "labels")?).map_err(|error| wrong("labels", error.to_string()))?;
        let (skin_toml, source) = (entry(SKIN, "toml")?.to_owned(), entry(RECORDING, "source")?.to_owned());
        let calibration = |key: &str| found.get(CALIBRATION).and_then(|record| record.get(key)).cloned();
        let (calibration, forces) = (calibration("image"), calibration("forces"));
        let head = Self { skin_toml, layout: layout.into(), labels, source, calibration, forces };
        head.validate().map_err(|error| wrong("labels", error.to_string()))?;
        Ok(head)
    }
}

pub(super) fn record<const N: usize>(name: &str, entries: [(&str, String); N]) -> Metadata {
    let metadata = entries.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
    Metadata { name: name.to_owned(), metadata }
}

/// [`Layout`] in JSON.
#[derive(Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
enum LayoutText {
    Channels { count: usize },
    SingleEnded { electrodes: usize, stimulations: Vec<(usize, usize)> },
    FullMatrix { electrodes: usize },
}

impl From<&Layout> for LayoutText {
    fn from(layout: &Layout) -> Self {
        match layout {
            Layout::Channels { count } => Self::Channels { count: *count },
            Layout::SingleEnded { electrodes, stimulations } => {
                Self::SingleEnded { electrodes: *electrodes, stimulations: stimulations.clone() }
            }
            Layout::FullMatrix { electrodes } => Self::FullMatrix { electrodes: *electrodes },
        }
    }
}

impl From<LayoutText> for Layout {
    fn from(text: LayoutText) -> Self {
        match text {
            LayoutText::Channels { count } => Self::Channels { count },
            LayoutText::SingleEnded { electrodes, stimulations } => Self::SingleEnded { electrodes, stimulations },
            LayoutText::FullMatrix { electrodes } => Self::FullMatrix { electrodes },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_layout_survives() {
        let layouts = [
            Layout::Channels { count: 2 },
            Layout::SingleEnded { electrodes: 2, stimulations: vec![(0, 1)] },
            Layout::FullMatrix { electrodes: 1 },
        ];
        for layout in layouts {
            let mut head = RecordingHead::new("name = \"a\"\n", layout, "twin:a");
            head.forces = (head.labels.is_empty() && head.layout.channels() == 1).then(|| "{}".to_owned());
            head.labels = (0..head.layout.channels()).map(|channel| format!("\"{channel}\"")).collect();
            let found = head.metadata().into_iter().map(|record| (record.name, record.metadata)).collect();
            assert_eq!(RecordingHead::from_metadata(&found), Ok(head));
        }
    }

    #[test]
    fn missing_parts_are_named() {
        let (field, reason) = RecordingHead::from_metadata(&BTreeMap::new()).unwrap_err();
        assert_eq!((field.as_str(), reason.contains("not found")), ("metadata dermis.recording, key version", true));
    }
}
