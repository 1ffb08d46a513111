//! A run in progress: shows and records its frames and answers the pages' requests.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use crate::page::{self, Command, Hub, Level, PageOptions, Reply, Request, ServerHandle};
use crossbeam_channel::Receiver;
use dermis_device::acquire::{Acquisition, AcquisitionCounters};
use dermis_device::{Frame, HostStamp};
use dermis_live::pipeline::Pipeline;
use dermis_live::skin_frame::SkinFrame;
use dermis_page::Announcer;
use dermis_page::feed::{PageFeed, RecordingView};
use dermis_page::message::Notice;
use dermis_record::{
    LiveCommand, LiveFeed, LiveRecording, Publisher, RecorderStatus, RecordingEnd, RecordingHead, SkinView,
};

use super::super::printing::date_of;
use super::twin_requests;
use super::viewers::Viewers;
use crate::exit::{Outcome, UsageError};
use crate::interrupt;

/// Maximum number of page requests handled per frame. Of each kind, only the last counts.
const MOST_REQUESTS: usize = 256;

/// A run in progress: what it shows and records, and the requests of its pages.
pub(in crate::commands) struct Running {
    twin: Option<dermis::source::TwinControl>,
    recorder: Option<LiveRecording>,
    viewers: Viewers,
    not_recorded: u64,
    recording_failed: bool,
    head: RecordingHead,
    announcer: Announcer,
    hub: Hub,
    feed: PageFeed,
    publishers: Vec<Box<dyn Publisher>>,
}

impl Running {
    /// A run without a page, for a pipeline that hasn't seen a frame.
    pub(in crate::commands) fn new(
        twin: Option<dermis::source::TwinControl>,
        head: RecordingHead,
        pipeline: &Pipeline,
    ) -> Self {
        let mut feed = PageFeed::new(pipeline);
        feed.demonstrate(twin.is_some());
        Self {
            twin,
            recorder: None,
            viewers: Viewers::default(),
            not_recorded: 0,
            recording_failed: false,
            head,
            announcer: Announcer::new(&pipeline.prepared().skin),
            hub: Hub::new(),
            feed,
            publishers: Vec::new(),
        }
    }

    /// The source of the frames.
    #[cfg(feature = "ros2")]
    pub(in crate::commands) fn source(&self) -> &str {
        &self.head.source
    }

    /// Adds a publisher of the run.
    #[cfg(feature = "ros2")]
    pub(in crate::commands) fn publish_to(&mut self, publisher: Box<dyn Publisher>) {
        self.publishers.push(publisher);
    }

    /// The run with viewers other than pages.
    pub(in crate::commands) fn with_viewers(self, viewers: Viewers) -> Self {
        Self { viewers, ..self }
    }

    /// Carries out the requests of viewers and publishers before the next frame.
    pub(in crate::commands) fn answer_others(&mut self, pipeline: &mut Pipeline) {
        let mut requests = self.viewers.requests();
        requests.extend(self.publishers.iter_mut().filter_map(|publisher| publisher.take_request()));
        for request in requests {
            request.carry_out(pipeline, |event, detail, values| self.tell(event, detail, values));
        }
    }

    /// Ends the viewers and reports the frames they missed.
    pub(in crate::commands) fn end_viewers(&mut self) {
        self.viewers.report();
        self.viewers = Viewers::default();
    }

    /// The feeds that receive the pipeline's output: the recording's and the viewers'.
    fn feeds(&self) -> impl Iterator<Item = &LiveFeed> {
        self.recorder.as_deref().into_iter().chain(&self.viewers.feeds)
    }

    fn feeds_mut(&mut self) -> impl Iterator<Item = &mut LiveFeed> {
        self.recorder.as_deref_mut().into_iter().chain(&mut self.viewers.feeds)
    }

    /// Serves the page; its requests arrive through the channel.
    pub(in crate::commands) fn serve(
        &self,
        address: SocketAddr,
        options: PageOptions,
        pipeline: &Pipeline,
    ) -> anyhow::Result<(ServerHandle, Receiver<Request>)> {
        let (commands, requests) = crossbeam_channel::bounded(MOST_REQUESTS);
        let press = self.twin.as_ref().map(|twin| twin.press);
        let scene = dermis_page::scene(pipeline.prepared(), press, pipeline.calibration());
        Ok((page::serve(address, options, self.hub.clone(), scene, commands)?, requests))
    }

