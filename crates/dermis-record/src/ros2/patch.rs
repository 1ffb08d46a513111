//! The publisher of one patch: turns frames, results and states into messages for the node's thread.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crossbeam_channel::{Receiver, Sender};
use dermis_body::{Press, Transform, Wrench, mount_transform, presses, trusted_force};
use dermis_device::acquire::AcquisitionCounters;
use dermis_device::{Frame, HostStamp};
use dermis_live::pipeline::Pipeline;
use dermis_live::skin_frame::SkinFrame;
use dermis_skin::Skin;

use super::messages::{self, NamedTransform};
use super::shape::{PatchLimits, PatchShape};
use super::status::{PatchStatus, SharedStatus};
use super::topics::OfPatch;
use crate::events::EventWatch;
use crate::live_request::LiveRequest;
use crate::messages::{Stamp, origin_name, write_event, write_touches};
use crate::publisher::{ForceAndTorque, Publisher};
use crate::view::SkinView;

/// Interval between updates of a patch's state, nanoseconds: ten per message of diagnostics.
const STATE_EVERY_NS: u64 = 100_000_000;
/// Messages of one image: the cells, the image itself, the points of touches.
const CLOUDS: u64 = 3;
/// Origin of every frame of reference.
const ORIGIN: [f64; 3] = [0.0; 3];

/// Everything about a patch that is known before its first frame.
#[derive(Debug)]
pub struct PatchHead {
    /// Its frame of reference.
    pub(super) frame_id: String,
    /// Name below the node's, if the node has several patches.
    pub(super) name: Option<String>,
    pub(super) shape: PatchShape,
    pub(super) skin: Skin,
    pub(super) view: SkinView,
    pub(super) limits: PatchLimits,
    pub(super) mount: Option<NamedTransform>,
    pub(super) events: EventWatch,
}

impl PatchHead {
    /// A patch in a frame of reference of this name, mounted as in its skin file. `source` names the source of its
    /// frames.
    pub fn new(pipeline: &Pipeline, frame_id: &str, source: &str) -> Self {
        let head = Self::unmounted(pipeline, frame_id, source);
        match &pipeline.prepared().skin.mount {
            Some(mount) => head.on_link(&mount.link, mount_transform(mount.xyz_mm, mount.rpy_deg)),
            None => head,
        }
    }

    fn unmounted(pipeline: &Pipeline, frame_id: &str, source: &str) -> Self {
        Self {
            frame_id: frame_id.to_owned(),
            name: None,
            shape: PatchShape::new(pipeline, None, source),
            skin: pipeline.prepared().skin.clone(),
            view: SkinView::new(pipeline.prepared()).with_frame_id(frame_id),
            limits: PatchLimits::new(pipeline),
            mount: None,
            events: EventWatch::new(&pipeline.prepared().skin),
        }
    }

    /// Publishes the patch below this name.
    #[must_use]
    pub fn named(self, name: &str) -> Self {
        Self { name: Some(name.to_owned()), ..self }
    }

    /// Mounts the patch on a link of the robot.
    #[must_use]
    pub fn on_link(mut self, link: &str, link_from_patch: Transform) -> Self {
        let (parent, child) = (link.to_owned(), self.frame_id.clone());
        self.mount = Some(NamedTransform { parent, child, parent_from_child: link_from_patch });
        self.shape.link = Some(link.to_owned());
        self
    }
}

/// A message for the node's thread.
#[derive(Debug)]
pub(super) struct Item {
    /// Number of the topic.
    pub topic: usize,
    pub message: Vec<u8>,
}

/// The queue of a node.
#[derive(Clone, Debug)]
pub(super) struct Outbox {
    pub items: Sender<Item>,
    /// Messages that didn't fit.
    pub dropped: Arc<AtomicU64>,
    /// Images and clouds are not queued behind more messages than this.
    pub most_before_clouds: usize,
}

impl Outbox {
    /// Queues a message, or drops it.
    pub fn send(&self, topic: usize, message: Vec<u8>) {
        if self.items.try_send(Item { topic, message }).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// True if there is room for large messages.
    fn has_room(&self) -> bool {
        self.items.len() <= self.most_before_clouds
    }
}

/// Numbers of the topics of a patch: its own, and those of its link and body if it has them.
#[derive(Clone, Debug)]
pub(super) struct PatchTopics {
    pub first: usize,
    pub link_wrench: Option<usize>,
    pub body_wrench: Option<usize>,
    pub root: String,
}

/// Sends events, while the watch that finds them is borrowed.
struct Events<'a> {
    outbox: &'a Outbox,
    topics: &'a PatchTopics,
}

