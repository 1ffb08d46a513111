//! The DDS half of a node: topics by their names in ROS 2, messages as bytes, and the discovery topic that lists the
//! node's endpoints.

use std::convert::Infallible;
use std::env;
use std::net::{IpAddr, Ipv4Addr, UdpSocket};
use std::time::{Duration as StdDuration, Instant};

use rustdds::bytes::Bytes;
use rustdds::no_key::{DataReader, DataWriter, Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter};
use rustdds::policy::{Durability, History, Reliability};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, Duration, GUID, Publisher, QosPolicies, QosPolicyBuilder, RTPSEntity,
    RepresentationIdentifier, SampleIdentity, Subscriber, Topic, TopicKind, WriteOptionsBuilder,
};

use super::error::Ros2Error;
use super::messages;
use super::names::{NodeName, dds_topic, dds_type};

/// Bytes before every message that name its encoding. DDS adds them itself.
const ENCAPSULATION: usize = 4;
/// Highest domain whose ports fit into 16 bits (RTPS 2.5, section 9.6.2.3).
const MOST_DOMAIN: u16 = 232;
/// Messages kept for each reader before the oldest is dropped: the default of ROS 2.
const HISTORY: i32 = 10;
/// Time for which a topic refuses messages because a reader acknowledges none, before the topic is recreated.
const STALLED: StdDuration = StdDuration::from_millis(100);

/// Quality of service of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Quality {
    /// Reliable, with the last message kept for late readers.
    Latched,
    /// Reliable, for present readers.
    Reliable,
    /// Best effort: lost messages are not sent again.
    Sensor,
}

impl Quality {
    fn policies(self) -> QosPolicies {
        let reliable = Reliability::Reliable { max_blocking_time: Duration::from_millis(0) };
        let (reliability, durability, depth) = match self {
            Self::Latched => (reliable, Durability::TransientLocal, 1),
            Self::Reliable => (reliable, Durability::Volatile, HISTORY),
            Self::Sensor => (Reliability::BestEffort, Durability::Volatile, HISTORY),
        };
        let history = History::KeepLast { depth };
        QosPolicyBuilder::new().reliability(reliability).durability(durability).history(history).build()
    }
}

/// A message without its encapsulation.
#[derive(Clone, Debug)]
pub(super) struct Payload(Bytes);

/// Sends and takes bytes as they are.
pub(super) struct AsIs;

impl SerializerAdapter<Payload> for AsIs {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(value: &Payload) -> Result<Bytes, Infallible> {
        Ok(value.0.clone())
    }
}

/// Takes bytes as they are.
#[derive(Clone)]
pub(super) struct Take;

impl Decode<'_, Payload> for Take {
    type Error = Infallible;

    fn decode_bytes(self, bytes: &[u8], _encoding: RepresentationIdentifier) -> Result<Payload, Infallible> {
        Ok(Payload(Bytes::copy_from_slice(bytes)))
    }
}

impl DeserializerAdapter<Payload> for AsIs {
    type Error = Infallible;
    type Decoded = Payload;

    /// Only little-endian: every computer that runs ROS 2 today sends it.
    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE]
    }

    fn transform_decoded(decoded: Payload) -> Payload {
        decoded
    }
}

impl DefaultDecoder<Payload> for AsIs {
    type Decoder = Take;
    const DECODER: Take = Take;
}

/// Outcome of sending one message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sent {
    /// On its way.
    Yes,
    /// Refused because a reader has acknowledged none of the last thousands of messages.
    No,
    /// Refused, and the topic has been recreated with a new identity.
    Restarted,
}

/// Writes to one topic.
pub(super) struct Writer {
    topic: Topic,
    qos: QosPolicies,
    writer: DataWriter<Payload, AsIs>,
    refuses_since: Option<Instant>,
}

/// A received message, such as a request to a service.
pub(super) struct Received {
    /// The message, with its encapsulation.
    pub message: Vec<u8>,
    /// Identity of the message, for an answer.
    pub identity: SampleIdentity,
}

/// Reads one topic.
pub(super) struct Reader(DataReader<Payload, AsIs>);

/// A member of a DDS domain.
pub(super) struct Participant {
    participant: DomainParticipant,
    publisher: Publisher,
    subscriber: Subscriber,
}

/// The domain that `ROS_DOMAIN_ID` names; 0 without it.
pub(super) fn domain() -> Result<u16, Ros2Error> {
    let Some(text) = env::var_os("ROS_DOMAIN_ID").filter(|text| !text.is_empty()) else { return Ok(0) };
    let text = text.to_string_lossy();
    let domain = text.trim().parse().ok().filter(|domain| *domain <= MOST_DOMAIN);
    domain.ok_or_else(|| Ros2Error::Domain { text: text.into_owned(), most: MOST_DOMAIN })
}

/// True if the environment restricts discovery to this machine, with the variables of Humble or of later releases.
fn is_local() -> bool {
    let says = |name: &str, value: &str| env::var(name).is_ok_and(|text| text.eq_ignore_ascii_case(value));
    says("ROS_LOCALHOST_ONLY", "1") || says("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
}

/// The reason why no network interface supports multicast, if none does.
pub(super) fn no_multicast() -> Option<std::io::Error> {
    // Looks up the route and sends nothing.
    UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))
        .and_then(|socket| socket.connect((Ipv4Addr::new(239, 255, 0, 1), 7400)))
        .err()
}

