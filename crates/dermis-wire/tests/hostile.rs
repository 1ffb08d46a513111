//! Random and damaged bytes. The decoder must not panic or invent messages, and must find every intact packet between
//! two delimiters.

use dermis_wire::{Decoder, Frame, Message, Numbers, Status, WireError, encode, encoded_len};
use proptest::prelude::*;

fn frame_bytes(sequence: u32, readings: &[i16]) -> Vec<u8> {
    let frame = Frame {
        sequence,
        device_time_ns: u64::from(sequence) * 1_000_000,
        status: Status::default(),
        gain: 1,
        scale: 1e-3,
        values: Numbers::from(readings),
        imaginary: None,
        channel_times_ns: None,
    };
    let mut buffer = vec![0; encoded_len(64 + 2 * readings.len())];
    encode(&Message::Frame(frame), &mut buffer).unwrap().to_vec()
}

/// Frames whose readings follow from the sequence number, so that false ones are recognised.
fn stream(count: u32, channels: usize) -> Vec<Vec<u8>> {
    (0..count).map(|sequence| frame_bytes(sequence, &readings(sequence, channels))).collect()
}

fn readings(sequence: u32, channels: usize) -> Vec<i16> {
    (0..channels as u32).map(|channel| (sequence.wrapping_mul(257).wrapping_add(channel) % 511) as i16 - 128).collect()
}

/// Feeds pieces and returns the sequence numbers of the frames found. Fails if a frame's readings do not match its
/// number.
fn found<'a>(pieces: impl Iterator<Item = &'a [u8]>, channels: usize) -> Vec<u32> {
    let mut decoder = Decoder::new(vec![0; 1024]);
    let mut sequences = Vec::new();
    for mut piece in pieces {
        while let Some(message) = decoder.feed(&mut piece) {
            if let Ok(Message::Frame(frame)) = message {
                let expected = readings(frame.sequence, channels);
                assert_eq!(frame.values, Numbers::from(&expected[..]), "a false frame");
                sequences.push(frame.sequence);
            }
        }
    }
    sequences
}

/// A small generator for long runs, where drawing every byte with proptest would be slow: Marsaglia's xorshift
/// (2003).
struct Bytes(u64);

impl Bytes {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }
}

/// Decodes `chunks` chunks of 4096 random bytes; returns the number of bad packets.
fn decode_random(chunks: usize, seed: u64) -> u64 {
    let mut random = Bytes(seed);
    let mut decoder = Decoder::new([0; 512]);
    let mut chunk = [0; 4096];
    for _ in 0..chunks {
        chunk.iter_mut().for_each(|byte| *byte = (random.next() >> 32) as u8);
        let mut rest: &[u8] = &chunk;
        while let Some(message) = decoder.feed(&mut rest) {
            assert!(message.is_err(), "{message:?}");
        }
    }
    decoder.counters().bad
}

#[test]
fn sixteen_million_random_bytes_contain_no_message() {
    // One packet in 2^32 has the right checksum by chance. One byte in 256 is a zero on average, which makes 2^16
    // packets; adjacent zeros enclose nothing.
    let bad = decode_random(4096, 0x9e37_79b9_7f4a_7c15);
    assert!((64_000..66_500).contains(&bad), "{bad}");
}

#[test]
#[ignore = "a long run, once for every change of the decoder"]
fn a_billion_random_bytes_contain_no_message() {
    let bad = decode_random(250_000, 0x2545_f491_4f6c_dd1d);
    assert!((3_900_000..4_100_000).contains(&bad), "{bad}");
}

