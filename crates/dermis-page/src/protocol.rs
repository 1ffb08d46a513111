//! The messages on the wire, version 1: little-endian binary for images, channels and noise, JSON for the rest.
//! `docs/src/page-protocol.md` describes them for other programs and includes `web/src/messages.ts`, which a test
//! writes from the types here: `DERMIS_BLESS=1 cargo test -p dermis-page --lib blessed`.

use bytes::Bytes;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::body_scene::BodyScene;
use crate::body_state::BodyState;
use crate::message::{Answer, HubStats, Notice};
use crate::scene::Scene;
use crate::update::{
    ClassImage, Counter, DamageView, GuardView, HealthView, PipelineState, StageLatency, TouchView, Update,
};

/// Version of the messages, included in each of them.
pub const PROTOCOL_VERSION: u16 = 1;

const MAGIC: [u8; 4] = *b"DRMS";
const KIND_IMAGE: u16 = 1;
const KIND_CHANNELS: u16 = 2;
const KIND_NOISE: u16 = 3;
const KIND_CLASSES: u16 = 4;
const KIND_PATCH_IMAGE: u16 = 5;
/// Bytes before the values of a binary message.
const HEADER_BYTES: usize = 32;

/// One update, encoded once for all pages.
#[derive(Debug)]
pub struct Encoded {
    /// Counts encoded updates from 1. Pages acknowledge it; gaps show what a page has missed.
    pub sequence: u64,
    /// The image, binary.
    pub image: Bytes,
    /// The channels, binary.
    pub channels: Bytes,
    /// The classes, binary, if a network provides any.
    pub classes: Option<Bytes>,
    /// The state, JSON; sent last.
    pub state: String,
}

/// A message from a page.
#[derive(Debug, PartialEq)]
pub enum PageMessage<C> {
    /// The update with this sequence number has been shown.
    Acknowledge(u64),
    /// A request; the number is returned in the answer.
    Ask(u64, C),
}

/// A JSON message: version and type, then the body's own fields.
#[derive(Serialize)]
struct Envelope<'a, T> {
    v: u16,
    #[serde(rename = "type")]
    kind: &'a str,
    #[serde(flatten)]
    body: T,
}

/// The page's content for one frame, except what is binary.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
struct State<'a> {
    /// Number of the update, to be acknowledged.
    sequence: u64,
    /// Frame number.
    frame: u64,
    /// Host monotonic time of the frame's first byte, nanoseconds. Text, like the other times, since JSON readers
    /// round integers beyond 2^53.
    time_ns: String,
    /// The same time on the system's monotonic clock, which all processes of a machine share.
    monotonic_ns: String,
    /// The same time on the host's wall clock, since 1970-01-01 UTC.
    wall_ns: String,
    /// The device's own clock, if it has one.
    device_time_ns: Option<String>,
    /// Frames per second that leave the pipeline.
    fps: f32,
    /// Touches on the skin, and those that ended in this frame.
    touches: &'a [TouchView],
    /// Latency of every stage over the last ten seconds, in pipeline order.
    latency: &'a [StageLatency],
    /// Counters, including losses.
    counters: &'a [Counter],
    /// State of the pipeline.
    state: &'a PipelineState,
    /// Faults.
    health: &'a HealthView,
    /// Classification of the frame by a network, if there is one.
    classes: Option<ClassState>,
    /// Damage and baselines, if the skin is watched for damage.
    damage: Option<&'a DamageView>,
    /// The guard's verdict, if the skin has a guard.
    guard: Option<&'a GuardView>,
}

/// Classification of a frame by a network.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
struct ClassState {
    /// Distance of the frame from the network's training data; above 1.5 the frame is unlike them. NaN if unknown.
    #[cfg_attr(test, schemars(with = "Option<f32>"))]
    novelty: f32,
    /// True if thresholds on the image replaced the network.
    falls_back: bool,
}

