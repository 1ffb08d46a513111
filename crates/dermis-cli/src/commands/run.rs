//! `dermis run`: acquire, reconstruct, show. One thread reads the source, this one runs the pipeline, the page's server
//! has its own; whatever is lost on the way is counted, shown, and tells in the exit code.

mod page_feed;
pub mod source;

use std::io::Write;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::page::{self, Command, Hub, Level, PageOptions, Reply, Request, Token};
use crossbeam_channel::Receiver;
use dermis::device::acquire::Acquisition;
use dermis::lab::twin_commands::{CommandRefused, TwinCommand};
use dermis::live::clock::FrameAnomalies;
use dermis::live::driver::{Driver, Observer};
use dermis::live::network::built_in;
use dermis::live::output::Output;
use dermis::live::pipeline::Pipeline;
use dermis::live::stages::classes::ClassPace;
use dermis::live::stages::health::{HealthChange, HealthWatch};
use dermis::record::sink::{JsonLines, LinesFor, Sink};
use dermis::record::{LiveRecording, RecordingEnd, RecordingHead, SkinView, is_recording};
use dermis::skin::Skin;
use dermis::twin::from_skin::treatment_of;
use dermis_device::Frame;
use dermis_learn::Model;

use super::acquired::AcquiredFrames;
use crate::exit::{Outcome, UsageError};
use crate::interrupt;
use page_feed::PageFeed;

const EXAMPLE: &str = "\
Examples:
  dermis run
  dermis run healing-square --no-open --port 8080
  dermis run healing-square --headless --frames 100
  dermis run --source recording.mcap --speed 0

Without a source, the skin's digital twin runs; press on it in the page with the mouse. The address of the page is printed
as `page: http://...`. Pages on other addresses than this machine's own need the token that is part of that address.";

/// Frames that may wait between source and pipeline.
const QUEUE: usize = 64;
/// Requests of pages that may wait for the next frame; of one kind, the last counts.
const MOST_REQUESTS: usize = 256;

/// Arguments of `dermis run`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    #[command(flatten)]
    input: source::InputArguments,
    /// A network made by `dermis train` for this skin, which classifies the pixels of every frame (damaged,
    /// compressed), in place of the one that ships with it.
    #[arg(long, value_name = "MODEL.json")]
    model: Option<PathBuf>,
    /// No network.
    #[arg(long, conflicts_with = "model")]
    no_model: bool,
    /// Record raw frames from the start.
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// No page; one JSON line a frame on stdout.
    #[arg(long)]
    headless: bool,
    /// With --headless: lines only for frames with touches or events.
    #[arg(long, requires = "headless")]
    only_touches: bool,
    /// Do not open a browser.
    #[arg(long)]
    no_open: bool,
    /// Address of the page; any but this machine's own needs the token that is printed.
    #[arg(long, default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    host: IpAddr,
    /// Port of the page; 0 takes a free one.
    #[arg(long, default_value_t = 7878)]
    port: u16,
    /// Further names under which browsers may ask for the page.
    #[arg(long, value_name = "NAME")]
    allow_host: Vec<String>,
    /// Stop after so many frames.
    #[arg(long, value_name = "N")]
    frames: Option<u64>,
}

/// The run in progress.
struct Run {
    twin: Option<dermis::source::TwinControl>,
    recorder: Option<LiveRecording>,
    not_recorded: u64,
    recording_failed: bool,
    head: RecordingHead,
    health: HealthWatch,
    hub: Hub,
    feed: PageFeed,
}

