//! Reads a skin: a source, the pipeline behind it, and an iterator over the results.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use dermis_device::{
    Counters, DeviceError, FileSpec, Frame, HostStamp, Source, SourceEvent, SourceSelector, instruments,
};
use dermis_lab::Error;
use dermis_lab::twin_source::TwinCommand;
use dermis_live::calibration::Calibration;
use dermis_live::forces::load_forces;
use dermis_live::output::Output;
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_record::read_frames_of;
use dermis_skin::Skin;
use dermis_touch::{Touch, TouchEvent};

use crate::source::{OpenedSource, SourceOptions, TwinControl, open_source};

/// Wait for a frame between checks.
const NAP: Duration = Duration::from_millis(100);
/// Default time without a frame after which a [`Session`] reports an error.
const PATIENCE: Duration = Duration::from_secs(10);

/// Options of a [`Session`] in addition to its source and skin.
#[derive(Clone, Debug)]
pub struct SessionOptions {
    /// Speed of files and twins, settings of instruments, format of files.
    pub source: SourceOptions,
    /// Frames of the untouched skin. Without them the first 32 frames are used.
    pub baseline: Option<FileSpec>,
    /// A calibration made by `dermis calibrate`.
    pub calibration: Option<PathBuf>,
    /// A force calibration made by `dermis calibrate --forces`.
    pub forces: Option<PathBuf>,
    /// Time without a frame after which the session yields an error. It goes on waiting when called again.
    pub patience: Duration,
}

impl Default for SessionOptions {
    /// Files and twins as fast as frames are taken, the baseline from the first frames, no calibrations, 10 s of
    /// patience.
    fn default() -> Self {
        Self { source: SourceOptions::default(), baseline: None, calibration: None, forces: None, patience: PATIENCE }
    }
}

/// A skin being read: an iterator over frames with touches. See the [crate's first example](crate).
pub struct Session {
    source: Box<dyn Source>,
    pipeline: Pipeline,
    twin: Option<TwinControl>,
    frame: Frame,
    last_sequence: Option<u64>,
    first_ns: Option<u64>,
    patience: Duration,
    ended: bool,
}

/// The results of one frame of a [`Session`].
#[derive(Clone, Debug)]
pub struct SkinFrame {
    /// The device's frame number. Gaps are lost frames.
    pub sequence: u64,
    /// Seconds since the session's first frame, by the device's clock if it has one.
    pub time_s: f64,
    /// False while the first frames make the baseline. Until then the image is `NaN`, and there are no touches.
    pub is_ready: bool,
    /// Touches on the skin in this frame: positions in metres from the skin's centre, x right, y up.
    pub touches: Vec<Touch>,
    /// Event of each touch in this frame: begin, move, end.
    pub events: Vec<TouchEvent>,
    /// The image, row-major, row 0 at the top (+y), `NaN` outside the skin.
    pub image: Vec<f32>,
    /// Rows of the image.
    pub rows: usize,
    /// Pixels per row of the image.
    pub columns: usize,
}

impl Session {
    /// Opens a source for a skin: `twin` (the skin's own), `twin:NAME`, a file of frames or a recording
    /// (`press.mcap`, `frames.csv#0..60`), `tcp:HOST:PORT`, `serial:PORT[@BAUD]` or `serial:VID:PID[:SERIAL]`; after
    /// a port `#lines` or `#floats:CHANNELS` for instruments that send just numbers.
    ///
    /// # Errors
    /// The text is not a valid source, the source cannot be opened, or its frames do not hold the skin's channels.
    pub fn open(source: &str, skin: Skin) -> Result<Self, Error> {
        Self::open_with(source, skin, &SessionOptions::default())
    }

    /// Like `open`, with options.
    ///
    /// # Errors
    /// As for [`Session::open`], and if a file cannot be read or belongs to another skin.
    pub fn open_with(source: &str, skin: Skin, options: &SessionOptions) -> Result<Self, Error> {
        let selector: SourceSelector = source.parse()?;
        let baseline = options.baseline.as_ref();
        let baseline = baseline.map(|spec| read_frames_of(&skin, spec, options.source.read.clone())).transpose()?;
        let OpenedSource { source, twin, is_file, .. } = open_source(&selector, &skin, &options.source)?;
        let calibration = match &options.calibration {
            Some(path) => Some(Calibration::parse(&instruments::read_bytes(path)?, path)?),
            None => None,
        };
        let forces = options.forces.as_deref().map(|path| load_forces(path, &skin)).transpose()?;
        let mut pipeline = Pipeline::new(Prepared::new(skin)?, source.layout(), calibration)?;
        // Files and twins run at a speed of their own.
        pipeline.watch_lag(twin.is_none() && !is_file);
        forces.map_or(Ok(()), |forces| pipeline.set_forces(forces))?;
        baseline.map_or(Ok(()), |table| pipeline.set_baseline(&table))?;
        Ok(Self { twin, patience: options.patience, ..Self::of(source, pipeline) })
    }

