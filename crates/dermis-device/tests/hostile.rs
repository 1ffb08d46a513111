//! Bytes that aren't frames. For any input, every reader returns frames or an error, never an infinite reading or more
//! values than the bytes can hold.

#[path = "hostile/mutated_tables.rs"]
mod mutated_tables;

use std::path::Path;

use dermis_device::instruments::npy;
use dermis_device::{FileSpec, Format, FrameSelect, SourceSelector, decode};
use proptest::prelude::*;

/// Reads `content` in every format and with detection, and checks properties that hold for all frames.
fn read_every_way(content: &[u8]) {
    let file = Path::new("made.bin");
    for format in Format::ALL {
        if let Ok(table) = decode(format, content, file) {
            // A value takes at least a separator or a line end, except the very last one. Packed values take less:
            // deflate expands a byte to up to 1032, and runs of equal values are stored as a count.
            let packed = [Format::Npz, Format::Mat, Format::Xlsx].contains(&format);
            let most = if packed { 1032 * content.len() } else { content.len() + 1 };
            let values = table.values().len() + table.imaginary().map_or(0, <[f64]>::len);
            assert!(
                format == Format::Parquet || values <= most,
                "{format}: {values} values from {} bytes",
                content.len()
            );
            assert_eq!(table.frames() * table.channels(), table.values().len());
            assert!(!table.values().iter().any(|value| value.is_infinite()));
        }
    }
    let _ = Format::detect(file, content);
    let _ = Format::detect(Path::new("made.eit"), content);
}

fn sciospec() -> Vec<u8> {
    let mut text = String::from("12\n2\nmade\n2024.02.29. 23:59:01.250\n5000.0\n5000.0\n1\n1\n0.001\n10.0\n0\n");
    text += "MeasurementChannels: 1,2,3\n";
    for pair in ["1 2", "2 3", "3 1"] {
        text += &format!("{pair}\n0.5\t-0.1\t-0.5\t1e-3\t0.25\tNaN\n");
    }
    text.into_bytes()
}

fn array() -> Vec<u8> {
    let mut content = Vec::new();
    npy::write_header::<f64>(&mut content, &[3, 4]).unwrap();
    content.extend((0..12).flat_map(|i| f64::from(i).to_le_bytes()));
    content
}

/// Small valid files of every kind, to be damaged.
fn whole_files() -> Vec<Vec<u8>> {
    vec![
        b"1,2,3\n4,nan,6\n7,,9\n".to_vec(),
        b"# run 7\ntime_s;a;b\n0;1;2\n0.5;3;4\n".to_vec(),
        b"ref,one\n1,2\n3,4\n5,6\n".to_vec(),
        b"1 -2 3 -4\n5 -6 7 -8\n".to_vec(),
        sciospec(),
        array(),
    ]
}

/// Small valid files written by other programs.
fn foreign_files() -> Vec<(Format, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let mut files = vec![(Format::Mat, "kinds.mat"), (Format::Mat, "with_times.mat"), (Format::Mat, "structure.mat")];
    if cfg!(feature = "excel") {
        files.push((Format::Xlsx, "book.xlsx"));
    }
    if cfg!(feature = "parquet") {
        files.extend([(Format::Parquet, "lists.parquet"), (Format::Parquet, "whole.parquet")]);
    }
    files.into_iter().map(|(format, name)| (format, std::fs::read(folder.join(name)).expect(name))).collect()
}

#[test]
fn whole_files_are_read() {
    let formats = [Format::Csv, Format::Csv, Format::Columns, Format::Pyeidors, Format::Sciospec, Format::Npy];
    for (content, format) in whole_files().iter().zip(formats) {
        decode(format, content, Path::new("made.bin")).unwrap();
        read_every_way(content);
    }
}

#[test]
fn every_truncation_is_survived() {
    for content in whole_files() {
        for length in 0..content.len() {
            read_every_way(&content[..length]);
        }
    }
}

#[test]
fn a_truncated_array_is_always_refused() {
    let content = array();
    for length in 0..content.len() {
        assert!(npy::decode(&content[..length], Path::new("a.npy")).is_err(), "{length}");
    }
}

