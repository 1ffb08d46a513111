//! The test vectors of the book's chapter on the wire, which includes them from `wire-vectors.txt`: this crate must
//! send and read exactly these bytes. An independent program with another checksum implementation (zlib's) and another
//! stuffing generated them.

use std::collections::BTreeMap;

use dermis_wire::{
    Command, Decoder, Describe, Element, Features, Frame, Hello, Kind, List, Message, NO_ELECTRODE, Numbers, Part,
    Reply, ReplyStatus, Request, Status, WireError, encode,
};

const CHAPTER: &str = include_str!("../../../docs/src/wire-vectors.txt");

/// Vectors by name: blocks that open with "```text vector NAME".
fn vectors() -> BTreeMap<String, Vec<u8>> {
    let blocks = CHAPTER.split("```text vector ").skip(1).map(|rest| rest.split("```").next().unwrap());
    let hex = |text: &str| text.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
    blocks
        .map(|block| {
            let (name, bytes) = block.split_once('\n').unwrap();
            (name.trim().to_string(), hex(bytes))
        })
        .collect()
}

/// The messages described in words in the chapter.
fn check(mut is: impl FnMut(&str, Message<'_>)) {
    is("hello", Message::Hello(Hello { nonce: 0x1234_5678, lowest_version: 1, highest_version: 1 }));
    is("describe", Message::Describe(describe()));
    let measurements = [[0, 1, 2, 3], [0, 1, 3, NO_ELECTRODE]];
    let commands = [
        ("protocol", Command::Protocol { first: 2, total: 4, measurements: List::from(&measurements[..]) }),
        ("named-protocol", Command::ProtocolName("opposite")),
        ("amplitude", Command::Amplitude(0.35e-3)),
        ("frequency", Command::Frequency(954.0)),
        ("gain", Command::Gain(255)),
        ("rate", Command::Rate(25.0)),
        ("start", Command::Start),
        ("stop", Command::Stop),
        ("single-shot", Command::SingleShot),
        ("self-test", Command::SelfTest),
        ("impedance", Command::ElectrodeImpedance),
    ];
    for (index, (name, command)) in commands.into_iter().enumerate() {
        assert_eq!(usize::from(command.code()), index);
        is(name, Message::Command(Request { tag: index as u16 + 1, command }));
    }
    let frequency = [953.674_3];
    let values = List::from(&frequency[..]);
    is("reply", Message::Reply(Reply { tag: 4, command: 3, status: ReplyStatus::Done, values }));
    let ohms = [120.5, f32::INFINITY, 0.0];
    let values = List::from(&ohms[..]);
    is("reply-impedance", Message::Reply(Reply { tag: 11, command: 10, status: ReplyStatus::Done, values }));
    frames(&mut is);
}

fn describe() -> Describe<'static> {
    Describe {
        nonce: 0x1234_5678,
        boot: 42,
        electrodes: 16,
        channels: 208,
        element: Element::I16,
        adc_bits: 16,
        features: Features::RUNNING.with(Features::CHANNEL_TIMES),
        commands: 0b111_1110_1111,
        frames_per_s: 25.0,
        most_frames_per_s: 100.0,
        amplitude_a: 0.5e-3,
        frequency_hz: 954.0,
        device: "demo board",
        serial: "A-007",
        firmware: "1.2.0",
        protocol: "adjacent",
        protocols: "adjacent,opposite",
    }
}

fn frames(is: &mut impl FnMut(&str, Message<'_>)) {
    let plain = Frame {
        sequence: 7,
        device_time_ns: 20_000_000,
        status: Status::default(),
        gain: 0,
        scale: 1e-6,
        values: Numbers::from(&[1200i16, -7, 0][..]),
        imaginary: None,
        channel_times_ns: None,
    };
    is("frame-i16", Message::Frame(plain));
    let timed = Frame {
        sequence: u32::MAX,
        device_time_ns: 0x0102_0304_0506_0708,
        status: Status::SATURATED.with(Status::GAIN_CHANGED),
        gain: 3,
        scale: 2.5e-7,
        values: Numbers::from(&[i32::MIN, 65_536][..]),
        channel_times_ns: Some(List::from(&[0, 125_000][..])),
        ..plain
    };
    is("frame-i32-times", Message::Frame(timed));
    let complex = Frame {
        sequence: 0,
        device_time_ns: 0,
        scale: 1.0,
        values: Numbers::from(&[0.5f32, -0.25][..]),
        imaginary: Some(Numbers::from(&[1.0f32, 0.0][..])),
        ..plain
    };
    is("frame-f32-complex", Message::Frame(complex));
    let counts: Vec<i16> = (0..160).map(|channel| 0x0101 + channel).collect();
    let long = Frame { sequence: 300, device_time_ns: 1, scale: 1.0, values: Numbers::from(&counts[..]), ..plain };
    is("frame-long", Message::Frame(long));
    let readings = Frame {
        sequence: 9,
        device_time_ns: 400_000_000,
        gain: 4,
        scale: 15.625e-6,
        values: Numbers::from(&[100i16, -3][..]),
        channel_times_ns: Some(List::from(&[0, 1_600_000][..])),
        ..plain
    };
    is("part", Message::Part(Part { first: 256, total: 4096, readings }));
}

#[test]
fn messages_are_the_bytes_in_the_book() {
    let mut vectors = vectors();
    check(|name, message| {
        let bytes = vectors.remove(name).unwrap_or_else(|| panic!("no vector {name} in docs/src/wire-vectors.txt"));
        let mut buffer = [0; 1024];
        assert_eq!(encode(&message, &mut buffer).unwrap(), bytes, "{name}");
        let mut decoder = Decoder::new([0; 1024]);
        assert_eq!(decoder.feed(&mut bytes.as_slice()), Some(Ok(message)), "{name}");
    });
    let left: Vec<_> = vectors.keys().collect();
    assert!(left.is_empty(), "vectors without a message here: {left:?}");
}

#[test]
fn protocol_names_are_listed() {
    assert_eq!(describe().protocol_names().collect::<Vec<_>>(), ["adjacent", "opposite"]);
}

#[test]
fn a_bit_is_known_by_its_name() {
    let status = Status(0b10_0001);
    assert!(status.has(Status::SATURATED) && status.has(Status::GAIN_CHANGED) && !status.has(Status::OVERRUN));
}

#[test]
fn a_part_that_ends_beyond_its_frame_is_refused_by_both_sides() {
    let readings = Frame {
        sequence: 0,
        device_time_ns: 0,
        status: Status::default(),
        gain: 0,
        scale: 1.0,
        values: Numbers::from(&[1i16, 2, 3][..]),
        imaginary: None,
        channel_times_ns: None,
    };
    let mut buffer = [0; 128];
    let long = Message::Part(Part { first: 6, total: 8, readings });
    let error = WireError::Count { kind: Kind::Part, field: "values", expected: 8, found: 9 };
    assert_eq!(encode(&long, &mut buffer), Err(error));
    let fits = Message::Part(Part { first: 5, total: 8, readings });
    let bytes = encode(&fits, &mut buffer).unwrap();
    assert_eq!(Decoder::new([0; 128]).feed(&mut &*bytes), Some(Ok(fits)));
}
