//! Opens the source of a run's frames from the text that the user wrote.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::Context;
use dermis::source::{OpenedSource, SourceOptions, TwinControl, open_source};
use dermis_body::is_body_file;
use dermis_device::{FileSpec, FrameTable, Source, SourceSelector};
use dermis_live::calibration::Calibration;
use dermis_live::forces::{parse_forces, parse_forces_as};
use dermis_live::pipeline::{Pipeline, TARE_FRAMES};
use dermis_live::prepare::Prepared;
use dermis_record::{Recording, RecordingHead, is_recording, read_frames, read_frames_of};
use dermis_skin::{DEFAULT_NAME, Skin};

use super::super::reading::ReadArguments;
use super::super::skin_word::{SkinWord, skin};
use super::super::{busy, hint};
use crate::exit::UsageError;

/// Options that select the frames, their skin and their calibrations.
#[derive(clap::Args)]
pub struct InputArguments {
    #[command(flatten)]
    skin: SkinWord,
    /// Source of the frames: twin, a file (a recording .mcap, or anything that `reconstruct` reads), tcp:HOST:PORT,
    /// serial:PORT[@BAUD] or serial:VID:PID[:SERIAL]. After a port, #lines or #floats:CHANNELS for instruments that
    /// send just numbers.
    #[arg(long, default_value = "twin", value_name = "SOURCE")]
    source: String,
    /// Frames of the untouched skin, for example from the source's own file. Without them the first 32 frames are
    /// used.
    #[arg(long, value_name = "FILE[#FRAMES]")]
    baseline: Option<FileSpec>,
    #[command(flatten)]
    read: ReadArguments,
    /// Keep the settings of an instrument on the wire; without this it gets the skin file's protocol and current.
    #[arg(long)]
    as_set: bool,
    /// Accept a recording and calibrations of another skin as SKIN's.
    #[arg(long)]
    as_skin: bool,
    /// Speed of a file or twin: 1 in real time, 0 as fast as possible.
    #[arg(long, default_value_t = 1.0, allow_negative_numbers = true)]
    speed: f64,
    /// A calibration made by `dermis calibrate`.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// A force calibration made by `dermis calibrate --forces`.
    #[arg(long, value_name = "FILE")]
    forces: Option<PathBuf>,
}

impl InputArguments {
    /// The body file given in place of a skin, if any.
    ///
    /// # Errors
    /// Two skins are given.
    pub fn body_file(&self) -> Result<Option<PathBuf>, UsageError> {
        let given = self.skin.given()?.map(PathBuf::from);
        Ok(given.filter(|path| is_body_file(path)))
    }

    /// Options for opening the sources of a body's patches. Settings that the body file makes for each patch are not
    /// options.
    ///
    /// # Errors
    /// An option for a single skin is given, or the speed is invalid.
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
        Ok(self.options())
    }

    fn options(&self) -> SourceOptions {
        let (speed, as_set, as_skin) = (self.speed, self.as_set, self.as_skin);
        SourceOptions { speed, as_set, as_skin, read: self.read.options() }
    }

    /// Opens the source and its pipeline, and makes the head of a recording.
    pub fn open(&self) -> anyhow::Result<(Opened, Pipeline, RecordingHead)> {
        let given = self.skin.given()?;
        let skin = given.clone().unwrap_or_else(|| DEFAULT_NAME.to_owned());
        // Report faults in a file before the work of preparing a skin.
        let baseline = self.baseline.as_ref().map(|spec| self.read_baseline(spec, &skin)).transpose()?;
        let busy = busy(format!("preparing {skin}"));
        let options = self.options();
        if self.as_skin && given.is_none() {
            return Err(UsageError("--as-skin: expected SKIN as the first word, to read the frames as".into()).into());
        }
        let mut opened = open(&self.source, given.as_deref(), &options)?;
        let (mut pipeline, head) = opened.pipeline(self.calibration.as_deref(), self.forces.as_deref())?;
        match &baseline {
            Some(table) => pipeline.set_baseline(table)?,
            None if opened.is_file => hint(&format!(
                "the first {TARE_FRAMES} frames of {} are assumed to show the untouched skin; --baseline FILE[#FRAMES] selects others",
                opened.source.name()
            )),
            None => {}
        }
        busy.finish();
        Ok((opened, pipeline, head))
    }
}

impl InputArguments {
    /// Reads the baseline, using the named skin unless the source is a recording, which brings its own.
    fn read_baseline(&self, spec: &FileSpec, name: &str) -> anyhow::Result<FrameTable> {
        let is_recorded = self.source.parse().is_ok_and(|selector| match selector {
            SourceSelector::File(spec) => is_recording(&spec.path),
            _ => false,
        });
        let options = self.read.options();
        match skin(name) {
            Ok(skin) if !is_recorded => Ok(read_frames_of(&skin, spec, options)?),
            _ => Ok(read_frames(spec, options)?),
        }
    }
}

