//! `dermis run`: acquire, reconstruct, show. One thread reads the source, this one runs the pipeline, and the page's
//! server has its own. All losses on the way are counted, shown, and reflected in the exit code.

mod body_page;
mod on_body;
#[cfg_attr(not(feature = "ros2"), path = "run/ros2_absent.rs")]
mod ros2;
mod running;
pub mod source;
mod twin_requests;
mod viewers;

use std::io::Write;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::page::{Binding, PageOptions, Request, Token};
use crossbeam_channel::Receiver;
use dermis::body::BodyRunOptions;
use dermis_body::JointSource;
use dermis_device::acquire::Acquisition;
use dermis_device::{Frame, HostStamp, RealTime};
use dermis_learn::Model;
use dermis_live::driver::{Driver, Observer};
use dermis_live::network::built_in;
use dermis_live::pipeline::Pipeline;
use dermis_live::skin_frame::SkinFrame;
use dermis_live::stages::classes::ClassPace;
use dermis_record::guard_socket::{GuardAddress, GuardPublisher, GuardSocket};
use dermis_record::sink::{JsonLines, LinesFor, Sink};
use dermis_skin::GuardSettings;

use super::acquired::AcquiredFrames;
use crate::exit::{Outcome, UsageError};
use crate::interrupt;
use on_body::Shown;
pub(super) use running::Running;
use viewers::{ViewerArguments, Viewers};

const EXAMPLE: &str = "\
Examples:
  dermis run
  dermis run healing-square --no-open --port 8080
  dermis run healing-square --headless --frames 100
  dermis run --source recording.mcap --speed 0
  dermis run arm/arm.toml
  dermis run arm/arm.toml --headless --frames 50 --speed 0
  dermis run --headless --frames 50 --guard tcp://127.0.0.1:0

A body file in place of the skin (`dermis body demo arm` writes one) runs all skins of a robot, each with the source \
that the file names. The page shows the robot in 3-D, with a page for each patch. With --headless it prints JSON \
lines with touches in the frames of patch, link and root, net wrenches, and once per second a line of health.

Without a source, the skin's digital twin runs; press on it in the page with the mouse. The address of the page is \
printed as `page: http://...`. If other machines can reach the page, the address includes a token that they need.";

/// Frames that may queue between source and pipeline: a search for presses may take the time of a hundred frames at
/// 1,000 frames/s.
const QUEUE: usize = 128;

/// Arguments of `dermis run`.
#[derive(clap::Args)]
#[command(after_help = format!("{EXAMPLE}{}", ros2::EXAMPLE))]
pub struct Arguments {
    #[command(flatten)]
    input: source::InputArguments,
    /// A network made by `dermis train` for this skin, which classifies the pixels of every frame (damaged,
    /// compressed); replaces the one shipped with the skin.
    #[arg(long, value_name = "MODEL.json")]
    model: Option<PathBuf>,
    /// Use no network.
    #[arg(long, conflicts_with = "model")]
    no_model: bool,
    /// Record raw frames from the start.
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// No page; print one JSON line per frame on stdout.
    #[arg(long)]
    headless: bool,
    /// With --headless: print lines only for frames with touches or events.
    #[arg(long, requires = "headless")]
    only_touches: bool,
    /// Do not open a browser.
    #[arg(long)]
    no_open: bool,
    /// Address of the page; any address but this machine's own needs the token that is printed.
    #[arg(long, default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    host: IpAddr,
    /// Port of the page; 0 takes a free one.
    #[arg(long, default_value_t = 7878)]
    port: u16,
    /// Additional host names that browsers may use for the page.
    #[arg(long, value_name = "NAME")]
    allow_host: Vec<String>,
    /// Stop after this many frames; for a body, frames of each patch.
    #[arg(long, value_name = "N")]
    frames: Option<u64>,
    /// Source of a body's joint values: - (JSON lines on standard input), tcp:HOST:PORT, ros2:/TOPIC (JointState), a
    /// file of such lines, sweep (a demonstration), or page (sliders on the page, also used if there is no source).
    #[arg(long, value_name = "SOURCE")]
    joints: Option<JointSource>,
    /// Run the other patches of a body if one can't be started.
    #[arg(long)]
    keep_going: bool,
    /// Publish the guard's verdict on every frame (ok, stale, stop) as a line of JSON on this local socket:
    /// tcp://127.0.0.1:PORT or unix://PATH. The limits are those of [guard] in the skin file; without that table,
    /// any touch means stop. Not safety-rated.
    #[arg(long, value_name = "ADDRESS")]
    guard: Option<GuardAddress>,
    #[command(flatten)]
    viewers: ViewerArguments,
    #[command(flatten)]
    ros2: ros2::Ros2Arguments,
}

