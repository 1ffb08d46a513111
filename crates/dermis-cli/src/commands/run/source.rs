//! Where the frames of a run come from, by what the user wrote.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::Context;
use dermis::body::is_body_file;
use dermis::live::calibration::Calibration;
use dermis::live::forces::parse_forces;
use dermis::live::pipeline::{Pipeline, TARE_FRAMES};
use dermis::live::prepare::Prepared;
use dermis::record::{Recording, RecordingHead, is_recording, read_frames};
use dermis::skin::{DEFAULT_NAME, Skin};
use dermis::source::{OpenedSource, SourceOptions, TwinControl, open_source};
use dermis_device::{FileSpec, Format, Source, SourceSelector};

use super::super::skin_word::{SkinWord, skin};
use super::super::{busy, hint};
use crate::exit::UsageError;

/// The arguments that say which frames, of which skin, read by which calibrations.
#[derive(clap::Args)]
pub struct InputArguments {
    #[command(flatten)]
    skin: SkinWord,
    /// Where frames come from: twin, a file (a recording .mcap, or anything that `reconstruct` reads), tcp:HOST:PORT,
    /// serial:PORT[@BAUD] or serial:VID:PID[:SERIAL]. After a port, #lines or #floats:CHANNELS for instruments that
    /// send just numbers.
    #[arg(long, default_value = "twin", value_name = "SOURCE")]
    source: String,
    /// Frames of the untouched skin, of the source's own file for instance. Without them the first 32 frames are taken
    /// for it.
    #[arg(long, value_name = "FILE[#FRAMES]")]
    baseline: Option<FileSpec>,
    /// Format of files of frames (csv, columns, npy, sciospec, ktc, golfball, pyeidors); recognised where left out.
    #[arg(long)]
    format: Option<Format>,
    /// Leave an instrument on the wire as it is set; without it, it is told the skin file's protocol and current.
    #[arg(long)]
    as_set: bool,
    /// Pace of a file: 1 as recorded, 0 as fast as possible, also of the twin.
    #[arg(long, default_value_t = 1.0)]
    speed: f64,
    /// A calibration made by `dermis calibrate`.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// A force calibration made by `dermis calibrate --forces`.
    #[arg(long, value_name = "FILE")]
    forces: Option<PathBuf>,
}

impl InputArguments {
    /// The body file that stands in place of a skin, if one does.
    ///
    /// # Errors
    /// Two skins.
    pub fn body_file(&self) -> Result<Option<PathBuf>, UsageError> {
        let given = self.skin.given()?.map(PathBuf::from);
        Ok(given.filter(|path| is_body_file(path)))
    }

    /// How the sources of a body's patches are opened; what the body file says of each patch is no option here.
    ///
    /// # Errors
    /// Options of a single skin, and a pace that is none.
    pub fn source_options(&self) -> Result<SourceOptions, UsageError> {
        let given = [
            ("--source", "source", self.source != "twin"),
            ("--baseline", "baseline", self.baseline.is_some()),
            ("--calibration", "calibration", self.calibration.is_some()),
            ("--forces", "forces", self.forces.is_some()),
        ];
        if let Some((option, key, _)) = given.into_iter().find(|(_, _, is_given)| *is_given) {
            return Err(UsageError(format!("{option}: expected {key} = \"...\" in a [[patch]] of the body file")));
        }
        check_speed(self.speed)?;
        Ok(SourceOptions { speed: self.speed, as_set: self.as_set, format: self.format })
    }

    /// Opens the source, its pipeline, and what a recording of it says at its beginning.
    pub fn open(&self) -> anyhow::Result<(Opened, Pipeline, RecordingHead)> {
        let skin = self.skin.or(DEFAULT_NAME)?;
        // What is wrong with a file is said before the work of preparing a skin.
        let baseline = self.baseline.as_ref().map(|spec| read_frames(spec, self.format)).transpose()?;
        let busy = busy(format!("preparing {skin}"));
        let options = SourceOptions { speed: self.speed, as_set: self.as_set, format: self.format };
        let mut opened = open(&self.source, &skin, &options)?;
        let (mut pipeline, head) = opened.pipeline(self.calibration.as_deref(), self.forces.as_deref())?;
        match &baseline {
            Some(table) => pipeline.set_baseline(table)?,
            None if opened.is_file => hint(&format!(
                "the first {TARE_FRAMES} frames of {} are taken for the untouched skin; --baseline FILE[#FRAMES] names others",
                opened.source.name()
            )),
            None => {}
        }
        busy.finish();
        Ok((opened, pipeline, head))
    }
}