/// An opened source with the skin of its frames and related settings.
pub struct Opened {
    /// The skin that the frames are of.
    pub skin: Skin,
    /// The frames.
    pub source: Box<dyn Source>,
    /// Control over the twin, if the source is one.
    pub twin: Option<TwinControl>,
    /// True if the source can wait, as files and unpaced twins can; an instrument cannot.
    pub wait: bool,
    /// True if the source is a table of frames or a recording, which ends.
    pub is_file: bool,
    /// Accept calibrations of another skin.
    as_skin: bool,
    /// The skin prepared in parallel with its twin, until the pipeline takes it.
    prepared: Option<Prepared>,
}

impl Opened {
    /// A custom source, which may be made to wait.
    pub fn of(skin: Skin, source: Box<dyn Source>) -> Self {
        Self { skin, source, twin: None, wait: true, is_file: false, as_skin: false, prepared: None }
    }

    /// The pipeline for these frames, and the head of a recording of it. Both calibrations are files.
    pub fn pipeline(
        &mut self,
        calibration: Option<&Path>,
        forces: Option<&Path>,
    ) -> anyhow::Result<(Pipeline, RecordingHead)> {
        let read = |path: &Path| dermis_device::instruments::read_bytes(path).map_err(dermis_lab::Error::from);
        let calibration_text = calibration.map(read).transpose()?;
        let forces_text = forces.map(read).transpose()?;
        let parsed = match (calibration, &calibration_text) {
            (Some(path), Some(text)) => Some(Calibration::parse(text, path)?),
            _ => None,
        };
        let parsed = if self.as_skin { parsed.map(Calibration::insist) } else { parsed };
        let prepared = match self.prepared.take() {
            Some(prepared) => prepared,
            None => Prepared::new(self.skin.clone())?,
        };
        let layout = self.source.layout().clone();
        let mut head = RecordingHead::of(&prepared, layout.clone(), self.source.name());
        let mut pipeline = Pipeline::new(prepared, &layout, parsed)?;
        if let (Some(path), Some(text)) = (forces, &forces_text) {
            let parse = if self.as_skin { parse_forces_as } else { parse_forces };
            pipeline.set_forces(parse(text, path, &self.skin)?)?;
        }
        // JSON that has been parsed is valid text.
        let as_text = |bytes: Option<Vec<u8>>| bytes.map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
        (head.calibration, head.forces) = (as_text(calibration_text), as_text(forces_text));
        Ok((pipeline, head))
    }
}

/// Opens the source that `--source` names.
///
/// # Errors
/// As for [`open_of`].
pub fn open(selector: &str, given: Option<&str>, options: &SourceOptions) -> anyhow::Result<Opened> {
    let named = given.map(skin).transpose()?;
    let find = |name: Option<&str>| match (name, &named) {
        (None, Some(skin)) => Ok(skin.clone()),
        (name, _) => skin(name.unwrap_or(DEFAULT_NAME)),
    };
    open_of(selector, &find, named.as_ref(), options)
}

/// Like [`open`], with `find` to look up the skin named in the selector (`None` if it names none).
///
/// A recording is read as the skin that the user has `named`, which may differ from the recorded one only where
/// frames don't depend on it; if the user named none, it is read as the recorded skin. A twin is made of the skin in
/// the selector.
///
/// # Errors
/// The selector is invalid, a skin or source cannot be opened, or the recording is of another skin than the named
/// one.
pub fn open_of(
    selector: &str,
    find: &dyn Fn(Option<&str>) -> anyhow::Result<Skin>,
    named: Option<&Skin>,
    options: &SourceOptions,
) -> anyhow::Result<Opened> {
    check_speed(options.speed)?;
    let selector = selector.parse::<SourceSelector>().map_err(dermis_lab::Error::from)?;
    let skin = match &selector {
        SourceSelector::Twin { name } => find(name.as_deref())?,
        SourceSelector::File(spec) if named.is_none() && is_recording(&spec.path) => {
            let recording = Recording::open(&spec.path)?;
            Skin::parse(&recording.head().skin_toml, &spec.path.display().to_string())?
        }
        _ => find(None)?,
    };
    // The selected twin is a twin of this skin.
    let is_twin = matches!(selector, SourceSelector::Twin { .. });
    let selector = if is_twin { SourceSelector::Twin { name: None } } else { selector };
    let source = || open_source(&selector, &skin, options);
    // A twin takes as long to make as its skin, so make both at once. With an instrument, report its faults before
    // preparing the skin.
    let (opened, prepared) = match is_twin {
        true => rayon::join(source, || Prepared::new(skin.clone()).map(Some)),
        false => (source(), Ok(None)),
    };
    let OpenedSource { source, twin, waits: wait, is_file } = opened?;
    Ok(Opened { source, twin, wait, is_file, as_skin: options.as_skin, prepared: prepared?, skin })
}

fn check_speed(speed: f64) -> Result<(), UsageError> {
    if speed >= 0.0 && speed.is_finite() {
        return Ok(());
    }
    Err(UsageError(format!("--speed {speed}: expected 0 (as fast as possible) or a positive number")))
}

/// Asks the desktop to open the page; without a desktop, does nothing.
pub fn open_browser(url: &str) {
    let opener = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    if Path::new("/usr/bin").join(opener).exists() {
        let child = Command::new(opener).arg(url).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
        if let Err(error) = child.context("starting a browser") {
            tracing::info!("{error:#}");
        }
    }
}
