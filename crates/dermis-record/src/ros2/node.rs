//! A node and its sending thread.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use dermis_device::HostStamp;
use rustdds::GUID;

use super::error::Ros2Error;
use super::messages::{self, NamedTransform};
use super::names::{NodeName, tokens_of};
use super::participant::{Participant, Sent, Writer, domain, no_multicast};
use super::patch::{Item, Outbox, PatchHead, PatchPublisher, PatchTopics};
use super::status::{SharedStatus, Traffic, Watch};
use super::tare::TareService;
use super::topics::{DIAGNOSTICS, PATCH_TOPICS, TARE, TF, TF_STATIC, Topic, WRENCH};
use crate::live_request::LiveRequest;

/// Messages that may wait: half a second at 1,000 frames per second and four messages per frame.
const QUEUE: usize = 2048;
/// With this many messages waiting, no further clouds are queued.
const QUEUE_FOR_CLOUDS: usize = QUEUE / 8;
/// Longest wait for a message before requests to services are checked.
const NAP: Duration = Duration::from_millis(10);
/// Maximum number of messages sent before requests are checked, even if more are waiting.
const MOST_IN_A_ROW: usize = 64;
/// Interval between messages of diagnostics, nanoseconds.
const DIAGNOSTICS_EVERY_NS: u64 = 1_000_000_000;

/// Options of a node.
#[derive(Clone, Debug, PartialEq)]
pub struct Ros2Options {
    /// Name of the node.
    pub node: NodeName,
    /// Maximum number of images and point clouds per second of each patch.
    pub clouds_per_s: f64,
}

impl Ros2Options {
    /// Images and point clouds per second by default.
    pub const CLOUDS_PER_S: f64 = 10.0;
}

impl Default for Ros2Options {
    fn default() -> Self {
        Self { node: NodeName::default(), clouds_per_s: Self::CLOUDS_PER_S }
    }
}

/// Everything that a node publishes.
#[derive(Debug, Default)]
pub struct NodeHead {
    /// The patches.
    pub patches: Vec<PatchHead>,
    /// Name of the body's root frame, if the patches are a body's.
    pub root: Option<String>,
    /// Transforms that don't change, in addition to the mounts of the patches.
    pub fixed: Vec<NamedTransform>,
}

/// Message counts over a node's lifetime.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ros2Summary {
    /// Messages sent.
    pub sent: u64,
    /// Messages dropped because the queue was full.
    pub dropped: u64,
    /// Messages refused by DDS because a reader acknowledged nothing.
    pub refused: u64,
}

/// A running node. Dropping it sends what is queued and leaves the domain.
#[derive(Debug)]
pub struct Ros2Node {
    publishers: Vec<Option<PatchPublisher>>,
    transforms: TransformPublisher,
    stop: Option<Sender<()>>,
    counts: Arc<Counts>,
    thread: Option<JoinHandle<()>>,
}

/// Counts shared with the thread.
#[derive(Debug, Default)]
struct Counts {
    sent: AtomicU64,
    refused: AtomicU64,
    dropped: Arc<AtomicU64>,
}

/// Publishes transforms that change.
#[derive(Clone, Debug)]
pub struct TransformPublisher {
    outbox: Outbox,
    topic: usize,
}

impl TransformPublisher {
    /// Publishes transforms at a time on the wall clock.
    pub fn publish(&self, wall_ns: u64, transforms: &[NamedTransform]) {
        self.outbox.send(self.topic, messages::transforms(wall_ns, transforms));
    }
}

