//! The host's side of the wire protocol: hello, description, settings, start, frames and calls in between. Counts lost
//! frames exactly.

use std::sync::PoisonError;
use std::time::Duration;

use dermis_wire::{
    Decoder, Features, Frame as WireFrame, Hello, MOST_PACKET, Message, Part, Reply, ReplyStatus, Request, VERSION,
    encode, encoded_len,
};

use super::assembly::{Assembly, fill};
use super::count::Count;
use super::order::{Call, Controlled, Description, Order, WireControl, reason};
use crate::stream::{Dialogue, Inbox};
use crate::{HostStamp, Layout};

/// Time before a request without an answer is repeated.
const AGAIN: Duration = Duration::from_millis(500);
/// Longest wait for the device's description.
const LONGEST: Duration = Duration::from_secs(3);

/// The host's side of a conversation over the wire, as a [`Dialogue`].
#[derive(Debug)]
pub struct WireHost {
    decoder: Decoder<Vec<u8>>,
    stage: Stage,
    /// Time of the last request, since the connection was made.
    asked: Duration,
    /// Start of the current stage or order.
    since: Duration,
    now: Duration,
    nonce: u32,
    tag: u16,
    /// Orders for the device before frames flow.
    setup: Vec<Order>,
    start: bool,
    /// The part of the setup that this conversation sends.
    planned: Vec<Order>,
    /// The device's description after it was set up.
    set: Option<Description>,
    known: Option<Description>,
    /// Boot number and channel count of the device whose frames are being delivered.
    streamed: Option<(u32, u16)>,
    control: Option<Controlled>,
    flight: Option<Flight>,
    count: Count,
    assembly: Assembly,
    /// Arrival of the current packet's first byte, if that came in an earlier read.
    begun: Option<HostStamp>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// Waiting for the answer to hello.
    Greeting,
    /// Waiting for the reply to an order from the setup.
    Setting(usize),
    /// Waiting for the answer to a second hello: the setup may have changed the number of channels.
    Confirming,
    /// Waiting for the reply to start.
    Starting,
    /// Frames flow, or the device waits for calls.
    Open,
}

/// An order waiting for its reply.
#[derive(Debug)]
struct Flight {
    order: Order,
    /// Index of the first list entry that was sent.
    first: usize,
    /// The call to answer; `None` for orders from the setup.
    call: Option<Call>,
}

/// Meaning of a message for the conversation. Owned, so it outlives the decoder's borrow.
enum Heard {
    Nothing,
    Bad,
    Described { answer: bool, known: Description },
    Replied { status: ReplyStatus, values: Vec<f32> },
}

impl WireHost {
    /// A new conversation that starts the device with its present settings.
    pub fn new() -> Self {
        Self {
            decoder: Decoder::new(vec![0; encoded_len(MOST_PACKET)]),
            stage: Stage::Greeting,
            asked: Duration::ZERO,
            since: Duration::ZERO,
            now: Duration::ZERO,
            // Distinguishes successive hosts of one device.
            nonce: HostStamp::now().wall_ns as u32,
            tag: 0,
            setup: Vec::new(),
            start: true,
            planned: Vec::new(),
            set: None,
            known: None,
            streamed: None,
            control: None,
            flight: None,
            count: Count::default(),
            assembly: Assembly::default(),
            begun: None,
        }
    }

    /// A conversation that sets up the device before starting it, and that takes calls. The setup is sent on every
    /// connection where the device isn't already set up. Settings that the device doesn't support or the wire can't
    /// hold are skipped. Without `start` the host waits for calls.
    pub fn with_control(setup: Vec<Order>, start: bool) -> (Self, WireControl) {
        let (control, controlled) = WireControl::pair();
        (Self { setup, start, control: Some(controlled), ..Self::new() }, control)
    }

    fn say_hello(&mut self, send: &mut Vec<u8>) {
        let hello = Hello { nonce: self.nonce, lowest_version: VERSION, highest_version: VERSION };
        push(&Message::Hello(hello), send);
        self.asked = self.now;
    }