impl Arguments {
    /// Runs until the source ends, the frames asked for are done, or the user interrupts.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let (opened, mut pipeline, head) = self.input.open()?;
        self.classify_by_network(&mut pipeline)?;
        let hub = Hub::new();
        let (commands, requests) = crossbeam_channel::bounded(MOST_REQUESTS);
        let server = if self.headless {
            None
        } else {
            let scene = page_feed::scene(pipeline.prepared(), opened.twin.as_ref().map(|twin| twin.press));
            let server = page::serve(self.address(), self.page_options()?, hub.clone(), scene, commands)?;
            writeln!(out, "page: {}", server.url())?;
            out.flush()?;
            if !self.no_open {
                source::open_browser(&server.url());
            }
            Some(server)
        };
        let mut feed = PageFeed::new(&pipeline);
        feed.demonstrate(opened.twin.is_some());
        let health = HealthWatch::new(&pipeline.prepared().skin);
        let mut run = Run {
            twin: opened.twin,
            recorder: None,
            not_recorded: 0,
            recording_failed: false,
            head,
            health,
            hub,
            feed,
        };
        // A signal from here on ends the run as it would end with its source, so that a recording is finished.
        interrupt::begin();
        if let Some(path) = &self.record {
            run.start_recording(path, &pipeline)?;
        }
        // Last of all, so that no frame waits for anything above.
        let mut acquisition = Acquisition::spawn(opened.source, QUEUE, opened.wait);
        let name = acquisition.name().to_string();
        let outcome = self.follow(&mut acquisition, &mut pipeline, &mut run, &requests, out);
        run.stop_recording();
        let counters = acquisition.counters();
        drop(acquisition);
        let has_ended = matches!(outcome, Ok(true)) && opened.is_file;
        if let Some(server) = server {
            if has_ended { server.shutdown_because("the file has ended") } else { server.shutdown() }
        }
        outcome?;
        if has_ended {
            eprintln!("{name} has ended after {} frames", pipeline.frames());
        }
        Ok(Outcome::of_frames(counters, run.not_recorded, run.recording_failed))
    }

    /// The network asked for, or the one that ships with the skin as long as the skin is what it was trained on.
    fn classify_by_network(&self, pipeline: &mut Pipeline) -> anyhow::Result<()> {
        if let Some(path) = &self.model {
            let model = Model::load(path).map_err(dermis::Error::from)?;
            return Ok(pipeline.set_classifier(Some(&model), ClassPace::Background)?);
        }
        let name = pipeline.prepared().skin.name.clone();
        let built_in = if self.no_model { None } else { built_in(&name).map_err(dermis::Error::from)? };
        if let Some(model) = built_in
            && let Err(error) = pipeline.set_classifier(Some(&model), ClassPace::Background)
        {
            tracing::warn!("no classes of pixels: {error}");
        }
        Ok(())
    }

    fn address(&self) -> SocketAddr {
        SocketAddr::new(self.host, self.port)
    }

    fn page_options(&self) -> anyhow::Result<PageOptions> {
        let token = if self.host.is_loopback() { None } else { Some(Token::random()?) };
        Ok(PageOptions { token, allowed_hosts: self.allow_host.clone(), ..PageOptions::default() })
    }

    /// True where the source has ended by itself.
    fn follow(
        &self,
        acquisition: &mut Acquisition,
        pipeline: &mut Pipeline,
        run: &mut Run,
        requests: &Receiver<Request>,
        out: &mut dyn Write,
    ) -> anyhow::Result<bool> {
        let lines_for = if self.only_touches { LinesFor::Touches } else { LinesFor::EveryFrame };
        // Interrupted, the run ends as it would with its source, so that a recording is finished.
        let interrupted = interrupt::begin();
        let bar = (!self.headless).then(|| super::spinner("waiting for the baseline"));
        let lines = self.headless.then(|| JsonLines::new(Vec::new(), "standard output", lines_for));
        let console = Console { lines, out, bar, done: 0, most: self.frames };
        let mut frames = AcquiredFrames::new(acquisition, Duration::from_millis(100));
        let mut followed = Followed { run, console, requests, interrupted, wall_ns: 0, is_told_to_stop: false };
        Driver::new(pipeline).run(&mut frames, &mut followed)?;
        let is_told_to_stop = followed.is_told_to_stop;
        run.feed.end();
        run.hub.publish(run.feed.update())?;
        Ok(!is_told_to_stop)
    }
}

/// What is written to the terminal.
struct Console<'a> {
    lines: Option<JsonLines<Vec<u8>>>,
    out: &'a mut dyn Write,
    bar: Option<indicatif::ProgressBar>,
    done: u64,
    /// Frames to stop after.
    most: Option<u64>,
}

impl Console<'_> {
    /// Writes the lines of the frame just done.
    fn flush(&mut self, status: impl FnOnce() -> String) -> anyhow::Result<()> {
        if let Some(lines) = &mut self.lines {
            self.out.write_all(lines.get_mut())?;
            self.out.flush()?;
            lines.get_mut().clear();
        }
        self.done += 1;
        if let Some(bar) = &mut self.bar
            && self.done.is_multiple_of(25)
        {
            bar.set_message(status());
        }
        Ok(())
    }
}

/// The run as it sees its frames.
struct Followed<'a> {
    run: &'a mut Run,
    console: Console<'a>,
    requests: &'a Receiver<Request>,
    interrupted: &'static AtomicBool,
    /// Time of the frame at hand.
    wall_ns: u64,
    /// The run ends before its source.
    is_told_to_stop: bool,
}

impl Observer<AcquiredFrames<'_>> for Followed<'_> {
    fn between(&mut self, pipeline: &mut Pipeline) -> anyhow::Result<bool> {
        if self.interrupted.load(Ordering::Relaxed) || self.console.most.is_some_and(|most| self.console.done >= most) {
            self.is_told_to_stop = true;
            return Ok(false);
        }
        for request in page::coalesced(self.requests.try_iter().take(MOST_REQUESTS)) {
            self.run.answer(request, pipeline);
        }
        Ok(true)
    }