impl Ros2Node {
    /// Joins the domain that `ROS_DOMAIN_ID` names, and starts sending.
    ///
    /// # Errors
    /// Names that ROS doesn't allow or that collide; a domain that doesn't exist or cannot be joined.
    pub fn open(options: &Ros2Options, head: NodeHead) -> Result<Self, Ros2Error> {
        let domain = domain()?;
        let names = tokens_of(head.patches.iter().filter_map(|patch| patch.name.as_deref()))?;
        let links = links_of(&head);
        let link_names = tokens_of(links.iter().map(String::as_str))?;
        if let Some(error) = no_multicast() {
            tracing::warn!(
                "no network interface supports multicast ({error}): programs on other machines will not find the ROS 2 node \
                 {}; on Linux, `ip link set dev INTERFACE multicast on` and a route for 224.0.0.0/4 help",
                options.node
            );
        }
        let participant = Participant::join(domain)?;
        let mut thread = NodeThread::new(participant, options.node.clone())?;
        let (items, queue) = bounded(QUEUE);
        let counts = Arc::new(Counts::default());
        let outbox = Outbox { items, dropped: counts.dropped.clone(), most_before_clouds: QUEUE_FOR_CLOUDS };
        // Topics of links and of the body come before those of patches.
        let root = head.root.unwrap_or_default();
        let body_wrench = (!root.is_empty()).then(|| thread.add(&options.node.topic(WRENCH.name), WRENCH));
        let body_wrench = body_wrench.transpose()?;
        let link_topic = |name: &String| options.node.topic(&format!("links/{name}/{}", WRENCH.name));
        let link_wrenches = link_names.iter().map(|name| thread.add(&link_topic(name), WRENCH));
        let link_wrenches = link_wrenches.collect::<Result<Vec<_>, _>>()?;
        let tf = thread.add(TF.name, TF)?;
        let tf_static = thread.add(TF_STATIC.name, TF_STATIC)?;
        let (mut fixed, mut publishers) = (head.fixed, Vec::new());
        let mut names = names.into_iter();
        for patch in head.patches {
            fixed.extend(patch.mount.clone());
            let prefix = match &patch.name {
                Some(_) => options.node.topic(&names.next().unwrap_or_default()),
                None => options.node.to_string(),
            };
            let link = patch.mount.as_ref().and_then(|mount| links.iter().position(|link| *link == mount.parent));
            let link_wrench = link.and_then(|link| link_wrenches.get(link).copied()).filter(|_| body_wrench.is_some());
            let first = thread.add_patch(&prefix)?;
            let topics = PatchTopics { first, link_wrench, body_wrench, root: root.clone() };
            let (tares, status) = thread.serve(&prefix, &patch)?;
            let publisher = PatchPublisher::new(patch, topics, outbox.clone(), status, tares, period_ns(options));
            publishers.push(Some(publisher));
        }
        if !fixed.is_empty() {
            outbox.send(tf_static, messages::transforms(HostStamp::now().wall_ns, &fixed));
        }
        let transforms = TransformPublisher { outbox, topic: tf };
        let (stop, stopped) = bounded(0);
        let (there, builder) = (counts.clone(), std::thread::Builder::new().name("dermis-ros2".to_owned()));
        let spawned = builder.spawn(move || thread.run(&queue, &stopped, &there));
        let thread = Some(spawned.map_err(|source| Ros2Error::Thread { source })?);
        Ok(Self { publishers, transforms, stop: Some(stop), counts, thread })
    }

    /// The publisher of a patch, by its index in [`NodeHead::patches`]; each can be taken once.
    pub fn publisher(&mut self, patch: usize) -> Option<PatchPublisher> {
        self.publishers.get_mut(patch)?.take()
    }

    /// The publisher of `/tf`.
    pub fn transforms(&self) -> TransformPublisher {
        self.transforms.clone()
    }

    /// Sends what is queued and leaves the domain.
    pub fn close(mut self) -> Ros2Summary {
        self.end();
        let get = |count: &AtomicU64| count.load(Ordering::Relaxed);
        let Counts { sent, refused, dropped } = &*self.counts;
        Ros2Summary { sent: get(sent), dropped: get(dropped), refused: get(refused) }
    }

    fn end(&mut self) {
        self.stop = None;
        if let Some(thread) = self.thread.take() {
            // A panic has been printed.
            let _ = thread.join();
        }
    }
}

impl Drop for Ros2Node {
    fn drop(&mut self) {
        self.end();
    }
}

/// Time between two clouds, nanoseconds; `None` for no clouds.
fn period_ns(options: &Ros2Options) -> Option<u64> {
    // The cast saturates.
    (options.clouds_per_s > 0.0).then(|| (1e9 / options.clouds_per_s) as u64)
}

/// The links that carry patches, each once.
fn links_of(head: &NodeHead) -> Vec<String> {
    let mut links: Vec<String> = Vec::new();
    let mounts = head.patches.iter().filter_map(|patch| patch.mount.as_ref());
    for mount in mounts.filter(|_| head.root.is_some()) {
        if !links.contains(&mount.parent) {
            links.push(mount.parent.clone());
        }
    }
    links
}

/// State of the thread.
struct NodeThread {
    participant: Participant,
    node: NodeName,
    discovery: Writer,
    writers: Vec<Writer>,
    services: Vec<TareService>,
    watches: Vec<Watch>,
    diagnostics: Writer,
    next_diagnostics_ns: u64,
}

