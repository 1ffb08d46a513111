//! Turns messages into bytes.

use crate::cobs::{Full, Stuffer};
use crate::list::{List, Numbers, Scalar};
use crate::message::{Describe, Frame, Hello, Kind, Message, Part};
use crate::packet::{CRC, MOST_PACKET, MOST_TEXT, VERSION};
use crate::{Command, Reply, Request, WireError};

/// Writes a message into `out`, with a delimiter before and after it, and returns the bytes to send.
/// [`encoded_len`](crate::encoded_len) gives the room a packet needs.
///
/// # Errors
/// [`WireError::Long`] if `out` is too short or the packet is longer than [`MOST_PACKET`]; [`WireError::Text`] and
/// [`WireError::Count`] for fields that do not fit the format.
pub fn encode<'b>(message: &Message<'_>, out: &'b mut [u8]) -> Result<&'b mut [u8], WireError> {
    let mut writer = Writer::new(out)?;
    writer.bytes(&[VERSION, message.kind().code()])?;
    match message {
        Message::Hello(hello) => writer.hello(hello)?,
        Message::Describe(describe) => writer.describe(describe)?,
        Message::Command(request) => writer.request(request)?,
        Message::Reply(reply) => writer.reply(reply)?,
        Message::Frame(frame) => writer.frame(Kind::Frame, frame)?,
        Message::Part(part) => writer.part(part)?,
    }
    writer.finish()
}

struct Writer<'b> {
    stuffer: Stuffer<'b>,
    checksum: crc::Digest<'static, u32>,
    written: usize,
    limit: usize,
}

/// Static, so that the checksum table exists only once.
static CHECKSUM: crc::Crc<u32> = CRC;

impl<'b> Writer<'b> {
    fn new(out: &'b mut [u8]) -> Result<Self, WireError> {
        let limit = out.len();
        let stuffer = Stuffer::new(out).map_err(|Full| WireError::Long { limit })?;
        Ok(Self { stuffer, checksum: CHECKSUM.digest(), written: 0, limit })
    }

    fn bytes(&mut self, bytes: &[u8]) -> Result<(), WireError> {
        self.checksum.update(bytes);
        self.raw(bytes)
    }

    fn raw(&mut self, bytes: &[u8]) -> Result<(), WireError> {
        let long = WireError::Long { limit: self.limit };
        self.written += bytes.len();
        if self.written > MOST_PACKET {
            return Err(long);
        }
        bytes.iter().try_for_each(|byte| self.stuffer.push(*byte)).map_err(|Full| long)
    }

