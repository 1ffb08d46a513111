//! The files that a patch names in the body file: frames of the untouched skin, calibration, forces.

use std::path::{Path, PathBuf};

use dermis_body::{Body, Patch};
use dermis_device::{FileSpec, FrameTable, ReadOptions, SourceSelector};
use dermis_live::calibration::Calibration;
use dermis_live::forces::parse_forces;
use dermis_record::read_frames_of;
use dermis_touch::force::ForceCalibration;

use crate::error::Error;

/// The contents of those files, and the source of the patch.
pub(super) struct PatchFiles {
    pub selector: SourceSelector,
    /// Frames of the untouched skin.
    pub baseline: Option<FrameTable>,
    /// The calibration of touches, with its text.
    pub calibration: Option<(Calibration, String)>,
    /// The calibration of forces, with its text.
    pub forces: Option<(ForceCalibration, String)>,
}

impl PatchFiles {
    /// Reads the files of a patch.
    ///
    /// # Errors
    /// A selector that cannot be parsed, or a file that is missing, malformed, or made for another skin.
    pub fn read(body: &Body, patch: &Patch, options: &ReadOptions) -> Result<Self, Error> {
        let folder = body.file.parent().unwrap_or(Path::new(""));
        let beside = |spec: FileSpec| FileSpec { path: folder.join(&spec.path), ..spec };
        let selector = match patch.source.parse::<SourceSelector>()? {
            SourceSelector::File(spec) => SourceSelector::File(beside(spec)),
            other => other,
        };
        let baseline = match &patch.baseline {
            Some(text) => Some(read_frames_of(&patch.skin, &beside(text.parse()?), options.clone())?),
            None => None,
        };
        let read = |path: &PathBuf| dermis_device::instruments::read_bytes(path);
        // JSON that has been parsed is valid text.
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        let forces = match &patch.forces {
            Some(path) => {
                let bytes = read(path)?;
                Some((parse_forces(&bytes, path, &patch.skin)?, text(&bytes)))
            }
            None => None,
        };
        let calibration = match &patch.calibration {
            Some(path) => {
                let bytes = read(path)?;
                Some((Calibration::parse(&bytes, path)?, text(&bytes)))
            }
            None => None,
        };
        Ok(Self { selector, baseline, calibration, forces })
    }
}

/// Reads the files that a patch of a body names, without opening its source.
///
/// No example here: `dermis body check` prints these errors.
///
/// # Errors
/// A source or baseline that cannot be parsed, or a file that is missing, malformed, or made for another skin.
pub fn check_patch_files(body: &Body, patch: &Patch) -> Result<(), Error> {
    let files = PatchFiles::read(body, patch, &ReadOptions::default())?;
    match &files.selector {
        // A patch of a recording is named like a file in it.
        SourceSelector::File(FileSpec { path, .. }) if !path.exists() && !path.parent().is_some_and(Path::is_file) => {
            let source = std::io::ErrorKind::NotFound.into();
            Err(Error::Io(dermis_skin::FileError { file: path.clone(), source }))
        }
        _ => Ok(()),
    }
}
