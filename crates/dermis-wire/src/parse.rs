//! Turns unstuffed packets into messages that borrow from them.

use crate::list::{Element, List, Numbers, Scalar};
use crate::message::{Describe, Features, Frame, Hello, Kind, Message, Part, Status};
use crate::packet::{CRC, FRAMING, MOST_PACKET, VERSION};
use crate::{Command, Reply, ReplyStatus, Request, WireError};

static CHECKSUM: crc::Crc<u32> = CRC;

/// Parses a whole packet: version, kind, payload, checksum.
pub(crate) fn message(packet: &[u8]) -> Result<Message<'_>, WireError> {
    if packet.len() < FRAMING {
        return Err(WireError::Short { found: packet.len() });
    }
    if packet.len() > MOST_PACKET {
        return Err(WireError::Long { limit: MOST_PACKET });
    }
    let (body, checksum) = packet.split_at(packet.len() - 4);
    let (expected, found) = (CHECKSUM.checksum(body), u32::from_wire(checksum));
    if expected != found {
        return Err(WireError::Checksum { expected, found });
    }
    if body[0] != VERSION {
        return Err(WireError::Version { found: body[0] });
    }
    let kind = Kind::from_code(body[1]).ok_or(WireError::UnknownKind { found: body[1] })?;
    let mut fields = Fields { kind, bytes: &body[2..], at: 0 };
    let message = match kind {
        Kind::Hello => Message::Hello(fields.hello()?),
        Kind::Describe => Message::Describe(fields.describe()?),
        Kind::Command => Message::Command(fields.request()?),
        Kind::Reply => Message::Reply(fields.reply()?),
        Kind::Frame => Message::Frame(fields.frame()?),
        Kind::Part => Message::Part(fields.part()?),
    };
    fields.end()?;
    Ok(message)
}

struct Fields<'a> {
    kind: Kind,
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Fields<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], WireError> {
        let end = self.at + count;
        let taken = self.bytes.get(self.at..end).ok_or(WireError::Length {
            kind: self.kind,
            expected: end,
            found: self.bytes.len(),
        })?;
        self.at = end;
        Ok(taken)
    }

    fn end(&self) -> Result<(), WireError> {
        if self.at == self.bytes.len() {
            return Ok(());
        }
        Err(WireError::Length { kind: self.kind, expected: self.at, found: self.bytes.len() })
    }

    fn byte(&mut self) -> Result<u8, WireError> {
        Ok(self.take(1)?[0])
    }

    fn short(&mut self) -> Result<u16, WireError> {
        let bytes = self.take(2)?;
        Ok(u16::from_le_bytes([bytes[0], bytes[1]]))
    }

    fn scalar<T: Scalar>(&mut self) -> Result<T, WireError> {
        self.take(T::BYTES).map(T::from_wire)
    }

    fn list<T: Scalar>(&mut self, count: u16) -> Result<List<'a, T>, WireError> {
        self.take(usize::from(count) * T::BYTES).map(List::wire)
    }

    fn numbers(&mut self, element: Element, count: u16) -> Result<Numbers<'a>, WireError> {
        let bytes = self.take(usize::from(count) * element.bytes())?;
        Ok(Numbers::wire(element, bytes))
    }

    fn text(&mut self, field: &'static str) -> Result<&'a str, WireError> {
        let length = self.byte()?;
        let bytes = self.take(usize::from(length))?;
        core::str::from_utf8(bytes).map_err(|_| WireError::Text { kind: self.kind, field })
    }

    fn code<T>(&self, field: &'static str, found: u8, of: impl FnOnce(u8) -> Option<T>) -> Result<T, WireError> {
        of(found).ok_or(WireError::Code { kind: self.kind, field, found: u32::from(found) })
    }

    fn hello(&mut self) -> Result<Hello, WireError> {
        Ok(Hello { nonce: self.scalar()?, lowest_version: self.byte()?, highest_version: self.byte()? })
    }

    fn describe(&mut self) -> Result<Describe<'a>, WireError> {
        let (nonce, boot) = (self.scalar()?, self.scalar()?);
        let (electrodes, channels) = (self.short()?, self.short()?);
        let element = self.byte()?;
        let element = self.code("element", element, Element::from_code)?;
        let (adc_bits, features) = (self.byte()?, Features(self.byte()?));
        self.byte()?;
        Ok(Describe {
            nonce,
            boot,
            electrodes,
            channels,
            element,
            adc_bits,
            features,
            commands: self.scalar()?,
            frames_per_s: self.scalar()?,
            most_frames_per_s: self.scalar()?,
            amplitude_a: self.scalar()?,
            frequency_hz: self.scalar()?,
            device: self.text("device")?,
            serial: self.text("serial")?,
            firmware: self.text("firmware")?,
            protocol: self.text("protocol")?,
            protocols: self.text("protocols")?,
        })
    }

    fn request(&mut self) -> Result<Request<'a>, WireError> {
        let (tag, code) = (self.short()?, self.byte()?);
        self.byte()?;
        let command = match code {
            0 => {
                let (first, total, count) = (self.short()?, self.short()?, self.short()?);
                let (end, most) = (usize::from(first) + usize::from(count), usize::from(total));
                if end > most {
                    let field = "measurements";
                    return Err(WireError::Count { kind: self.kind, field, expected: most, found: end });
                }
                Command::Protocol { first, total, measurements: self.list(count)? }
            }
            1 => Command::ProtocolName(self.text("protocol")?),
            2 => Command::Amplitude(self.scalar()?),
            3 => Command::Frequency(self.scalar()?),
            4 => Command::Gain(self.byte()?),
            5 => Command::Rate(self.scalar()?),
            6 => Command::Start,
            7 => Command::Stop,
            8 => Command::SingleShot,
            9 => Command::SelfTest,
            10 => Command::ElectrodeImpedance,
            found => return Err(WireError::Code { kind: self.kind, field: "command", found: u32::from(found) }),
        };
        Ok(Request { tag, command })
    }

    fn reply(&mut self) -> Result<Reply<'a>, WireError> {
        let (tag, command, status) = (self.short()?, self.byte()?, self.byte()?);
        let status = self.code("status", status, ReplyStatus::from_code)?;
        let count = self.short()?;
        Ok(Reply { tag, command, status, values: self.list(count)? })
    }

    fn part(&mut self) -> Result<Part<'a>, WireError> {
        let (first, total) = (self.short()?, self.short()?);
        let readings = self.frame()?;
        let (end, most) = (usize::from(first) + readings.values.len(), usize::from(total));
        if end > most {
            return Err(WireError::Count { kind: self.kind, field: "values", expected: most, found: end });
        }
        Ok(Part { first, total, readings })
    }

    fn frame(&mut self) -> Result<Frame<'a>, WireError> {
        let sequence = self.scalar()?;
        let (low, high): (u32, u32) = (self.scalar()?, self.scalar()?);
        let (status, channels) = (Status(self.short()?), self.short()?);
        let (element, parts, gain) = (self.byte()?, self.byte()?, self.byte()?);
        self.byte()?;
        let element = self.code("element", element, Element::from_code)?;
        if parts > 3 {
            return Err(WireError::Code { kind: self.kind, field: "parts", found: u32::from(parts) });
        }
        Ok(Frame {
            sequence,
            device_time_ns: u64::from(low) | (u64::from(high) << 32),
            status,
            gain,
            scale: self.scalar()?,
            values: self.numbers(element, channels)?,
            imaginary: if parts & 1 == 0 { None } else { Some(self.numbers(element, channels)?) },
            channel_times_ns: if parts & 2 == 0 { None } else { Some(self.list(channels)?) },
        })
    }
}
