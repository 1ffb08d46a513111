//! A host's request as owned data, so that it outlives the packet it was read from.

use dermis_wire::{Command, Message, Request, VERSION, WireError};

use crate::protocol::{Named, Protocol, Taken};

/// A message from a host.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Asked {
    /// An identification request, in a version that this firmware supports.
    Hello { nonce: u32 },
    /// A command.
    Order { tag: u16, code: u8, order: Order },
    /// A message not meant for devices, or an unreadable one.
    Nothing,
}

/// A command with checked arguments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Order {
    List(Taken),
    /// The list cannot be replaced while frames are being taken.
    ListWhileBusy,
    Name(Option<Named>),
    AmplitudeA(f32),
    FrequencyHz(f32),
    Gain(u8),
    FramesPerS(f32),
    Start,
    Stop,
    SingleShot,
    SelfTest,
    Impedance,
}

impl Asked {
    /// Interprets a message. Parts of a list go into `protocol` at once, unless the board is `busy` measuring it.
    pub(crate) fn of(
        message: Result<Message<'_>, WireError>,
        protocol: &mut Protocol<'_>,
        names: &[Named],
        busy: bool,
    ) -> Self {
        let Request { tag, command } = match message {
            Ok(Message::Hello(hello)) if (hello.lowest_version..=hello.highest_version).contains(&VERSION) => {
                return Self::Hello { nonce: hello.nonce };
            }
            Ok(Message::Command(request)) => request,
            _ => return Self::Nothing,
        };
        let order = match command {
            Command::Protocol { .. } if busy => Order::ListWhileBusy,
            Command::Protocol { first, total, measurements } => {
                Order::List(protocol.take(first, total, measurements, names[0]))
            }
            Command::ProtocolName(name) => Order::Name(names.iter().copied().find(|known| known.name() == name)),
            Command::Amplitude(amplitude_a) => Order::AmplitudeA(amplitude_a),
            Command::Frequency(frequency_hz) => Order::FrequencyHz(frequency_hz),
            Command::Gain(code) => Order::Gain(code),
            Command::Rate(frames_per_s) => Order::FramesPerS(frames_per_s),
            Command::Start => Order::Start,
            Command::Stop => Order::Stop,
            Command::SingleShot => Order::SingleShot,
            Command::SelfTest => Order::SelfTest,
            Command::ElectrodeImpedance => Order::Impedance,
        };
        Self::Order { tag, code: command.code(), order }
    }
}