impl Participant {
    /// Joins a domain.
    pub fn join(domain: u16) -> Result<Self, Ros2Error> {
        let failed = |error: &dyn std::fmt::Display| Ros2Error::Network { domain, reason: error.to_string() };
        let mut builder = DomainParticipantBuilder::new(domain);
        if is_local() {
            builder = builder.with_only_networks([IpAddr::V4(Ipv4Addr::LOCALHOST)]);
        }
        let participant = builder.build().map_err(|error| failed(&error))?;
        let defaults = QosPolicyBuilder::new().build();
        let publisher = participant.create_publisher(&defaults).map_err(|error| failed(&error))?;
        let subscriber = participant.create_subscriber(&defaults).map_err(|error| failed(&error))?;
        Ok(Self { participant, publisher, subscriber })
    }

    /// A writer to a topic of ROS 2: `/dermis/touches`, `dermis_msgs/msg/Touches`.
    pub fn writer(&self, topic: &str, kind: &str, quality: Quality) -> Result<Writer, Ros2Error> {
        self.dds_writer(&dds_topic(topic), &dds_type(kind), quality)
    }

    /// A writer to a topic by its name and type in DDS.
    pub fn dds_writer(&self, topic: &str, kind: &str, quality: Quality) -> Result<Writer, Ros2Error> {
        let qos = quality.policies();
        let failed =
            |error: &dyn std::fmt::Display| Ros2Error::Topic { topic: topic.into(), reason: error.to_string() };
        let made = self.participant.create_topic(topic.into(), kind.into(), &qos, TopicKind::NoKey);
        let topic = made.map_err(|error| failed(&error))?;
        let writer = self.publisher.create_datawriter_no_key(&topic, Some(qos.clone()));
        let writer = writer.map_err(|error| failed(&error))?;
        Ok(Writer { topic, qos, writer, refuses_since: None })
    }

    /// A reader of a topic by its name and type in DDS.
    pub fn dds_reader(&self, topic: &str, kind: &str, quality: Quality) -> Result<Reader, Ros2Error> {
        let qos = quality.policies();
        let failed =
            |error: &dyn std::fmt::Display| Ros2Error::Topic { topic: topic.into(), reason: error.to_string() };
        let made = self.participant.create_topic(topic.into(), kind.into(), &qos, TopicKind::NoKey);
        let made = made.map_err(|error| failed(&error))?;
        let reader = self.subscriber.create_datareader_no_key(&made, Some(qos));
        Ok(Reader(reader.map_err(|error| failed(&error))?))
    }

    /// Tells other nodes that this participant is this node, with these writers and readers.
    pub fn announce(&self, to: &mut Writer, node: &NodeName, writers: &[GUID], readers: &[GUID]) {
        let gids = |guids: &[GUID]| guids.iter().map(GUID::to_bytes).collect::<Vec<_>>();
        let message = messages::participant(self.participant.guid().to_bytes(), node, &gids(writers), &gids(readers));
        // Sent again at the next change; a failure cannot be reported to anyone.
        let _ = to.write(message, self);
    }

    /// The writer of [`Participant::announce`].
    pub fn discovery(&self) -> Result<Writer, Ros2Error> {
        let kind = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";
        self.dds_writer("ros_discovery_info", kind, Quality::Latched)
    }
}

impl Writer {
    /// Sends a message, given with its encapsulation. Never waits. A reader that acknowledges nothing fills the window
    /// of unacknowledged messages; the topic is then recreated, so that the other readers continue.
    pub fn write(&mut self, message: Vec<u8>, participant: &Participant) -> Sent {
        let payload = Payload(Bytes::from(message).split_off(ENCAPSULATION));
        if self.writer.write(payload, None).is_ok() {
            self.refuses_since = None;
            return Sent::Yes;
        }
        let since = *self.refuses_since.get_or_insert_with(Instant::now);
        if since.elapsed() < STALLED {
            return Sent::No;
        }
        self.refuses_since = None;
        match participant.publisher.create_datawriter_no_key(&self.topic, Some(self.qos.clone())) {
            Ok(writer) => {
                self.writer = writer;
                Sent::Restarted
            }
            Err(error) => {
                tracing::error!("{:?}: {error}", self.topic);
                Sent::No
            }
        }
    }

    /// Sends the reply to a request.
    pub fn answer(&self, message: Vec<u8>, request: SampleIdentity) {
        let payload = Payload(Bytes::from(message).split_off(ENCAPSULATION));
        let options = WriteOptionsBuilder::new().related_sample_identity(request).build();
        if let Err(error) = self.writer.write_with_options(payload, options) {
            tracing::warn!("a reply was not sent: {error}");
        }
    }

    /// Identity of the writer.
    pub fn guid(&self) -> GUID {
        self.writer.guid()
    }
}

impl Reader {
    /// The next message, if there is one.
    pub fn take(&mut self) -> Option<Received> {
        let sample = self.0.take_next_sample().ok()??;
        let identity = sample.sample_info().sample_identity();
        let Payload(bytes) = sample.into_value();
        Some(Received { message: [&[0, 1, 0, 0][..], &bytes].concat(), identity })
    }

    /// Identity of the reader.
    pub fn guid(&self) -> GUID {
        self.0.guid()
    }
}
