//! Starts the server, gives each patch its channels, and stops it.

use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use ::foxglove::websocket::{Capability, ChannelView, Client, Parameter, ServerListener, ShutdownHandle};
use ::foxglove::{Context, FoxgloveError, WebSocketServer};
use crossbeam_channel::{Receiver, bounded};
use dermis_live::pipeline::Pipeline;
use dermis_skin::GuardSettings;

use super::address::FoxgloveAddress;
use super::channels::{CommonChannels, Kept, PatchChannels, encoded};
use super::parameters::{self, HYPERPARAMETER, Parameters, Running};
use super::publisher::{Losses, Publisher};
use super::scene::Scene;
use super::tare;
use super::transforms::{FramePose, message};
use crate::live_feed::LiveFeed;
use crate::view::SkinView;
use crate::{Error, LiveRequest, messages};

/// Messages that may wait for a client; about two seconds' worth. Beyond that it loses the oldest. Replies and
/// statuses have a queue of the same size, and a client that lets it fill up is disconnected.
pub const CLIENT_QUEUE: usize = 512;

/// Frames that may wait for the publishing thread.
const QUEUE: usize = 64;
/// Commands that may wait for a pipeline.
const REQUESTS: usize = 16;
/// Time for saying goodbye to the clients.
const GOODBYE: Duration = Duration::from_millis(300);

/// A running server.
pub struct FoxgloveServer {
    address: FoxgloveAddress,
    context: Arc<Context>,
    server: Arc<Running>,
    common: CommonChannels,
    kept: Arc<Subscriptions>,
    parameters: Parameters,
}

/// One patch of a body, or a single skin.
#[derive(Clone, Debug, Default)]
pub struct FoxglovePatch {
    /// Name of the patch on a body; `None` for a single skin.
    pub name: Option<String>,
    /// Frame of reference of the skin.
    pub frame_id: String,
    /// Pose of that frame in its link, if it doesn't come with [`FoxgloveServer::transforms`].
    pub mount: Option<FramePose>,
    /// The guard's limits in use.
    pub guard: Option<GuardSettings>,
}

impl std::fmt::Debug for FoxgloveServer {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("FoxgloveServer").field("address", &self.address).finish_non_exhaustive()
    }
}

impl FoxgloveServer {
    /// Starts a server for a skin or body of this name. `has_joints` adds `/joint_states`.
    ///
    /// # Errors
    /// [`Error::Listen`] if the address cannot be used.
    pub fn open(address: &FoxgloveAddress, name: &str, has_joints: bool) -> Result<Self, Error> {
        let refused = |error| refused(address, error);
        let (context, server) = (Context::new(), Arc::new(Running::default()));
        let common = CommonChannels::open(&context, has_joints).map_err(refused)?;
        let kept = Arc::new(Subscriptions(Mutex::new(common.kept().collect())));
        let parameters = Parameters::new(server.clone());
        parameters.publish(vec![
            Parameter::string("name", name),
            Parameter::string("dermis_version", env!("CARGO_PKG_VERSION")),
        ]);
        let handle = WebSocketServer::new()
            .name(format!("dermis {}: {name}", env!("CARGO_PKG_VERSION")))
            .bind(address.host(), address.port())
            .context(&context)
            .capabilities([Capability::Services, Capability::Parameters])
            .supported_encodings(["json"])
            .parameter_handler(Arc::new(parameters.clone()))
            .listener(kept.clone())
            .message_backlog_size(CLIENT_QUEUE)
            .start_blocking()
            .map_err(refused)?;
        let address = address.with_port(handle.port());
        server.set(handle);
        Ok(Self { address, context, server, common, kept, parameters })
    }

    /// The address, with the port in use.
    pub fn address(&self) -> &FoxgloveAddress {
        &self.address
    }

