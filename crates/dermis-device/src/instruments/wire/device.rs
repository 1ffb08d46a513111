//! The device's side of the wire protocol: answers hello and commands, and packs frames while the host wants them.
//! Twins use it on a socket; firmware does the same with fixed-size memory.

use dermis_wire::{Command, Decoder, Describe, Element, Features, List, Message, Numbers, Reply, ReplyStatus};
use dermis_wire::{Request, Status, encode, encoded_len};

use crate::Frame;

/// Longest accepted command in bytes, as encoded.
const LONGEST_COMMAND: usize = 4096;

/// A device's description of itself.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceInfo {
    /// Make and model.
    pub device: String,
    /// Serial number.
    pub serial: String,
    /// Firmware version.
    pub firmware: String,
    /// Measurement protocol.
    pub protocol: String,
    /// Boot number: nonzero, and different after every start of the device.
    pub boot: u32,
    /// Number of electrodes.
    pub electrodes: u16,
    /// Number of readings in a frame.
    pub channels: u16,
    /// Frame rate in frames per second.
    pub frames_per_s: f32,
    /// Drive current amplitude in amperes.
    pub amplitude_a: f32,
    /// Drive frequency in hertz.
    pub frequency_hz: f32,
    /// True if readings are unsigned magnitudes.
    pub magnitude: bool,
}

/// The device's side of a conversation over the wire. It obeys start, stop and single shot, and sends readings as f32
/// in volts. Amplitude, frequency and rate are fixed; a request for another value is answered with the actual one. The
/// only gain has code 0. Self-test and impedance check return the values from [`WireDevice::set_measured`]. The device
/// only knows its own measurement protocol.
#[derive(Debug)]
pub struct WireDevice {
    info: DeviceInfo,
    self_test: Vec<f32>,
    impedances_ohm: Vec<f32>,
    decoder: Decoder<Vec<u8>>,
    running: bool,
    shots: u32,
    readings: Vec<f32>,
    imaginary: Vec<f32>,
    times_ns: Vec<u32>,
    buffer: Vec<u8>,
}

impl WireDevice {
    /// A device that sends no frames yet.
    pub fn new(info: DeviceInfo) -> Self {
        let longest = encoded_len(64 + 12 * usize::from(info.channels)).max(encoded_len(2048));
        Self {
            info,
            self_test: Vec::new(),
            impedances_ohm: Vec::new(),
            decoder: Decoder::new(vec![0; LONGEST_COMMAND]),
            running: false,
            shots: 0,
            readings: Vec::new(),
            imaginary: Vec::new(),
            times_ns: Vec::new(),
            buffer: vec![0; longest],
        }
    }

    /// Sets the answers to self-test and impedance check (ohms, one value per electrode, NaN where open). An empty
    /// answer means that the device doesn't have that command.
    pub fn set_measured(&mut self, self_test: &[f32], impedances_ohm: &[f32]) {
        self.self_test.clear();
        self.self_test.extend_from_slice(self_test);
        self.impedances_ohm.clear();
        self.impedances_ohm.extend_from_slice(impedances_ohm);
    }

    /// Resets the state when a host connects or disconnects. Nothing is sent until a host asks for it.
    pub fn reset_link(&mut self) {
        self.decoder.reset();
        self.running = false;
        self.shots = 0;
    }

    /// True while frames flow.
    pub fn is_running(&self) -> bool {
        self.running
    }

    /// True while frames flow or a single shot is pending.
    pub fn wants_frames(&self) -> bool {
        self.running || self.shots > 0
    }

    /// Handles bytes from the host. Answers are appended to `send`.
    pub fn receive(&mut self, bytes: &[u8], send: &mut Vec<u8>) {
        let mut rest = bytes;
        loop {
            let asked = match self.decoder.feed(&mut rest) {
                Some(Ok(Message::Hello(hello))) => Asked::Hello {
                    nonce: hello.nonce,
                    speaks: (hello.lowest_version..=hello.highest_version).contains(&dermis_wire::VERSION),
                },
                Some(Ok(Message::Command(Request { tag, command }))) => {
                    Asked::Command { tag, code: command.code(), argument: argument_of(&command) }
                }
                Some(_) => continue,
                None => return,
            };
            match asked {
                Asked::Hello { nonce, speaks: true } => self.describe(nonce, send),
                Asked::Hello { speaks: false, .. } => {}
                Asked::Command { tag, code, argument } => self.answer(tag, code, argument, send),
            }
        }
    }

    /// Packs a frame if the host wants one. Its number on the wire is the frame's own, wrapped to 32 bits.
    pub fn frame(&mut self, frame: &Frame, status: Status, send: &mut Vec<u8>) {
        if !self.wants_frames() {
            return;
        }
        let status = status.with(frame.status);
        let status = if self.running { status } else { status.with(Status::SINGLE) };
        self.shots = self.shots.saturating_sub(1);
        self.readings.clear();
        self.readings.extend(frame.values.iter().map(|value| *value as f32));
        self.imaginary.clear();
        self.imaginary.extend(frame.imaginary.iter().map(|value| *value as f32));
        self.times_ns.clear();
        // The wire's u32 nanoseconds cover 4.29 s.
        self.times_ns.extend(frame.channel_times_ns.iter().map(|time_ns| u32::try_from(*time_ns).unwrap_or(u32::MAX)));
        let message = Message::Frame(dermis_wire::Frame {
            sequence: frame.sequence as u32,
            device_time_ns: frame.device_time_ns.unwrap_or(frame.host_monotonic_ns),
            status,
            gain: frame.gain.unwrap_or(0),
            scale: 1.0,
            values: Numbers::from(&self.readings[..]),
            imaginary: (!self.imaginary.is_empty()).then(|| Numbers::from(&self.imaginary[..])),
            channel_times_ns: (!self.times_ns.is_empty()).then(|| List::from(&self.times_ns[..])),
        });
        push(&message, &mut self.buffer, send);
    }

