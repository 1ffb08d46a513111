//! What commands that work on frames from files are told alike: the skin, the frames and their format.

use dermis_device::{FileSpec, Format};

/// Frames in a file, and the skin that they are of.
#[derive(clap::Args)]
pub(super) struct RecordedFrames {
    /// Built-in skin or skin file.
    #[arg(long, value_name = "NAME|FILE")]
    pub skin: String,
    /// Frames to work on; #0..60 or #name after the file's name takes some of them.
    #[arg(long, value_name = "FILE[#FRAMES]")]
    pub frames: FileSpec,
    /// Format of all files of frames (csv, columns, npy, sciospec, ktc, golfball, pyeidors); recognised where left out.
    #[arg(long)]
    pub format: Option<Format>,
}
