//! Shows one patch of a running body: on its own page, and on the body's. Lives on the patch's thread.

use std::collections::VecDeque;
use std::sync::Arc;

use crossbeam_channel::Receiver;
use dermis::body::{BodyWatch, JointsState};
use dermis::source::TwinControl;
use dermis_body::{SpatialTouch, Transform, trusted_force};
use dermis_device::acquire::AcquisitionCounters;
use dermis_device::{Frame, HostStamp};
use dermis_live::pipeline::Pipeline;
use dermis_live::skin_frame::SkinFrame;
use dermis_page::feed::PageFeed;
use dermis_page::message::Notice;
use dermis_page::{Announcer, BodyTouchView, PlacedTouchView};
use dermis_record::{ForceAndTorque, LiveCommand, LiveRequest, Publisher};
use dermis_touch::{Touch, TouchPhase};

use super::super::twin_requests;
use super::board::PatchBoard;
use crate::page::{self, Command, Hub, Level, Reply, Request, SourceState};

/// Most page requests that a patch takes per frame.
pub(super) const MOST_REQUESTS: usize = 256;
/// Millimetres per metre.
const MM: f64 = 1e3;

/// Publishes a patch to its own page and to the body's.
pub(super) struct PagePublisher {
    pub number: usize,
    pub watch: BodyWatch,
    pub board: Arc<PatchBoard>,
    pub twin: Option<TwinControl>,
    pub feed: PageFeed,
    pub announcer: Announcer,
    /// The patch's own page.
    pub hub: Hub,
    /// The body's page.
    pub body_hub: Hub,
    /// Requests of both.
    pub requests: Receiver<Request>,
    /// Requests for the pipeline, which takes one per frame.
    pub waiting: VecDeque<(Command, Reply)>,
    /// Baselines seen.
    pub baselines: usize,
}

impl PagePublisher {
    /// Announces on both pages, on the body's with the name of the patch.
    fn announce(&self, level: Level, text: &str) {
        self.hub.announce(level, text);
        let name = &self.watch.body().patches[self.number].name;
        self.body_hub.announce(level, format!("{name}: {text}"));
    }

    fn publish(&self) {
        if let Err(error) = self.hub.publish(self.feed.update()) {
            tracing::error!("not shown: {error}");
        }
    }

    fn touches(&self, touches: &[Touch]) -> Vec<BodyTouchView> {
        let body = self.watch.body();
        let surface = body.patches[self.number].surface();
        let joints = self.watch.joints_at(HostStamp::now().monotonic_ns);
        let known = (joints.state != JointsState::Stale).then_some(&joints.values);
        let root_from_patch: Option<Transform> = known.and_then(|joints| body.root_from_patch(self.number, joints));
        let view = |touch: &Touch| {
            // A touch that has ended exerts no force.
            let force = (touch.phase != TouchPhase::End).then(|| trusted_force(touch)).flatten();
            let in_patch = SpatialTouch::of(touch, &surface, force);
            BodyTouchView {
                id: touch.id,
                phase: match touch.phase {
                    TouchPhase::Begin => page::TouchPhase::Begin,
                    TouchPhase::Move => page::TouchPhase::Move,
                    TouchPhase::End => page::TouchPhase::End,
                },
                sheet_mm: touch.position_m.map(|m| MM * m),
                radius_mm: touch.footprint_radius_m().map(|m| MM * m),
                force_n: force.map(|force| force.force_n),
                sigma_force_n: force.map(|force| force.sigma_n),
                in_patch: placed(&in_patch),
                in_root: root_from_patch.map(|place| placed(&in_patch.in_frame(&place))),
            }
        };
        touches.iter().map(view).collect()
    }
}

fn placed(touch: &SpatialTouch) -> PlacedTouchView {
    PlacedTouchView {
        position_mm: touch.position_m.map(|m| MM * m),
        sigma_mm: [0, 1, 2].map(|axis| MM * touch.covariance_m2[axis][axis].max(0.0).sqrt()),
        normal: touch.normal,
        force_n: touch.force_n,
    }
}

impl Publisher for PagePublisher {
    fn frame(&mut self, _frame: &Frame) {}

    fn results(&mut self, output: &SkinFrame<'_>) {
        self.feed.show(output, HostStamp::now().monotonic_ns);
        for Notice { level, text } in self.announcer.notices(output) {
            tracing::warn!(frame = output.sequence, "{text}");
            self.announce(level, &text);
        }
        let touches = self.touches(&output.touches);
        let update = self.feed.update();
        self.board.post(|posted| {
            posted.version += 1;
            (posted.frame, posted.time_ns) = (output.sequence, output.time_ns);
            posted.image.clear();
            posted.image.extend_from_slice(&output.image);
            (posted.touches, posted.guard) = (touches, output.guard);
            (posted.fps, posted.demonstrates) = (update.fps, update.state.demonstrates);
        });
    }

    fn state(&mut self, pipeline: &Pipeline, counters: AcquisitionCounters) {
        self.feed.count(counters, None);
        self.feed.describe(pipeline, HostStamp::now().monotonic_ns);
        self.publish();
        if pipeline.baseline_records().len() > self.baselines {
            self.baselines = pipeline.baseline_records().len();
            let (_, noise) = pipeline.baseline();
            self.hub.publish_noise(&noise.iter().map(|v| *v as f32).collect::<Vec<_>>());
        }
        let notices = self.twin.iter().flat_map(|twin| twin.notices.try_iter());
        notices.for_each(|text| self.announce(Level::Warning, &text));
    }

    fn idle(&mut self, problem: Option<&str>) {
        if self.feed.wait(problem.map(str::to_owned), HostStamp::now().monotonic_ns) {
            self.publish();
        }
    }

    fn wrenches(&mut self, _on_link: Option<ForceAndTorque>, on_body: Option<ForceAndTorque>) {
        self.board.post(|posted| posted.body_wrench = on_body);
    }

    fn event(&mut self, _event: &str, _detail: &str, _values: &[f64]) {}

    fn take_request(&mut self) -> Option<LiveRequest> {
        for request in page::coalesced(self.requests.try_iter().take(MOST_REQUESTS)) {
            self.waiting.extend(twin_requests::carry_out(request, self.twin.as_ref(), &mut self.feed));
        }
        while let Some((command, reply)) = self.waiting.pop_front() {
            let command = match command {
                Command::Tare { force } => LiveCommand::Tare { force },
                Command::Hyperparameter(value) => LiveCommand::Hyperparameter(value),
                Command::RecordStart | Command::RecordStop => {
                    reply.refuse(
                        "a body is recorded as a whole, from its start: dermis run BODY.toml --record FILE.mcap",
                    );
                    continue;
                }
                // All channels are published and the page selects. Commands to the twin have been handled already.
                _ => continue,
            };
            return Some(LiveRequest::new(command, "requested on the page", |done| match done {
                Ok(text) => reply.accept(text),
                Err(text) => reply.refuse(text),
            }));
        }
        None
    }
}

impl Drop for PagePublisher {
    /// The patch's thread has ended, so there will be no more frames.
    fn drop(&mut self) {
        if !matches!(self.feed.update().state.source, SourceState::Lost { .. }) {
            self.feed.end();
        }
        self.publish();
    }
}