    /// Adds a patch. Its pipeline feeds the [`LiveFeed`], and carries out the requests between frames.
    ///
    /// # Errors
    /// [`Error::Listen`] for a second patch of the same name, an I/O error if the operating system refuses a thread.
    pub fn patch(&self, patch: FoxglovePatch, pipeline: &Pipeline) -> Result<(LiveFeed, Receiver<LiveRequest>), Error> {
        let FoxglovePatch { name, frame_id, mount, guard } = patch;
        let refused = |error| refused(&self.address, error);
        let channels = PatchChannels::open(&self.context, name.as_deref()).map_err(refused)?;
        self.kept.add(channels.kept());
        let (send, requests) = bounded(REQUESTS);
        let service = tare::service(name.as_deref(), send.clone());
        self.server.with(|handle| handle.add_services([service])).transpose().map_err(refused)?;
        let prefix = name.as_ref().map_or(String::new(), |name| format!("{name}."));
        self.parameters.allow(format!("{prefix}{HYPERPARAMETER}"), send);
        self.parameters.publish(guard.iter().flat_map(|guard| parameters::of_guard(&prefix, guard)).collect());
        let skin = &pipeline.prepared().skin;
        let publisher = Publisher {
            server: self.server.clone(),
            channels,
            log: self.common.log.clone(),
            transforms: self.common.transforms.clone(),
            mount,
            view: SkinView::new(pipeline.prepared()).with_frame_id(&frame_id),
            scene: Scene::new(skin, &frame_id),
            scene_ns: 0,
            parameters: self.parameters.clone(),
            prefix,
            name: name.unwrap_or_else(|| skin.name.clone()),
            frames: 0,
            losses: Losses::default(),
            beaten: None,
            bytes: Vec::new(),
        };
        let feed = LiveFeed::start(publisher, &format!("server at {}", self.address), QUEUE, pipeline)?;
        Ok((feed, requests))
    }

    /// Publishes poses of frames of reference.
    pub fn transforms(&self, wall_ns: u64, poses: &[FramePose]) {
        self.common.transforms.log(wall_ns, &encoded(&message(wall_ns, poses)));
    }

    /// Publishes joint values, radians or metres, as a `sensor_msgs/JointState`.
    pub fn joints<'a>(&self, wall_ns: u64, joints: impl ExactSizeIterator<Item = (&'a str, f64)>) {
        if let Some(channel) = &self.common.joints {
            let mut bytes = Vec::new();
            messages::write_joints(&mut bytes, wall_ns, joints);
            channel.log(wall_ns, &bytes);
        }
    }
}

impl Drop for FoxgloveServer {
    fn drop(&mut self) {
        let Some(handle) = self.server.take() else { return };
        // Says goodbye on another thread, because a client that doesn't read would delay it forever.
        let (done, ended) = bounded::<()>(0);
        let stopping: ShutdownHandle = handle.stop();
        let thread = std::thread::Builder::new().name("dermis-foxglove-end".to_owned()).spawn(move || {
            stopping.wait_blocking();
            drop(done);
        });
        if thread.is_ok() {
            let _ = ended.recv_timeout(GOODBYE);
        }
    }
}

/// Sends the last message of some channels to new subscribers.
struct Subscriptions(Mutex<Vec<Arc<Kept>>>);

impl Subscriptions {
    fn add(&self, kept: [Arc<Kept>; 2]) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).extend(kept);
    }
}

impl ServerListener for Subscriptions {
    fn on_subscribe(&self, client: Client, channel: ChannelView<'_>) {
        let kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let found = kept.iter().find(|kept| kept.channel().id() == channel.id()).cloned();
        drop(kept);
        if let (Some(found), Some(sink)) = (found, client.sink_id()) {
            found.repeat(sink);
        }
    }
}

fn refused(address: &FoxgloveAddress, error: FoxgloveError) -> Error {
    let source = match error {
        FoxgloveError::Bind(source) | FoxgloveError::IoError(source) => source,
        other => io::Error::other(other.to_string()),
    };
    let advice = match source.kind() {
        io::ErrorKind::AddrInUse => "; another program uses this port: choose another one, or 0 for a free one",
        io::ErrorKind::AddrNotAvailable => "; this machine has no such address: 127.0.0.1 and 0.0.0.0 always work",
        _ => "",
    };
    Error::Listen { address: address.to_string(), source, advice }
}
