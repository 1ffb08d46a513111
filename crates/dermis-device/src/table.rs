//! A finite recording: frames x channels, with any known order and times.

use std::path::{Path, PathBuf};

use crate::{DeviceError, FrameItem, FrameSelect};

/// Assignment of readings to a frame's channels. Electrodes count from 0.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Layout {
    /// In the order of the measurements in the skin's protocol.
    Channels {
        /// Number of readings.
        count: usize,
    },
    /// The potential of every electrode against a common reference, for every stimulation. Stimulation-major: channel
    /// `s * electrodes + e`.
    SingleEnded {
        /// Number of electrodes.
        electrodes: usize,
        /// Electrode where the current enters the body, and electrode where it leaves.
        stimulations: Vec<(usize, usize)>,
    },
    /// For each of the `electrodes` pairs of neighbours (k, k+1) that drive, all pairs of neighbours (j, j+1) that
    /// measure, driven ones included: channel `k * electrodes + j`.
    FullMatrix {
        /// Number of electrodes, which is also the number of pairs and of drives.
        electrodes: usize,
    },
}

impl Layout {
    /// Readings in a frame of this layout.
    pub fn channels(&self) -> usize {
        match self {
            Self::Channels { count } => *count,
            Self::SingleEnded { electrodes, stimulations } => electrodes.saturating_mul(stimulations.len()),
            Self::FullMatrix { electrodes } => electrodes.saturating_mul(*electrodes),
        }
    }
}

/// Frames of one recording. Readings are finite, or NaN if missing.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameTable {
    layout: Layout,
    source: PathBuf,
    values: Vec<f64>,
    imaginary: Option<Vec<f64>>,
    times_s: Option<Vec<f64>>,
    sequences: Option<Vec<u64>>,
    names: Option<Vec<String>>,
    channel_names: Option<Vec<String>>,
    wall_ns: Option<Vec<i64>>,
    notes: Vec<String>,
}

impl FrameTable {
    /// Creates a table from `values`, frame after frame with `layout.channels()` readings each, read from `source`.
    ///
    /// # Errors
    /// [`DeviceError::Empty`] without frames, [`DeviceError::Count`] if the last frame is incomplete,
    /// [`DeviceError::Infinite`] for an infinite reading.
    pub fn new(layout: Layout, values: Vec<f64>, source: impl Into<PathBuf>) -> Result<Self, DeviceError> {
        let source = source.into();
        let channels = layout.channels();
        if channels == 0 || values.is_empty() {
            return Err(DeviceError::Empty { file: source });
        }
        let whole = values.len() / channels * channels;
        if whole != values.len() {
            let found = values.len() - whole;
            return Err(DeviceError::Count {
                file: source,
                what: "readings in the last frame",
                expected: channels,
                found,
            });
        }
        refuse_infinite(&values, channels, &source)?;
        Ok(Self {
            layout,
            source,
            values,
            imaginary: None,
            times_s: None,
            sequences: None,
            names: None,
            channel_names: None,
            wall_ns: None,
            notes: Vec::new(),
        })
    }

    /// Adds the imaginary part of every reading, in the order of the real parts.
    ///
    /// # Errors
    /// [`DeviceError::Count`] or [`DeviceError::Infinite`], as for the real parts.
    pub fn with_imaginary(mut self, imaginary: Vec<f64>) -> Result<Self, DeviceError> {
        self.check_count("imaginary parts", self.values.len(), imaginary.len())?;
        refuse_infinite(&imaginary, self.channels(), &self.source)?;
        self.imaginary = Some(imaginary);
        Ok(self)
    }

    /// Adds the time of every frame in seconds, with any origin.
    ///
    /// # Errors
    /// [`DeviceError::Count`] if there is not one time per frame.
    pub fn with_times_s(mut self, times_s: Vec<f64>) -> Result<Self, DeviceError> {
        self.check_count("frame times", self.frames(), times_s.len())?;
        self.times_s = Some(times_s);
        Ok(self)
    }