    fn idle(&mut self, feed: &AcquiredFrames<'_>) -> anyhow::Result<()> {
        if self.run.feed.wait(feed.acquisition().problem()) {
            self.run.hub.publish(self.run.feed.update())?;
        }
        Ok(())
    }

    /// Raw is on its way to the disk before anything is made of it.
    fn before(&mut self, frame: &Frame) -> anyhow::Result<()> {
        self.wall_ns = frame.host_wall_ns;
        if let Some(recorder) = &mut self.run.recorder {
            recorder.frame(frame);
        }
        Ok(())
    }

    fn result(&mut self, output: &Output<'_>) -> anyhow::Result<ControlFlow<()>> {
        if let Some(lines) = &mut self.console.lines {
            lines.accept(output)?;
        }
        self.run.show(output);
        Ok(ControlFlow::Continue(()))
    }

    fn after(&mut self, feed: &AcquiredFrames<'_>, pipeline: &Pipeline, renewed: bool) -> anyhow::Result<()> {
        self.run.publish(feed.acquisition(), pipeline)?;
        if renewed {
            self.run.new_baseline(pipeline, self.wall_ns);
        }
        self.run.notice_failure();
        self.console.flush(|| self.run.feed.status())
    }
}

impl Run {
    /// Hands the results of a frame to the recording and the page, and says what has happened.
    fn show(&mut self, output: &Output<'_>) {
        if let Some(recorder) = &mut self.recorder {
            recorder.results(output);
        }
        self.feed.show(output);
        for event in output.damage.events {
            let text = dermis::live::stages::damage::describe(event);
            tracing::warn!(frame = output.sequence, "{text}");
            self.hub.announce(Level::Warning, text);
        }
        for HealthChange { detail, is_fault, .. } in self.health.changes(output.health) {
            tracing::warn!(frame = output.sequence, "{detail}");
            self.hub.announce(if is_fault { Level::Warning } else { Level::Info }, detail);
        }
        let FrameAnomalies { clock_jump_ns, renumbered, .. } = output.anomalies;
        if clock_jump_ns != 0 || renumbered {
            let jump_s = clock_jump_ns as f64 * 1e-9;
            let reset = if renumbered { ", and its frames are numbered anew: it was reset" } else { "" };
            let text = format!("the device's clock was off by {jump_s:.1} s{reset}; time goes on at the pace it had");
            tracing::warn!(frame = output.sequence, "{text}");
            self.hub.announce(Level::Warning, text);
        }
    }

    /// Brings the page up to date.
    fn publish(&mut self, acquisition: &Acquisition, pipeline: &Pipeline) -> anyhow::Result<()> {
        self.feed
            .count(acquisition.counters(), self.recorder.as_ref().map(|recorder| (recorder.path(), recorder.status())));
        self.feed.describe(pipeline);
        self.hub.publish(self.feed.update())?;
        for text in self.twin.iter().flat_map(|twin| twin.notices.try_iter()) {
            if let Some(recorder) = &self.recorder {
                recorder.event("notice", &text, &[]);
            }
            self.hub.announce(Level::Warning, text);
        }
        Ok(())
    }

    /// A recording that has stopped is said at once; the stream goes on.
    fn notice_failure(&mut self) {
        if let Some(error) = self.recorder.as_mut().and_then(LiveRecording::new_failure) {
            tracing::error!("the recording has stopped: {error}");
            self.hub.announce(Level::Error, format!("the recording has stopped: {error}"));
        }
    }

    fn new_baseline(&mut self, pipeline: &Pipeline, wall_ns: u64) {
        let (_, noise) = pipeline.baseline();
        self.hub.publish_noise(&noise.iter().map(|v| *v as f32).collect::<Vec<_>>());
        if let Some(recorder) = &self.recorder {
            recorder.baseline(pipeline, wall_ns);
        }
        if let Some(reference) = pipeline.reference() {
            let correlation = reference.order.correlation;
            tracing::info!(correlation, "baseline taken");
            if let Some(better) = &reference.order.better {
                let text = format!(
                    "the channels may be in another order: \"{}\" correlates {:.3} with the model, the stated order {:.3}; \
                     `dermis order` writes the lines of the skin file that say so",
                    better.description, better.correlation, correlation
                );
                tracing::warn!("{text}");
                self.hub.announce(Level::Warning, text);
            }
        }
    }

