//! Facts about the frames of a file: size, times, range of the readings, and channels that look broken.

use std::io::{self, Write};

use dermis_device::FrameTable;
use serde::Serialize;

/// Channels listed by number; more are counted.
const MOST_LISTED: usize = 12;

/// Content of a file of frames. Readings are in the file's unit, scaled by units in its header.
#[derive(Debug, PartialEq, Serialize)]
pub(super) struct Summary {
    file: String,
    /// How the file was understood.
    understood: String,
    frames: usize,
    channels: usize,
    is_complex: bool,
    /// Time from the first frame to the last; absent without times.
    duration_s: Option<f64>,
    /// Median rate; absent without times.
    frames_per_s: Option<f64>,
    /// Missing readings.
    missing: usize,
    /// Smallest and largest reading (real parts); absent if all are missing.
    range: Option<[f64; 2]>,
    /// Median magnitude of the readings (real parts).
    median_magnitude: Option<f64>,
    /// Channels, from 1, that are missing in every frame.
    empty_channels: Vec<usize>,
    /// Channels, from 1, with the same reading in all of several frames.
    constant_channels: Vec<usize>,
    /// Frames, from 0, that repeat the frame before them exactly.
    repeated_frames: usize,
}

impl Summary {
    pub(super) fn of(table: &FrameTable) -> Self {
        let magnitudes: Vec<f64> =
            table.values().iter().map(|value| value.abs()).filter(|value| value.is_finite()).collect();
        let present = || table.values().iter().copied().filter(|value| value.is_finite());
        let range = (!magnitudes.is_empty())
            .then(|| [present().fold(f64::INFINITY, f64::min), present().fold(f64::NEG_INFINITY, f64::max)]);
        let column = |channel: usize| table.rows().map(move |row| row[channel]);
        let is_empty = |channel: &usize| column(*channel).all(f64::is_nan);
        let is_constant = |channel: &usize| {
            let first = table.values()[*channel];
            table.frames() > 1 && column(*channel).all(|value| value == first)
        };
        let rows: Vec<&[f64]> = table.rows().collect();
        let repeats = |pair: &&[&[f64]]| pair[0].iter().zip(pair[1]).all(|(a, b)| a.to_bits() == b.to_bits());
        let numbers =
            |is: &dyn Fn(&usize) -> bool| (0..table.channels()).filter(is).map(|channel| channel + 1).collect();
        Self {
            file: table.source().display().to_string(),
            understood: table.understood(),
            frames: table.frames(),
            channels: table.channels(),
            is_complex: table.imaginary().is_some(),
            duration_s: table.times_s().and_then(|times_s| Some(times_s.last()? - times_s.first()?)),
            frames_per_s: table.times_s().and_then(rate),
            missing: table.values().len() - magnitudes.len(),
            range,
            median_magnitude: median(&magnitudes),
            empty_channels: numbers(&is_empty),
            constant_channels: numbers(&is_constant),
            repeated_frames: rows.windows(2).filter(repeats).count(),
        }
    }

    pub(super) fn print(&self, as_json: bool, out: &mut dyn Write) -> io::Result<()> {
        if as_json {
            serde_json::to_writer_pretty(&mut *out, self)?;
            return writeln!(out);
        }
        writeln!(out, "file: {}", self.file)?;
        writeln!(out, "frames: {}", self.frames)?;
        writeln!(out, "channels: {}{}", self.channels, if self.is_complex { ", complex" } else { "" })?;
        if let Some(seconds) = self.duration_s {
            let rate = self.frames_per_s.map_or_else(String::new, |rate| format!(", {rate:.1} frames/s"));
            writeln!(out, "duration: {seconds:.3} s{rate}")?;
        }
        match (self.range, self.median_magnitude) {
            (Some([least, most]), Some(median)) => {
                writeln!(out, "readings: {least:.6e} to {most:.6e}, median magnitude {median:.3e}")?;
            }
            _ => writeln!(out, "readings: none")?,
        }
        writeln!(out, "missing readings: {}", self.missing)?;
        let channels = [("empty", &self.empty_channels), ("constant", &self.constant_channels)];
        for (name, channels) in channels.iter().filter(|(_, channels)| !channels.is_empty()) {
            writeln!(out, "{name} channels: {}", listed(channels))?;
        }
        if self.repeated_frames > 0 {
            writeln!(out, "frames identical to the previous one: {}", self.repeated_frames)?;
        }
        Ok(())
    }
}

fn listed(channels: &[usize]) -> String {
    let shown: Vec<String> = channels.iter().take(MOST_LISTED).map(usize::to_string).collect();
    let more = channels.len().saturating_sub(MOST_LISTED);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{}{more}", shown.join(", "))
}

fn rate(times_s: &[f64]) -> Option<f64> {
    let steps: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).collect();
    median(&steps).map(f64::recip)
}

fn median(values: &[f64]) -> Option<f64> {
    Some(dermis_touch::median(values)).filter(|median| median.is_finite())
}

#[cfg(test)]
mod tests {
    use dermis_device::{Format, Layout, ReadOptions, decode_with};

    use super::*;

    #[test]
    fn broken_channels_and_repeats_are_listed() {
        let text = b"t,a,b,c\n0,1,,5\n0.1,1,,6\n0.2,1,,6\n0.3,1,,-7\n";
        let table = decode_with(Format::Csv, text, "a.csv".as_ref(), &ReadOptions::default()).unwrap();
        let summary = Summary::of(&table);
        assert_eq!((summary.frames, summary.channels, summary.missing), (4, 3, 4));
        assert_eq!((&summary.empty_channels[..], &summary.constant_channels[..]), (&[2][..], &[1][..]));
        assert_eq!((summary.repeated_frames, summary.range), (1, Some([-7.0, 6.0])));
        assert!((summary.frames_per_s.unwrap() - 10.0).abs() < 1e-9);
        let mut text = Vec::new();
        summary.print(false, &mut text).unwrap();
        assert!(String::from_utf8(text).unwrap().contains("empty channels: 2\nconstant channels: 1\n"));
    }

    #[test]
    fn a_file_of_missing_readings_has_no_range() {
        let table = FrameTable::new(Layout::Channels { count: 2 }, vec![f64::NAN; 4], "a").unwrap();
        assert_eq!(Summary::of(&table).range, None);
    }
}
