//! Files written by SciPy, pandas, openpyxl and pyarrow; `data/make.py` creates them.

use std::path::{Path, PathBuf};

use dermis_device::{FileSpec, FrameTable, ReadOptions, read};

const FRAMES: usize = 6;
const CHANNELS: usize = 12;

/// The reading in volts that every file contains for a frame and channel.
fn volts(frame: usize, channel: usize) -> f64 {
    (1000 * (channel + 1) + 10 * frame) as f64 * 1e-6
}

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn try_read(name: &str, options: ReadOptions) -> Result<FrameTable, String> {
    read(&FileSpec::all(path(name)), options).map_err(|error| error.to_string())
}

fn of_skin() -> ReadOptions {
    ReadOptions::default().with_channels([CHANNELS])
}

fn array(name: &str) -> ReadOptions {
    ReadOptions { array: Some(name.to_owned()), ..of_skin() }
}

/// Reads a file and compares every reading with `factor` times the volts, to the precision of the file.
#[track_caller]
fn check(name: &str, options: ReadOptions, factor: f64, precision: f64) -> FrameTable {
    let table = try_read(name, options).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!((table.frames(), table.channels()), (FRAMES, CHANNELS), "{}", table.understood());
    for (frame, row) in table.rows().enumerate() {
        for (channel, found) in row.iter().enumerate() {
            let expected = factor * volts(frame, channel);
            assert!((found - expected).abs() <= precision * expected, "{frame} {channel}: {found}, not {expected}");
        }
    }
    table
}

#[track_caller]
fn has_times(table: &FrameTable) {
    let times_s = table.times_s().unwrap_or_else(|| panic!("no times: {}", table.understood()));
    let right = times_s.iter().enumerate().all(|(frame, time)| (time - times_s[0] - 0.02 * frame as f64).abs() < 1e-9);
    assert!(times_s.len() == FRAMES && right, "{times_s:?}");
}

#[track_caller]
fn says(table: &FrameTable, words: &[&str]) {
    let understood = table.understood();
    for word in words {
        assert!(understood.contains(word), "no `{word}` in: {understood}");
    }
}

#[track_caller]
fn refuses(name: &str, options: ReadOptions, words: &[&str]) {
    let message = try_read(name, options).expect_err("an error");
    assert!(message.contains(name), "{message}");
    for word in words {
        assert!(message.contains(word), "no `{word}` in: {message}");
    }
}

#[test]
fn matlab_arrays_of_every_kind() {
    for name in ["plain.mat", "big_endian.mat"] {
        let table = check(name, ReadOptions::default(), 1.0, 0.0);
        says(&table, &["array `frames`", "array of 6 x 12"]);
    }
    let table = check("with_times.mat", of_skin(), 1.0, 1e-7);
    has_times(&table);
    says(&table, &["array `v`", "others:", "gain (3, 3)", "times from array `time_s`"]);
    check("kinds.mat", array("int32"), 1e6, 1e-12);
    check("kinds.mat", array("int16"), 1e6, 1e-12);
    check("kinds.mat", array("cube"), 1.0, 0.0);
    let table = check("kinds.mat", array("complex"), 1.0, 0.0);
    let half = table.imaginary().unwrap().iter().zip(table.values()).all(|(im, re)| (im - re / 2.0).abs() < 1e-15);
    assert!(half && table.understood().contains("6 frames x 12 complex channels"));
    let one = try_read("kinds.mat", array("column")).unwrap();
    assert_eq!((one.frames(), one.channels()), (1, CHANNELS));
    let decoded =
        dermis_device::decode(dermis_device::Format::Mat, &std::fs::read(path("plain.mat")).unwrap(), "a".as_ref());
    assert_eq!(decoded.unwrap().values(), try_read("plain.mat", of_skin()).unwrap().values());
}

#[test]
fn measurements_in_a_structure_are_columns() {
    refuses("structure.mat", of_skin(), &["12 frames of 6 readings", "transposed?", "--transpose"]);
    let table = check("structure.mat", ReadOptions { transpose: true, ..of_skin() }, 1.0, 0.0);
    has_times(&table);
    says(
        &table,
        &["array `vi.meas`", "others:", "vi.elec.z_contact", "frames in columns", "times from array `vi.time`"],
    );
}