    /// A session with any source, for example an instrument of your own, and a pipeline made for its layout.
    pub fn of(source: Box<dyn Source>, pipeline: Pipeline) -> Self {
        let frame = Frame::with_capacity(source.channels());
        let (last_sequence, first_ns) = (None, None);
        Self { source, pipeline, twin: None, frame, last_sequence, first_ns, patience: PATIENCE, ended: false }
    }

    /// Sets the time without a frame after which the session reports an error.
    pub fn with_patience(self, patience: Duration) -> Self {
        Self { patience, ..self }
    }

    /// The skin.
    pub fn skin(&self) -> &Skin {
        &self.pipeline.prepared().skin
    }

    /// The pipeline: its baseline, operator, health.
    pub fn pipeline(&self) -> &Pipeline {
        &self.pipeline
    }

    /// The pipeline, for changes between two frames: a tare, another lambda, a network.
    pub fn pipeline_mut(&mut self) -> &mut Pipeline {
        &mut self.pipeline
    }

    /// Numbers of frames received and lost.
    pub fn counters(&self) -> Counters {
        self.source.counters()
    }

    /// Presses the session's twin from its next frame on: position and radius in metres, pressure in pascals. False
    /// if there is no twin, or if too many commands are queued.
    pub fn press(&self, position_m: [f64; 2], radius_m: f64, pressure_pa: f64) -> bool {
        self.command(TwinCommand::Press { pointer: POINTER, position_m, radius_m, pressure_pa })
    }

    /// Releases the press on the session's twin. False as for [`Session::press`].
    pub fn release(&self) -> bool {
        self.command(TwinCommand::Release { pointer: POINTER })
    }

    fn command(&self, command: TwinCommand) -> bool {
        self.twin.as_ref().is_some_and(|twin| twin.commands.send(command).is_ok())
    }

    /// Waits for the next frame and runs it through the pipeline. The result is borrowed; nothing is copied. `None`
    /// after the last frame of a file.
    ///
    /// # Errors
    /// The source fails, or is silent for longer than the session's patience; it goes on waiting when called again.
    pub fn next_output(&mut self) -> Result<Option<Output<'_>>, Error> {
        if !self.receive()? {
            return Ok(None);
        }
        let now_ns = HostStamp::now().monotonic_ns;
        Ok(Some(self.pipeline.process(&self.frame, now_ns)?))
    }

    /// Waits for the next frame; false after the last one.
    fn receive(&mut self) -> Result<bool, Error> {
        let begun = Instant::now();
        while !self.ended {
            match self.source.next_frame(&mut self.frame, NAP)? {
                SourceEvent::End => self.ended = true,
                SourceEvent::Frame if self.last_sequence == Some(self.frame.sequence) => {} // A duplicate.
                SourceEvent::Frame => {
                    self.last_sequence = Some(self.frame.sequence);
                    return Ok(true);
                }
                SourceEvent::Idle if begun.elapsed() < self.patience => {}
                SourceEvent::Idle => {
                    let none = || format!("no frame in {:.1} s", self.patience.as_secs_f64());
                    let reason = self.source.problem().unwrap_or_else(none);
                    return Err(DeviceError::SourceFailed { name: self.source.name().to_owned(), reason }.into());
                }
            }
        }
        Ok(false)
    }

    fn next_frame(&mut self) -> Result<Option<SkinFrame>, Error> {
        let Some(output) = self.next_output()? else { return Ok(None) };
        let Output { sequence, time_ns, touches, events, image, rows, columns, .. } = output;
        let (touches, events, image) = (touches.to_vec(), events.to_vec(), image.to_vec());
        let time_ns = self.frame.device_time_ns.unwrap_or(time_ns);
        let first_ns = *self.first_ns.get_or_insert(time_ns);
        let time_s = time_ns.saturating_sub(first_ns) as f64 * 1e-9;
        let is_ready = self.pipeline.reference().is_some();
        Ok(Some(SkinFrame { sequence, time_s, is_ready, touches, events, image, rows, columns }))
    }
}

/// Pointer id of the session's presses on the twin.
const POINTER: u64 = 1;

impl Iterator for Session {
    type Item = Result<SkinFrame, Error>;

    /// `None` after the last frame of a file. A source that fails yields its error again on every call.
    fn next(&mut self) -> Option<Self::Item> {
        self.next_frame().transpose()
    }
}

impl std::fmt::Debug for Session {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("Session")
            .field("source", &self.source.name())
            .field("skin", &self.skin().name)
            .finish_non_exhaustive()
    }
}
