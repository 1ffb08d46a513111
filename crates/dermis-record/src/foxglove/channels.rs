//! The server's channels. Those that recordings also have take their schemas from [`crate::schema`].

use std::sync::{Arc, Mutex, PoisonError};

use ::foxglove::messages::{FrameTransforms, Log, SceneUpdate};
use ::foxglove::{ChannelBuilder, Context, Encode, FoxgloveError, PartialMetadata, RawChannel, SinkId};

use crate::schema::{self, Schema, topic_of};

/// Topics for viewers only.
pub(super) const SCENE: &str = "/dermis/scene";
pub(super) const TRANSFORMS: &str = "/dermis/transforms";
pub(super) const LOG: &str = "/dermis/log";

/// A channel whose last message goes to every new subscriber, because the next one may take long.
pub(super) struct Kept {
    channel: Arc<RawChannel>,
    /// Log time and content.
    last: Mutex<Option<(u64, Vec<u8>)>>,
}

impl Kept {
    fn new(channel: Arc<RawChannel>) -> Arc<Self> {
        Arc::new(Self { channel, last: Mutex::default() })
    }

    pub(super) fn channel(&self) -> &RawChannel {
        &self.channel
    }

    pub(super) fn log(&self, wall_ns: u64, message: &[u8]) {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        let (time, bytes) = last.get_or_insert_default();
        *time = wall_ns;
        bytes.clear();
        bytes.extend_from_slice(message);
        // Send under the lock, so that a new subscriber gets this message at least once and no older one after it.
        log(&self.channel, wall_ns, message);
    }

    /// Sends the last message to a new subscriber.
    pub(super) fn repeat(&self, to: SinkId) {
        if let Some((wall_ns, message)) = &*self.last.lock().unwrap_or_else(PoisonError::into_inner) {
            self.channel.log_with_meta_to_sink(message, PartialMetadata::with_log_time(*wall_ns), Some(to));
        }
    }
}

/// The channels of one patch, or of a single skin.
pub(super) struct PatchChannels {
    pub(super) frames: Arc<RawChannel>,
    pub(super) baselines: Arc<Kept>,
    pub(super) touches: Arc<RawChannel>,
    pub(super) events: Arc<RawChannel>,
    pub(super) image: Arc<RawChannel>,
    pub(super) points: Arc<RawChannel>,
    pub(super) touch_points: Arc<RawChannel>,
    pub(super) scene: Arc<Kept>,
}

impl PatchChannels {
    pub(super) fn open(context: &Arc<Context>, patch: Option<&str>) -> Result<Self, FoxgloveError> {
        let [frames, baselines, touches, events] = &schema::OWN;
        let [image, points, touch_points] = &schema::STANDARD;
        let of = |schema| recorded(context, schema, patch);
        Ok(Self {
            frames: of(frames)?,
            baselines: Kept::new(of(baselines)?),
            touches: of(touches)?,
            events: of(events)?,
            image: of(image)?,
            points: of(points)?,
            touch_points: of(touch_points)?,
            scene: Kept::new(shown::<SceneUpdate>(context, &topic_of(SCENE, patch))?),
        })
    }

    /// The channels whose last message goes to new subscribers.
    pub(super) fn kept(&self) -> [Arc<Kept>; 2] {
        [self.baselines.clone(), self.scene.clone()]
    }
}

/// The channels of the whole server.
pub(super) struct CommonChannels {
    pub(super) transforms: Arc<Kept>,
    pub(super) log: Arc<RawChannel>,
    pub(super) joints: Option<Arc<Kept>>,
}

impl CommonChannels {
    pub(super) fn open(context: &Arc<Context>, has_joints: bool) -> Result<Self, FoxgloveError> {
        let joints = has_joints.then(|| recorded(context, &schema::JOINTS, None)).transpose()?;
        Ok(Self {
            transforms: Kept::new(shown::<FrameTransforms>(context, TRANSFORMS)?),
            log: shown::<Log>(context, LOG)?,
            joints: joints.map(Kept::new),
        })
    }

    /// The channels whose last message goes to new subscribers.
    pub(super) fn kept(&self) -> impl Iterator<Item = Arc<Kept>> + '_ {
        std::iter::once(self.transforms.clone()).chain(self.joints.clone())
    }
}

/// A channel with a recording's schema.
fn recorded(context: &Arc<Context>, schema: &Schema, patch: Option<&str>) -> Result<Arc<RawChannel>, FoxgloveError> {
    let definition = ::foxglove::Schema::new(schema.name, "ros2msg", schema.text().into_bytes());
    let channel = ChannelBuilder::new(topic_of(schema.topic, patch)).context(context);
    channel.message_encoding("cdr").schema(definition).build_raw()
}

/// A channel for one of Foxglove's own message types.
fn shown<T: Encode>(context: &Arc<Context>, topic: &str) -> Result<Arc<RawChannel>, FoxgloveError> {
    let channel = ChannelBuilder::new(topic).context(context).schema(T::get_schema());
    channel.message_encoding(T::get_message_encoding()).build_raw()
}

/// Sends a message to the channel's subscribers.
pub(super) fn log(channel: &RawChannel, wall_ns: u64, message: &[u8]) {
    channel.log_with_meta(message, PartialMetadata::with_log_time(wall_ns));
}

/// Encodes one of Foxglove's own messages.
pub(super) fn encoded(message: &impl Encode) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(message.encoded_len().unwrap_or(0));
    // A vector grows as needed, which is the only way to fail.
    let _ = message.encode(&mut bytes);
    bytes
}