    /// Adds the instrument's own frame numbers.
    ///
    /// # Errors
    /// [`DeviceError::Count`] if there is not one number per frame.
    pub fn with_sequences(mut self, sequences: Vec<u64>) -> Result<Self, DeviceError> {
        self.check_count("frame numbers", self.frames(), sequences.len())?;
        self.sequences = Some(sequences);
        Ok(self)
    }

    /// Adds the frames' names.
    ///
    /// # Errors
    /// [`DeviceError::Count`] if there is not one name per frame.
    pub fn with_names(mut self, names: Vec<String>) -> Result<Self, DeviceError> {
        self.check_count("frame names", self.frames(), names.len())?;
        self.names = Some(names);
        Ok(self)
    }

    /// Adds the file's names for its channels.
    ///
    /// # Errors
    /// [`DeviceError::Count`] if there is not one name per channel.
    pub fn with_channel_names(mut self, names: Vec<String>) -> Result<Self, DeviceError> {
        self.check_count("channel names", self.channels(), names.len())?;
        self.channel_names = Some(names);
        Ok(self)
    }

    /// Adds the wall-clock time of every frame, in nanoseconds since 1970-01-01 UTC (in local time if the file states
    /// no time zone).
    ///
    /// # Errors
    /// [`DeviceError::Count`] if there is not one time per frame.
    pub fn with_wall_ns(mut self, wall_ns: Vec<i64>) -> Result<Self, DeviceError> {
        self.check_count("moments", self.frames(), wall_ns.len())?;
        self.wall_ns = Some(wall_ns);
        Ok(self)
    }

    /// Adds notes on how the file was understood, apart from its dimensions. One item per note.
    #[must_use]
    pub fn with_notes(mut self, notes: Vec<String>) -> Self {
        self.notes.extend(notes);
        self
    }

    fn check_count(&self, what: &'static str, expected: usize, found: usize) -> Result<(), DeviceError> {
        if expected == found {
            return Ok(());
        }
        Err(DeviceError::Count { file: self.source.clone(), what, expected, found })
    }

    /// Readings in every frame.
    pub fn channels(&self) -> usize {
        self.layout.channels()
    }

    /// Number of frames, at least 1.
    pub fn frames(&self) -> usize {
        self.values.len() / self.channels()
    }

    /// Assignment of readings to channels.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// The file or directory of the recording.
    pub fn source(&self) -> &Path {
        &self.source
    }

    /// All readings, frames x channels, row-major; real parts if complex.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// All imaginary parts in the order of [`Self::values`], if the instrument reads them.
    pub fn imaginary(&self) -> Option<&[f64]> {
        self.imaginary.as_deref()
    }

    /// Readings of one frame (real parts if complex), or `None` if there is no such frame.
    pub fn row(&self, frame: usize) -> Option<&[f64]> {
        self.values.chunks_exact(self.channels()).nth(frame)
    }

    /// Imaginary parts of one frame, or `None` for a real recording or if there is no such frame.
    pub fn imaginary_row(&self, frame: usize) -> Option<&[f64]> {
        self.imaginary.as_ref()?.chunks_exact(self.channels()).nth(frame)
    }

