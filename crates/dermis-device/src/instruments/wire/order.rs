//! Orders from a host to a device on the wire: settings before frames flow, and calls at any time from any thread.

use std::fmt;
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use dermis_wire::{Command, Describe, Features, List, ReplyStatus};

use crate::DeviceError;

/// Number of list entries in one packet.
pub(super) const LIST_PART: usize = 50;
/// Longest wait for the reply to a setting.
const SHORT: Duration = Duration::from_secs(3);
/// Longest wait for a reply that requires a measurement.
const LONG: Duration = Duration::from_secs(30);

/// A command, in SI units.
#[derive(Debug, Clone, PartialEq)]
pub enum Order {
    /// Measure this list of electrodes: current in, current out, voltage, reference. Electrodes count from 0;
    /// [`dermis_wire::NO_ELECTRODE`] means none.
    Protocol(Vec<[u8; 4]>),
    /// Measure a list that the device stores under this name.
    ProtocolName(String),
    /// Drive current amplitude in amperes.
    AmplitudeA(f32),
    /// Drive frequency in hertz.
    FrequencyHz(f32),
    /// Gain, as the device's own code; `None` leaves it to the device.
    Gain(Option<u8>),
    /// Frame rate in frames per second.
    FramesPerS(f32),
    /// Start sending frames.
    Start,
    /// Stop sending frames.
    Stop,
    /// Send one frame.
    SingleShot,
    /// Run a self-test.
    SelfTest,
    /// Measure contact impedances.
    ElectrodeImpedance,
}

impl Order {
    /// The command on the wire. A list is sent in parts; this one begins at `first`.
    pub(super) fn command(&self, first: usize) -> Command<'_> {
        match self {
            Self::Protocol(list) => {
                let part = &list[first..list.len().min(first + LIST_PART)];
                Command::Protocol { first: first as u16, total: list.len() as u16, measurements: List::from(part) }
            }
            Self::ProtocolName(name) => Command::ProtocolName(name),
            Self::AmplitudeA(amplitude_a) => Command::Amplitude(*amplitude_a),
            Self::FrequencyHz(frequency_hz) => Command::Frequency(*frequency_hz),
            Self::Gain(code) => Command::Gain(code.unwrap_or(u8::MAX)),
            Self::FramesPerS(frames_per_s) => Command::Rate(*frames_per_s),
            Self::Start => Command::Start,
            Self::Stop => Command::Stop,
            Self::SingleShot => Command::SingleShot,
            Self::SelfTest => Command::SelfTest,
            Self::ElectrodeImpedance => Command::ElectrodeImpedance,
        }
    }

    /// Start of the next part of a list, or `None` after the last one.
    pub(super) fn next_part(&self, first: usize) -> Option<usize> {
        match self {
            Self::Protocol(list) => Some(first + LIST_PART).filter(|next| *next < list.len()),
            _ => None,
        }
    }

    /// True if repeating the order is harmless.
    pub(super) fn can_be_repeated(&self) -> bool {
        !matches!(self, Self::SingleShot | Self::SelfTest | Self::ElectrodeImpedance)
    }

    pub(super) fn patience(&self) -> Duration {
        if self.can_be_repeated() { SHORT } else { LONG }
    }

    /// Refuses orders that the wire can't hold.
    pub(super) fn check(&self) -> Result<(), String> {
        match self {
            Self::Protocol(list) if list.is_empty() || list.len() > usize::from(u16::MAX) => {
                Err(format!("a list of 1 to 65535 measurements, found {}", list.len()))
            }
            Self::ProtocolName(name) if name.len() > 32 => Err(format!("a name of at most 32 bytes, found '{name}'")),
            _ => Ok(()),
        }
    }
}

impl fmt::Display for Order {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Protocol(list) => write!(out, "protocol of {} measurements", list.len()),
            Self::ProtocolName(name) => write!(out, "protocol '{}'", crate::error::shorten(name)),
            Self::AmplitudeA(amplitude_a) => write!(out, "amplitude {amplitude_a} A"),
            Self::FrequencyHz(frequency_hz) => write!(out, "frequency {frequency_hz} Hz"),
            Self::Gain(Some(code)) => write!(out, "gain {code}"),
            Self::Gain(None) => write!(out, "automatic gain"),
            Self::FramesPerS(frames_per_s) => write!(out, "{frames_per_s} frames/s"),
            Self::Start => write!(out, "start"),
            Self::Stop => write!(out, "stop"),
            Self::SingleShot => write!(out, "single shot"),
            Self::SelfTest => write!(out, "self-test"),
            Self::ElectrodeImpedance => write!(out, "electrode impedance check"),
        }
    }
}

/// A device's description of itself, owned. The fields are those of [`dermis_wire::Describe`].
#[derive(Debug, Clone, PartialEq)]
#[expect(missing_docs, reason = "the wire's description has them")]
pub struct Description {
    pub boot: u32,
    pub electrodes: u16,
    pub channels: u16,
    pub adc_bits: u8,
    pub features: Features,
    pub commands: u32,
    pub frames_per_s: f32,
    pub most_frames_per_s: f32,
    pub amplitude_a: f32,
    pub frequency_hz: f32,
    pub device: String,
    pub serial: String,
    pub firmware: String,
    pub protocol: String,
    pub protocols: Vec<String>,
}