    fn enter(&mut self, stage: Stage) {
        self.stage = stage;
        self.since = self.now;
    }

    /// Sends an order, or the next part of one.
    fn order(&mut self, order: Order, first: usize, call: Option<Call>, send: &mut Vec<u8>) {
        self.tag = self.tag.wrapping_add(1);
        push(&Message::Command(Request { tag: self.tag, command: order.command(first) }), send);
        (self.asked, self.since) = (self.now, self.now);
        self.flight = Some(Flight { order, first, call });
    }

    fn repeat(&mut self, send: &mut Vec<u8>) {
        if let Some(flight) = &self.flight {
            let command = flight.order.command(flight.first);
            push(&Message::Command(Request { tag: self.tag, command }), send);
            self.asked = self.now;
        }
    }

    /// Orders to send before the start. None if the device still has the settings that this host gave it, for instance
    /// because it kept measuring while the connection was down. Otherwise a running device is stopped first, and then
    /// gets the part of the setup that it supports.
    fn plan(&self) -> Vec<Order> {
        let Some(known) = &self.known else { return Vec::new() };
        if self.set.as_ref().is_some_and(|set| is_still(set, known)) {
            return Vec::new();
        }
        let settings: Vec<Order> =
            self.setup.iter().filter(|order| known.obeys(order) && order.check().is_ok()).cloned().collect();
        let runs = known.features.has(Features::RUNNING) && !settings.is_empty();
        runs.then_some(Order::Stop).into_iter().chain(settings).collect()
    }

    /// Continues the plan at order `index`, then starts the device.
    fn set_up(&mut self, index: usize, send: &mut Vec<u8>) -> Result<(), String> {
        if let Some(order) = self.planned.get(index).cloned() {
            self.enter(Stage::Setting(index));
            self.order(order, 0, None, send);
            return Ok(());
        }
        // The description shows the effect of the settings: a new number of channels, the nearest available amplitude.
        if self.stage != Stage::Confirming && !self.planned.is_empty() {
            self.enter(Stage::Confirming);
            self.say_hello(send);
            return Ok(());
        }
        self.settle(true)?;
        if self.start {
            self.enter(Stage::Starting);
            self.order(Order::Start, 0, None, send);
        } else {
            self.enter(Stage::Open);
        }
        Ok(())
    }
}

/// True if the settings are unchanged. The frame rate may differ, and frames may or may not flow.
fn is_still(set: &Description, known: &Description) -> bool {
    let settings = |d: &Description| (d.boot, d.channels, d.protocol.clone(), d.amplitude_a, d.frequency_hz);
    known.boot != 0 && settings(set) == settings(known)
}

impl Default for WireHost {
    fn default() -> Self {
        Self::new()
    }
}

impl Dialogue for WireHost {
    fn open(&mut self, send: &mut Vec<u8>) {
        self.decoder.reset();
        self.assembly.forget();
        self.begun = None;
        self.nonce = self.nonce.wrapping_add(1).max(1);
        self.now = Duration::ZERO;
        self.give_up("the connection has ended");
        self.enter(Stage::Greeting);
        self.say_hello(send);
    }

