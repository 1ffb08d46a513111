//! Runs a recording through the pipeline again. Frames keep their numbers and times, recorded commands are repeated
//! at the same points, and the recorded calibrations are used, so the results equal those of the live run bit for
//! bit. With another skin, prior or lambda the results are those that the live run would have had.

use std::io::{Read, Seek};
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use dermis_device::Layout;

use super::live_feed::{HYPERPARAMETER, TARE};
use super::{BaselineEntry, Damage, Entry, EventEntry, LostFrames, Recording, RecordingHead};
use crate::Error;
use dermis_live::calibration::Calibration;
use dermis_live::driver::{Command, Driver, Feed, Next, Progress};
use dermis_live::forces::parse_forces_as;
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_live::skin_frame::SkinFrame;
use dermis_skin::Skin;

/// Longest sleep between checks of the stop flag.
const NAP: Duration = Duration::from_millis(50);

/// Options of a rerun.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RerunOptions {
    /// 1 in real time, 2 twice as fast, 0 as fast as possible.
    pub speed: f64,
    /// Repeat changes of lambda made while recording; false to try another value.
    pub follow_hyperparameter: bool,
}

impl Default for RerunOptions {
    /// As fast as possible, repeating all commands.
    fn default() -> Self {
        Self { speed: 0.0, follow_hyperparameter: true }
    }
}

/// Summary of a rerun.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RerunReport {
    /// Number of frames run.
    pub frames: u64,
    /// Number of frames missing in between, by their sequence numbers.
    pub missing: u64,
    /// Parts of the recording that could not be read.
    pub damage: Damage,
    /// Recorded commands that were refused this time, as can happen to a tare with another image.
    pub refused: u64,
}

impl RerunReport {
    /// True if the recording lacks anything.
    #[must_use]
    pub fn has_losses(&self) -> bool {
        self.missing > 0 || !self.damage.is_none()
    }
}

impl RecordingHead {
    /// The head for recording a prepared skin's frames of `layout`, sent by `source`. Channels get labels if the
    /// frames hold the protocol's channels themselves.
    pub fn of(prepared: &Prepared, layout: Layout, source: &str) -> Self {
        let mut head = Self::new(prepared.skin.to_toml(), layout, source);
        if head.layout.channels() == prepared.channels() {
            head.labels = (0..prepared.channels()).map(|channel| prepared.protocol.channel_label(channel)).collect();
        }
        head
    }

    /// The pipeline that the recording was made with, for the recorded skin or another one; `file` is only used in
    /// messages. The recorded calibrations are used without checking their fingerprints, since the caller chose the
    /// skin.
    ///
    /// # Errors
    /// The skin cannot be prepared or doesn't fit the recorded frames, or a calibration cannot be read.
    pub fn pipeline(&self, skin: Skin, file: &Path) -> Result<Pipeline, Error> {
        let calibration =
            self.calibration.as_deref().map(|text| Calibration::parse(text.as_bytes(), file)).transpose()?;
        let calibration = calibration.map(Calibration::insist);
        let forces = self.forces.as_deref().map(|text| parse_forces_as(text.as_bytes(), file, &skin)).transpose()?;
        let mut pipeline = Pipeline::new(Prepared::new(skin)?, &self.layout, calibration)?;
        forces.map_or(Ok(()), |forces| pipeline.set_forces(forces))?;
        Ok(pipeline)
    }
}

/// Runs the rest of `recording` through `pipeline` and hands every result to `each`, until `each` breaks off, `stop`
/// is set or the recording ends. A recording started in the middle of a run begins with the baseline then in use.
///
/// # Errors
/// Frames don't fit the pipeline, an I/O error, or an error of `each`.
pub fn rerun<R: Read + Seek>(
    recording: &mut Recording<R>,
    pipeline: &mut Pipeline,
    options: RerunOptions,
    stop: &AtomicBool,
    mut each: impl FnMut(&SkinFrame<'_>) -> Result<ControlFlow<()>, Error>,
) -> Result<RerunReport, Error> {
    let mut feed = RecordingFeed { recording, options, stop, begun: None, is_stopped: false };
    let progress = Driver::new(pipeline).run(&mut feed, &mut |output: &SkinFrame<'_>| each(output))?;
    let Progress { frames, missing, refused } = progress;
    let mut damage = feed.recording.damage();
    // Frames that weren't reached are not lost.
    if feed.is_stopped {
        damage.frames = LostFrames::Exactly(0);
    }
    Ok(RerunReport { frames, missing, damage, refused })
}

/// The frames of a recording at their pace, with the commands between them.
struct RecordingFeed<'a, R> {
    recording: &'a mut Recording<R>,
    options: RerunOptions,
    stop: &'a AtomicBool,
    /// Start time, and the recorded time of the first frame.
    begun: Option<(Instant, u64)>,
    /// True if it was told to stop before the end.
    is_stopped: bool,
}

impl<R: Read + Seek> Feed for RecordingFeed<'_, R> {
    type Error = Error;

    fn next(&mut self) -> Result<Next<'_>, Error> {
        let Some(entry) = self.recording.next_entry()? else { return Ok(Next::End) };
        let command = match entry {
            Entry::Frame(frame) => {
                let (start, first_ns) = *self.begun.get_or_insert_with(|| (Instant::now(), frame.host_monotonic_ns));
                let since_first = Duration::from_nanos(frame.host_monotonic_ns.saturating_sub(first_ns));
                wait(start, since_first, self.options.speed, self.stop);
                self.is_stopped = self.stop.load(Ordering::Relaxed);
                return Ok(if self.is_stopped { Next::End } else { Next::Frame(frame, None) });
            }
            Entry::Baseline { entry: BaselineEntry { record, values, noise_std }, .. } if self.begun.is_none() => {
                let (record, values, noise_std) = (record.clone(), values.clone(), noise_std.clone());
                Some(Command::RestoreBaseline { record, values, noise_std })
            }
            Entry::Event { entry, .. } => command(entry, self.options),
            Entry::Baseline { .. } | Entry::Touches { .. } => None,
        };
        Ok(command.map_or(Next::Idle, Next::Command))
    }
}

/// The command behind an event, if it is one and should be repeated.
fn command(entry: &EventEntry, options: RerunOptions) -> Option<Command> {
    let value = *entry.values.first()?;
    match entry.event.as_str() {
        TARE => Some(Command::Tare { force: value != 0.0, reason: entry.detail.clone() }),
        HYPERPARAMETER if options.follow_hyperparameter => Some(Command::Hyperparameter(value)),
        _ => None,
    }
}

/// Sleeps until a frame is due.
fn wait(start: Instant, since_first: Duration, speed: f64, stop: &AtomicBool) {
    // The due time is beyond any clock, so there is no pace to keep.
    let after = Duration::try_from_secs_f64(since_first.as_secs_f64() / speed);
    let Some(due) = after.ok().and_then(|after| start.checked_add(after)) else { return };
    while !stop.load(Ordering::Relaxed) {
        let left = due.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return;
        }
        std::thread::sleep(left.min(NAP));
    }
}