impl NodeThread {
    fn new(participant: Participant, node: NodeName) -> Result<Self, Ros2Error> {
        let discovery = participant.discovery()?;
        let diagnostics = participant.writer(DIAGNOSTICS.name, DIAGNOSTICS.kind, DIAGNOSTICS.quality)?;
        let (writers, services, watches) = (Vec::new(), Vec::new(), Vec::new());
        Ok(Self { participant, node, discovery, writers, services, watches, diagnostics, next_diagnostics_ns: 0 })
    }

    /// Adds a topic, and returns its number.
    fn add(&mut self, name: &str, topic: Topic) -> Result<usize, Ros2Error> {
        self.writers.push(self.participant.writer(name, topic.kind, topic.quality)?);
        Ok(self.writers.len() - 1)
    }

    /// Adds the topics of a patch, and returns the number of the first.
    fn add_patch(&mut self, prefix: &str) -> Result<usize, Ros2Error> {
        let first = self.writers.len();
        for topic in PATCH_TOPICS {
            self.add(&format!("{prefix}/{}", topic.name), topic)?;
        }
        Ok(first)
    }

    /// Adds the service of a patch, and its diagnosis.
    fn serve(&mut self, prefix: &str, patch: &PatchHead) -> Result<(Receiver<LiveRequest>, SharedStatus), Ros2Error> {
        let (name, _) = TARE;
        let (service, tares) = TareService::new(&self.participant, &format!("{prefix}/{name}"))?;
        self.services.push(service);
        let status = SharedStatus::default();
        let title = format!("{}: {}", self.node.name(), patch.name.as_ref().unwrap_or(&patch.frame_id));
        let now_ns = HostStamp::now().monotonic_ns;
        self.watches.push(Watch::new(status.clone(), title, patch.shape.source.clone(), now_ns));
        Ok((tares, status))
    }

    fn announce(&mut self) {
        let (mut readers, mut writers): (Vec<GUID>, Vec<GUID>) = (Vec::new(), vec![self.diagnostics.guid()]);
        writers.extend(self.writers.iter().map(Writer::guid));
        for (reader, writer) in self.services.iter().map(TareService::guids) {
            readers.push(reader);
            writers.push(writer);
        }
        self.participant.announce(&mut self.discovery, &self.node, &writers, &readers);
    }

    /// Sends until told to stop, then sends the rest of the queue.
    fn run(mut self, queue: &Receiver<Item>, stopped: &Receiver<()>, counts: &Counts) {
        self.announce();
        loop {
            let has_ended = stopped.try_recv().is_err_and(|error| error.is_disconnected());
            match queue.recv_timeout(if has_ended { Duration::ZERO } else { NAP }) {
                Ok(item) => {
                    self.send(item, counts);
                    let more = queue.try_iter().take(MOST_IN_A_ROW);
                    more.for_each(|item| self.send(item, counts));
                }
                Err(_) if has_ended => break,
                Err(RecvTimeoutError::Timeout) => {}
                // All publishers are gone; the services still answer that the skin has ended.
                Err(RecvTimeoutError::Disconnected) => std::thread::sleep(NAP),
            }
            self.services.iter_mut().for_each(TareService::work);
            self.diagnose(counts);
        }
    }

    fn send(&mut self, Item { topic, message }: Item, counts: &Counts) {
        let Some(writer) = self.writers.get_mut(topic) else { return };
        let sent = writer.write(message, &self.participant);
        let count = if sent == Sent::Yes { &counts.sent } else { &counts.refused };
        count.fetch_add(1, Ordering::Relaxed);
        if sent == Sent::Restarted {
            tracing::warn!("a ROS 2 reader acknowledged nothing; its topic was restarted without it");
            self.announce();
        }
    }

    fn diagnose(&mut self, counts: &Counts) {
        let now = HostStamp::now();
        if now.monotonic_ns < self.next_diagnostics_ns {
            return;
        }
        self.next_diagnostics_ns = now.monotonic_ns + DIAGNOSTICS_EVERY_NS;
        let get = |count: &AtomicU64| count.load(Ordering::Relaxed);
        let traffic = Traffic { sent: get(&counts.sent), dropped: get(&counts.dropped), refused: get(&counts.refused) };
        let all: Vec<_> = self.watches.iter_mut().map(|watch| watch.diagnose(now.monotonic_ns, traffic)).collect();
        // A failure doesn't matter: they are sent again in a second.
        let _ = self.diagnostics.write(messages::diagnostics(now.wall_ns, &all), &self.participant);
    }
}
