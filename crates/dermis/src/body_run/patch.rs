//! The thread of one patch: takes frames, sends reports.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::error::Error;
use crossbeam_channel::{Receiver, SendTimeoutError, Sender};
use dermis_body::{Body, SpatialTouch, Wrench, trusted_force};
use dermis_device::acquire::{Acquisition, Next};
use dermis_device::{Frame, HostStamp, RealTime};
use dermis_live::latency::RecentLatencies;
use dermis_live::pipeline::Pipeline;
use dermis_live::skin_frame::SkinFrame;
use dermis_record::guard_socket::GuardPublisher;
use dermis_record::sink::{JsonLines, LinesFor};
use dermis_record::{ForceAndTorque, LiveFeed, LiveRecording, LiveRequest, Publisher};
use dermis_touch::Touch;

use super::joints::{JointFeed, JointsState};
use super::line::BodyExtras;
use super::loads::Loads;
use super::report::{PatchHealth, PatchReport, PatchState, TouchInFrames};

/// Wait for a frame between checks of the stop flag.
const NAP: Duration = Duration::from_millis(50);
/// A patch is silent after this many frame periods of its skin without a frame.
const SILENT_PERIODS: f64 = 10.0;
/// Minimum time without a frame before a patch is silent.
const LEAST_SILENCE: Duration = Duration::from_millis(500);

/// A row of the health table, updated by a patch's thread and readable by anyone.
#[derive(Clone, Debug)]
pub(super) struct SharedHealth(Arc<Mutex<PatchHealth>>);

impl SharedHealth {
    pub fn new(name: &str) -> Self {
        Self(Arc::new(Mutex::new(PatchHealth {
            patch: name.to_owned(),
            state: PatchState::Starting,
            frames: 0,
            lost: 0,
            damaged: 0,
            dropped: 0,
            unread: 0,
            not_recorded: 0,
            not_shown: 0,
            recording_problem: None,
            touches: 0,
            channels_left_out: 0,
            latency_p99_ms: f64::NAN,
            problem: None,
        })))
    }

    pub fn get(&self) -> PatchHealth {
        self.row().clone()
    }

    pub fn fail(&self, reason: String) {
        self.row().state = PatchState::Failed(reason);
    }

    fn row(&self) -> MutexGuard<'_, PatchHealth> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A viewer of one patch: the feed it is shown and the commands it sends.
#[cfg_attr(not(feature = "foxglove"), allow(dead_code, reason = "there are no viewers"))]
pub(super) struct Viewer {
    pub patch: usize,
    pub feed: LiveFeed,
    pub requests: Receiver<LiveRequest>,
}

/// State of a patch's thread.
pub(super) struct PatchThread {
    pub number: usize,
    pub body: Arc<Body>,
    pub acquisition: Acquisition,
    /// True if the source can wait for its frames to be taken; reports then wait too.
    pub waits: bool,
    pub pipeline: Pipeline,
    pub joints: JointFeed,
    pub loads: Arc<Loads>,
    pub health: SharedHealth,
    pub reports: Sender<PatchReport>,
    pub stop: Arc<AtomicBool>,
    pub guard: Option<GuardPublisher>,
    pub recording: Option<LiveRecording>,
    /// Viewers.
    pub feeds: Vec<LiveFeed>,
    /// Commands of viewers.
    pub requests: Vec<Receiver<LiveRequest>>,
    pub publishers: Vec<Box<dyn Publisher>>,
    /// True if every patch on the link measures forces. Otherwise a net wrench without touches would mean nothing.
    pub link_tells_forces: bool,
    /// The same for all patches of the body.
    pub body_tells_forces: bool,
    pub lines: bool,
    pub most_frames: Option<u64>,
    pub recent: RecentLatencies<1>,
}

/// Marks the patch as failed if its thread panics.
struct Panicking {
    health: SharedHealth,
    loads: Arc<Loads>,
    number: usize,
}

impl Drop for Panicking {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let row = self.health.get();
            self.health.fail("an error in dermis, which is printed above".to_owned());
            self.loads.lose(self.number, format!("{}: failed", row.patch));
        }
    }
}

