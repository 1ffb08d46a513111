//! The host's side: hello, describe, start, frames; and exact counting of what did not come.

use std::time::Duration;

use dermis_wire::{Command, Decoder, Describe, Frame, Hello, MOST_PACKET, Message, ReplyStatus, Request};
use dermis_wire::{VERSION, encode, encoded_len};

use crate::stream::{Dialogue, Inbox};
use crate::{HostStamp, Layout};

/// Time between two attempts to get an answer.
const AGAIN: Duration = Duration::from_millis(500);
/// Longest wait for a description or a reply.
const LONGEST: Duration = Duration::from_secs(3);
/// Frames in a row with numbers of the past after which the device is taken to count anew.
const STUBBORN: u32 = 16;

/// The host's side of a conversation over the wire, as a [`Dialogue`].
#[derive(Debug)]
pub struct WireHost {
    decoder: Decoder<Vec<u8>>,
    stage: Stage,
    /// When, after the connection was made, something was asked last.
    asked: Duration,
    /// When the present stage began.
    since: Duration,
    now: Duration,
    nonce: u32,
    tag: u16,
    known: Option<Known>,
    count: Count,
    /// When the packet in progress began, if its first byte came earlier.
    begun: Option<HostStamp>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// Waiting for the answer to hello.
    Greeting,
    /// Waiting for the reply to start.
    Starting,
    /// Frames flow.
    Streaming,
}

/// What the device has said of itself.
#[derive(Debug)]
struct Known {
    boot: u32,
    channels: u16,
    frames_per_s: f32,
    identity: String,
}

/// Sequence numbers: the device's, which wrap, and the host's, which do not.
#[derive(Debug, Default)]
struct Count {
    /// What the device's next number should be.
    expected: Option<u32>,
    /// The host's next number.
    next: u64,
    /// The device was reset, or may have been: its numbers start anew.
    anew: Option<Anew>,
    /// Numbers of the past in a row.
    repeats: u32,
    /// Arrival of the last frame.
    last_ns: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Anew {
    /// Known by another boot number.
    Certain,
    /// The device has none; believed where its numbers go back.
    IfBack,
}

impl WireHost {
    /// A conversation that has not begun.
    pub fn new() -> Self {
        Self {
            decoder: Decoder::new(vec![0; encoded_len(MOST_PACKET)]),
            stage: Stage::Greeting,
            asked: Duration::ZERO,
            since: Duration::ZERO,
            now: Duration::ZERO,
            // Differs between hosts that follow each other on one device.
            nonce: HostStamp::now().wall_ns as u32,
            tag: 0,
            known: None,
            count: Count::default(),
            begun: None,
        }
    }

    fn say_hello(&mut self, send: &mut Vec<u8>) {
        let hello = Hello { nonce: self.nonce, lowest_version: VERSION, highest_version: VERSION };
        push(&Message::Hello(hello), send);
        self.asked = self.now;
    }

    fn order(&mut self, command: Command<'_>, send: &mut Vec<u8>) {
        self.tag = self.tag.wrapping_add(1);
        push(&Message::Command(Request { tag: self.tag, command }), send);
        self.asked = self.now;
    }

    fn enter(&mut self, stage: Stage) {
        self.stage = stage;
        self.since = self.now;
    }
}

impl Default for WireHost {
    fn default() -> Self {
        Self::new()
    }
}

/// What a message means for the conversation, owned, so that it outlives the decoder's borrow.
enum Heard {
    Nothing,
    Bad,
    Described { answer: bool, known: Known },
    Started,
    Refused(String),
}

impl Dialogue for WireHost {
    fn open(&mut self, send: &mut Vec<u8>) {
        self.decoder.reset();
        self.begun = None;
        self.nonce = self.nonce.wrapping_add(1).max(1);
        self.now = Duration::ZERO;
        self.enter(Stage::Greeting);
        self.say_hello(send);
    }

    fn receive(&mut self, bytes: &[u8], at: HostStamp, inbox: &mut Inbox, send: &mut Vec<u8>) -> Result<(), String> {
        let mut rest = bytes;
        let mut stamp = self.begun.unwrap_or(at);
        while let Some(message) = self.decoder.feed(&mut rest) {
            let heard = match message {
                Ok(Message::Frame(frame)) => {
                    if self.stage == Stage::Greeting {
                        // Of an earlier conversation.
                        Heard::Nothing
                    } else if let Some(known) = self.known.as_ref().filter(|known| fits(known, &frame)) {
                        self.count.take(&frame, known.frames_per_s, stamp, inbox);
                        Heard::Nothing
                    } else {
                        Heard::Bad
                    }
                }
                Ok(Message::Describe(describe)) => {
                    Heard::Described { answer: describe.nonce == self.nonce, known: Known::of(&describe) }
                }
                Ok(Message::Reply(reply)) if reply.tag == self.tag && reply.command == Command::Start.code() => {
                    match reply.status {
                        ReplyStatus::Done => Heard::Started,
                        status => Heard::Refused(format!("the device does not start: {status:?}")),
                    }
                }
                Ok(_) => Heard::Nothing,
                Err(_) => Heard::Bad,
            };
            stamp = at;
            match heard {
                Heard::Nothing => {}
                // Before frames flow, the end of a packet whose beginning was not heard is nothing to count.
                Heard::Bad if self.stage == Stage::Streaming => inbox.bad(1),
                Heard::Bad => {}
                Heard::Described { answer, known } => self.described(answer, known, send)?,
                Heard::Started => self.enter(Stage::Streaming),
                Heard::Refused(reason) => return Err(reason),
            }
        }
        self.begun = self.decoder.is_mid_packet().then_some(stamp);
        Ok(())
    }

