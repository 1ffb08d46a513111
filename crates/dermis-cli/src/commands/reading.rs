//! Options for reading files of frames where guessing isn't enough, shared by all commands.

use dermis_device::{Format, FrameSelect, Frequencies, ReadOptions};

/// Options for reading files of frames, with their format.
#[derive(clap::Args)]
pub(super) struct ReadArguments {
    /// Format of files of frames (csv, lines, columns, npy, npz, mat, xlsx, parquet, sciospec, ktc, golfball,
    /// pyeidors); default: recognised from the file.
    #[arg(long)]
    format: Option<Format>,
    #[command(flatten)]
    table: TableArguments,
}

/// Options for reading files of frames whose format is recognised.
#[derive(clap::Args)]
pub(super) struct TableArguments {
    /// Columns of tables that hold readings: names, indices from 0, ranges such as 1..209; other columns are times or
    /// ignored.
    #[arg(long, value_name = "COLUMNS")]
    columns: Option<FrameSelect>,
    /// Lines to skip at the start of text files.
    #[arg(long, value_name = "N", default_value_t = 0)]
    skip_rows: usize,
    /// Array (npz, MATLAB), sheet (Excel) or column of lists (Parquet) that holds the frames.
    #[arg(long, value_name = "NAME")]
    array: Option<String>,
    /// Topic with the frames in a ROS bag or in another program's MCAP file.
    #[arg(long, value_name = "TOPIC", conflicts_with = "array")]
    topic: Option<String>,
    /// Frames are stored as columns.
    #[arg(long)]
    transpose: bool,
    /// Frequency in a sweep; A,B gives the readings at A minus those at B.
    #[arg(long, value_name = "HZ[,HZ]", value_parser = frequencies)]
    frequency_hz: Option<Frequencies>,
}

fn frequencies(text: &str) -> Result<Frequencies, String> {
    let one = |text: &str| text.trim().parse::<f64>().ok().filter(|hz| *hz > 0.0 && hz.is_finite());
    match text.split_once(',') {
        None => one(text).map(Frequencies::One),
        Some((a, b)) => one(a).zip(one(b)).map(|(a, b)| Frequencies::Difference(a, b)),
    }
    .ok_or_else(|| "expected a frequency in hertz, or two separated by a comma".to_owned())
}

impl ReadArguments {
    /// The options as a struct.
    pub(super) fn options(&self) -> ReadOptions {
        ReadOptions { format: self.format, ..self.table.options() }
    }
}

impl TableArguments {
    /// The options as a struct.
    pub(super) fn options(&self) -> ReadOptions {
        ReadOptions {
            format: None,
            columns: self.columns.clone().unwrap_or_default(),
            skip_rows: self.skip_rows,
            array: self.array.clone().or_else(|| self.topic.clone()),
            transpose: self.transpose,
            channels: Vec::new(),
            frequencies_hz: self.frequency_hz.unwrap_or_default(),
        }
    }
}
