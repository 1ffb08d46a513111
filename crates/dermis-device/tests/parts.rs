//! Frames in parts are joined, with their times. A frame with a missing or damaged part is lost and counted, and parts
//! of different frames are never mixed.

use std::sync::mpsc::Receiver;

use dermis_device::instruments::wire::WireHost;
use dermis_device::stream::{Dialogue, Inbox};
use dermis_device::{Frame, HostStamp, Status};
use dermis_wire::{
    Decoder, Describe, Element, Features, Frame as WireFrame, List, Message, Numbers, Part, Reply, ReplyStatus, encode,
};

const CHANNELS: u16 = 300;
const PART: usize = 128;

fn bytes(message: &Message<'_>) -> Vec<u8> {
    let mut buffer = [0; 2048];
    encode(message, &mut buffer).expect("it fits").to_vec()
}

/// Reading of a channel, as a number that identifies frame and channel.
fn reading(sequence: u32, channel: usize) -> i16 {
    (sequence.wrapping_mul(7919).wrapping_add(channel as u32 * 31) % 30_000) as i16 - 15_000
}

/// The parts of a frame, with 2 ms per reading.
fn parts(sequence: u32) -> Vec<Vec<u8>> {
    let readings: Vec<i16> = (0..usize::from(CHANNELS)).map(|channel| reading(sequence, channel)).collect();
    let part = |(n, values): (usize, &[i16])| {
        let first = n * PART;
        let times_ns: Vec<u32> = (0..values.len()).map(|k| k as u32 * 2_000_000).collect();
        let readings = WireFrame {
            sequence,
            device_time_ns: u64::from(sequence) * 1_000_000_000 + first as u64 * 2_000_000,
            status: if n == 1 { Status::SATURATED } else { Status::default() },
            gain: n as u8 + 3,
            scale: 0.5,
            values: Numbers::from(values),
            imaginary: None,
            channel_times_ns: Some(List::from(&times_ns[..])),
        };
        bytes(&Message::Part(Part { first: first as u16, total: CHANNELS, readings }))
    };
    readings.chunks(PART).enumerate().map(part).collect()
}

/// A host after the handshake with a device that sends parts.
struct Line {
    host: WireHost,
    inbox: Inbox,
    out: Receiver<Frame>,
}

impl Line {
    fn new() -> Self {
        let (inbox, out, _) = Inbox::new(8192);
        let mut line = Self { host: WireHost::new(), inbox, out };
        let mut hello = Vec::new();
        line.host.open(&mut hello);
        let mut said = Decoder::new([0; 256]);
        let Some(Ok(Message::Hello(hello))) = said.feed(&mut hello.as_slice()) else { panic!("no hello") };
        let start = line.hear(&bytes(&Message::Describe(Describe {
            nonce: hello.nonce,
            boot: 1,
            electrodes: 16,
            channels: CHANNELS,
            element: Element::I16,
            adc_bits: 16,
            features: Features::PARTS,
            commands: u32::MAX,
            frames_per_s: 1.0,
            most_frames_per_s: 1.0,
            amplitude_a: 0.0,
            frequency_hz: 0.0,
            device: "made",
            serial: "1",
            firmware: "0",
            protocol: "listed",
            protocols: "",
        })));
        let Some(Ok(Message::Command(start))) = said.feed(&mut start.as_slice()) else { panic!("no start") };
        let reply = Reply { tag: start.tag, command: 6, status: ReplyStatus::Done, values: List::from(&[][..]) };
        line.hear(&bytes(&Message::Reply(reply)));
        line
    }

    fn hear(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut send = Vec::new();
        let at = HostStamp { monotonic_ns: 5, wall_ns: 6 };
        self.host.receive(bytes, at, &mut self.inbox, &mut send).expect("a conversation");
        send
    }
}

#[test]
fn parts_are_joined_with_their_times_status_and_gain() {
    let mut line = Line::new();
    parts(40).iter().for_each(|part| assert!(line.hear(part).is_empty()));
    let frame = line.out.try_recv().expect("a frame");
    let expected: Vec<f64> = (0..300).map(|channel| 0.5 * f64::from(reading(40, channel))).collect();
    assert_eq!((frame.sequence, frame.values), (0, expected));
    assert_eq!(frame.device_time_ns, Some(40_000_000_000));
    let times_ns: Vec<u64> = (0..300).map(|channel| channel * 2_000_000).collect();
    assert_eq!(frame.channel_times_ns, times_ns, "after the frame's first reading, over all parts");
    assert_eq!((frame.status, frame.gain), (Status::SATURATED, Some(3)), "of any part; of the first");
    assert_eq!((frame.host_monotonic_ns, line.inbox.losses()), (5, (0, 0)));
}

#[test]
fn a_missing_part_loses_its_frame_and_a_restarted_frame_loses_none() {
    let mut line = Line::new();
    for sequence in 0..6 {
        for (n, part) in parts(sequence).iter().enumerate() {
            let missing = matches!((sequence, n), (1, 1) | (2, 0) | (4, 2));
            if sequence == 5 && n == 0 {
                // Start the frame, then restart it with the same number.
                line.hear(part);
                line.hear(&parts(5)[1]);
            }
            if !missing {
                line.hear(part);
            }
        }
    }
    let numbers: Vec<u64> = line.out.try_iter().map(|frame| frame.sequence).collect();
    assert_eq!((numbers, line.inbox.losses()), (vec![0, 3, 5], (3, 0)));
}

#[test]
fn every_frame_of_a_damaged_stream_is_correct_or_counted_as_lost() {
    const FRAMES: u32 = 2000;
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let mut below = |limit: usize| {
        // Xorshift (Marsaglia 2003).
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 33) as usize % limit
    };
    let mut line = Line::new();
    let mut whole = 0;
    for sequence in 0..FRAMES {
        let ends = sequence == 0 || sequence == FRAMES - 1;
        let mut sound = true;
        for mut part in parts(sequence) {
            match if ends { 99 } else { below(24) } {
                0 => {
                    let at = 1 + below(part.len() - 2);
                    part[at] ^= 1 << below(8);
                    sound = false;
                }
                1 => {
                    part.truncate(below(part.len() - 1));
                    sound = false;
                }
                2 => part.splice(0..0, (0..below(50)).map(|_| below(256) as u8).collect::<Vec<_>>()).for_each(drop),
                3 => {
                    part.clear();
                    sound = false;
                }
                _ => {}
            }
            let cut = below(part.len() + 1);
            line.hear(&part[..cut]);
            line.hear(&part[cut..]);
        }
        whole += u64::from(sound);
    }
    let mut seen = 0;
    for frame in line.out.try_iter() {
        let sequence = frame.sequence as u32;
        let expected: Vec<f64> = (0..300).map(|channel| 0.5 * f64::from(reading(sequence, channel))).collect();
        assert_eq!(frame.values, expected, "frame {sequence}");
        seen += 1;
    }
    // Junk may swallow the delimiter before a part, but that delimiter also ends the junk, so every intact frame
    // arrives.
    assert_eq!((seen, line.inbox.losses().0), (whole, u64::from(FRAMES) - whole));
}