#[test]
fn matlab_files_that_leave_something_open_are_asked_about() {
    refuses("kinds.mat", of_skin(), &["--array: expected one of int32 (6, 12), int16 (6, 12), complex (6, 12), cube"]);
    refuses("kinds.mat", array("x"), &["--array: expected one of int32 (6, 12)", "found 'x'"]);
    refuses("words.mat", of_skin(), &["expected an array of numbers", "label (text)", "cells (cells)"]);
    refuses("with_times.mat", array("operator"), &["expected an array of numbers", "operator (text)"]);
}

#[cfg(feature = "excel")]
#[test]
fn workbooks_are_read_as_tables_are() {
    // openpyxl writes 16 digits.
    let table = check("pandas.xlsx", ReadOptions::default(), 1.0, 1e-15);
    says(&table, &["header in line 1", "it counts the rows", "sheet `Sheet1`"]);
    for options in [of_skin(), array("Frames")] {
        let table = try_read("book.xlsx", options).unwrap();
        assert_eq!((table.frames(), table.channels()), (FRAMES, CHANNELS), "{}", table.understood());
        for (frame, row) in table.rows().enumerate() {
            for (channel, found) in row.iter().enumerate() {
                let expected = volts(frame, channel);
                let is_right = (found - expected).abs() < 1e-15;
                assert!(
                    if (frame, channel) == (2, 4) { found.is_nan() } else { is_right },
                    "{frame} {channel} {found}"
                );
            }
        }
        has_times(&table);
        assert_eq!(table.wall_ns().unwrap()[1], 1_709_302_032_020_000_000);
        assert_eq!(table.channel_names().unwrap()[3], "ch3 (mV)");
        says(
            &table,
            &[
                "header in line 4",
                "times from column `timestamp`",
                "volts",
                "sheet `Frames`",
                "1 of 72 readings missing",
            ],
        );
    }
}

#[cfg(feature = "excel")]
#[test]
fn workbooks_that_cannot_be_read_name_the_cell() {
    refuses("book.xlsx", array("Blatt 1"), &["--array: expected one of Notes, Frames, Settings"]);
    refuses("formulas.xlsx", of_skin(), &["sheet Sheet", ":1: column 1", "open the file in Excel and save it"]);
    refuses("error.xlsx", of_skin(), &[":4: column 3: expected a number", "#DIV/0!"]);
}

#[cfg(feature = "parquet")]
#[test]
fn parquet_tables_of_every_kind() {
    let mut full = try_read("pandas.parquet", of_skin()).unwrap();
    assert!(full.row(2).unwrap()[4].is_nan() && full.row(2).unwrap()[5] == volts(2, 5));
    has_times(&full);
    assert_eq!(full.wall_ns().unwrap()[1], 1_709_302_032_020_000_000);
    says(&full, &["6 frames x 12 channels", "times from column `timestamp`", "column `note` left out: words"]);
    full = full.select(&"0..2,3..6".parse().unwrap()).unwrap();
    assert_eq!(full.row(4).unwrap()[0], volts(5, 0));
    let table = check("index.parquet", of_skin(), 1.0, 0.0);
    has_times(&table);
    let table = check("whole.parquet", of_skin(), 1e6, 1e-12);
    has_times(&table);
    let table = check("lists.parquet", of_skin(), 1.0, 1e-7);
    says(&table, &["lists in column `voltages`", "column `frame` left out"]);
    let content = std::fs::read(path("whole.parquet")).unwrap();
    let decoded = dermis_device::decode(dermis_device::Format::Parquet, &content, "a".as_ref()).unwrap();
    assert_eq!(decoded.values(), try_read("whole.parquet", of_skin()).unwrap().values());
}

#[cfg(feature = "parquet")]
#[test]
fn parquet_files_that_cannot_be_read_name_the_row() {
    refuses("short.parquet", of_skin(), &[":4: expected 12 values as in the other rows, found 11"]);
    refuses("whole.parquet", array("x"), &["--array", "no column of lists"]);
    let chosen = ReadOptions { columns: "ch3,ch1".parse().unwrap(), ..ReadOptions::default() };
    assert_eq!(try_read("pandas.parquet", chosen).unwrap().row(5), Some([volts(5, 3), volts(5, 1)].as_slice()));
}