impl PatchThread {
    /// Runs until the source ends or fails, the requested frames are done, or the body stops.
    pub fn run(mut self) {
        let (health, loads) = (self.health.clone(), self.loads.clone());
        let _told = Panicking { health, loads, number: self.number };
        let _real_time = self.acquisition.is_instrument().then(RealTime::request);
        let name = self.body.patches[self.number].name.clone();
        let state = match self.follow() {
            Ok(()) => PatchState::Ended,
            Err(error) => {
                tracing::error!("patch {name}: {error}");
                let reason = error.to_string();
                self.publishers.iter_mut().for_each(|publisher| publisher.idle(Some(&reason)));
                PatchState::Failed(reason)
            }
        };
        self.loads.lose(self.number, format!("{name}: {}", state.name()));
        self.guard.iter().for_each(GuardPublisher::end);
        let recorded = self.recording.take().map(LiveRecording::finish);
        let reason = if let PatchState::Failed(reason) = &state { reason.as_str() } else { "no more frames" };
        self.feeds.iter().for_each(|feed| feed.event(state.name(), reason, &[]));
        let not_shown = self.feeds.drain(..).map(|feed| feed.status().dropped).sum();
        let mut row = self.health.row();
        if let Some(end) = recorded {
            if let Some(error) = &end.error {
                tracing::error!("patch {name}: the recording is incomplete: {error}");
            }
            (row.not_recorded, row.recording_problem) = (end.lost, end.error);
        }
        row.not_shown = not_shown;
        row.state = state;
        // If there was no other problem, a file may have ended early.
        row.problem = row.problem.take().or_else(|| self.acquisition.incomplete());
    }

    fn follow(&mut self) -> Result<(), Error> {
        let rate = self.body.patches[self.number].skin.backend.frame_rate_hz();
        let silence = Duration::from_secs_f64(SILENT_PERIODS / rate.max(1e-3)).max(LEAST_SILENCE);
        let (mut last, mut done) = (Instant::now(), 0);
        let mut lines = JsonLines::new(Vec::new(), "line", LinesFor::EveryFrame);
        while !self.stop.load(Ordering::Relaxed) && self.most_frames.is_none_or(|most| done < most) {
            self.answer();
            match self.acquisition.next(NAP)? {
                Next::End => return Ok(()),
                Next::Idle => self.wait(last.elapsed() > silence),
                Next::Frame(frame) => {
                    let result = self.frame(&frame, &mut lines);
                    self.acquisition.recycle(frame);
                    result?;
                    (last, done) = (Instant::now(), done + 1);
                }
            }
        }
        Ok(())
    }

    /// Carries out the commands of viewers and publishers between two frames.
    fn answer(&mut self) {
        let mut waiting: Vec<LiveRequest> = self.requests.iter().flat_map(Receiver::try_iter).collect();
        waiting.extend(self.publishers.iter_mut().filter_map(|publisher| publisher.take_request()));
        for request in waiting {
            request.carry_out(&mut self.pipeline, |event, detail, values| {
                let feeds = self.recording.as_deref().into_iter().chain(&self.feeds);
                feeds.for_each(|feed| feed.event(event, detail, values));
                self.publishers.iter_mut().for_each(|publisher| publisher.event(event, detail, values));
            });
        }
    }

    /// Everything that receives the raw frames and the results.
    fn feeds(&mut self) -> impl Iterator<Item = &mut LiveFeed> {
        self.recording.as_deref_mut().into_iter().chain(&mut self.feeds)
    }

    /// Updates the state when no frame has come.
    fn wait(&mut self, is_silent: bool) {
        let problem = self.acquisition.problem();
        self.publishers.iter_mut().for_each(|publisher| publisher.idle(problem.as_deref()));
        if is_silent {
            let name = &self.body.patches[self.number].name;
            self.loads.lose(self.number, format!("{name}: silent"));
        }
        let mut row = self.health.row();
        if is_silent {
            if row.state != PatchState::Silent {
                let reason = problem.as_deref().unwrap_or("no frames arrive");
                self.feeds.iter().for_each(|feed| feed.event("silent", reason, &[]));
            }
            row.state = PatchState::Silent;
        }
        row.problem = problem;
    }