impl Arguments {
    /// Runs until the source ends, the requested frames are done, or the user interrupts.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        self.viewers.check()?;
        if let Some(file) = self.input.body_file()? {
            return self.run_body(&file, out);
        }
        if self.joints.is_some() || self.keep_going {
            let text = "--joints and --keep-going: expected a body file, as `dermis body demo arm` writes one";
            return Err(UsageError(text.into()).into());
        }
        let (opened, mut pipeline, head) = self.input.open()?;
        self.classify_by_network(&mut pipeline)?;
        let is_twin = opened.twin.is_some();
        let guard = self.open_guard(&mut pipeline)?;
        pipeline.set_live(!is_twin && !opened.is_file);
        let limits = pipeline.prepared().skin.guard.or(guard.as_ref().map(|_| GuardSettings::default()));
        let viewers = Viewers::open(&self.viewers, &pipeline, limits)?;
        let mut run = Running::new(opened.twin, head, &pipeline).with_viewers(viewers);
        let page = if self.headless {
            None
        } else {
            let (server, requests) = run.serve(self.address(), self.page_options()?, &pipeline)?;
            writeln!(out, "page: {}", server.url())?;
            out.flush()?;
            if !self.no_open {
                source::open_browser(&server.url());
            }
            Some((server, requests))
        };
        // From here on a signal ends the run as the end of its source would, so that the recording is finished.
        interrupt::begin();
        if let Some(path) = &self.record {
            run.start_recording(path, &pipeline)?;
        }
        let node = self.ros2.open(&mut run, &pipeline)?;
        // Started last, so that no frame waits for the setup above.
        let mut acquisition = Acquisition::spawn(opened.source, QUEUE, opened.wait);
        let name = acquisition.name().to_string();
        let requests = page.as_ref().map(|(_, requests)| requests);
        let outcome = self.follow(&mut acquisition, &mut pipeline, &mut run, requests, guard.as_ref(), out);
        // Tell the guard's readers to stop before finishing the recording, which takes longer.
        drop(guard);
        node.close();
        run.stop_recording();
        run.end_viewers();
        if pipeline.waits() > 0 {
            tracing::info!(frames = pipeline.waits(), "processing fell behind; frames were queued");
        }
        let (counters, incomplete) = (acquisition.counters(), acquisition.incomplete());
        drop(acquisition);
        let has_ended = matches!(outcome, Ok(true)) && opened.is_file;
        if let Some((server, _)) = page {
            if has_ended { server.shutdown_because("the file has ended") } else { server.shutdown() }
        }
        outcome?;
        if has_ended {
            if let Some(problem) = pipeline.take_start_problem() {
                return Err(problem.into());
            }
            let rest = if pipeline.hyperparameter().is_none() { ", before it had a baseline" } else { "" };
            eprintln!("{name} has ended after {} frames{rest}", pipeline.frames());
        }
        let counters = if is_twin { Outcome::without_twins_frames(counters) } else { counters };
        Ok(run.outcome(counters, incomplete.as_deref()))
    }

    fn run_body(&self, file: &Path, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        if self.model.is_some() {
            return Err(UsageError("--model: only for single skins; expected none with a body file".into()).into());
        }
        let shown = if self.headless {
            Shown::Lines { only_touches: self.only_touches }
        } else {
            // Opened before the patches are prepared, which takes longer.
            let binding = Box::new(Binding::new(self.address(), self.page_options()?)?);
            Shown::Page { binding, opens_browser: !self.no_open }
        };
        #[cfg_attr(not(feature = "ros2"), expect(clippy::needless_update, reason = "features add options"))]
        let mut options = BodyRunOptions {
            source: self.input.source_options()?,
            joints: self.joints.clone(),
            keep_going: self.keep_going,
            record: self.record.clone(),
            lines: self.headless,
            most_frames: self.frames,
            guard: self.guard.clone(),
            #[cfg(feature = "foxglove")]
            foxglove: self.viewers.foxglove.clone(),
            ..BodyRunOptions::default()
        };
        self.ros2.add_to(&mut options)?;
        on_body::run(file, &options, shown, out)
    }

    /// Loads the requested network, or the one shipped with the skin if the skin is unchanged since its training.
    fn classify_by_network(&self, pipeline: &mut Pipeline) -> anyhow::Result<()> {
        if let Some(path) = &self.model {
            let model = Model::load(path).map_err(dermis_lab::Error::from)?;
            return Ok(pipeline.set_classifier(Some(&model), ClassPace::Background)?);
        }
        let name = pipeline.prepared().skin.name.clone();
        let built_in = if self.no_model { None } else { built_in(&name).map_err(dermis_lab::Error::from)? };
        if let Some(model) = built_in
            && let Err(error) = pipeline.set_classifier(Some(&model), ClassPace::Background)
        {
            tracing::warn!("pixels are not classified: {error}");
        }
        Ok(())
    }

    /// Opens the socket of the guard, if one is requested.
    fn open_guard(&self, pipeline: &mut Pipeline) -> anyhow::Result<Option<GuardSocket>> {
        let Some(address) = &self.guard else { return Ok(None) };
        let skin = &pipeline.prepared().skin;
        let name = skin.name.clone();
        if skin.guard.is_none() {
            super::hint(&format!("{name} has no [guard]: the verdict is stop at any touch"));
            pipeline.set_guard(Some(GuardSettings::default()))?;
        }
        let before = pipeline.guard_before_frames(HostStamp::now().monotonic_ns);
        let patches: Vec<_> = before.map(|report| (name, report)).into_iter().collect();
        let socket = GuardSocket::open(address, &patches)?;
        eprintln!("guard: {}", socket.address());
        Ok(Some(socket))
    }

    fn address(&self) -> SocketAddr {
        SocketAddr::new(self.host, self.port)
    }

    fn page_options(&self) -> anyhow::Result<PageOptions> {
        let token = if self.host.is_loopback() { None } else { Some(Token::random()?) };
        Ok(PageOptions { token, allowed_hosts: self.allow_host.clone(), ..PageOptions::default() })
    }

    /// Follows the source; returns true if it ended by itself.
    fn follow(
        &self,
        acquisition: &mut Acquisition,
        pipeline: &mut Pipeline,
        run: &mut Running,
        requests: Option<&Receiver<Request>>,
        guard: Option<&GuardSocket>,
        out: &mut dyn Write,
    ) -> anyhow::Result<bool> {
        let lines_for = if self.only_touches { LinesFor::Touches } else { LinesFor::EveryFrame };
        // An interrupted run ends as with its source, so that the recording is finished.
        let interrupted = interrupt::begin();
        let bar = (!self.headless).then(|| super::spinner("waiting for the baseline"));
        let lines = self.headless.then(|| JsonLines::new(Vec::new(), "standard output", lines_for));
        let console = Console { lines, out, bar, done: 0, most: self.frames };
        let is_instrument = acquisition.is_instrument();
        let mut frames = AcquiredFrames::new(acquisition, Duration::from_millis(100));
        let guard = guard.map(|socket| socket.publisher(0));
        let mut followed = Followed { run, console, requests, guard, interrupted, wall_ns: 0, is_told_to_stop: false };
        let _real_time = is_instrument.then(RealTime::request);
        Driver::new(pipeline).run(&mut frames, &mut followed)?;
        let is_told_to_stop = followed.is_told_to_stop;
        run.end()?;
        Ok(!is_told_to_stop)
    }
}