impl Description {
    pub(super) fn of(describe: &Describe<'_>) -> Self {
        let clean = crate::error::shorten;
        Self {
            boot: describe.boot,
            electrodes: describe.electrodes,
            channels: describe.channels,
            adc_bits: describe.adc_bits,
            features: describe.features,
            commands: describe.commands,
            frames_per_s: describe.frames_per_s,
            most_frames_per_s: describe.most_frames_per_s,
            amplitude_a: describe.amplitude_a,
            frequency_hz: describe.frequency_hz,
            device: clean(describe.device),
            serial: clean(describe.serial),
            firmware: clean(describe.firmware),
            protocol: clean(describe.protocol),
            protocols: describe.protocol_names().map(clean).collect(),
        }
    }

    /// True if the device supports the order.
    pub fn obeys(&self, order: &Order) -> bool {
        // A command's code doesn't depend on its arguments.
        self.commands & (1 << order.command(0).code()) != 0
    }

    /// Summary for users, in one line.
    pub fn identity(&self) -> String {
        let Self { device, serial, firmware, electrodes, channels, frames_per_s, .. } = self;
        format!(
            "{device} {serial}, firmware {firmware}, {electrodes} electrodes, {channels} channels at {frames_per_s} frames/s"
        )
    }
}

/// An order and the channel for its answer.
#[derive(Debug)]
pub(super) struct Call {
    pub(super) order: Order,
    pub(super) answer: SyncSender<Result<Vec<f32>, String>>,
}

/// Calls to a device whose frames another thread reads.
///
/// Every call waits for the device's reply, up to three seconds for a setting and thirty for a measurement.
#[derive(Debug, Clone)]
pub struct WireControl {
    calls: Sender<Call>,
    known: Arc<Mutex<Option<Description>>>,
}

/// The host's end of a [`WireControl`].
#[derive(Debug)]
pub(super) struct Controlled {
    pub(super) calls: Receiver<Call>,
    pub(super) known: Arc<Mutex<Option<Description>>>,
}

impl WireControl {
    pub(super) fn pair() -> (Self, Controlled) {
        let (sender, calls) = channel();
        let known = Arc::default();
        (Self { calls: sender, known: Arc::clone(&known) }, Controlled { calls, known })
    }

    /// The device's latest description of itself.
    pub fn description(&self) -> Option<Description> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Sends an order and waits for the numbers in its reply. Amplitude (A), frequency (Hz) and rate (frames/s) return
    /// the value that was set. A self-test returns its measurements (see the device's manual). The impedance check
    /// returns one value per electrode in ohms, NaN or infinite where open. Other orders return nothing.
    ///
    /// # Errors
    /// [`DeviceError::Refused`] with the device's reason, or because there was no answer.
    pub fn call(&self, order: Order) -> Result<Vec<f32>, DeviceError> {
        self.ask(order)?.wait()
    }

    /// Sends an order without waiting for the answer.
    ///
    /// # Errors
    /// [`DeviceError::Refused`] if the wire can't hold the order, or the connection has been closed.
    pub fn ask(&self, order: Order) -> Result<Question, DeviceError> {
        let (answer, answers) = sync_channel(1);
        let question = Question { order: order.clone(), answers };
        order.check().map_err(|expected| question.refused(format!("expected {expected}")))?;
        let sent = self.calls.send(Call { order, answer });
        sent.map_err(|_| question.refused("the connection has been closed".to_owned()))?;
        Ok(question)
    }
}

/// An order that was sent but not answered yet.
#[derive(Debug)]
pub struct Question {
    order: Order,
    answers: Receiver<Result<Vec<f32>, String>>,
}

impl Question {
    /// Waits for the answer; see [`WireControl::call`].
    ///
    /// # Errors
    /// As [`WireControl::call`].
    pub fn wait(self) -> Result<Vec<f32>, DeviceError> {
        // The conversation has its own time limit. Wait a little longer, because its thread may be between two reads.
        match self.answers.recv_timeout(self.order.patience() + SHORT) {
            Ok(result) => result.map_err(|reason| self.refused(reason)),
            Err(_) => Err(self.refused("no answer: the device is not connected".to_owned())),
        }
    }

    /// The answer, if it has arrived.
    pub fn answer(&self) -> Option<Result<Vec<f32>, DeviceError>> {
        let result = self.answers.try_recv().ok()?;
        Some(result.map_err(|reason| self.refused(reason)))
    }

    fn refused(&self, reason: String) -> DeviceError {
        DeviceError::Refused { order: self.order.to_string(), reason }
    }
}

/// Describes a reply's status in words.
pub(super) fn reason(status: ReplyStatus) -> String {
    match status {
        ReplyStatus::Done => "done",
        ReplyStatus::Unknown => "the device does not have this command",
        ReplyStatus::BadArgument => "the device cannot take this",
        ReplyStatus::Busy => "the device is busy: stop it first",
        ReplyStatus::Failed => "the device tried and failed",
    }
    .to_owned()
}