    fn receive(&mut self, bytes: &[u8], at: HostStamp, inbox: &mut Inbox, send: &mut Vec<u8>) -> Result<(), String> {
        let mut rest = bytes;
        let mut stamp = self.begun.unwrap_or(at);
        while let Some(message) = self.decoder.feed(&mut rest) {
            // Frames before the answer to hello belong to an earlier conversation.
            let greeting = self.stage == Stage::Greeting;
            let frames_per_s = self.known.as_ref().map_or(0.0, |known| known.frames_per_s);
            let channels = self.known.as_ref().map_or(0, |known| usize::from(known.channels));
            let heard = match message {
                Ok(Message::Frame(_) | Message::Part(_)) if greeting => Heard::Nothing,
                Ok(Message::Frame(frame)) if frame.values.len() == channels => {
                    take(&mut self.count, &frame, frames_per_s, stamp, inbox);
                    Heard::Nothing
                }
                Ok(Message::Part(part)) if usize::from(part.total) == channels => {
                    join(&mut self.assembly, &mut self.count, &part, frames_per_s, stamp, inbox);
                    Heard::Nothing
                }
                Ok(Message::Describe(describe)) => {
                    Heard::Described { answer: describe.nonce == self.nonce, known: Description::of(&describe) }
                }
                Ok(Message::Reply(reply)) => replied(&reply, self.tag),
                Ok(Message::Frame(_) | Message::Part(_)) | Err(_) => Heard::Bad,
                Ok(_) => Heard::Nothing,
            };
            stamp = at;
            match heard {
                Heard::Nothing => {}
                // Before frames flow, the tail of a packet whose start was missed doesn't count as damage.
                Heard::Bad if self.stage == Stage::Open => inbox.bad(1),
                Heard::Bad => {}
                Heard::Described { answer, known } => self.described(answer, known, send)?,
                Heard::Replied { status, values } => self.replied(status, values, send)?,
            }
        }
        self.begun = self.decoder.is_mid_packet().then_some(stamp);
        Ok(())
    }

    fn tick(&mut self, open_for: Duration, send: &mut Vec<u8>) -> Result<(), String> {
        self.now = open_for;
        let (waited, again) = (open_for.saturating_sub(self.since), open_for.saturating_sub(self.asked) >= AGAIN);
        match self.stage {
            Stage::Greeting | Stage::Confirming if waited > LONGEST => {
                let seconds = LONGEST.as_secs();
                return Err(format!("no answer to the handshake in {seconds} s: another instrument?"));
            }
            Stage::Greeting | Stage::Confirming if again => self.say_hello(send),
            Stage::Greeting | Stage::Confirming => {}
            Stage::Setting(_) | Stage::Starting | Stage::Open => self.wait_for_reply(waited, again, send)?,
        }
        if self.stage == Stage::Open && self.flight.is_none() {
            let call = self.control.as_ref().and_then(|control| control.calls.try_recv().ok());
            if let Some(call) = call {
                self.order(call.order.clone(), 0, Some(call), send);
            }
        }
        Ok(())
    }

    fn close(&mut self, send: &mut Vec<u8>) {
        self.give_up("the connection has been closed");
        self.order(Order::Stop, 0, None, send);
        self.flight = None;
    }

    fn layout(&self) -> Option<Layout> {
        let known = self.known.as_ref().filter(|_| matches!(self.stage, Stage::Starting | Stage::Open))?;
        Some(Layout::Channels { count: usize::from(known.channels) })
    }

    fn identity(&self) -> Option<String> {
        self.known.as_ref().map(Description::identity)
    }
}

impl WireHost {
    /// Handles a description that answers this conversation's hello or was sent unprompted.
    fn described(&mut self, answer: bool, known: Description, send: &mut Vec<u8>) -> Result<(), String> {
        if !answer && self.stage == Stage::Greeting {
            return Ok(());
        }
        if known.channels == 0 {
            return Err("the device has no channels".to_owned());
        }
        let settled = matches!(self.stage, Stage::Starting | Stage::Open);
        let reset = settled && self.streamed.is_some_and(|(boot, _)| boot != known.boot);
        if let Some(control) = &self.control {
            *control.known.lock().unwrap_or_else(PoisonError::into_inner) = Some(known.clone());
        }
        self.known = Some(known);
        if self.stage == Stage::Greeting || reset {
            self.give_up("the device was reset");
            self.enter(Stage::Greeting);
            self.planned = self.plan();
            return self.set_up(0, send);
        }
        if answer && self.stage == Stage::Confirming {
            return self.set_up(self.planned.len(), send);
        }
        if settled { self.settle(false) } else { Ok(()) }
    }

