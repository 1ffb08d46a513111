//! Bytes of an instrument on the wire: raw, or, if the first byte is odd, as the content of a packet with a correct
//! checksum. Every message that is decoded must survive encoding and decoding again.
#![no_main]

use dermis_wire::{Decoder, checksum, encode};
use libfuzzer_sys::fuzz_target;

/// Consistent overhead byte stuffing, with a delimiter before and after.
fn stuffed(content: &[u8]) -> Vec<u8> {
    let mut packet = vec![0];
    for part in content.split(|byte| *byte == 0) {
        let mut rest = part;
        while rest.len() >= 254 {
            packet.push(255);
            packet.extend_from_slice(&rest[..254]);
            rest = &rest[254..];
        }
        packet.push(rest.len() as u8 + 1);
        packet.extend_from_slice(rest);
    }
    packet.push(0);
    packet
}

fuzz_target!(|data: &[u8]| {
    let Some((mode, rest)) = data.split_first() else { return };
    let bytes = match mode % 2 {
        0 => rest.to_vec(),
        _ => stuffed(&[rest, &checksum(rest).to_le_bytes()].concat()),
    };
    let mut decoder = Decoder::new(vec![0; 16 + 64 * usize::from(*mode)]);
    let mut again = vec![0; 1 << 16];
    let mut left = &bytes[..];
    while let Some(message) = decoder.feed(&mut left) {
        let Ok(message) = message else { continue };
        let packet = encode(&message, &mut again).expect("what was read can be sent").to_vec();
        let mut reader = Decoder::new(vec![0; 1 << 16]);
        let mut packet = &packet[..];
        let read = reader.feed(&mut packet).expect("a whole packet").expect("a sound packet");
        // NaN is not equal to itself, but its text is.
        assert_eq!(format!("{read:?}"), format!("{message:?}"));
    }
});