/// Decodes a long stream of partly damaged frames. Every undamaged frame must be found, once per copy.
fn decode_damaged(frames: u32, seed: u64) {
    let mut random = Bytes(seed);
    let mut below = |limit: usize| (random.next() >> 33) as usize % limit;
    let mut decoder = Decoder::new([0; 512]);
    let mut line: Vec<u8> = Vec::new();
    for sequence in 0..frames {
        let mut bytes = frame_bytes(sequence, &readings(sequence, 30));
        let (length, mut whole) = (bytes.len(), 1);
        match below(8) {
            0 => {
                // Not at the ends, so that the neighbours keep their delimiters.
                bytes[1 + below(length - 2)] ^= 1 << below(8);
                whole = 0;
            }
            1 => {
                bytes.truncate(1 + below(length - 2));
                whole = 0;
            }
            2 => {
                bytes.extend_from_within(..);
                whole = 2;
            }
            3 => {
                let junk: Vec<u8> = (0..below(40)).map(|_| below(256) as u8).collect();
                bytes.splice(0..0, junk);
            }
            4 => {
                // Swaps two neighbouring pieces; if they are identical, the frame is undamaged.
                let before = bytes.clone();
                let (from, to) = (1 + below(length / 2 - 1), length / 2 + below(length / 2 - 1));
                bytes[from..to].rotate_left((to - from) / 2);
                whole = usize::from(bytes == before);
            }
            _ => {}
        }
        line.extend_from_slice(&bytes);
        let mut found = 0;
        let mut rest = line.as_slice();
        while !rest.is_empty() {
            // Pieces of any size, as a serial port delivers them.
            let (mut piece, after) = rest.split_at(rest.len().min(1 + below(200)));
            rest = after;
            while let Some(message) = decoder.feed(&mut piece) {
                if let Ok(Message::Frame(frame)) = message {
                    assert_eq!(frame.values, Numbers::from(&readings(sequence, 30)[..]), "a false frame");
                    assert_eq!(frame.sequence, sequence);
                    found += 1;
                }
            }
        }
        line.clear();
        assert_eq!(found, whole, "frame {sequence}");
    }
}

#[test]
fn undamaged_frames_among_twenty_thousand_are_found() {
    decode_damaged(20_000, 0x1234_5678_9abc_def1);
}

#[test]
#[ignore = "a long run, once for every change of the decoder"]
fn undamaged_frames_among_ten_million_are_found() {
    decode_damaged(10_000_000, 0x0fed_cba9_8765_4321);
}

#[test]
fn no_single_flipped_bit_passes_and_the_next_frame_does() {
    let good = frame_bytes(5, &readings(5, 40));
    let next = frame_bytes(6, &readings(6, 40));
    for bit in 0..good.len() * 8 {
        let mut damaged = good.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        let sequences = found([damaged.as_slice(), next.as_slice()].into_iter(), 40);
        // Flipping a delimiter affects at most this frame; its neighbour has its own delimiter.
        assert!(sequences == [6] || (sequences == [5, 6] && bit < 8), "bit {bit}: {sequences:?}");
    }
}

#[test]
fn every_truncation_loses_that_frame_alone() {
    let frames = stream(3, 25);
    for keep in 0..frames[1].len() - 1 {
        let pieces = [frames[0].as_slice(), &frames[1][..keep], frames[2].as_slice()];
        assert_eq!(found(pieces.into_iter(), 25), [0, 2], "{keep} bytes kept");
    }
}

#[test]
fn a_packet_too_long_for_the_buffer_is_reported_once_and_skipped() {
    let long = frame_bytes(1, &readings(1, 300));
    let short = frame_bytes(2, &readings(2, 10));
    let stream = [long.as_slice(), short.as_slice()].concat();
    let mut decoder = Decoder::new([0; 128]);
    let mut rest = stream.as_slice();
    assert_eq!(decoder.feed(&mut rest), Some(Err(WireError::Long { limit: 128 })));
    assert!(matches!(decoder.feed(&mut rest), Some(Ok(Message::Frame(Frame { sequence: 2, .. })))));
    assert_eq!(decoder.feed(&mut rest), None);
    assert!(!decoder.is_mid_packet() && rest.is_empty());
}

#[test]
fn a_buffer_too_short_to_write_into_is_refused_at_every_length() {
    let whole = frame_bytes(9, &readings(9, 130));
    let expected = readings(9, 130);
    for length in 0..whole.len() {
        let frame = Frame {
            sequence: 9,
            device_time_ns: 9_000_000,
            status: Status::default(),
            gain: 1,
            scale: 1e-3,
            values: Numbers::from(&expected[..]),
            imaginary: None,
            channel_times_ns: None,
        };
        let mut buffer = vec![0xaa; length];
        assert_eq!(encode(&Message::Frame(frame), &mut buffer), Err(WireError::Long { limit: length }));
    }
}