    fn frame(&mut self, frame: &Frame, lines: &mut JsonLines<Vec<u8>>) -> Result<(), Error> {
        let baselines = self.pipeline.baseline_records().len();
        // Hand on the raw frame before it is processed.
        self.feeds().for_each(|feed| feed.frame(frame));
        self.publishers.iter_mut().for_each(|publisher| publisher.frame(frame));
        let patch = &self.body.patches[self.number];
        let output = self.pipeline.process(frame, HostStamp::now().monotonic_ns)?;
        // Before anything else, because the robot waits for the verdict.
        if let (Some(guard), Some(report)) = (&self.guard, output.guard) {
            guard.publish(output.sequence, report);
        }
        self.recording.as_deref_mut().into_iter().chain(&mut self.feeds).for_each(|feed| feed.results(&output));
        self.publishers.iter_mut().for_each(|publisher| publisher.results(&output));
        let SkinFrame { sequence, time_ns, is_ready, ref touches, .. } = output;
        let channels_left_out = output.health.channels.len();
        let joints = self.joints.at(HostStamp::now().monotonic_ns);
        let is_known = joints.state != JointsState::Stale;
        let known = is_known.then_some(&joints.values);
        self.loads.set(self.number, &patch.name, &output, trusted_force);
        let (on_link, on_body) = (self.loads.on_link(&self.body, patch.link), self.loads.on_body(&self.body, known));
        let link = on_link.wrench.filter(|_| self.link_tells_forces).map(force_and_torque);
        let whole = on_body.wrench.filter(|_| self.body_tells_forces).map(force_and_torque);
        self.publishers.iter_mut().for_each(|publisher| publisher.wrenches(link, whole));
        let root_from_patch = known.and_then(|joints| self.body.root_from_patch(self.number, joints));
        let surface = patch.surface();
        if self.lines {
            let extras = BodyExtras {
                patch: &patch.name,
                link: self.body.kinematics.link_name(patch.link),
                root: self.body.root(),
                surface,
                link_from_patch: patch.link_from_patch,
                root_from_patch,
                joints: &joints,
                on_link: &on_link,
                on_body: &on_body,
                force: &trusted_force,
            };
            lines.accept_with(&output, &extras)?;
        }
        let in_frames = |touch: &Touch| {
            let in_patch = SpatialTouch::of(touch, &surface, trusted_force(touch));
            TouchInFrames {
                touch: *touch,
                in_patch,
                in_link: in_patch.in_frame(&patch.link_from_patch),
                in_root: root_from_patch.map(|place| in_patch.in_frame(&place)),
            }
        };
        let report = PatchReport {
            patch: self.number,
            sequence,
            time_ns,
            is_ready,
            touches: touches.iter().map(in_frames).collect(),
            joints,
            on_link,
            on_body,
            line: std::mem::take(lines.get_mut()),
        };
        if self.pipeline.baseline_records().len() > baselines {
            let feeds = self.recording.as_deref().into_iter().chain(&self.feeds);
            feeds.for_each(|feed| feed.baseline(&self.pipeline, frame.host_wall_ns));
        }
        let touches = report.touches.len();
        let is_read = self.publish(report);
        let counters = self.acquisition.counters();
        self.publishers.iter_mut().for_each(|publisher| publisher.state(&self.pipeline, counters));
        let now_ns = HostStamp::now().monotonic_ns;
        let latency_us = self.recent.quantiles_us([&self.pipeline.latencies().total], now_ns);
        let mut row = self.health.row();
        row.state = if is_ready { PatchState::Running } else { PatchState::Starting };
        row.frames += 1;
        (row.lost, row.damaged, row.dropped) = (counters.lost, counters.bad, counters.dropped);
        row.unread += u64::from(!is_read);
        (row.touches, row.channels_left_out) = (touches, channels_left_out);
        if let Some([[_, p99_us]]) = latency_us {
            row.latency_p99_ms = 1e-3 * p99_us;
        }
        row.problem = None;
        Ok(())
    }

    /// Queues a report; false if the queue is full. For sources that can wait, this waits for room, until the body
    /// stops or nobody reads reports any more.
    fn publish(&self, report: PatchReport) -> bool {
        if !self.waits {
            return self.reports.try_send(report).is_ok();
        }
        let mut report = report;
        while !self.stop.load(Ordering::Relaxed) {
            match self.reports.send_timeout(report, NAP) {
                Ok(()) => return true,
                Err(SendTimeoutError::Timeout(back)) => report = back,
                Err(SendTimeoutError::Disconnected(_)) => return false,
            }
        }
        true
    }
}

fn force_and_torque(wrench: Wrench) -> ForceAndTorque {
    [wrench.force_n, wrench.torque_nm]
}