    /// Every frame's readings in order.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        self.values.chunks_exact(self.channels())
    }

    /// Time of each frame in seconds, if recorded.
    pub fn times_s(&self) -> Option<&[f64]> {
        self.times_s.as_deref()
    }

    /// The instrument's own frame numbers, if recorded.
    pub fn sequences(&self) -> Option<&[u64]> {
        self.sequences.as_deref()
    }

    /// The frames' names, if recorded.
    pub fn names(&self) -> Option<&[String]> {
        self.names.as_deref()
    }

    /// The file's names for its channels, if it has any.
    pub fn channel_names(&self) -> Option<&[String]> {
        self.channel_names.as_deref()
    }

    /// Wall-clock time of every frame, if recorded, in nanoseconds since 1970-01-01 UTC.
    pub fn wall_ns(&self) -> Option<&[i64]> {
        self.wall_ns.as_deref()
    }

    /// Notes on how the file was understood, apart from its dimensions.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// One-line summary of how the file was understood:
    /// `40 frames x 208 channels; header in line 1; decimal commas`.
    pub fn understood(&self) -> String {
        let kind = if self.imaginary.is_some() { " complex" } else { "" };
        let frames = if self.frames() == 1 { "1 frame".to_owned() } else { format!("{} frames", self.frames()) };
        let mut text = format!("{frames} x {}{kind} channels", self.channels());
        for note in &self.notes {
            text.push_str("; ");
            text.push_str(note);
        }
        let missing = self.values.iter().filter(|value| value.is_nan()).count();
        if missing > 0 {
            text.push_str(&format!("; {missing} of {} readings missing", self.values.len()));
        }
        text
    }

    /// The same frames with different channels. `taken` lists an old channel and a factor for each new one.
    ///
    /// # Panics
    /// If an old channel doesn't exist.
    #[must_use]
    pub fn rearranged(mut self, taken: &[(usize, f64)]) -> Self {
        let channels = self.channels();
        for all in std::iter::once(&mut self.values).chain(&mut self.imaginary) {
            let rows = all.chunks_exact(channels);
            *all = rows.flat_map(|row| taken.iter().map(|(from, factor)| row[*from] * factor)).collect();
        }
        self.channel_names =
            self.channel_names.map(|names| taken.iter().map(|(from, _)| names[*from].clone()).collect());
        self.layout = Layout::Channels { count: taken.len() };
        self
    }

    /// Returns a table of the selected frames.
    ///
    /// # Errors
    /// [`DeviceError::Selection`] with the item that matches no frame, or several with the same name.
    pub fn select(self, select: &FrameSelect) -> Result<Self, DeviceError> {
        let FrameSelect::Listed(items) = select else { return Ok(self) };
        let mut chosen = Vec::new();
        for item in items {
            chosen.extend(self.resolve(item)?);
        }
        let channels = self.channels();
        let gather = |all: &[f64]| -> Vec<f64> {
            chosen.iter().flat_map(|&frame| &all[frame * channels..(frame + 1) * channels]).copied().collect()
        };
        Ok(Self {
            layout: self.layout.clone(),
            source: self.source.clone(),
            values: gather(&self.values),
            imaginary: self.imaginary.as_deref().map(gather),
            times_s: self.times_s.as_ref().map(|times| chosen.iter().map(|&frame| times[frame]).collect()),
            sequences: self.sequences.as_ref().map(|numbers| chosen.iter().map(|&frame| numbers[frame]).collect()),
            names: self.names.as_ref().map(|names| chosen.iter().map(|&frame| names[frame].clone()).collect()),
            wall_ns: self.wall_ns.as_ref().map(|moments| chosen.iter().map(|&frame| moments[frame]).collect()),
            channel_names: self.channel_names,
            notes: self.notes,
        })
    }

    /// Frame indices for an item. They all exist, and there is at least one.
    fn resolve(&self, item: &FrameItem) -> Result<std::ops::Range<usize>, DeviceError> {
        let frames = self.frames();
        let range = match item {
            FrameItem::Range { first, end } => *first..end.unwrap_or(frames),
            FrameItem::Frame(name) => {
                let named = self.names.iter().flatten().enumerate().filter(|(_, other)| *other == name);
                let mut named = named.map(|(index, _)| index);
                let index = match (named.next(), named.next()) {
                    (Some(index), None) => Some(index),
                    (Some(_), Some(_)) => None,
                    (None, _) => name.parse().ok(),
                };
                let Some(index) = index.filter(|&index: &usize| index < frames) else {
                    return Err(self.no_such_frame(item));
                };
                index..index + 1
            }
        };
        if range.is_empty() || range.end > frames {
            return Err(self.no_such_frame(item));
        }
        Ok(range)
    }

    fn no_such_frame(&self, item: &FrameItem) -> DeviceError {
        const LISTED: usize = 16;
        let frames = self.frames();
        let mut available = format!("an index or range from 0 to {}", frames - 1);
        if let Some(names) = &self.names {
            let listed: Vec<String> = names.iter().take(LISTED).map(|name| crate::error::shorten(name)).collect();
            let more = if names.len() > LISTED { ", ..." } else { "" };
            available = format!("one of {}{more}, or {available}", listed.join(", "));
        }
        DeviceError::Selection { file: self.source.clone(), item: crate::error::shorten(&item.to_string()), available }
    }
}