/// Output to the terminal.
struct Console<'a> {
    lines: Option<JsonLines<Vec<u8>>>,
    out: &'a mut dyn Write,
    bar: Option<indicatif::ProgressBar>,
    done: u64,
    /// Number of frames after which to stop.
    most: Option<u64>,
}

impl Console<'_> {
    /// Writes the lines of the last frame.
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

/// Connects the run to its frames.
struct Followed<'a> {
    run: &'a mut Running,
    console: Console<'a>,
    requests: Option<&'a Receiver<Request>>,
    guard: Option<GuardPublisher>,
    interrupted: &'static AtomicBool,
    /// Wall-clock time of the current frame.
    wall_ns: u64,
    /// True if the run ends before its source.
    is_told_to_stop: bool,
}

impl Observer<AcquiredFrames<'_>> for Followed<'_> {
    fn between(&mut self, pipeline: &mut Pipeline) -> anyhow::Result<bool> {
        if self.interrupted.load(Ordering::Relaxed) || self.console.most.is_some_and(|most| self.console.done >= most) {
            self.is_told_to_stop = true;
            return Ok(false);
        }
        if let Some(requests) = self.requests {
            self.run.answer_all(requests, pipeline);
        }
        self.run.answer_others(pipeline);
        Ok(true)
    }

    fn idle(&mut self, feed: &AcquiredFrames<'_>) -> anyhow::Result<()> {
        self.run.wait(feed.acquisition())
    }

    fn before(&mut self, frame: &Frame) -> anyhow::Result<()> {
        self.wall_ns = frame.host_wall_ns;
        self.run.record(frame);
        Ok(())
    }

    fn result(&mut self, output: &SkinFrame<'_>) -> anyhow::Result<ControlFlow<()>> {
        // The guard comes first; everything else can wait.
        if let (Some(guard), Some(report)) = (&self.guard, output.guard) {
            guard.publish(output.sequence, report);
        }
        if let Some(lines) = &mut self.console.lines {
            lines.accept(output)?;
        }
        self.run.show(output);
        Ok(ControlFlow::Continue(()))
    }

    fn after(&mut self, feed: &AcquiredFrames<'_>, pipeline: &Pipeline, renewed: bool) -> anyhow::Result<()> {
        self.run.after(feed.acquisition(), pipeline, renewed.then_some(self.wall_ns))?;
        self.console.flush(|| self.run.status())
    }
}
