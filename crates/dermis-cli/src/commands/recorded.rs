//! What commands that work on frames from files are told alike: the skin, the frames and their format.

use dermis::skin::Skin;
use dermis_device::FileSpec;

use super::reading::ReadArguments;
use super::skin_word::SkinWord;
use crate::exit::UsageError;

/// Frames in a file, and the skin that they are of.
#[derive(clap::Args)]
pub(super) struct RecordedFrames {
    #[command(flatten)]
    pub skin: SkinWord,
    /// Frames to work on; #0..60 or #name after the file's name takes some of them.
    #[arg(long, value_name = "FILE[#FRAMES]")]
    pub frames: FileSpec,
    #[command(flatten)]
    pub read: ReadArguments,
    /// Read the frames of a recording as SKIN's though they are of another skin.
    #[arg(long)]
    pub as_skin: bool,
}

/// Whether frames are differences already: a baseline is given, or said not to be needed.
///
/// # Errors
/// Neither, or both.
pub(super) fn baseline_or_differences(
    baseline: Option<&FileSpec>,
    flag: bool,
    skin: &Skin,
) -> Result<bool, UsageError> {
    match (baseline, flag || skin.backend.differences) {
        (Some(_), false) => Ok(false),
        (None, true) => Ok(true),
        (None, false) => {
            let text = "--baseline is needed: frames of the untouched skin, or --differences where the frames are \
                        differences from it already";
            Err(UsageError(text.into()))
        }
        (Some(_), true) => {
            let text = format!(
                "--baseline: expected none, frames of skin {} are differences (backend.differences = true)",
                skin.name
            );
            Err(UsageError(text))
        }
    }
}
