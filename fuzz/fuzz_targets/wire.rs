//! Bytes of an instrument on the wire. Whatever is understood is written again as the same message.
#![no_main]

use dermis_wire::{Decoder, encode};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let (size, mut bytes) = data.split_first().map_or((0, data), |(size, rest)| (usize::from(*size), rest));
    let mut decoder = Decoder::new(vec![0; 16 + 16 * size]);
    let mut again = vec![0; 1 << 16];
    while let Some(message) = decoder.feed(&mut bytes) {
        let Ok(message) = message else { continue };
        // A message read is one that can be sent; one of numbers that are not numbers is not equal to itself.
        let Ok(packet) = encode(&message, &mut again) else { continue };
        let packet = packet.to_vec();
        let mut reader = Decoder::new(vec![0; 1 << 16]);
        let mut rest = &packet[..];
        let read = reader.feed(&mut rest).expect("a whole packet").expect("a sound packet");
        assert_eq!(format!("{read:?}"), format!("{message:?}"));
    }
});