fn refuse_infinite(values: &[f64], channels: usize, file: &Path) -> Result<(), DeviceError> {
    match values.iter().position(|value| value.is_infinite()) {
        None => Ok(()),
        Some(at) => Err(DeviceError::Infinite {
            file: file.to_owned(),
            frame: at / channels,
            channel: at % channels,
            found: values[at],
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> FrameTable {
        let values = (0..8).map(f64::from).collect();
        let table = FrameTable::new(Layout::Channels { count: 2 }, values, "made.csv").unwrap();
        let table = table.with_names(["ref", "a", "a", "1"].map(String::from).to_vec()).unwrap();
        table.with_times_s(vec![0.0, 0.5, 1.0, 1.5]).unwrap()
    }

    #[test]
    fn rows_are_frames() {
        let table = table();
        assert_eq!((table.frames(), table.channels()), (4, 2));
        assert_eq!(table.row(3), Some([6.0, 7.0].as_slice()));
        assert_eq!(table.row(4), None);
        assert_eq!(table.rows().len(), 4);
    }

    #[test]
    fn frames_are_chosen_by_name_before_index() {
        let chosen = table().select(&"1,ref,2..".parse().unwrap()).unwrap();
        assert_eq!(chosen.values(), [6.0, 7.0, 0.0, 1.0, 4.0, 5.0, 6.0, 7.0]);
        assert_eq!(chosen.times_s(), Some([1.5, 0.0, 1.0, 1.5].as_slice()));
        assert_eq!(chosen.names().unwrap()[0], "1");
    }

    #[test]
    fn impossible_choices_are_refused_with_the_options() {
        for item in ["a", "target", "4", "4..", "2..2", "3..2", "0..5"] {
            let message = table().select(&item.parse().unwrap()).unwrap_err().to_string();
            assert!(message.contains("ref") && message.contains("from 0 to 3"), "{item}: {message}");
        }
    }

    #[test]
    fn infinite_readings_are_refused_with_their_place() {
        let values = vec![0.0, f64::NAN, 1.0, f64::NEG_INFINITY];
        let error = FrameTable::new(Layout::Channels { count: 2 }, values, "x.npy").unwrap_err();
        assert_eq!(error.to_string(), "x.npy: frame 1, channel 1: expected a finite value or NaN, found -inf");
    }

    #[test]
    fn counts_must_fit_the_layout() {
        let layout = Layout::SingleEnded { electrodes: 2, stimulations: vec![(0, 1), (1, 0)] };
        assert_eq!(layout.channels(), 4);
        let error = FrameTable::new(layout, vec![0.0; 7], "x").unwrap_err();
        assert!(matches!(error, DeviceError::Count { expected: 4, found: 3, .. }), "{error}");
        assert!(matches!(
            FrameTable::new(Layout::FullMatrix { electrodes: 2 }, vec![], "x"),
            Err(DeviceError::Empty { .. })
        ));
        assert!(table().with_imaginary(vec![0.0; 7]).is_err());
        assert!(table().with_sequences(vec![0; 3]).is_err());
    }
}