/// A sign of life, every second.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
struct Alive {
    /// Number of updates that this page missed.
    missed: u64,
    /// Statistics of all pages.
    hub: HubStats,
}

impl<C> PageMessage<C> {
    /// The same message with another type of command.
    pub fn map<D>(self, change: impl FnOnce(C) -> D) -> PageMessage<D> {
        match self {
            Self::Acknowledge(sequence) => PageMessage::Acknowledge(sequence),
            Self::Ask(id, command) => PageMessage::Ask(id, change(command)),
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Incoming<C> {
    v: u16,
    ack: Option<u64>,
    id: Option<u64>,
    command: Option<C>,
}

#[derive(Serialize)]
struct NumberedBodyState<'a> {
    sequence: u64,
    #[serde(flatten)]
    state: &'a BodyState,
}

impl Encoded {
    /// The messages of one update.
    pub fn new(sequence: u64, update: &Update) -> Self {
        let state = State {
            sequence,
            frame: update.frame,
            time_ns: update.time_ns.to_string(),
            monotonic_ns: update.monotonic_ns.to_string(),
            wall_ns: update.wall_ns.to_string(),
            device_time_ns: update.device_time_ns.map(|ns| ns.to_string()),
            fps: update.fps,
            touches: &update.touches,
            latency: &update.latency,
            counters: &update.counters,
            state: &update.state,
            health: &update.health,
            classes: update.classes.as_ref().map(|ClassImage { novelty, falls_back, .. }| ClassState {
                novelty: *novelty,
                falls_back: *falls_back,
            }),
            damage: update.damage.as_ref(),
            guard: update.guard.as_ref(),
        };
        let classes = update.classes.as_ref().map(|of| classes(update, of));
        Self { sequence, image: image(update), channels: channels(update), classes, state: json("state", state) }
    }
}

/// The scene, sent first.
pub fn scene(scene: &Scene) -> String {
    json("scene", scene)
}

/// The scene of a body, sent first.
pub fn body_scene(scene: &BodyScene) -> String {
    json("body_scene", scene)
}

/// The state of a body; pages acknowledge its sequence number.
pub fn body_state(sequence: u64, state: &BodyState) -> String {
    json("body_state", NumberedBodyState { sequence, state })
}

/// The image of one of a body's patches, kind 5. `values` fill the grid in the patch's scene.
pub fn patch_image(patch: usize, frame: u64, time_ns: u64, values: &[f32]) -> Bytes {
    let mut message = header(KIND_PATCH_IMAGE, frame, time_ns, [patch as u32, values.len() as u32], values.len());
    put_values(&mut message, values);
    message.into()
}

/// An answer to one request.
pub fn answer(answer: &Answer) -> String {
    json("answer", answer)
}

/// A notice to every page.
pub fn notice(notice: &Notice) -> String {
    json("notice", notice)
}

/// Sent every second, so that a page can tell a silent pipeline from a lost connection.
pub fn alive(missed: u64, hub: HubStats) -> String {
    json("alive", Alive { missed, hub })
}

/// Channel noise, kind 3.
pub fn noise(values: &[f32]) -> Bytes {
    let mut message = header(KIND_NOISE, 0, 0, [values.len() as u32, 0], values.len());
    put_values(&mut message, values);
    message.into()
}

/// Parses a message from a page with commands of type `C`: [`crate::Command`] or [`crate::BodyCommand`].
///
/// # Errors
/// A sentence for the page that states the fault and what was expected, with the request's number if it was readable.
pub fn parse<C: DeserializeOwned>(text: &str) -> Result<PageMessage<C>, (u64, String)> {
    let incoming: Incoming<C> =
        serde_json::from_str(text).map_err(|error| (0, format!("message not understood: {error}")))?;
    let id = incoming.id.unwrap_or(0);
    if incoming.v != PROTOCOL_VERSION {
        return Err((id, format!("message of version {}; expected {PROTOCOL_VERSION}: reload the page", incoming.v)));
    }
    match (incoming.ack, incoming.id, incoming.command) {
        (Some(sequence), None, None) => Ok(PageMessage::Acknowledge(sequence)),
        (None, Some(id), Some(command)) => Ok(PageMessage::Ask(id, command)),
        _ => Err((id, "message not understood: expected either ack, or id and command".into())),
    }
}

fn json(kind: &str, body: impl Serialize) -> String {
    // Serialising fails only for maps with non-text keys, and none of these types contains a map.
    serde_json::to_string(&Envelope { v: PROTOCOL_VERSION, kind, body }).unwrap_or_default()
}

/// Image, kind 1: rows and columns, then row-major values.
fn image(update: &Update) -> Bytes {
    let image = &update.image;
    let size = [image.rows as u32, image.cols as u32];
    let mut message = header(KIND_IMAGE, update.frame, update.time_ns, size, image.values.len());
    put_values(&mut message, &image.values);
    message.into()
}

/// Channels, kind 2: numbers of values and of indices, then the indices, then the values.
fn channels(update: &Update) -> Bytes {
    let channels = &update.channels;
    let size = [channels.values.len() as u32, channels.indices.len() as u32];
    let words = channels.values.len() + channels.indices.len();
    let mut message = header(KIND_CHANNELS, update.frame, update.time_ns, size, words);
    message.extend(channels.indices.iter().flat_map(|index| index.to_le_bytes()));
    put_values(&mut message, &channels.values);
    message.into()
}

/// Classes, kind 4: rows and columns, then the probabilities of lowered and of raised conductivity, each row-major.
fn classes(update: &Update, classes: &ClassImage) -> Bytes {
    let size = [classes.rows as u32, classes.cols as u32];
    let words = classes.lowered.len() + classes.raised.len();
    let mut message = header(KIND_CLASSES, update.frame, update.time_ns, size, words);
    put_values(&mut message, &classes.lowered);
    put_values(&mut message, &classes.raised);
    message.into()
}

fn header(kind: u16, frame: u64, time_ns: u64, size: [u32; 2], words: usize) -> Vec<u8> {
    let mut message = Vec::with_capacity(HEADER_BYTES + 4 * words);
    message.extend_from_slice(&MAGIC);
    message.extend_from_slice(&PROTOCOL_VERSION.to_le_bytes());
    message.extend_from_slice(&kind.to_le_bytes());
    message.extend_from_slice(&frame.to_le_bytes());
    message.extend_from_slice(&time_ns.to_le_bytes());
    message.extend_from_slice(&size[0].to_le_bytes());
    message.extend_from_slice(&size[1].to_le_bytes());
    message
}

fn put_values(message: &mut Vec<u8>, values: &[f32]) {
    message.extend(values.iter().flat_map(|value| value.to_le_bytes()));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::{Command, Press};
    use crate::schema_text;
    use crate::update::Image;
    use crate::{BodyCommand, PatchCommand};

    #[test]
    fn an_image_message_has_the_documented_layout() {
        let mut update = Update { frame: 7, time_ns: 9, ..Update::default() };
        update.image = Image { rows: 1, cols: 2, values: vec![1.5, f32::NAN] };
        let message = Encoded::new(1, &update).image;
        assert_eq!(message.len(), 40);
        assert_eq!(&message[..8], b"DRMS\x01\x00\x01\x00");
        assert_eq!(message[8..16], 7u64.to_le_bytes());
        assert_eq!(message[16..24], 9u64.to_le_bytes());
        assert_eq!(message[24..32], [1, 0, 0, 0, 2, 0, 0, 0]);
        assert_eq!(message[32..36], 1.5f32.to_le_bytes());
        assert!(f32::from_le_bytes([message[36], message[37], message[38], message[39]]).is_nan());
    }

    #[test]
    fn commands_are_parsed_and_bad_ones_explained() {
        let press = r#"{"v":1,"id":3,"command":{"press":{"pointer_id":1,"x_mm":2,"y_mm":-3.5,"radius_mm":10,"pressure_kpa":80}}}"#;
        let expected = Press { pointer_id: 1, x_mm: 2.0, y_mm: -3.5, radius_mm: 10.0, pressure_kpa: 80.0 };
        assert_eq!(parse(press), Ok(PageMessage::Ask(3, Command::Press(expected))));
        assert_eq!(parse(r#"{"v":1,"id":4,"command":"record_start"}"#), Ok(PageMessage::Ask(4, Command::RecordStart)));
        assert_eq!(parse::<Command>(r#"{"v":1,"ack":88}"#), Ok(PageMessage::Acknowledge(88)));
        for (wrong, hint) in [
            (r#"{"v":2,"ack":1}"#, "version 2"),
            (r#"{"v":1}"#, "expected either"),
            (r#"{"v":1,"id":1,"command":{"hyperparameter":1e999}}"#, "out of range"),
            (r#"{"v":1,"id":1,"command":{"tare":{"force":true,"more":1}}}"#, "unknown field `more`"),
            (r#"{"v":1,"id":1,"command":"explode"}"#, "unknown variant `explode`"),
            ("[1", "not understood"),
        ] {
            let (_, text) = parse::<Command>(wrong).expect_err(wrong);
            assert!(text.contains(hint), "{wrong}: {text}");
        }
    }

    #[test]
    fn commands_of_a_bodys_page_name_a_patch_or_joints() {
        let tare = r#"{"v":1,"id":3,"command":{"patch":{"number":2,"command":{"tare":{"force":false}}}}}"#;
        let command = Command::Tare { force: false };
        assert_eq!(parse(tare), Ok(PageMessage::Ask(3, BodyCommand::Patch(PatchCommand { number: 2, command }))));
        let joints = r#"{"v":1,"id":4,"command":{"joints":{"elbow":0.5}}}"#;
        assert_eq!(parse(joints), Ok(PageMessage::Ask(4, BodyCommand::Joints([("elbow".to_owned(), 0.5)].into()))));
        let (id, text) = parse::<BodyCommand>(r#"{"v":1,"id":5,"command":{"tare":{"force":false}}}"#).unwrap_err();
        assert!(id == 0 && text.contains("unknown variant `tare`, expected `patch` or `joints`"), "{text}");
    }

    #[test]
    fn the_image_of_a_patch_states_its_number() {
        let message = patch_image(3, 7, 9, &[1.5, 2.5]);
        assert_eq!(&message[..8], b"DRMS\x01\x00\x05\x00");
        assert_eq!(message[24..32], [3, 0, 0, 0, 2, 0, 0, 0]);
        assert_eq!(message[36..], 2.5f32.to_le_bytes());
    }

    #[test]
    fn types_of_the_page_are_blessed() {
        use schemars::generate::SchemaSettings;
        let mut sent = SchemaSettings::draft2020_12().for_serialize().into_generator();
        sent.subschema_for::<Scene>();
        sent.subschema_for::<State<'_>>();
        sent.subschema_for::<Alive>();
        sent.subschema_for::<Notice>();
        sent.subschema_for::<Answer>();
        let mut received = SchemaSettings::draft2020_12().for_deserialize().into_generator();
        received.subschema_for::<Command>();
        let (sent, received) = (sent.take_definitions(true), received.take_definitions(true));
        let messages = ["Scene", "State", "Alive", "Notice", "Answer"];
        dermis_testdata::blessed("web/src/messages.ts", |_| {
            let text = [schema_text::typescript(&sent, &messages), schema_text::typescript(&received, &["Command"])];
            format!(
                "// Written by a test of crates/dermis-page from its types; protocol.rs says how.\n{}",
                text.concat()
            )
        });
    }

    #[test]
    fn unknown_numbers_become_null() {
        let mut update = Update::default();
        update.state.baseline_age_s = f64::NAN;
        let state = Encoded::new(1, &update).state;
        assert!(state.contains(r#""baseline_age_s":null"#), "{state}");
    }
}