    fn finish(mut self) -> Result<&'b mut [u8], WireError> {
        let checksum = self.checksum.clone().finalize();
        self.raw(&checksum.to_le_bytes())?;
        let limit = self.limit;
        self.stuffer.finish().map_err(|Full| WireError::Long { limit })
    }

    fn text(&mut self, kind: Kind, field: &'static str, text: &str) -> Result<(), WireError> {
        let length = u8::try_from(text.len()).map_err(|_| WireError::Text { kind, field })?;
        debug_assert!(usize::from(length) <= MOST_TEXT);
        self.bytes(&[length])?;
        self.bytes(text.as_bytes())
    }

    fn count(&mut self, kind: Kind, field: &'static str, found: usize) -> Result<(), WireError> {
        let expected = usize::from(u16::MAX);
        let count = u16::try_from(found).map_err(|_| WireError::Count { kind, field, expected, found })?;
        self.bytes(&count.to_le_bytes())
    }

    fn list<T: Scalar>(&mut self, list: &List<'_, T>) -> Result<(), WireError> {
        list.iter().try_for_each(|number| number.to_wire(|bytes| self.bytes(bytes)))
    }

    fn numbers(&mut self, numbers: &Numbers<'_>) -> Result<(), WireError> {
        match numbers {
            Numbers::I16(list) => self.list(list),
            Numbers::I32(list) => self.list(list),
            Numbers::F32(list) => self.list(list),
        }
    }

    fn hello(&mut self, hello: &Hello) -> Result<(), WireError> {
        self.bytes(&hello.nonce.to_le_bytes())?;
        self.bytes(&[hello.lowest_version, hello.highest_version])
    }

    fn describe(&mut self, describe: &Describe<'_>) -> Result<(), WireError> {
        self.bytes(&describe.nonce.to_le_bytes())?;
        self.bytes(&describe.boot.to_le_bytes())?;
        self.bytes(&describe.electrodes.to_le_bytes())?;
        self.bytes(&describe.channels.to_le_bytes())?;
        self.bytes(&[describe.element.code(), describe.adc_bits, describe.features.0, 0])?;
        self.bytes(&describe.commands.to_le_bytes())?;
        for number in [describe.frames_per_s, describe.most_frames_per_s, describe.amplitude_a, describe.frequency_hz] {
            self.bytes(&number.to_le_bytes())?;
        }
        for (field, text) in [
            ("device", describe.device),
            ("serial", describe.serial),
            ("firmware", describe.firmware),
            ("protocol", describe.protocol),
            ("protocols", describe.protocols),
        ] {
            self.text(Kind::Describe, field, text)?;
        }
        Ok(())
    }

    fn request(&mut self, request: &Request<'_>) -> Result<(), WireError> {
        self.bytes(&request.tag.to_le_bytes())?;
        self.bytes(&[request.command.code(), 0])?;
        match &request.command {
            Command::Protocol { first, total, measurements } => {
                self.bytes(&first.to_le_bytes())?;
                self.bytes(&total.to_le_bytes())?;
                self.count(Kind::Command, "measurements", measurements.len())?;
                self.list(measurements)
            }
            Command::ProtocolName(name) => self.text(Kind::Command, "protocol", name),
            Command::Amplitude(number) | Command::Frequency(number) | Command::Rate(number) => {
                self.bytes(&number.to_le_bytes())
            }
            Command::Gain(code) => self.bytes(&[*code]),
            Command::Start | Command::Stop | Command::SingleShot | Command::SelfTest | Command::ElectrodeImpedance => {
                Ok(())
            }
        }
    }

    fn reply(&mut self, reply: &Reply<'_>) -> Result<(), WireError> {
        self.bytes(&reply.tag.to_le_bytes())?;
        self.bytes(&[reply.command, reply.status.code()])?;
        self.count(Kind::Reply, "values", reply.values.len())?;
        self.list(&reply.values)
    }

    fn part(&mut self, part: &Part<'_>) -> Result<(), WireError> {
        let (end, total) = (usize::from(part.first) + part.readings.values.len(), usize::from(part.total));
        if end > total {
            return Err(WireError::Count { kind: Kind::Part, field: "values", expected: total, found: end });
        }
        self.bytes(&part.first.to_le_bytes())?;
        self.bytes(&part.total.to_le_bytes())?;
        self.frame(Kind::Part, &part.readings)
    }

    fn frame(&mut self, kind: Kind, frame: &Frame<'_>) -> Result<(), WireError> {
        let expected = frame.values.len();
        if let Some(imaginary) = &frame.imaginary {
            let same = imaginary.element() == frame.values.element();
            let found = if same { imaginary.len() } else { 0 };
            if found != expected {
                return Err(WireError::Count { kind, field: "imaginary", expected, found });
            }
        }
        if let Some(times) = frame.channel_times_ns.filter(|times| times.len() != expected) {
            return Err(WireError::Count { kind, field: "channel times", expected, found: times.len() });
        }
        let parts = u8::from(frame.imaginary.is_some()) | (u8::from(frame.channel_times_ns.is_some()) << 1);
        self.bytes(&frame.sequence.to_le_bytes())?;
        self.bytes(&frame.device_time_ns.to_le_bytes())?;
        self.bytes(&frame.status.0.to_le_bytes())?;
        self.count(kind, "values", expected)?;
        self.bytes(&[frame.values.element().code(), parts, frame.gain, 0])?;
        self.bytes(&frame.scale.to_le_bytes())?;
        self.numbers(&frame.values)?;
        if let Some(imaginary) = &frame.imaginary {
            self.numbers(imaginary)?;
        }
        match &frame.channel_times_ns {
            Some(times) => self.list(times),
            None => Ok(()),
        }
    }
}