/// A source, the skin that its frames are of, and what goes with it.
pub struct Opened {
    /// The skin that the frames are of.
    pub skin: Skin,
    /// The frames.
    pub source: Box<dyn Source>,
    /// To press on it, if it is a twin.
    pub twin: Option<TwinControl>,
    /// A file may be held up, and a twin without pace; an instrument may not.
    pub wait: bool,
    /// It is a table of frames, or a recording, and ends.
    pub is_file: bool,
    /// The skin, where it was prepared beside its twin, until the pipeline takes it.
    prepared: Option<Prepared>,
}

impl Opened {
    /// The pipeline for these frames, and what a recording of it says at its beginning; both calibrations are files.
    pub fn pipeline(
        &mut self,
        calibration: Option<&Path>,
        forces: Option<&Path>,
    ) -> anyhow::Result<(Pipeline, RecordingHead)> {
        let read = |path: &Path| dermis_device::instruments::read_bytes(path).map_err(dermis::Error::from);
        let calibration_text = calibration.map(read).transpose()?;
        let forces_text = forces.map(read).transpose()?;
        let parsed = match (calibration, &calibration_text) {
            (Some(path), Some(text)) => Some(Calibration::parse(text, path)?),
            _ => None,
        };
        let prepared = match self.prepared.take() {
            Some(prepared) => prepared,
            None => Prepared::new(self.skin.clone())?,
        };
        let layout = self.source.layout().clone();
        let mut head = RecordingHead::of(&prepared, layout.clone(), self.source.name());
        let mut pipeline = Pipeline::new(prepared, &layout, parsed)?;
        if let (Some(path), Some(text)) = (forces, &forces_text) {
            pipeline.set_forces(parse_forces(text, path, &self.skin.name)?)?;
        }
        // What was parsed as JSON is text.
        let as_text = |bytes: Option<Vec<u8>>| bytes.map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
        (head.calibration, head.forces) = (as_text(calibration_text), as_text(forces_text));
        Ok((pipeline, head))
    }
}

/// Opens what `--source` names.
///
/// # Errors
/// As [`open_of`].
pub fn open(selector: &str, skin_name: &str, options: &SourceOptions) -> anyhow::Result<Opened> {
    open_of(selector, &|name| skin(name.unwrap_or(skin_name)), options)
}

/// As [`open`], of the skin that `find` makes of the name in the selector, or of none where it has no name. A recording
/// is of the skin that is in it, and a twin of the one in its name.
///
/// # Errors
/// A selector that names nothing, a skin or source that cannot be opened.
pub fn open_of(
    selector: &str,
    find: &dyn Fn(Option<&str>) -> anyhow::Result<Skin>,
    options: &SourceOptions,
) -> anyhow::Result<Opened> {
    check_speed(options.speed)?;
    let selector = selector.parse::<SourceSelector>().map_err(dermis::Error::from)?;
    let skin = match &selector {
        SourceSelector::Twin { name } => find(name.as_deref())?,
        SourceSelector::File(spec) if is_recording(&spec.path) => {
            let recording = Recording::open(&spec.path)?;
            Skin::parse_any_version(&recording.head().skin_toml, &spec.path.display().to_string())?
        }
        _ => find(None)?,
    };
    // The twin that was named is the skin's own.
    let is_twin = matches!(selector, SourceSelector::Twin { .. });
    let selector = if is_twin { SourceSelector::Twin { name: None } } else { selector };
    let source = || open_source(&selector, &skin, options);
    // A twin takes as long to make as its skin; what is wrong with an instrument is said before either is begun.
    let (opened, prepared) = match is_twin {
        true => rayon::join(source, || Prepared::new(skin.clone()).map(Some)),
        false => (source(), Ok(None)),
    };
    let OpenedSource { source, twin, waits: wait, is_file } = opened?;
    Ok(Opened { source, twin, wait, is_file, prepared: prepared?, skin })
}

fn check_speed(speed: f64) -> Result<(), UsageError> {
    if speed >= 0.0 && speed.is_finite() {
        return Ok(());
    }
    Err(UsageError(format!("--speed {speed}: expected 0 (as fast as possible) or a positive number")))
}

/// Asks the desktop to show the page; without a desktop nothing happens.
pub fn open_browser(url: &str) {
    let opener = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    if Path::new("/usr/bin").join(opener).exists() {
        let child = Command::new(opener).arg(url).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
        if let Err(error) = child.context("starting a browser") {
            tracing::info!("{error:#}");
        }
    }
}