impl Events<'_> {
    fn send(&self, stamp: Stamp<'_>, event: &str, detail: &str, values: &[f64]) {
        let mut message = Vec::new();
        write_event(&mut message, stamp, event, detail, values);
        self.outbox.send(self.topics.first + OfPatch::Events as usize, message);
    }
}

/// Publishes one patch.
pub struct PatchPublisher {
    head: PatchHead,
    topics: PatchTopics,
    outbox: Outbox,
    status: SharedStatus,
    tares: Receiver<LiveRequest>,
    /// Interval between clouds, nanoseconds; `None` for no clouds.
    period_ns: Option<u64>,
    state: State,
}

/// The parts that change from frame to frame.
struct State {
    /// Baselines described so far.
    baselines: usize,
    /// Standard deviation of each cell at rest.
    sigmas: Vec<f32>,
    next_cloud_ns: u64,
    next_state_ns: u64,
    wall_ns: u64,
}

impl std::fmt::Debug for PatchPublisher {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("PatchPublisher").field("frame_id", &self.head.frame_id).finish_non_exhaustive()
    }
}

impl PatchPublisher {
    pub(super) fn new(
        head: PatchHead,
        topics: PatchTopics,
        outbox: Outbox,
        status: SharedStatus,
        tares: Receiver<LiveRequest>,
        period_ns: Option<u64>,
    ) -> Self {
        let state = State {
            baselines: 0,
            sigmas: Vec::new(),
            next_cloud_ns: 0,
            next_state_ns: 0,
            wall_ns: HostStamp::now().wall_ns,
        };
        let publisher = Self { head, topics, outbox, status, tares, period_ns, state };
        let shape = messages::patch(publisher.stamp(), &publisher.head.shape, &publisher.head.limits, &[], None);
        publisher.send(OfPatch::Shape, shape);
        publisher
    }

    fn stamp(&self) -> Stamp<'_> {
        Stamp { wall_ns: self.state.wall_ns, frame_id: &self.head.frame_id }
    }

    fn send(&self, topic: OfPatch, message: Vec<u8>) {
        self.outbox.send(self.topics.first + topic as usize, message);
    }

    /// Sends the shape again after a new baseline, with its noise.
    fn describe(&mut self, pipeline: &Pipeline) {
        let records = pipeline.baseline_records();
        let Some(record) = records.last().filter(|_| records.len() != self.state.baselines) else { return };
        let Some(noise) = pipeline.noise_image() else { return };
        self.state.baselines = records.len();
        let pixels = self.head.shape.cells.pixels.iter();
        self.state.sigmas = pixels.map(|pixel| noise.get(*pixel as usize).copied().unwrap_or(f32::NAN)).collect();
        let baseline = Some((record, origin_name(record.origin)));
        let PatchHead { shape, limits, .. } = &self.head;
        let message = messages::patch(self.stamp(), shape, limits, &self.state.sigmas, baseline);
        self.send(OfPatch::Shape, message);
    }

    /// Sends image, cells and points of touches, if they are due.
    fn clouds(&mut self, output: &SkinFrame<'_>) {
        let Some(period_ns) = self.period_ns else { return };
        let now_ns = HostStamp::now().monotonic_ns;
        if now_ns < self.state.next_cloud_ns || !output.image.iter().any(|value| value.is_finite()) {
            return;
        }
        // Keep the average rate, catching up by at most half a period.
        let next_ns = self.state.next_cloud_ns.saturating_add(period_ns);
        self.state.next_cloud_ns = next_ns.max(now_ns.saturating_add(period_ns / 2));
        if !self.outbox.has_room() {
            self.outbox.dropped.fetch_add(CLOUDS, Ordering::Relaxed);
            return;
        }
        let cells = messages::cells(self.stamp(), &self.head.shape.cells, &self.state.sigmas, &output.image);
        self.send(OfPatch::Points, cells);
        let mut image = Vec::new();
        self.head.view.write_image(&mut image, output.wall_ns, &output.image);
        self.send(OfPatch::Image, image);
        let mut points = Vec::new();
        self.head.view.write_touch_points(&mut points, output.wall_ns, &output.touches);
        self.send(OfPatch::TouchPoints, points);
    }

    /// Sends the touches and their wrenches. While a fault leaves the touches unknown, sends a message only if a touch
    /// has ended.
    fn touches(&self, output: &SkinFrame<'_>) {
        let has_ended = !output.ended.is_empty();
        let is_known = self.state.baselines > 0 && output.health.frame.is_none();
        if is_known || has_ended {
            let mut message = Vec::new();
            let SkinFrame { sequence, time_ns, touches, ended, .. } = output;
            write_touches(&mut message, self.stamp(), *sequence, *time_ns, touches, ended);
            self.send(OfPatch::Touches, message);
        }
        if !is_known || self.head.limits.force_from.is_none() {
            return;
        }
        let (known, unknown) = presses(&output.touches, trusted_force);
        let surface = self.head.skin.surface();
        let of = |press: &Press| Wrench::of(press, &surface, &Transform::IDENTITY, ORIGIN);
        let mut net = Wrench::none_about(ORIGIN);
        for wrench in known.iter().map(of) {
            self.send(OfPatch::Wrenches, messages::wrench(self.stamp(), wrench.force_n, wrench.torque_nm));
            net = net.plus(&wrench);
        }
        if unknown.is_empty() {
            self.send(OfPatch::Wrench, messages::wrench(self.stamp(), net.force_n, net.torque_nm));
        }
    }
}

