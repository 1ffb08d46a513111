//! Recordings: all entries are read twice, with the same count, and the header is turned into a skin.
#![no_main]

use std::io::Cursor;

use dermis_record::Recording;
use dermis_skin::Skin;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Ok(mut recording) = Recording::from_reader(Cursor::new(data), "fuzzed.mcap") else { return };
    let _ = Skin::parse(&recording.head().skin_toml, "fuzzed.mcap");
    let mut counts = [0_u64; 2];
    for count in &mut counts {
        recording.rewind();
        while let Ok(Some(_)) = recording.next_entry() {
            *count += 1;
        }
        let _ = (recording.damage().to_string(), recording.counts().len());
    }
    assert_eq!(counts[0], counts[1], "entries of the first and the second reading");
});
