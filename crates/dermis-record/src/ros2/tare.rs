//! The service `~/tare`: requests go to the patch's pipeline, answers back to the client. Clients with rmw_fastrtps and
//! with rmw_cyclonedds mark their requests differently; both are understood.

use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use rustdds::{GUID, SampleIdentity};

use super::error::Ros2Error;
use super::messages::{cyclone_header, trigger_reply};
use super::names::{dds_service, dds_type};
use super::participant::{Participant, Quality, Reader, Received, Writer};
use super::topics::TARE;
use crate::live_request::{LiveCommand, LiveRequest};

/// Requests that may wait for a frame.
const MOST_WAITING: usize = 4;
/// Longest time for which a request waits for a frame.
const PATIENCE: Duration = Duration::from_secs(2);

/// The reason for a tare, in recordings and events.
const REASON: &str = "requested over ROS 2";

/// Outcome of a request: the text of the reply.
type Outcome = Result<String, String>;

/// A request whose outcome is awaited.
struct Waiting {
    identity: SampleIdentity,
    cyclone: Option<[u8; 16]>,
    outcome: Receiver<Outcome>,
    asked: Instant,
}

/// The service of one patch.
pub(super) struct TareService {
    requests: Reader,
    replies: Writer,
    tares: Sender<LiveRequest>,
    waiting: Vec<Waiting>,
}

impl TareService {
    /// The service with this name; the requests come out of the channel.
    pub fn new(participant: &Participant, service: &str) -> Result<(Self, Receiver<LiveRequest>), Ros2Error> {
        let [request, reply] = dds_service(service);
        let (_, kind) = TARE;
        let requests = participant.dds_reader(&request, &dds_type(&format!("{kind}_Request")), Quality::Reliable)?;
        let replies = participant.dds_writer(&reply, &dds_type(&format!("{kind}_Response")), Quality::Reliable)?;
        let (tares, taken) = bounded(MOST_WAITING);
        Ok((Self { requests, replies, tares, waiting: Vec::new() }, taken))
    }

    /// Identities of reader and writer.
    pub fn guids(&self) -> (GUID, GUID) {
        (self.requests.guid(), self.replies.guid())
    }

    /// Takes new requests, and answers those that are done.
    pub fn work(&mut self) {
        while let Some(Received { message, identity }) = self.requests.take() {
            let (tell, outcome) = bounded(1);
            // An answer that comes too late has no receiver.
            let answer = move |outcome| drop(tell.try_send(outcome));
            let cyclone = cyclone_header(&message);
            match self.tares.try_send(LiveRequest::new(LiveCommand::Tare { force: false }, REASON, answer)) {
                Ok(()) => self.waiting.push(Waiting { identity, cyclone, outcome, asked: Instant::now() }),
                Err(TrySendError::Full(_)) => self.reply(identity, cyclone, refused("earlier requests are waiting")),
                Err(TrySendError::Disconnected(_)) => {
                    self.reply(identity, cyclone, refused("the skin has ended"));
                }
            }
        }
        for waiting in std::mem::take(&mut self.waiting) {
            let outcome = waiting.outcome.try_recv().ok();
            let is_late = waiting.asked.elapsed() > PATIENCE;
            match outcome.or(is_late.then(|| refused(&format!("no frame in {} s", PATIENCE.as_secs())))) {
                Some(outcome) => self.reply(waiting.identity, waiting.cyclone, outcome),
                None => self.waiting.push(waiting),
            }
        }
    }

    fn reply(&self, identity: SampleIdentity, cyclone: Option<[u8; 16]>, outcome: Outcome) {
        let (is_done, text) = match &outcome {
            Ok(text) => (true, text),
            Err(text) => (false, text),
        };
        self.replies.answer(trigger_reply(cyclone, is_done, text), identity);
    }
}

fn refused(reason: &str) -> Outcome {
    Err(format!("tare refused: {reason}"))
}