/// Some such files have columns of negative length, or without their dictionary.
#[test]
#[cfg(feature = "parquet")]
fn parquet_files_with_one_wrong_byte() {
    for (format, whole) in foreign_files().into_iter().filter(|(format, _)| *format == Format::Parquet) {
        for at in 0..whole.len() {
            for byte in [0, 1, 47, 127, 255] {
                let mut content = whole.clone();
                content[at] = byte;
                if let Err(error) = decode(format, &content, Path::new("made.bin")) {
                    assert!(error.to_string().starts_with("made.bin"), "{error}");
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn arbitrary_bytes(content in prop::collection::vec(any::<u8>(), 0..600)) {
        read_every_way(&content);
    }

    #[test]
    fn arbitrary_text(text in "([0-9eE+.,;:#'\" \t\n\r(){}-]|nan|inf|1e999|\u{e9}){0,200}") {
        read_every_way(text.as_bytes());
    }

    #[test]
    fn arbitrary_array_headers(
        version in 0_u8..5,
        length in any::<u32>(),
        header in "[{'a-z:<>0-9f(), }TrueFals]{0,120}",
        data in prop::collection::vec(any::<u8>(), 0..64),
    ) {
        let mut content = npy::MAGIC.to_vec();
        content.extend([version, 0]);
        content.extend(length.to_le_bytes());
        content.extend(header.as_bytes());
        content.extend(&data);
        read_every_way(&content);
    }

    #[test]
    fn arbitrary_shapes(shape in prop::collection::vec(any::<u64>(), 0..5), fortran in any::<bool>()) {
        let fortran = if fortran { "True" } else { "False" };
        let shape: Vec<String> = shape.iter().map(u64::to_string).collect();
        let header = format!("{{'descr': '<i2', 'fortran_order': {fortran}, 'shape': ({},), }}", shape.join(","));
        let mut content = npy::MAGIC.to_vec();
        content.extend([1, 0]);
        content.extend((header.len() as u16).to_le_bytes());
        content.extend(header.as_bytes());
        content.extend([0; 8]);
        read_every_way(&content);
    }

    #[test]
    fn mutated_files(
        which in 0_usize..6,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0_u8..3), 1..6),
    ) {
        let mut content = whole_files().swap_remove(which);
        for (at, byte, kind) in changes {
            let at = at.index(content.len());
            match kind {
                0 => content[at] = byte,
                1 => content.insert(at, byte),
                _ if content.len() > 1 => { content.remove(at); }
                _ => {}
            }
        }
        read_every_way(&content);
    }

    #[test]
    fn mutated_foreign_files(
        which in any::<prop::sample::Index>(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0_u8..3), 1..6),
        length in prop::option::weighted(0.1, any::<prop::sample::Index>()),
    ) {
        let mut files = foreign_files();
        let (format, mut content) = files.swap_remove(which.index(files.len()));
        for (at, byte, kind) in changes {
            let at = at.index(content.len());
            match kind {
                0 => content[at] = byte,
                1 => content.insert(at, byte),
                _ if content.len() > 1 => { content.remove(at); }
                _ => {}
            }
        }
        if let Some(length) = length {
            content.truncate(length.index(content.len()));
        }
        if let Err(error) = decode(format, &content, Path::new("made.bin")) {
            prop_assert!(error.to_string().starts_with("made.bin"), "{}", error);
        }
        let _ = Format::detect(Path::new("made.bin"), &content);
    }

    #[test]
    fn arbitrary_selectors(text in "\\PC{0,40}") {
        for text in [text.clone(), format!("tcp:{text}"), format!("serial:{text}"), format!("file:{text}")] {
            if let Ok(selector) = text.parse::<SourceSelector>() {
                prop_assert_eq!(selector.to_string().parse::<SourceSelector>().unwrap(), selector);
            }
        }
        let _ = text.parse::<FileSpec>();
        let _ = text.parse::<FrameSelect>();
    }

    #[test]
    fn arrays_survive_writing_and_reading(values in prop::collection::vec(-1e300_f64..1e300, 1..40)) {
        let mut content = Vec::new();
        npy::write_header::<f64>(&mut content, &[1, values.len()]).unwrap();
        content.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        let table = decode(Format::Npy, &content, Path::new("a.npy")).unwrap();
        prop_assert_eq!(table.values(), values.as_slice());
    }
}