    fn answer(&mut self, request: Request, pipeline: &mut Pipeline) {
        let reply = request.reply;
        match request.command {
            Command::Tare { force } => self.tare(force, reply, pipeline),
            Command::RecordStart => {
                let path = PathBuf::from(format!("{}.mcap", timestamp()));
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
            Command::Hyperparameter(value) => match pipeline.set_hyperparameter(value) {
                Ok(()) => {
                    if let Some(recorder) = &self.recorder {
                        recorder.hyperparameter(value);
                    }
                    reply.accept(format!("hyperparameter {value:.3e}"));
                }
                Err(error) => reply.refuse(format!("hyperparameter refused: {error}")),
            },
            Command::Press(press) | Command::Move(press) => {
                let press = TwinCommand::Press {
                    pointer: press.pointer_id,
                    position_m: [press.x_mm * 1e-3, press.y_mm * 1e-3],
                    radius_m: press.radius_mm * 1e-3,
                    pressure_pa: press.pressure_kpa * 1e3,
                };
                self.ask_twin(press, reply);
            }
            Command::Treat(action) => {
                self.feed.demonstrate(false);
                self.ask_twin(TwinCommand::Treat(treatment_of(action)), reply);
            }
            Command::Demonstrate(wanted) => match self.command_twin(TwinCommand::Demonstrate(wanted)) {
                Ok(()) => {
                    self.feed.demonstrate(wanted);
                    reply.accept(if wanted {
                        "the twin shows touches by itself"
                    } else {
                        "nothing but you presses the twin"
                    });
                }
                Err(refused) => reply.refuse(format!("refused: {refused}")),
            },
            Command::Release { pointer_id } => self.ask_twin(TwinCommand::Release { pointer: pointer_id }, reply),
            // Every channel is published; the page chooses among them.
            Command::ChooseChannels(_) => {}
        }
    }

    fn tare(&mut self, force: bool, reply: Reply, pipeline: &mut Pipeline) {
        const REASON: &str = "asked for in the page";
        let asked = pipeline.tare(force, REASON);
        match (asked, &self.recorder) {
            (Ok(frames), recorder) => {
                if let Some(recorder) = recorder {
                    recorder.tare(force, REASON);
                }
                reply.accept(format!("taring over {frames} frames"));
            }
            (Err(error), recorder) => {
                if let Some(recorder) = recorder {
                    recorder.event("tare-refused", &error.to_string(), &[]);
                }
                reply.refuse(format!("tare refused: {error}"));
            }
        }
    }

    fn command_twin(&self, command: TwinCommand) -> Result<(), CommandRefused> {
        self.twin.as_ref().map_or(Ok(()), |twin| twin.commands.send(command))
    }

    /// Hands a command to the twin, and says so only where it is refused.
    fn ask_twin(&self, command: TwinCommand, reply: Reply) {
        if let Err(refused) = self.command_twin(command) {
            reply.refuse(format!("refused: {refused}"));
        }
    }

    fn start_recording(&mut self, path: &Path, pipeline: &Pipeline) -> anyhow::Result<()> {
        if let Some(recorder) = &self.recorder {
            return Err(UsageError(format!("already recording to {}", recorder.path().display())).into());
        }
        let recorder = LiveRecording::start(path, &self.head, pipeline, SkinView::IMAGES_PER_S)?;
        interrupt::protect(recorder.stop());
        self.recorder = Some(recorder);
        Ok(())
    }

    fn stop_recording(&mut self) -> Option<RecordingEnd> {
        let end = self.recorder.take().map(LiveRecording::finish)?;
        self.not_recorded += end.lost;
        if let Some(error) = &end.error {
            self.recording_failed = true;
            tracing::error!(frames = end.frames, lost = end.lost, "the recording is not whole: {error}");
        }
        Some(end)
    }
}

/// A name for a recording: seconds since 1970, which sorts by time.
fn timestamp() -> String {
    let seconds = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0, |d| d.as_secs());
    format!("dermis-{seconds}")
}

/// Rate over the last second or so.
#[derive(Debug)]
struct Rate {
    since: Instant,
    frames: u32,
    per_s: f32,
}

impl Rate {
    fn new() -> Self {
        Self { since: Instant::now(), frames: 0, per_s: 0.0 }
    }

    fn count(&mut self) -> f32 {
        self.frames += 1;
        let elapsed = self.since.elapsed().as_secs_f32();
        if elapsed > 0.5 {
            self.per_s = self.frames as f32 / elapsed;
            self.since = Instant::now();
            self.frames = 0;
        }
        self.per_s
    }
}

/// The skin that a name or path stands for. Of a recording or another source it is said where that goes.
pub(super) fn skin(name: &str) -> anyhow::Result<Skin> {
    let path = Path::new(name);
    let is_source = ["tcp:", "serial:", "twin:", "file:"].iter().any(|scheme| name.starts_with(scheme));
    if path.is_file() && is_recording(path) {
        let text = format!("{name}: a recording and no skin file; it has its skin in it: dermis run --source {name}");
        return Err(UsageError(text).into());
    }
    if is_source {
        let text = format!("{name}: a source and no skin; expected SKIN first, and then --source {name}");
        return Err(UsageError(text).into());
    }
    Ok(Skin::open(name)?)
}