    /// Sends the description. `nonce` is 0 unless it answers a host's hello.
    pub fn describe(&mut self, nonce: u32, send: &mut Vec<u8>) {
        let known = (0..Command::COUNT).filter(|code| self.has(*code)).fold(0, |bits, code| bits | (1 << code));
        let running = if self.running { Features::RUNNING } else { Features::default() };
        let magnitude = if self.info.magnitude { Features::MAGNITUDE } else { Features::default() };
        let message = Message::Describe(Describe {
            nonce,
            boot: self.info.boot,
            electrodes: self.info.electrodes,
            channels: self.info.channels,
            element: Element::F32,
            adc_bits: 0,
            features: running.with(magnitude),
            commands: known,
            frames_per_s: self.info.frames_per_s,
            most_frames_per_s: self.info.frames_per_s,
            amplitude_a: self.info.amplitude_a,
            frequency_hz: self.info.frequency_hz,
            device: &self.info.device,
            serial: &self.info.serial,
            firmware: &self.info.firmware,
            protocol: &self.info.protocol,
            protocols: &self.info.protocol,
        });
        push(&message, &mut self.buffer, send);
    }

    /// True if the device has the command with this code.
    fn has(&self, code: u8) -> bool {
        match code {
            AMPLITUDE => self.info.amplitude_a > 0.0,
            FREQUENCY => self.info.frequency_hz > 0.0,
            SELF_TEST => !self.self_test.is_empty(),
            IMPEDANCE => !self.impedances_ohm.is_empty(),
            _ => (GAIN..=SINGLE_SHOT).contains(&code),
        }
    }

    /// Carries out a command. Returns the numbers for the reply.
    fn obey(&mut self, code: u8, argument: f32) -> Result<&[f32], ReplyStatus> {
        let sensible = argument > 0.0 && argument.is_finite();
        match code {
            _ if !self.has(code) => return Err(ReplyStatus::Unknown),
            AMPLITUDE | FREQUENCY | RATE if !sensible => return Err(ReplyStatus::BadArgument),
            GAIN if argument != 0.0 && argument != f32::from(u8::MAX) => return Err(ReplyStatus::BadArgument),
            SELF_TEST | IMPEDANCE if self.running => return Err(ReplyStatus::Busy),
            START => self.running = true,
            STOP => self.running = false,
            SINGLE_SHOT => self.shots = self.shots.saturating_add(1),
            _ => {}
        }
        Ok(match code {
            AMPLITUDE => std::slice::from_ref(&self.info.amplitude_a),
            FREQUENCY => std::slice::from_ref(&self.info.frequency_hz),
            RATE => std::slice::from_ref(&self.info.frames_per_s),
            SELF_TEST => &self.self_test,
            IMPEDANCE => &self.impedances_ohm,
            _ => &[],
        })
    }

    fn answer(&mut self, tag: u16, code: u8, argument: f32, send: &mut Vec<u8>) {
        let mut buffer = std::mem::take(&mut self.buffer);
        let (status, values) = match self.obey(code, argument) {
            Ok(values) => (ReplyStatus::Done, values),
            Err(status) => (status, &[][..]),
        };
        let reply = Reply { tag, command: code, status, values: List::from(values) };
        push(&Message::Reply(reply), &mut buffer, send);
        self.buffer = buffer;
    }
}

/// Codes of the optional commands on the wire.
const AMPLITUDE: u8 = 2;
const FREQUENCY: u8 = 3;
const GAIN: u8 = 4;
const RATE: u8 = 5;
const START: u8 = 6;
const STOP: u8 = 7;
const SINGLE_SHOT: u8 = 8;
const SELF_TEST: u8 = 9;
const IMPEDANCE: u8 = 10;

/// A request from the host. Owned, so it outlives the decoder's borrow.
enum Asked {
    Hello { nonce: u32, speaks: bool },
    Command { tag: u16, code: u8, argument: f32 },
}

/// A command's numeric argument, or 0 if it has none.
fn argument_of(command: &Command<'_>) -> f32 {
    match *command {
        Command::Amplitude(value) | Command::Frequency(value) | Command::Rate(value) => value,
        Command::Gain(code) => f32::from(code),
        _ => 0.0,
    }
}

/// Appends a message. A message that the format can't hold is dropped.
fn push(message: &Message<'_>, buffer: &mut [u8], send: &mut Vec<u8>) {
    match encode(message, buffer) {
        Ok(bytes) => send.extend_from_slice(bytes),
        Err(error) => tracing::error!("cannot send: {error}"),
    }
}
