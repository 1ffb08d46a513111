//! Sources of frames for a skin: its twin, a file, a recording, an instrument, or one of your own, which is a
//! [`Source`].

use crossbeam_channel::Receiver;
use dermis_device::stream::{StreamOptions, StreamSource};
use dermis_device::{open_sciospec, open_stream_greeted, open_wire};
use dermis_lab::measured_list::{sciospec_setup_of, setup_of};
use dermis_lab::twin_source::{TwinCommands, TwinSource};
use dermis_record::{Recording, Replay, check_skin, is_recording, read_frames_of};
use dermis_skin::Skin;
use dermis_tomo::mesh::Outline;
use dermis_twin::PressRange;

use crate::error::Error;

/// ```
/// use std::time::Duration;
///
/// use dermis::source::{Counters, Frame, HostStamp, Layout, Source, SourceEvent};
///
/// /// A board that counts. Yours reads a port.
/// struct Board(Layout, u64);
///
/// impl Source for Board {
///     fn layout(&self) -> &Layout {
///         &self.0
///     }
///     fn name(&self) -> &str {
///         "my board"
///     }
///     fn next_frame(
///         &mut self,
///         frame: &mut Frame,
///         _timeout: Duration,
///     ) -> Result<SourceEvent, dermis::source::DeviceError> {
///         frame.refill(self.1, HostStamp::now(), &[1.0, self.1 as f64], &[]);
///         self.1 += 1;
///         Ok(SourceEvent::Frame)
///     }
///     fn counters(&self) -> Counters {
///         Counters { frames: self.1, lost: 0, bad: 0 }
///     }
/// }
///
/// let (mut board, mut frame) = (Board(Layout::Channels { count: 2 }, 0), Frame::default());
/// board.next_frame(&mut frame, Duration::ZERO)?;
/// assert_eq!(frame.values, [1.0, 0.0]);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_device::Source;
/// Shown with [`Source`].
pub use dermis_device::{Counters, DeviceError, Frame, HostStamp, Layout, SourceEvent};

/// ```
/// use std::time::Duration;
///
/// use dermis::source::{Format, Frame, Pacing, Playback, Repeat, Source, decode};
///
/// // Three frames of two channels, as any spreadsheet writes them.
/// let text = b"time_s,left,right\n0.00,1.0,2.0\n0.02,1.1,2.0\n0.04,,2.1\n";
/// let table = decode(Format::Csv, text, "frames.csv".as_ref())?;
/// assert_eq!((table.frames(), table.channels()), (3, 2));
/// assert!(table.row(2).is_some_and(|row| row[0].is_nan()), "an empty cell is a missing reading");
/// // The same as a source.
/// let (mut source, mut frame) = (Playback::new(table, Pacing::Immediate, Repeat::Once)?, Frame::default());
/// source.next_frame(&mut frame, Duration::ZERO)?;
/// assert_eq!(frame.values, [1.0, 2.0]);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_device::decode;
/// Shown with [`decode`].
pub use dermis_device::{Format, Pacing, Playback, Repeat};
/// No example here: [`decode`]'s has a table; [`read`] takes the bytes from a file, with these options.
pub use dermis_device::{FrameTable, ReadOptions, read};

/// ```
/// use dermis::source::{FileSpec, FrameSelect, Instrument, SourceSelector};
///
/// let port: SourceSelector = "serial:/dev/ttyACM0@115200#lines".parse()?;
/// let SourceSelector::Serial { instrument, .. } = &port else { panic!("a serial port") };
/// assert_eq!(*instrument, Instrument::Lines { channels: None });
/// let part: FileSpec = "frames.csv#0..60".parse()?;
/// assert_ne!(part.select, FrameSelect::All);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_device::SourceSelector;
/// Shown with [`SourceSelector`].
pub use dermis_device::{FileSpec, FrameSelect, Instrument};

/// ```
/// use std::time::Duration;
///
/// use dermis::Skin;
/// use dermis::source::{Acquisition, Next, SourceOptions, open_source};
///
/// let skin = Skin::open("healing-square")?;
/// let opened = open_source(&"twin".parse()?, &skin, &SourceOptions::default())?;
/// // A thread reads the source into a queue of four frames, and waits if the queue is full.
/// let mut acquisition = Acquisition::spawn(opened.source, 4, true);
/// let Next::Frame(frame) = acquisition.next(Duration::from_secs(5))? else { panic!("a frame") };
/// assert_eq!(frame.values.len(), 208);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_device::acquire::Acquisition;
/// No example: numbers of frames that [`Acquisition`] has lost on the way.
pub use dermis_device::acquire::AcquisitionCounters;
/// Shown with [`Acquisition`].
pub use dermis_device::acquire::Next;

/// Options for opening a source.
///
/// ```
/// use dermis::source::SourceOptions;
///
/// // In real time, instead of as fast as frames are taken.
/// let options = SourceOptions { speed: 1.0, ..SourceOptions::default() };
/// assert!(!options.as_set, "an instrument is set to the skin's protocol");
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct SourceOptions {
    /// Speed of files and of the twin: 1 in real time, 2 twice as fast, 0 as fast as frames are taken.
    pub speed: f64,
    /// Use an instrument on the wire with its present settings, instead of setting it to the skin's protocol, current
    /// and frequency.
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
///
/// No example here: [`open_source`] has one.
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
///
/// No example here: [`TwinCommand`](crate::twin::TwinCommand) has one.
#[derive(Debug, Clone)]
pub struct TwinControl {
    /// Sender of commands.
    pub commands: TwinCommands,
    /// Range of pressures and radii for presses.
    pub press: PressRange,
    /// Outline of the twin's skin laid flat. Presses have their centre on it.
    pub outline: Outline,
    /// Notices from the twin.
    pub notices: Receiver<String>,
}

/// Opens a source of frames for a skin.
///
/// `twin` is the skin's own twin, and `twin:NAME` another skin's, which must have the same number of channels. A file
/// is a recording or anything else that [`dermis_record::read_frames`] reads.
///
/// ```
/// use std::time::Duration;
///
/// use dermis::Skin;
/// use dermis::source::{Frame, OpenedSource, SourceOptions, open_source};
///
/// let skin = Skin::open("healing-square")?;
/// let mut opened: OpenedSource = open_source(&"twin".parse()?, &skin, &SourceOptions::default())?;
/// let mut frame = Frame::default();
/// opened.source.next_frame(&mut frame, Duration::from_secs(5))?;
/// assert_eq!((frame.sequence, frame.values.len()), (0, 208));
/// # Ok::<(), dermis::Error>(())
/// ```
///
/// # Errors
/// The speed is negative or not finite, a file cannot be read, a recording is of another skin, an instrument does not
/// answer, or a twin cannot be built.
pub fn open_source(selector: &SourceSelector, skin: &Skin, options: &SourceOptions) -> Result<OpenedSource, Error> {
    if !(options.speed >= 0.0 && options.speed.is_finite()) {
        let expected = "0 (as fast as possible) or a positive number";
        return Err(Error::Value { what: "speed", expected, got: options.speed.to_string() });
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
    let control =
        TwinControl { commands, press: source.press_range(), outline: source.extent(), notices: source.notices() };
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
        let usual = skin.backend.frame_rate_hz();
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

/// Opens an instrument. An instrument on the wire is set up for the skin as far as possible, unless the options say not
/// to. A Sciospec instrument always gets its injections, because they alone determine its channels.
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
