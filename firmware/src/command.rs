//! What a host has asked, owned, so that it outlives the packet from which it was read.

use dermis_wire::{Command, Message, Request, VERSION, WireError};

use crate::protocol::{Named, Protocol, Taken};

/// A host's words.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Asked {
    /// Who are you? In a version that this firmware speaks.
    Hello { nonce: u32 },
    /// Do this.
    Order { tag: u16, code: u8, order: Order },
    /// Nothing for a device, or nothing that could be read.
    Nothing,
}

/// A command whose arguments have been looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Order {
    List(Taken),
    /// While frames flow their list cannot be replaced.
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
    /// What a message asks. Parts of a list go into `protocol` at once, unless the board is `busy` measuring it.
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