    /// Carries out the pages' requests before the next frame.
    pub(in crate::commands) fn answer_all(&mut self, requests: &Receiver<Request>, pipeline: &mut Pipeline) {
        for request in page::coalesced(requests.try_iter().take(MOST_REQUESTS)) {
            self.answer(request, pipeline);
        }
    }

    /// Call this when no frame arrived.
    pub(in crate::commands) fn wait(&mut self, acquisition: &Acquisition) -> anyhow::Result<()> {
        let problem = acquisition.problem();
        self.publishers.iter_mut().for_each(|publisher| publisher.idle(problem.as_deref()));
        if self.feed.wait(problem, HostStamp::now().monotonic_ns) {
            self.hub.publish(self.feed.update())?;
        }
        Ok(())
    }

    /// Hands a raw frame to the recording and the viewers before it is processed.
    pub(in crate::commands) fn record(&mut self, frame: &Frame) {
        self.feeds_mut().for_each(|feed| feed.frame(frame));
        self.publishers.iter_mut().for_each(|publisher| publisher.frame(frame));
    }

    /// Updates the page after a frame was shown. `renewed` is the frame's time if a new baseline has just been taken.
    pub(in crate::commands) fn after(
        &mut self,
        acquisition: &Acquisition,
        pipeline: &Pipeline,
        renewed: Option<u64>,
    ) -> anyhow::Result<()> {
        let counters = acquisition.counters();
        self.publishers.iter_mut().for_each(|publisher| publisher.state(pipeline, counters));
        self.publish(acquisition, pipeline)?;
        if let Some(wall_ns) = renewed {
            self.new_baseline(pipeline, wall_ns);
        }
        self.notice_failure();
        Ok(())
    }

    /// A status line for the terminal.
    pub(in crate::commands) fn status(&self) -> String {
        self.feed.status()
    }

    /// Outcome of a run with these losses; `incomplete` describes the part of its source that could not be read.
    pub(in crate::commands) fn outcome(&self, counters: AcquisitionCounters, incomplete: Option<&str>) -> Outcome {
        Outcome::of_frames(counters, incomplete, self.not_recorded, self.recording_failed)
    }

    /// Tells the page that there will be no more frames.
    pub(in crate::commands) fn end(&mut self) -> anyhow::Result<()> {
        self.feed.end();
        Ok(self.hub.publish(self.feed.update())?)
    }

    /// Hands the results of a frame to the recording, the viewers and the page, and announces events.
    pub(in crate::commands) fn show(&mut self, output: &SkinFrame<'_>) {
        self.feeds_mut().for_each(|feed| feed.results(output));
        self.publishers.iter_mut().for_each(|publisher| publisher.results(output));
        self.feed.show(output, HostStamp::now().monotonic_ns);
        for Notice { level, text } in self.announcer.notices(output) {
            tracing::warn!(frame = output.sequence, "{text}");
            self.hub.announce(level, text);
        }
    }

    /// Updates the page.
    fn publish(&mut self, acquisition: &Acquisition, pipeline: &Pipeline) -> anyhow::Result<()> {
        let recording = self.recorder.as_ref().map(|recorder| {
            let RecorderStatus { written, dropped, .. } = recorder.status();
            RecordingView { path: recorder.path(), written, dropped }
        });
        self.feed.count(acquisition.counters(), recording);
        self.feed.describe(pipeline, HostStamp::now().monotonic_ns);
        self.hub.publish(self.feed.update())?;
        for text in self.twin.iter().flat_map(|twin| twin.notices.try_iter()) {
            self.feeds().for_each(|feed| feed.event("notice", &text, &[]));
            self.hub.announce(Level::Warning, text);
        }
        Ok(())
    }

    /// Reports a failed recording at once; the stream continues.
    fn notice_failure(&mut self) {
        if let Some(error) = self.recorder.as_mut().and_then(LiveRecording::new_failure) {
            tracing::error!("the recording has stopped: {error}");
            self.hub.announce(Level::Error, format!("the recording has stopped: {error}"));
        }
    }