impl Publisher for PatchPublisher {
    fn frame(&mut self, frame: &Frame) {
        self.state.wall_ns = frame.host_wall_ns;
        let (to, stamp) = (
            Events { outbox: &self.outbox, topics: &self.topics },
            Stamp { wall_ns: frame.host_wall_ns, frame_id: &self.head.frame_id },
        );
        self.head.events.frame(frame, |event, detail, values| to.send(stamp, event, detail, values));
    }

    fn results(&mut self, output: &SkinFrame<'_>) {
        // The guard comes first; everything else can wait.
        if let Some(report) = output.guard {
            self.send(OfPatch::Guard, messages::guard(self.stamp(), output.sequence, &report));
        }
        self.touches(output);
        let (to, stamp) = (
            Events { outbox: &self.outbox, topics: &self.topics },
            Stamp { wall_ns: output.wall_ns, frame_id: &self.head.frame_id },
        );
        self.head.events.results(output, |event, detail, values| to.send(stamp, event, detail, values));
        self.clouds(output);
    }

    fn state(&mut self, pipeline: &Pipeline, counters: AcquisitionCounters) {
        self.describe(pipeline);
        let now_ns = HostStamp::now().monotonic_ns;
        if now_ns < self.state.next_state_ns {
            return;
        }
        self.state.next_state_ns = now_ns + STATE_EVERY_NS;
        self.status.set(PatchStatus::new(pipeline, counters));
    }

    fn idle(&mut self, problem: Option<&str>) {
        self.status.set_problem(problem);
    }

    fn wrenches(&mut self, on_link: Option<ForceAndTorque>, on_body: Option<ForceAndTorque>) {
        let link = self.head.shape.link.as_deref().unwrap_or_default();
        let to = [(self.topics.link_wrench, link, on_link), (self.topics.body_wrench, &self.topics.root, on_body)];
        for (topic, frame_id, wrench) in to {
            if let (Some(topic), Some([force_n, torque_nm])) = (topic, wrench) {
                let stamp = Stamp { wall_ns: self.state.wall_ns, frame_id };
                self.outbox.send(topic, messages::wrench(stamp, force_n, torque_nm));
            }
        }
    }

    fn event(&mut self, event: &str, detail: &str, values: &[f64]) {
        let to = Events { outbox: &self.outbox, topics: &self.topics };
        to.send(self.stamp(), event, detail, values);
    }

    fn take_request(&mut self) -> Option<LiveRequest> {
        self.tares.try_recv().ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_queue_costs_messages_and_no_time() {
        let (items, queue) = crossbeam_channel::bounded(4);
        let outbox = Outbox { items, dropped: Arc::default(), most_before_clouds: 2 };
        (0..10).for_each(|number| outbox.send(number, vec![number as u8]));
        assert_eq!((outbox.dropped.load(Ordering::Relaxed), outbox.has_room()), (6, false));
        let kept: Vec<usize> = queue.try_iter().map(|item| item.topic).collect();
        assert_eq!((kept, outbox.has_room()), (vec![0, 1, 2, 3], true));
    }
}
