//! The scan engine listens, answers, measures and sends, a little with every call of [`Engine::poll`], so that a host
//! is heard between two readings. Its memory is fixed: one part of a frame, and one packet in each direction. Memory
//! for the list of measurements is lent to it, so that the engine itself can be built on a small stack.

use dermis_wire::{
    Command, Decoder, Describe, Element, Features, Frame, List, Message, Numbers, Part, Reply, ReplyStatus, Status,
    encode, encoded_len,
};
use embedded_io::{Read, ReadReady, Write};

use crate::board::{Board, Failure, Reading};
use crate::command::{Asked, Order};
use crate::protocol::{MOST_ELECTRODES, Named, Protocol, Taken};
use crate::scan::{PART_READINGS, Scan};

/// Longest command, as received: 50 measurements of a list.
const COMMAND_BYTES: usize = 256;
/// Longest packet sent: header and checksum of a packet, 4 and 24 bytes of a part, readings with their times.
const PACKET_BYTES: usize = encoded_len(6 + 4 + 24 + PART_READINGS * (size_of::<i16>() + size_of::<u32>()));
/// Longest list of names in a description.
const NAMES_BYTES: usize = 96;
/// Upper bound on the size of an engine in bytes, without board, port, clock and list.
pub const STATE_BUDGET: usize = 2 * 1024;
/// Interval for signs of life. A device that is silent for a second is taken for dead.
const HEARTBEAT_NS: u64 = 900_000_000;
/// A reading that takes longer has failed: 17 conversions.
const READING_NS: u64 = 20_000_000;
/// Gain code that leaves the choice to the device.
const AUTOMATIC: u8 = 255;
/// Switch to the next finer range if the largest reading of a frame is below this many counts.
const FINER_BELOW: u16 = 14_000;

// Checked for every target of the crate.
const _: () = assert!(size_of::<Engine<'static, (), (), ()>>() <= STATE_BUDGET);

/// The board's clock.
pub trait Clock {
    /// Nanoseconds since an origin of its choice; never runs backwards.
    fn now_ns(&mut self) -> u64;
}

/// Distinguishes a board from others of its kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Identity {
    /// Serial number, at most 32 bytes.
    pub serial: &'static str,
    /// Differs at every start of the board (a counter in flash, or random bits); 0 if neither is available.
    pub boot: u32,
}

/// The engine.
#[derive(Debug)]
pub struct Engine<'l, B, P, C> {
    board: B,
    port: P,
    clock: C,
    identity: Identity,
    decoder: Decoder<[u8; COMMAND_BYTES]>,
    packet: [u8; PACKET_BYTES],
    protocol: Protocol<'l>,
    scan: Scan,
    running: bool,
    shots: u8,
    automatic_gain: bool,
    /// The gain has changed since the previous frame.
    gain_changed: bool,
    /// Something in the description has changed since it was sent.
    changed: bool,
    /// A reading in this frame has failed.
    failed: bool,
    /// Requested time between frames; 0 for as fast as possible.
    period_ns: u64,
    /// Duration of the last frame with this protocol; 0 before the first.
    took_ns: u64,
    sent_ns: u64,
}

impl<'l, B: Board, P: Read + ReadReady + Write, C: Clock> Engine<'l, B, P, C> {
    /// An engine that waits for a host; the first poll sends the description. `list` is memory for a host's list of
    /// measurements, four bytes each; rule-based protocols need none.
    pub fn new(board: B, port: P, clock: C, identity: Identity, list: &'l mut [[u8; 4]]) -> Self {
        let facts = board.facts();
        let named = facts.protocols.first().copied().unwrap_or(Named::AdjacentSink);
        Self {
            protocol: Protocol::new(facts.electrodes, facts.coils, named, list),
            board,
            port,
            clock,
            identity,
            decoder: Decoder::new([0; COMMAND_BYTES]),
            packet: [0; PACKET_BYTES],
            scan: Scan::new(),
            running: false,
            shots: 0,
            automatic_gain: true,
            gain_changed: false,
            changed: true,
            failed: false,
            period_ns: 0,
            took_ns: 0,
            sent_ns: 0,
        }
    }

