//! A file and a selection of its frames: `voltages.csv#train1,train2`.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use crate::DeviceError;

/// A path, optionally followed by `#` and a selection of frames.
///
/// The selection is a comma-separated list of frame names (if the file has any, for instance in column headers),
/// indices from 0, and half-open ranges `first..end` with either bound optional. Names take precedence over indices.
/// The selection follows the last `#`. If a path itself contains `#`, add a `#` at its end.
///
/// ```
/// use dermis_device::FileSpec;
///
/// let spec: FileSpec = "voltages.csv#ref".parse()?;
/// assert_eq!(spec.path.to_str(), Some("voltages.csv"));
/// assert_eq!(spec.select.to_string(), "ref");
///
/// let quiet: FileSpec = "run1/setup#0..60".parse()?;
/// assert_eq!(quiet.to_string(), "run1/setup#0..60");
///
/// let all: FileSpec = "odd#name.csv#".parse()?;
/// assert_eq!(all.path.to_str(), Some("odd#name.csv"));
/// assert!("".parse::<FileSpec>().is_err());
/// # Ok::<(), dermis_device::DeviceError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileSpec {
    /// The file or directory.
    pub path: PathBuf,
    /// The selected frames.
    pub select: FrameSelect,
}

impl FileSpec {
    /// Selects all frames of a file; the path may contain any characters.
    pub fn all(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), select: FrameSelect::All }
    }
}

impl FromStr for FileSpec {
    type Err = DeviceError;

    fn from_str(text: &str) -> Result<Self, DeviceError> {
        let (path, select) = text.rsplit_once('#').unwrap_or((text, ""));
        if path.is_empty() {
            return Err(DeviceError::selector(text, "a file path, optionally with #FRAMES as in voltages.csv#ref"));
        }
        Ok(Self { path: path.into(), select: select.parse()? })
    }
}

impl fmt::Display for FileSpec {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let path = self.path.display().to_string();
        match &self.select {
            FrameSelect::All if path.contains('#') => write!(out, "{path}#"),
            FrameSelect::All => write!(out, "{path}"),
            chosen => write!(out, "{path}#{chosen}"),
        }
    }
}

/// Selected frames of a file, in order. See [`FileSpec`] for the syntax.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum FrameSelect {
    /// Every frame in the file's order.
    #[default]
    All,
    /// The listed frames in the listed order.
    Listed(Vec<FrameItem>),
}

/// One entry of a [`FrameSelect`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum FrameItem {
    /// A frame by name, or by index from 0 if no frame has that name.
    Frame(String),
    /// Frames `first..end`, without `end` itself. If `end` is absent, up to the last frame.
    Range {
        /// First index.
        first: usize,
        /// One past the last index.
        end: Option<usize>,
    },
}

impl FromStr for FrameSelect {
    type Err = DeviceError;

    fn from_str(text: &str) -> Result<Self, DeviceError> {
        if text.is_empty() {
            return Ok(Self::All);
        }
        text.split(',').map(|item| parse_item(text, item.trim())).collect::<Result<_, _>>().map(Self::Listed)
    }
}

fn parse_item(text: &str, item: &str) -> Result<FrameItem, DeviceError> {
    if item.is_empty() {
        return Err(DeviceError::selector(text, "frame names, indices or ranges separated by single commas"));
    }
    let Some((first, end)) = item.split_once("..") else { return Ok(FrameItem::Frame(item.to_owned())) };
    let bound =
        |bound: &str| bound.parse().map_err(|_| DeviceError::selector(item, "a range of indices such as 0..60"));
    Ok(FrameItem::Range {
        first: if first.is_empty() { 0 } else { bound(first)? },
        end: if end.is_empty() { None } else { Some(bound(end)?) },
    })
}

impl fmt::Display for FrameSelect {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self::Listed(items) = self else { return Ok(()) };
        for (index, item) in items.iter().enumerate() {
            if index > 0 {
                write!(out, ",")?;
            }
            write!(out, "{item}")?;
        }
        Ok(())
    }
}

impl fmt::Display for FrameItem {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Frame(name) => write!(out, "{name}"),
            Self::Range { first, end: Some(end) } => write!(out, "{first}..{end}"),
            Self::Range { first, end: None } => write!(out, "{first}.."),
        }
    }
}

impl FrameSelect {
    /// True if any entry can only be a name, not an index or a range.
    pub fn names_frames(&self) -> bool {
        let Self::Listed(items) = self else { return false };
        items.iter().any(|item| matches!(item, FrameItem::Frame(name) if name.parse::<usize>().is_err()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_mix_names_indices_and_ranges() {
        let select: FrameSelect = "ref,3,10..,..2".parse().unwrap();
        let expected = vec![
            FrameItem::Frame("ref".into()),
            FrameItem::Frame("3".into()),
            FrameItem::Range { first: 10, end: None },
            FrameItem::Range { first: 0, end: Some(2) },
        ];
        assert_eq!(select, FrameSelect::Listed(expected));
        assert!(select.names_frames());
        assert!(!"3,10..".parse::<FrameSelect>().unwrap().names_frames());
    }

    #[test]
    fn empty_items_and_broken_ranges_are_refused() {
        for text in ["a,,b", ",", "1..x", "-1..4"] {
            assert!(text.parse::<FrameSelect>().is_err(), "{text}");
        }
    }
}