    fn new_baseline(&mut self, pipeline: &Pipeline, wall_ns: u64) {
        let (_, noise) = pipeline.baseline();
        self.hub.publish_noise(&noise.iter().map(|v| *v as f32).collect::<Vec<_>>());
        self.feeds().for_each(|feed| feed.baseline(pipeline, wall_ns));
        if let Some(reference) = pipeline.reference() {
            let correlation = reference.order.correlation;
            tracing::info!(correlation, "baseline taken");
            if let Some(better) = &reference.order.better {
                let text = format!(
                    "the channels may be in another order: \"{}\" correlates {:.3} with the model, the stated order {:.3}; \
                     `dermis order` prints the lines for the skin file",
                    better.description, better.correlation, correlation
                );
                tracing::warn!("{text}");
                self.hub.announce(Level::Warning, text);
            }
        }
    }

    fn answer(&mut self, request: Request, pipeline: &mut Pipeline) {
        let Some((command, reply)) = twin_requests::carry_out(request, self.twin.as_ref(), &mut self.feed) else {
            return;
        };
        match command {
            Command::Tare { force } => self.command(LiveCommand::Tare { force }, reply, pipeline),
            Command::RecordStart => {
                let path = free_name();
                match self.start_recording(&path, pipeline) {
                    Ok(()) => reply.accept(format!("recording to {}", path.display())),
                    Err(error) => reply.refuse(format!("not recording: {error}")),
                }
            }
            Command::RecordStop => match self.stop_recording() {
                Some(RecordingEnd { error: Some(error), lost, .. }) => {
                    reply.refuse(format!("the recording failed, {lost} frames are not in it: {error}"));
                }
                Some(RecordingEnd { path, frames, lost, .. }) => {
                    reply.accept(format!("{}: {frames} frames, {lost} dropped", path.display()));
                }
                None => reply.refuse("nothing is being recorded"),
            },
            Command::Hyperparameter(value) => self.command(LiveCommand::Hyperparameter(value), reply, pipeline),
            // All channels are published and the page selects. Commands to the twin have been handled already.
            _ => {}
        }
    }

    fn command(&mut self, command: LiveCommand, reply: Reply, pipeline: &mut Pipeline) {
        let tell = |event: &str, detail: &str, values: &[f64]| self.tell(event, detail, values);
        match command.carry_out("requested on the page", pipeline, tell) {
            Ok(text) => reply.accept(text),
            Err(text) => reply.refuse(text),
        }
    }

    /// Passes an event before the next frame to the recording, the viewers and the publishers.
    fn tell(&mut self, event: &str, detail: &str, values: &[f64]) {
        self.feeds().for_each(|feed| feed.event(event, detail, values));
        self.publishers.iter_mut().for_each(|publisher| publisher.event(event, detail, values));
    }

    /// Starts a recording.
    pub(in crate::commands) fn start_recording(&mut self, path: &Path, pipeline: &Pipeline) -> anyhow::Result<()> {
        if let Some(recorder) = &self.recorder {
            return Err(UsageError(format!("already recording to {}", recorder.path().display())).into());
        }
        let recorder = LiveRecording::start(path, &self.head, pipeline, SkinView::IMAGES_PER_S)?;
        interrupt::protect(recorder.stop());
        self.recorder = Some(recorder);
        Ok(())
    }

    /// Ends the recording, if there is one.
    pub(in crate::commands) fn stop_recording(&mut self) -> Option<RecordingEnd> {
        let end = self.recorder.take().map(LiveRecording::finish)?;
        self.not_recorded += end.lost;
        if let Some(error) = &end.error {
            self.recording_failed = true;
            tracing::error!(frames = end.frames, lost = end.lost, "the recording is incomplete: {error}");
        }
        Some(end)
    }
}

/// An unused file name for a recording: date and time in UTC, so that names sort by time, and a number if that is
/// taken.
fn free_name() -> PathBuf {
    let seconds = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0, |d| d.as_secs());
    let date = date_of(seconds / 86_400);
    let (hour, minute, second) = (seconds / 3600 % 24, seconds / 60 % 60, seconds % 60);
    let stem = format!("dermis-{date}-{hour:02}{minute:02}{second:02}Z");
    let numbered = (2..).map(|number: u32| format!("{stem}-{number}.mcap"));
    let mut names = std::iter::once(format!("{stem}.mcap")).chain(numbered).map(PathBuf::from);
    names.find(|name| !name.exists()).unwrap_or_default()
}