    /// Reads and answers incoming messages, and advances the scan by at most one step of a reading.
    ///
    /// # Errors
    /// Any error of the port. The engine can be polled again. Data being sent are lost, which the host notices by the
    /// sequence numbers.
    pub fn poll(&mut self) -> Result<(), P::Error> {
        self.listen()?;
        if self.changed && (self.scan.is_between() || !self.is_scanning()) {
            self.changed = false;
            self.describe(0)?;
        }
        if self.is_scanning() {
            self.measure()?;
            if self.clock.now_ns().saturating_sub(self.sent_ns) > HEARTBEAT_NS {
                self.describe(0)?;
            }
        }
        Ok(())
    }

    /// The board.
    pub fn board(&self) -> &B {
        &self.board
    }

    /// True while frames are being taken.
    pub fn is_scanning(&self) -> bool {
        self.running || self.shots > 0
    }

    fn listen(&mut self) -> Result<(), P::Error> {
        let mut bytes = [0; 64];
        while self.port.read_ready()? {
            let count = self.port.read(&mut bytes)?;
            let mut rest = &bytes[..count];
            let names = self.board.facts().protocols;
            loop {
                let busy = self.running || self.shots > 0;
                let Some(message) = self.decoder.feed(&mut rest) else { break };
                match Asked::of(message, &mut self.protocol, names, busy) {
                    Asked::Hello { nonce } => self.describe(nonce)?,
                    Asked::Order { tag, code, order } => self.obey(tag, code, order)?,
                    Asked::Nothing => {}
                }
            }
            if count == 0 {
                break;
            }
        }
        Ok(())
    }

    fn obey(&mut self, tag: u16, code: u8, order: Order) -> Result<(), P::Error> {
        let mut values = [0.0; MOST_ELECTRODES as usize];
        let (status, count) = match self.act(order, &mut values) {
            Ok(count) => (ReplyStatus::Done, count),
            Err(status) => (status, 0),
        };
        let values = List::from(&values[..count]);
        self.send(&Message::Reply(Reply { tag, command: code, status, values }))
    }

    /// Carries out an order; returns the number of `values` in the answer.
    fn act(&mut self, order: Order, values: &mut [f32]) -> Result<usize, ReplyStatus> {
        let refused = |failure| match failure {
            Failure::BadArgument => ReplyStatus::BadArgument,
            Failure::Unknown => ReplyStatus::Unknown,
            Failure::Bus => ReplyStatus::Failed,
        };
        match order {
            Order::List(Taken::Part) => return Ok(0),
            Order::List(Taken::Refused) | Order::Name(None) => return Err(ReplyStatus::BadArgument),
            Order::ListWhileBusy => return Err(ReplyStatus::Busy),
            Order::SelfTest | Order::Impedance if self.is_scanning() => return Err(ReplyStatus::Busy),
            Order::SelfTest => return self.board.self_test(values).map_err(refused),
            Order::Impedance => return self.impedances_ohm(values).map_err(refused),
            Order::SingleShot => {
                self.shots = self.shots.saturating_add(1);
                return Ok(0);
            }
            Order::List(Taken::Whole) => {}
            Order::Name(Some(named)) => self.protocol.set_named(named),
            Order::AmplitudeA(asked) => values[0] = self.board.set_amplitude_a(asked).map_err(refused)?,
            Order::FrequencyHz(asked) => values[0] = self.board.set_frequency_hz(asked).map_err(refused)?,
            Order::FramesPerS(asked) => values[0] = self.set_rate(asked)?,
            Order::Gain(AUTOMATIC) => self.automatic_gain = true,
            Order::Gain(gain) => {
                self.board.set_gain(gain).map_err(refused)?;
                (self.automatic_gain, self.gain_changed) = (false, true);
            }
            Order::Start => {
                self.changed |= !self.running;
                self.running = true;
                return Ok(0);
            }
            Order::Stop => {
                (self.running, self.shots) = (false, 0);
                self.board.quiet().map_err(refused)?;
            }
        }
        if matches!(order, Order::List(_) | Order::Name(_)) {
            self.took_ns = 0;
        }
        // Discard readings made with the old settings.
        self.scan.restart();
        self.changed = true;
        let answered = matches!(order, Order::AmplitudeA(_) | Order::FrequencyHz(_) | Order::FramesPerS(_));
        Ok(usize::from(answered))
    }