#[test]
fn lists_that_do_not_belong_together_are_refused() {
    let values = [1i16, 2];
    let frame = Frame {
        sequence: 0,
        device_time_ns: 0,
        status: Status::default(),
        gain: 0,
        scale: 1.0,
        values: Numbers::from(&values[..]),
        imaginary: Some(Numbers::from(&values[..1])),
        channel_times_ns: None,
    };
    let error = encode(&Message::Frame(frame), &mut [0; 100]).unwrap_err();
    assert_eq!(error.to_string(), "Frame: imaginary: expected 2 elements, found 1");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn any_chunking_gives_every_frame(cuts in proptest::collection::vec(1usize..90, 1..60), channels in 0usize..200) {
        let bytes = stream(6, channels).concat();
        let mut rest = bytes.as_slice();
        let mut pieces = Vec::new();
        for cut in cuts.iter().cycle() {
            let (piece, after) = rest.split_at((*cut).min(rest.len()));
            pieces.push(piece);
            rest = after;
            if rest.is_empty() {
                break;
            }
        }
        prop_assert_eq!(found(pieces.into_iter(), channels), [0, 1, 2, 3, 4, 5]);
    }

    #[test]
    fn garbage_between_frames_costs_no_frame(garbage in proptest::collection::vec(any::<u8>(), 0..300)) {
        let frames = stream(4, 30);
        let pieces = [&frames[0], &garbage, &frames[1], &garbage, &frames[2], &frames[3]];
        prop_assert_eq!(found(pieces.into_iter().map(Vec::as_slice), 30), [0, 1, 2, 3]);
    }

    #[test]
    fn damage_inside_costs_the_frames_it_touches(
        at in 0usize..5, offset in any::<prop::sample::Index>(), junk in proptest::collection::vec(any::<u8>(), 1..20)
    ) {
        let mut frames = stream(5, 30);
        let place = 1 + offset.index(frames[at].len() - 2);
        let end = (place + junk.len()).min(frames[at].len() - 1);
        let before = frames[at].clone();
        frames[at][place..end].copy_from_slice(&junk[..end - place]);
        let whole = frames[at] == before;
        let expected: Vec<u32> = (0..5).filter(|sequence| whole || *sequence as usize != at).collect();
        prop_assert_eq!(found(frames.iter().map(Vec::as_slice), 30), expected);
    }

    #[test]
    fn chunks_duplicated_and_reordered_make_no_false_frame(
        order in proptest::collection::vec(0usize..24, 0..60), size in 7usize..60
    ) {
        let bytes = stream(8, 33).concat();
        let chunks: Vec<&[u8]> = bytes.chunks(size).collect();
        // `found` checks every frame against its number.
        let sequences = found(order.iter().filter_map(|index| chunks.get(*index).copied()), 33);
        prop_assert!(sequences.iter().all(|sequence| *sequence < 8));
    }

    #[test]
    fn stuffing_agrees_with_another_implementation(readings in proptest::collection::vec(any::<i16>(), 0..400)) {
        let bytes = frame_bytes(1, &readings);
        let stuffed = &bytes[1..bytes.len() - 1];
        prop_assert!(!stuffed.contains(&0));
        let mut packet = vec![0; bytes.len()];
        let length = cobs::decode(stuffed, &mut packet).unwrap().frame_size();
        prop_assert_eq!(length, 2 + 24 + 2 * readings.len() + 4);
        let mut again = vec![0; encoded_len(length)];
        let written = cobs::encode(&packet[..length], &mut again);
        prop_assert_eq!(&again[..written], stuffed);
        prop_assert!(bytes.len() <= encoded_len(length));
    }

    #[test]
    fn bytes_with_a_right_checksum_are_read_or_refused(kind in 0u8..24, body in proptest::collection::vec(any::<u8>(), 0..120)) {
        let crc = crc32(&[&[1, kind], body.as_slice()].concat());
        let packet = [&[1, kind], body.as_slice(), &crc.to_le_bytes()].concat();
        let mut stuffed = vec![0; encoded_len(packet.len())];
        let written = cobs::encode(&packet, &mut stuffed);
        stuffed[written] = 0;
        let mut decoder = Decoder::new([0; 256]);
        let event = decoder.feed(&mut &stuffed[..=written]);
        if let Some(Ok(message)) = event {
            let mut again = [0; 256];
            encode(&message, &mut again).unwrap();
        }
    }
}

/// CRC-32 computed bit by bit from its definition.
fn crc32(bytes: &[u8]) -> u32 {
    let mut crc = u32::MAX;
    for byte in bytes {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { (crc >> 1) ^ 0xedb8_8320 } else { crc >> 1 };
        }
    }
    !crc
}
