//! Reads a skin: a source, the pipeline behind it, and an iterator over the results.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use dermis_device::{
    Counters, DeviceError, FileSpec, Frame, HostStamp, Source, SourceEvent, SourceSelector, instruments,
};
use dermis_lab::twin_source::TwinCommand;
use dermis_live::calibration::Calibration;
use dermis_live::forces::load_forces;
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_live::skin_frame::SkinFrame;
use dermis_record::read_frames_of;
use dermis_skin::Skin;
use dermis_twin::mechanics::{Indenter, check_on_skin};

use crate::error::Error;
use crate::source::{OpenedSource, SourceOptions, TwinControl, open_source};

/// Longest wait for a frame before the patience is checked.
const NAP: Duration = Duration::from_millis(100);
/// Default time without a frame after which a [`Session`] reports an error.
const PATIENCE: Duration = Duration::from_secs(10);

/// Options of a [`Session`] in addition to its source and skin.
///
/// ```
/// use std::time::Duration;
///
/// use dermis::{Session, SessionOptions, Skin};
///
/// let options = SessionOptions { patience: Duration::from_secs(2), ..SessionOptions::default() };
/// let session = Session::open_with("twin", Skin::open("healing-square")?, &options)?;
/// assert_eq!(session.skin().name, "healing-square");
/// # Ok::<(), dermis::Error>(())
/// ```
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
    /// Time without a frame after which the session yields an error. Calling it again continues to wait.
    pub patience: Duration,
}

impl Default for SessionOptions {
    /// Files and twins as fast as frames are taken, the baseline from the first frames, no calibrations, 10 s of
    /// patience.
    fn default() -> Self {
        Self { source: SourceOptions::default(), baseline: None, calibration: None, forces: None, patience: PATIENCE }
    }
}

/// A skin being read: an iterator over frames with touches.
///
/// ```
/// use dermis::{Error, Session, Skin};
///
/// let mut session = Session::open("twin", Skin::open("healing-square")?)?;
/// // The first frames make the baseline.
/// session.by_ref().find(|frame| frame.as_ref().is_ok_and(|frame| frame.is_ready));
/// session.press([0.01, -0.02], 0.008, 80e3)?;
/// let frame = session.by_ref().take(40).last().transpose()?.expect("a twin has no end");
/// let [x, y] = frame.touches[0].position_m;
/// assert!((x - 0.01).hypot(y + 0.02) < 0.005, "within 5 mm");
///
/// let off = session.press([1.0, 0.0], 0.008, 80e3).unwrap_err();
/// assert!(off.to_string().contains("no farther out than the skin's rim"), "{off}");
/// # Ok::<(), Error>(())
/// ```
pub struct Session {
    source: Box<dyn Source>,
    pipeline: Pipeline,
    twin: Option<TwinControl>,
    frame: Frame,
    last_sequence: Option<u64>,
    patience: Duration,
    ended: bool,
}

impl Session {
    /// Opens a source for a skin: `twin` (the skin's own), `twin:NAME`, a file of frames or a recording (`press.mcap`,
    /// `frames.csv#0..60`), `tcp:HOST:PORT`, `serial:PORT[@BAUD]` or `serial:VID:PID[:SERIAL]`. Append `#lines` or
    /// `#floats:CHANNELS` to a port if the instrument sends plain numbers.
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
        pipeline.set_live(twin.is_none() && !is_file);
        forces.map_or(Ok(()), |forces| pipeline.set_forces(forces))?;
        baseline.map_or(Ok(()), |table| pipeline.set_baseline(&table))?;
        Ok(Self { twin, patience: options.patience, ..Self::of(source, pipeline) })
    }

    /// A session with any source, for example an instrument of your own, and a pipeline made for its layout.
    pub fn of(source: Box<dyn Source>, pipeline: Pipeline) -> Self {
        let frame = Frame::with_capacity(source.channels());
        Self { source, pipeline, twin: None, frame, last_sequence: None, patience: PATIENCE, ended: false }
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

    /// Presses the session's twin from its next frame on, or moves and changes its press: position and radius in
    /// metres, pressure in pascals.
    ///
    /// # Errors
    /// The source is no twin, its skin can't carry such a press (which then has no effect), or too many commands are
    /// queued.
    pub fn press(&self, position_m: [f64; 2], radius_m: f64, pressure_pa: f64) -> Result<(), Error> {
        let twin = self.twin()?;
        check_on_skin(&twin.outline, &Indenter::disc(position_m, radius_m, pressure_pa))?;
        Ok(twin.commands.send(TwinCommand::Press { pointer: POINTER, position_m, radius_m, pressure_pa })?)
    }

    /// Releases the press on the session's twin.
    ///
    /// # Errors
    /// The source is no twin.
    pub fn release(&self) -> Result<(), Error> {
        Ok(self.twin()?.commands.send(TwinCommand::Release { pointer: POINTER })?)
    }

    fn twin(&self) -> Result<&TwinControl, Error> {
        let none = || Error::NotATwin { name: self.source.name().to_owned() };
        self.twin.as_ref().ok_or_else(none)
    }

    /// Waits for the next frame and runs it through the pipeline. The result borrows the pipeline's memory; nothing is
    /// copied. `None` after the last frame of a file.
    ///
    /// # Errors
    /// The source fails, or is silent for longer than the session's patience; calling this again continues to wait.
    pub fn next_borrowed(&mut self) -> Result<Option<SkinFrame<'_>>, Error> {
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
}

/// Pointer id of the session's presses on the twin.
const POINTER: u64 = 1;

impl Iterator for Session {
    type Item = Result<SkinFrame<'static>, Error>;

    /// `None` after the last frame of a file. A source that fails yields its error again on every call.
    fn next(&mut self) -> Option<Self::Item> {
        self.next_borrowed().map(|frame| frame.map(SkinFrame::into_owned)).transpose()
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