    fn set_rate(&mut self, frames_per_s: f32) -> Result<f32, ReplyStatus> {
        if !(frames_per_s > 0.0 && frames_per_s.is_finite()) {
            return Err(ReplyStatus::BadArgument);
        }
        let set = frames_per_s.min(self.most_frames_per_s());
        self.period_ns = (1e9 / set) as u64;
        Ok(set)
    }

    /// From the duration of the last frame or, before the first, from the board's estimate.
    fn most_frames_per_s(&self) -> f32 {
        if self.took_ns > 0 {
            return 1e9 / self.took_ns as f32;
        }
        self.board.facts().readings_per_s / f32::from(self.protocol.len().max(1))
    }

    fn impedances_ohm(&mut self, values: &mut [f32]) -> Result<usize, Failure> {
        let facts = self.board.facts();
        if !facts.has_impedance {
            return Err(Failure::Unknown);
        }
        for electrode in 0..facts.electrodes {
            values[usize::from(electrode)] = self.board.impedance_ohm(electrode)?;
        }
        Ok(usize::from(facts.electrodes))
    }

    /// Continues the current reading, or starts the next one.
    fn measure(&mut self) -> Result<(), P::Error> {
        let now_ns = self.clock.now_ns();
        if self.protocol.is_empty() {
            return Ok(());
        }
        let early = self.scan.is_between() && now_ns.saturating_sub(self.scan.frame_ns) < self.period_ns;
        if early && self.scan.frame_ns > 0 {
            return Ok(());
        }
        let began_ns = *self.scan.reading_ns.get_or_insert(now_ns);
        let reading = match self.board.measure(self.protocol.measurement(self.scan.index)) {
            Ok(reading) => reading,
            Err(nb::Error::WouldBlock) if now_ns - began_ns < READING_NS => return Ok(()),
            Err(_) => {
                self.failed = true;
                Reading { counts: i16::MIN, status: Status::SATURATED }
            }
        };
        self.scan.keep(reading);
        let whole = self.scan.index == self.protocol.len();
        if whole || self.scan.held == PART_READINGS {
            self.send_part()?;
        }
        if whole {
            self.finish_frame();
        }
        Ok(())
    }

    fn send_part(&mut self) -> Result<(), P::Error> {
        let held = core::mem::take(&mut self.scan.held);
        let first = self.scan.index - held as u16;
        let mut status = self.scan.status;
        if !self.running {
            status = status.with(Status::SINGLE);
        }
        if first == 0 && core::mem::take(&mut self.gain_changed) {
            status = status.with(Status::GAIN_CHANGED);
        }
        let readings = Frame {
            sequence: self.scan.sequence,
            device_time_ns: self.scan.part_ns,
            status,
            gain: self.board.gain(),
            scale: self.board.scale_v(),
            values: Numbers::from(&self.scan.readings[..held]),
            imaginary: None,
            channel_times_ns: Some(List::from(&self.scan.times_ns[..held])),
        };
        let message = Message::Part(Part { first, total: self.protocol.len(), readings });
        let sent = write(&message, &mut self.packet, &mut self.port);
        self.sent_ns = self.clock.now_ns();
        sent
    }

