//! Options shared by commands that work on frames from files: the skin, the frames and their format.

use dermis_device::FileSpec;
use dermis_skin::Skin;

use super::reading::ReadArguments;
use super::skin_word::SkinWord;
use crate::exit::UsageError;

/// Frames in a file, and the skin they belong to.
#[derive(clap::Args)]
pub(super) struct RecordedFrames {
    #[command(flatten)]
    pub skin: SkinWord,
    /// Frames to work on; #0..60 or #name after the file's name selects some of them.
    #[arg(long, value_name = "FILE[#FRAMES]")]
    pub frames: FileSpec,
    #[command(flatten)]
    pub read: ReadArguments,
    /// Accept a recording of another skin as frames of SKIN.
    #[arg(long)]
    pub as_skin: bool,
}

/// True if frames are already differences. Either a baseline must be given, or an option that says it isn't needed.
///
/// # Errors
/// Neither or both are given.
pub(super) fn baseline_or_differences(
    baseline: Option<&FileSpec>,
    flag: bool,
    skin: &Skin,
) -> Result<bool, UsageError> {
    match (baseline, flag || skin.backend.differences) {
        (Some(_), false) => Ok(false),
        (None, true) => Ok(true),
        (None, false) => {
            let text = "--baseline is needed: frames of the untouched skin, or --differences if the frames are already \
                        differences from it";
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
