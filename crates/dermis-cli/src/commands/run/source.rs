//! Where the frames of a run come from, by what the user wrote.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::Context;
use dermis::lab::twin_source::{TwinCommand, TwinSource};
use dermis::live::calibration::Calibration;
use dermis::live::forces::parse_forces;
use dermis::live::pipeline::Pipeline;
use dermis::live::prepare::Prepared;
use dermis::record::{Recording, RecordingHead, Replay};
use dermis::skin::Skin;
use dermis::twin::PressRange;
use dermis_device::stream::{StreamOptions, StreamSource};
use dermis_device::{Instrument, Pacing, Playback, Repeat, Source, SourceSelector, open_stream, open_wire};

use crate::exit::UsageError;

/// The arguments that say which frames, of which skin, read by which calibrations.
#[derive(clap::Args)]
pub struct InputArguments {
    /// Built-in skin or skin file.
    #[arg(default_value = "healing-square", value_name = "SKIN")]
    skin: String,
    /// Where frames come from: twin, a file (a recording .mcap, or anything that `reconstruct` reads), tcp:HOST:PORT,
    /// serial:PORT[@BAUD] or serial:VID:PID[:SERIAL]. After a port, #lines or #floats:CHANNELS for instruments that send
    /// just numbers.
    #[arg(long, default_value = "twin", value_name = "SOURCE")]
    source: String,
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
    /// Opens the source, its pipeline, and what a recording of it says at its beginning.
    pub fn open(&self) -> anyhow::Result<(Opened, Pipeline, RecordingHead)> {
        let opened = open(&self.source, &self.skin, self.speed, self.as_set)?;
        let (pipeline, head) = opened.pipeline(self.calibration.as_deref(), self.forces.as_deref())?;
        Ok((opened, pipeline, head))
    }
}

/// A source and what goes with it.
pub struct Opened {
    /// The skin that the frames are of.
    pub skin: Skin,
    /// The frames.
    pub source: Box<dyn Source>,
    /// To press on it, if it is a twin.
    pub twin: Option<TwinControl>,
    /// A file may be held up, and a twin without pace; an instrument may not.
    pub wait: bool,
}

impl Opened {
    /// The pipeline for these frames, and what a recording of it says at its beginning; both calibrations are files.
    pub fn pipeline(
        &self,
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
        let prepared = Prepared::new(self.skin.clone())?;
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

/// How a running twin is pressed.
pub struct TwinControl {
    /// Where commands go.
    pub commands: crossbeam_channel::Sender<TwinCommand>,
    /// What people may press with.
    pub press: PressRange,
    /// What the twin has to say.
    pub notices: crossbeam_channel::Receiver<String>,
}

/// Opens what `--source` names. An instrument on the wire is set to the skin file's protocol and current, unless it shall stay
/// `as_set`.
pub fn open(selector: &str, skin_name: &str, speed: f64, as_set: bool) -> anyhow::Result<Opened> {
    if !(speed >= 0.0 && speed.is_finite()) {
        return Err(
            UsageError(format!("--speed {speed}: expected 0 (as fast as possible) or a positive number")).into()
        );
    }
    if selector == "twin" {
        let skin = super::skin(skin_name)?;
        let (source, commands) = TwinSource::new(&skin)?;
        let twin = Some(TwinControl { commands, press: source.press_range(), notices: source.notices() });
        // Asked for as fast as possible, a twin waits for whoever takes its frames.
        let wait = speed == 0.0;
        let source = if wait { source.unpaced() } else { source };
        return Ok(Opened { skin, source: Box::new(source), twin, wait });
    }
    let pacing = |rate: Option<f64>| match (speed, rate) {
        (0.0, _) => Pacing::Immediate,
        (_, None) => Pacing::Recorded,
        (speed, Some(frames_per_s)) => Pacing::Rate { frames_per_s: speed * frames_per_s },
    };
    match selector.parse::<SourceSelector>().map_err(dermis::Error::from)? {
        SourceSelector::Twin { name } => open("twin", name.as_deref().unwrap_or(skin_name), speed, as_set),
        SourceSelector::File(spec) if spec.path.extension().is_some_and(|extension| extension == "mcap") => {
            let recording = Recording::open(&spec.path)?;
            let file = spec.path.display().to_string();
            let skin = Skin::parse_any_version(&recording.head().skin_toml, &file)?;
            let replay = Replay::new(recording, pacing(None), Repeat::Once).map_err(dermis::Error::from)?;
            Ok(Opened { skin, source: Box::new(replay), twin: None, wait: true })
        }
        SourceSelector::File(spec) => {
            let skin = super::skin(skin_name)?;
            let table = dermis_device::read(&spec, None).map_err(dermis::Error::from)?;
            let rate = match table.times_s() {
                Some(_) if speed == 1.0 => None,
                _ => Some(skin.backend.frames_per_s.unwrap_or(20.0)),
            };
            let playback = Playback::new(table, pacing(rate), Repeat::Once).map_err(dermis::Error::from)?;
            Ok(Opened { skin, source: Box::new(playback), twin: None, wait: true })
        }
        live => {
            let skin = super::skin(skin_name)?;
            let source = open_live(&live, &skin, as_set)?;
            tracing::info!("{live}: {}", source.identity().unwrap_or_default());
            Ok(Opened { skin, source: Box::new(source), twin: None, wait: false })
        }
    }
}

/// Opens an instrument. One on the wire is set to what the skin file says, as far as it can be, unless it shall stay `as_set`.
fn open_live(selector: &SourceSelector, skin: &Skin, as_set: bool) -> anyhow::Result<StreamSource> {
    let options = StreamOptions::default();
    let on_the_wire = matches!(
        selector,
        SourceSelector::Tcp { instrument: Instrument::Wire, .. }
            | SourceSelector::Serial { instrument: Instrument::Wire, .. }
    );
    let opened = if on_the_wire && !as_set {
        let setup = super::super::device::orders_of(skin)?;
        open_wire(selector, options, setup, true).map(|(source, _)| source)
    } else {
        open_stream(selector, options)
    };
    Ok(opened.map_err(dermis::Error::from)?)
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