    fn finish_frame(&mut self) {
        if self.automatic_gain && !core::mem::take(&mut self.failed) {
            let gain = self.board.gain();
            let wanted = match self.scan.largest {
                _ if self.scan.frame_status.has(Status::SATURATED) => gain.saturating_sub(1),
                largest if largest < FINER_BELOW => (gain + 1).min(self.board.gains() - 1),
                _ => gain,
            };
            // A bus that fails here fails again at the next reading, where it is reported.
            if wanted != gain && self.board.set_gain(wanted).is_ok() {
                (self.gain_changed, self.changed) = (true, true);
            }
        }
        // Send a description after the first frame of a protocol.
        self.changed |= self.took_ns == 0;
        self.took_ns = self.clock.now_ns().saturating_sub(self.scan.frame_ns).max(1);
        self.scan.next_frame();
        if !self.running {
            self.shots = self.shots.saturating_sub(1);
            if self.shots == 0 {
                // As above.
                let _ = self.board.quiet();
            }
        }
    }

    /// Sends the description and settings; `nonce` is 0 unless a host has asked.
    fn describe(&mut self, nonce: u32) -> Result<(), P::Error> {
        let facts = self.board.facts();
        let most_frames_per_s = self.most_frames_per_s();
        let wanted = if self.period_ns == 0 { f32::INFINITY } else { 1e9 / self.period_ns as f32 };
        let mut features = Features::CHANNEL_TIMES.with(Features::PARTS);
        if facts.magnitude {
            features = features.with(Features::MAGNITUDE);
        }
        if self.running {
            features = features.with(Features::RUNNING);
        }
        let mut names = [0; NAMES_BYTES];
        let message = Message::Describe(Describe {
            nonce,
            boot: self.identity.boot,
            electrodes: u16::from(facts.electrodes),
            channels: self.protocol.len(),
            element: Element::I16,
            adc_bits: facts.adc_bits,
            features,
            commands: commands(facts.has_frequency, facts.has_impedance),
            frames_per_s: most_frames_per_s.min(wanted),
            most_frames_per_s,
            amplitude_a: self.board.amplitude_a(),
            frequency_hz: self.board.frequency_hz(),
            device: facts.device,
            serial: self.identity.serial,
            firmware: env!("CARGO_PKG_VERSION"),
            protocol: self.protocol.name(),
            protocols: joined(facts.protocols, &mut names),
        });
        self.send(&message)
    }

    fn send(&mut self, message: &Message<'_>) -> Result<(), P::Error> {
        let sent = write(message, &mut self.packet, &mut self.port);
        self.sent_ns = self.clock.now_ns();
        sent
    }
}

/// Sends a message; all messages of this firmware fit into the packet's memory.
fn write<P: Write>(message: &Message<'_>, packet: &mut [u8], port: &mut P) -> Result<(), P::Error> {
    match encode(message, packet) {
        Ok(bytes) => port.write_all(bytes),
        Err(_) => Ok(()),
    }
}

/// Bits of the supported commands.
fn commands(has_frequency: bool, has_impedance: bool) -> u32 {
    let all = (1 << Command::COUNT) - 1;
    let without = |has: bool, command: Command<'_>| if has { 0 } else { 1 << command.code() };
    all & !without(has_frequency, Command::Frequency(0.0)) & !without(has_impedance, Command::ElectrodeImpedance)
}

/// Names separated by commas, as many as fit.
fn joined<'m>(protocols: &[Named], memory: &'m mut [u8]) -> &'m str {
    let mut at = 0;
    for named in protocols {
        let name = named.name().as_bytes();
        let comma = usize::from(at > 0);
        let Some(room) = memory.get_mut(at..at + comma + name.len()) else { break };
        room[..comma].fill(b',');
        room[comma..].copy_from_slice(name);
        at += comma + name.len();
    }
    core::str::from_utf8(&memory[..at]).unwrap_or_default()
}