    fn tick(&mut self, open_for: Duration, send: &mut Vec<u8>) -> Result<(), String> {
        self.now = open_for;
        if self.stage == Stage::Streaming {
            return Ok(());
        }
        if open_for.saturating_sub(self.since) > LONGEST {
            let seconds = LONGEST.as_secs();
            return Err(match self.stage {
                Stage::Greeting => format!("no answer to the handshake in {seconds} s: another instrument?"),
                _ => format!("described itself, but did not start in {seconds} s"),
            });
        }
        if open_for.saturating_sub(self.asked) >= AGAIN {
            match self.stage {
                Stage::Greeting => self.say_hello(send),
                _ => self.order(Command::Start, send),
            }
        }
        Ok(())
    }

    fn close(&mut self, send: &mut Vec<u8>) {
        self.order(Command::Stop, send);
    }

    fn layout(&self) -> Option<Layout> {
        self.known.as_ref().map(|known| Layout::Channels { count: usize::from(known.channels) })
    }

    fn identity(&self) -> Option<String> {
        self.known.as_ref().map(|known| known.identity.clone())
    }
}

impl WireHost {
    /// The device has described itself, in answer to this conversation's hello or unasked.
    fn described(&mut self, answer: bool, known: Known, send: &mut Vec<u8>) -> Result<(), String> {
        if !answer && self.stage == Stage::Greeting {
            return Ok(());
        }
        if known.channels == 0 {
            return Err("the device has no channels".to_owned());
        }
        let mut reset = false;
        if let Some(before) = &self.known {
            if before.channels != known.channels {
                return Err(format!(
                    "expected {} channels, found {} ({})",
                    before.channels, known.channels, known.identity
                ));
            }
            reset = before.boot != known.boot;
            self.count.anew = match (reset, known.boot) {
                (true, _) => Some(Anew::Certain),
                (false, 0) if answer => Some(Anew::IfBack),
                (false, _) => self.count.anew,
            };
        }
        self.known = Some(known);
        if self.stage == Stage::Greeting || reset {
            self.enter(Stage::Starting);
            self.order(Command::Start, send);
        }
        Ok(())
    }
}

impl Known {
    fn of(describe: &Describe<'_>) -> Self {
        let clean = |text: &str| crate::error::shorten(text);
        let (device, serial) = (clean(describe.device), clean(describe.serial));
        let identity = format!(
            "{device} {serial}, firmware {}, {} electrodes, {} channels at {} frames/s",
            clean(describe.firmware),
            describe.electrodes,
            describe.channels,
            describe.frames_per_s
        );
        Self { boot: describe.boot, channels: describe.channels, frames_per_s: describe.frames_per_s, identity }
    }
}

fn fits(known: &Known, frame: &Frame<'_>) -> bool {
    frame.values.len() == usize::from(known.channels)
}

impl Count {
    /// Numbers a frame, counts those before it that did not come, and hands it on unless it has come before.
    fn take(&mut self, frame: &Frame<'_>, frames_per_s: f32, at: HostStamp, inbox: &mut Inbox) {
        let ahead = frame.sequence.wrapping_sub(self.expected.unwrap_or(frame.sequence));
        let back = ahead >= 1 << 31;
        let anew = match self.anew.take() {
            Some(Anew::Certain) => true,
            Some(Anew::IfBack) => back,
            None => back && self.repeats >= STUBBORN,
        };
        if back && !anew {
            self.repeats += 1;
            inbox.bad(1);
            return;
        }
        let missed = if anew {
            // What the device would have sent since the last frame; its numbers say nothing of that.
            let elapsed_s = at.monotonic_ns.saturating_sub(self.last_ns) as f64 * 1e-9;
            (elapsed_s * f64::from(frames_per_s)).round() as u64
        } else {
            u64::from(ahead)
        };
        // With a reset the frame itself is one of those that the rate gives.
        let missed = if anew { missed.saturating_sub(1) } else { missed };
        inbox.lost(missed);
        let sequence = self.next + missed;
        self.next = sequence + 1;
        self.expected = Some(frame.sequence.wrapping_add(1));
        self.repeats = 0;
        self.last_ns = at.monotonic_ns;
        inbox.take(|out| {
            out.clear();
            out.sequence = sequence;
            out.stamp(at);
            out.device_time_ns = Some(frame.device_time_ns);
            out.values.extend(frame.values.volts(frame.scale));
            if let Some(imaginary) = &frame.imaginary {
                out.imaginary.extend(imaginary.volts(frame.scale));
            }
        });
    }
}

/// Appends a message; every message of this side is short.
fn push(message: &Message<'_>, send: &mut Vec<u8>) {
    let mut buffer = [0; 64];
    if let Ok(bytes) = encode(message, &mut buffer) {
        send.extend_from_slice(bytes);
    }
}
