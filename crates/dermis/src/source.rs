//! Opens sources of frames for a skin: its twin, a file, a recording, an instrument.

use crossbeam_channel::Receiver;
use dermis_device::stream::{StreamOptions, StreamSource};
use dermis_device::{
    FileSpec, FrameSelect, Instrument, Pacing, Playback, ReadOptions, Repeat, Source, SourceSelector, open_sciospec,
    open_stream_greeted, open_wire,
};
use dermis_lab::Error;
use dermis_lab::measured_list::{sciospec_setup_of, setup_of};
use dermis_lab::twin_source::{TwinCommands, TwinSource};
use dermis_record::{Recording, Replay, check_skin, is_recording, read_frames_of};
use dermis_skin::Skin;
use dermis_twin::PressRange;

/// Frame rate of files without times if the skin file gives none either, frames per second.
const FRAMES_PER_S: f64 = 20.0;

/// Options for opening a source.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceOptions {
    /// Speed of files and of the twin: 1 in real time, 2 twice as fast, 0 as fast as frames are taken.
    pub speed: f64,
    /// Leave an instrument on the wire as it is set, instead of setting it to the skin's protocol, current and
    /// frequency.
    pub as_set: bool,
    /// Accept a recording of another skin as one of this skin.
    pub as_skin: bool,
    /// How to read a file of frames.
    pub read: ReadOptions,
}

impl Default for SourceOptions {
    /// As fast as frames are taken, with instruments set to the skin.
    fn default() -> Self {
        Self { speed: 0.0, as_set: false, as_skin: false, read: ReadOptions::default() }
    }
}

/// An opened source and related settings.
pub struct OpenedSource {
    /// The frames.
    pub source: Box<dyn Source>,
    /// Control over the twin, if the source is one.
    pub twin: Option<TwinControl>,
    /// True for files, which end and can be made to wait; false for instruments.
    pub is_file: bool,
    /// True if frames wait until they are taken: files, and a twin without pacing.
    pub waits: bool,
}

/// Control over a running twin.
#[derive(Debug, Clone)]
pub struct TwinControl {
    /// Sender of commands.
    pub commands: TwinCommands,
    /// Range of pressures and radii for presses.
    pub press: PressRange,
    /// Notices from the twin.
    pub notices: Receiver<String>,
}

/// Opens a source of frames for a skin.
///
/// `twin` is the skin's own twin, and `twin:NAME` another skin's, which must have the same number of channels. A file
/// is a recording or anything else that [`dermis_record::read_frames`] reads.
///
/// # Errors
/// The speed is negative or not finite, a file cannot be read, a recording is of another skin, an instrument does not
/// answer, or a twin cannot be built.
pub fn open_source(selector: &SourceSelector, skin: &Skin, options: &SourceOptions) -> Result<OpenedSource, Error> {
    if !(options.speed >= 0.0 && options.speed.is_finite()) {
        let expected = "0 (as fast as possible) or a positive number".into();
        return Err(Error::Frames { what: "speed".into(), expected, got: options.speed.to_string() });
    }
    match selector {
        SourceSelector::Twin { name: Some(name) } if *name != skin.name => {
            let other = Skin::open(name)?;
            twin(&other, options)
        }
        SourceSelector::Twin { .. } => twin(skin, options),
        SourceSelector::File(spec) => file(spec, skin, options),
        live => {
            let source = instrument(live, skin, options)?;
            tracing::info!("{live}: {}", source.identity().unwrap_or_default());
            Ok(OpenedSource { source: Box::new(source), twin: None, is_file: false, waits: false })
        }
    }
}

fn twin(skin: &Skin, options: &SourceOptions) -> Result<OpenedSource, Error> {
    let (source, commands) = TwinSource::new(skin)?;
    let control = TwinControl { commands, press: source.press_range(), notices: source.notices() };
    // As fast as possible means that the twin waits for its frames to be taken.
    let waits = options.speed == 0.0;
    let source = if waits { source.unpaced() } else { source };
    Ok(OpenedSource { source: Box::new(source), twin: Some(control), is_file: false, waits })
}

fn file(spec: &FileSpec, skin: &Skin, options: &SourceOptions) -> Result<OpenedSource, Error> {
    let pacing = |rate: Option<f64>| match (options.speed, rate) {
        (0.0, _) => Pacing::Immediate,
        (_, None) => Pacing::Recorded,
        (speed, Some(frames_per_s)) => Pacing::Rate { frames_per_s: speed * frames_per_s },
    };
    if !options.as_skin && options.read.format.is_none() {
        check_skin(spec, skin)?;
    }
    let is_whole = spec.select == FrameSelect::All && options.read.format.is_none();
    let source: Box<dyn Source> = if is_whole && is_recording(&spec.path) {
        Box::new(Replay::new(Recording::open(&spec.path)?, pacing(None), Repeat::Once)?)
    } else {
        let table = read_frames_of(skin, spec, options.read.clone())?;
        let usual = skin.backend.frames_per_s.unwrap_or(FRAMES_PER_S);
        let rate = (table.times_s().is_none() || options.speed != 1.0).then_some(usual);
        // Frames without times are spaced at the skin's rate, however fast they are played.
        let table = match table.times_s() {
            Some(_) => table,
            None => {
                let times_s = (0..table.frames()).map(|index| index as f64 / usual).collect();
                table.with_times_s(times_s)?
            }
        };
        Box::new(Playback::new(table, pacing(rate), Repeat::Once)?)
    };
    Ok(OpenedSource { source, twin: None, is_file: true, waits: true })
}

/// Opens an instrument. One on the wire is set up for the skin as far as possible, unless it should stay as it is
/// set. A Sciospec instrument is always told its injections, because its channels follow from them alone.
fn instrument(selector: &SourceSelector, skin: &Skin, options: &SourceOptions) -> Result<StreamSource, Error> {
    let (SourceSelector::Tcp { instrument, .. } | SourceSelector::Serial { instrument, .. }) = selector else {
        return Ok(open_stream_greeted(selector, StreamOptions::default(), "")?);
    };
    match instrument {
        Instrument::Wire if !options.as_set => {
            return Ok(open_wire(selector, StreamOptions::default(), setup_of(skin)?, true)?.0);
        }
        Instrument::Sciospec => {
            return Ok(open_sciospec(selector, StreamOptions::default(), sciospec_setup_of(skin)?)?);
        }
        _ => {}
    }
    let greeting = skin.backend.send.as_deref().unwrap_or_default();
    Ok(open_stream_greeted(selector, StreamOptions::default(), greeting)?)
}
