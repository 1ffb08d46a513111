//! A recording run through the pipeline again. Frames come with the numbers and times that they had, what was commanded is
//! commanded again at the same places, and the calibrations are those recorded, so that the results are those of the live
//! run to the bit; with another skin, prior or lambda they are what that would have given.

use std::io::{Read, Seek};
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use dermis_device::{HostStamp, Layout};

use super::live::{HYPERPARAMETER, TARE};
use super::{BaselineEntry, Damage, Entry, EventEntry, Recording, RecordingHead};
use crate::Error;
use crate::calibrate::Calibration;
use crate::forces::parse_forces;
use crate::pipeline::Pipeline;
use crate::prepare::Prepared;
use crate::sink::Output;
use crate::skin::Skin;

/// Longest sleep between two looks at whether to stop.
const NAP: Duration = Duration::from_millis(50);

/// How a recording is run again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RerunOptions {
    /// 1 as fast as recorded, 2 twice as fast, 0 as fast as possible.
    pub speed: f64,
    /// Follow changes of lambda that were made while recording. No where another one is to be tried.
    pub follow_hyperparameter: bool,
}

impl Default for RerunOptions {
    /// As fast as possible, following everything.
    fn default() -> Self {
        Self { speed: 0.0, follow_hyperparameter: true }
    }
}

/// How a rerun went.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RerunReport {
    /// Frames run.
    pub frames: u64,
    /// Frames that are missing between them, by their numbers.
    pub missing: u64,
    /// What of the recording could not be read.
    pub damage: Damage,
    /// Recorded commands that were refused this time, as can happen to a tare under another image.
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
    /// The head for recording frames of `layout`, which `source` sends, of a prepared skin. Channels are labelled where the
    /// frames hold the protocol's channels themselves.
    pub fn of(prepared: &Prepared, layout: Layout, source: &str) -> Self {
        let mut head = Self::new(prepared.skin.to_toml(), layout, source);
        if head.layout.channels() == prepared.channels() {
            head.labels = (0..prepared.channels()).map(|channel| prepared.protocol.channel_label(channel)).collect();
        }
        head
    }

    /// The pipeline that the recording was made with, for the recorded skin or another one; `file` is for messages.
    ///
    /// # Errors
    /// A skin that cannot be prepared or does not fit the recorded frames, calibrations that cannot be read.
    pub fn pipeline(&self, skin: Skin, file: &Path) -> Result<Pipeline, Error> {
        let calibration =
            self.calibration.as_deref().map(|text| Calibration::parse(text.as_bytes(), file)).transpose()?;
        let forces = self.forces.as_deref().map(|text| parse_forces(text.as_bytes(), file, &skin.name)).transpose()?;
        let mut pipeline = Pipeline::new(Prepared::new(skin)?, &self.layout, calibration)?;
        forces.map_or(Ok(()), |forces| pipeline.set_forces(forces))?;
        Ok(pipeline)
    }
}

/// Runs what is left of `recording` through `pipeline` and hands every result to `each`, until that breaks off, `stop` is
/// set or the recording ends. A recording that was begun in the middle of a run begins with the baseline then in use.
///
/// # Errors
/// Frames that do not fit the pipeline, [`Error::Io`], and those of `each`.
pub fn rerun<R: Read + Seek>(
    recording: &mut Recording<R>,
    pipeline: &mut Pipeline,
    options: RerunOptions,
    stop: &AtomicBool,
    mut each: impl FnMut(&Output<'_>) -> Result<ControlFlow<()>, Error>,
) -> Result<RerunReport, Error> {
    let (mut frames, mut missing, mut refused) = (0, 0, 0);
    let mut last: Option<u64> = None;
    let mut begun: Option<(Instant, u64)> = None;
    while let Some(entry) = recording.next_entry()? {
        match entry {
            Entry::Frame(frame) => {
                missing += last.map_or(0, |last| frame.sequence.saturating_sub(last).saturating_sub(1));
                last = Some(frame.sequence);
                let (start, first_ns) = *begun.get_or_insert_with(|| (Instant::now(), frame.host_monotonic_ns));
                let since_first = Duration::from_nanos(frame.host_monotonic_ns.saturating_sub(first_ns));
                wait(start, since_first, options.speed, stop);
                if stop.load(Ordering::Relaxed) {
                    break;
                }
                let output = pipeline.process(frame, HostStamp::now().monotonic_ns)?;
                frames += 1;
                if each(&output)?.is_break() {
                    break;
                }
            }
            Entry::Baseline { entry: BaselineEntry { record, values, noise_std }, .. } if last.is_none() => {
                pipeline.restore_baseline(record.clone(), values, noise_std)?;
            }
            Entry::Event { entry, .. } => refused += u64::from(!obey(pipeline, entry, options)),
            Entry::Baseline { .. } | Entry::Touches { .. } => {}
        }
    }
    Ok(RerunReport { frames, missing, damage: recording.damage(), refused })
}

/// Carries out what was commanded; false if it was refused. Events that are no commands count as carried out.
fn obey(pipeline: &mut Pipeline, entry: &EventEntry, options: RerunOptions) -> bool {
    let value = entry.values.first().copied();
    match (entry.event.as_str(), value) {
        (TARE, Some(force)) => pipeline.tare(force != 0.0, &entry.detail).is_ok(),
        (HYPERPARAMETER, Some(lambda)) if options.follow_hyperparameter => pipeline.set_hyperparameter(lambda).is_ok(),
        _ => true,
    }
}

/// Sleeps until a frame is due.
fn wait(start: Instant, since_first: Duration, speed: f64, stop: &AtomicBool) {
    // Beyond what a clock can be set to, there is no pace to keep.
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