    /// Checks the device after setup. It must have as many channels as earlier frames. If this connection has just set
    /// it up, its frame numbers may have restarted.
    fn settle(&mut self, just_set_up: bool) -> Result<(), String> {
        let Some(known) = &self.known else { return Ok(()) };
        match self.streamed {
            Some((_, channels)) if channels != known.channels && self.start => {
                return Err(format!("expected {channels} channels, found {} ({})", known.channels, known.identity()));
            }
            Some((boot, _)) if boot != known.boot => self.count.was_reset(),
            Some((0, _)) if just_set_up => self.count.may_be_reset(),
            _ => {}
        }
        self.streamed = Some((known.boot, known.channels));
        self.set = Some(known.clone());
        Ok(())
    }

    /// Handles the reply to the order in flight.
    fn replied(&mut self, status: ReplyStatus, values: Vec<f32>, send: &mut Vec<u8>) -> Result<(), String> {
        let Some(Flight { order, first, call }) = self.flight.take() else { return Ok(()) };
        if status == ReplyStatus::Done
            && let Some(next) = order.next_part(first)
        {
            self.order(order, next, call, send);
            return Ok(());
        }
        if let Some(call) = call {
            let result = if status == ReplyStatus::Done { Ok(values) } else { Err(reason(status)) };
            // The caller may have given up.
            let _ = call.answer.try_send(result);
            return Ok(());
        }
        if status != ReplyStatus::Done {
            return Err(format!("{order}: {}", reason(status)));
        }
        match self.stage {
            Stage::Setting(index) => self.set_up(index + 1, send)?,
            Stage::Starting => self.enter(Stage::Open),
            _ => {}
        }
        Ok(())
    }

    /// Repeats the order in flight, or gives up on it.
    fn wait_for_reply(&mut self, waited: Duration, again: bool, send: &mut Vec<u8>) -> Result<(), String> {
        let Some(flight) = &self.flight else { return Ok(()) };
        let (patience, can_be_repeated) = (flight.order.patience(), flight.order.can_be_repeated());
        if waited > patience {
            let text = format!("no answer to '{}' in {} s", flight.order, patience.as_secs());
            if flight.call.is_none() {
                return Err(text);
            }
            self.give_up(&text);
        } else if again && can_be_repeated {
            self.repeat(send);
        }
        Ok(())
    }

    /// Drops the order in flight and tells its caller why.
    fn give_up(&mut self, why: &str) {
        if let Some(Flight { call: Some(call), .. }) = self.flight.take() {
            // The caller may have given up.
            let _ = call.answer.try_send(Err(why.to_owned()));
        }
    }
}

/// A reply, if it answers the last order.
fn replied(reply: &Reply<'_>, tag: u16) -> Heard {
    if reply.tag != tag {
        return Heard::Nothing;
    }
    Heard::Replied { status: reply.status, values: reply.values.iter().collect() }
}

/// Delivers a frame that came in one piece.
fn take(count: &mut Count, frame: &WireFrame<'_>, frames_per_s: f32, at: HostStamp, inbox: &mut Inbox) {
    let Some(number) = count.number(frame.sequence, frames_per_s, at, inbox) else { return };
    inbox.take(|out| {
        out.clear();
        fill(out, frame);
        out.sequence = number;
        out.stamp(at);
    });
}

/// Joins a part to the earlier ones, and delivers the frame once it is complete.
fn join(
    assembly: &mut Assembly,
    count: &mut Count,
    part: &Part<'_>,
    frames_per_s: f32,
    at: HostStamp,
    inbox: &mut Inbox,
) {
    if !assembly.take(part, at) {
        return;
    }
    let (sequence, begun) = assembly.of();
    let begun = begun.unwrap_or(at);
    let Some(number) = count.number(sequence, frames_per_s, begun, inbox) else { return };
    inbox.take(|out| {
        assembly.move_into(out);
        out.sequence = number;
        out.stamp(begun);
    });
}

/// Appends a message. All messages from the host are short.
fn push(message: &Message<'_>, send: &mut Vec<u8>) {
    let mut buffer = [0; 256];
    if let Ok(bytes) = encode(message, &mut buffer) {
        send.extend_from_slice(bytes);
    }
}
