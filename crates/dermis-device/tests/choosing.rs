//! Detection of formats and selection of frames through [`read`], on files created here.

#[path = "choosing/foreign.rs"]
mod foreign;

use std::path::{Path, PathBuf};

use dermis_device::instruments::npy;
use dermis_device::{FileSpec, Format, read};

fn write(directory: &Path, name: &str, content: &[u8]) -> PathBuf {
    let path = directory.join(name);
    std::fs::write(&path, content).unwrap();
    path
}

fn detected(text: &str) -> Format {
    Format::detect(Path::new("made.csv"), text.as_bytes()).unwrap()
}

fn rows(count: usize, columns: usize) -> String {
    (0..count).map(|row| vec![row.to_string(); columns].join(",") + "\n").collect()
}

#[test]
fn tables_are_distinguished_by_shape() {
    assert_eq!(detected(&format!("ref,b\n{}", rows(256, 2))), Format::Golfball);
    assert_eq!(detected(&format!("ref,b\n{}", rows(2356, 2))), Format::Ktc);
    // With other names, the same numbers of rows are frames with few channels.
    assert_eq!(detected(&format!("a,b\n{}", rows(256, 2))), Format::Csv);
    assert_eq!(detected(&format!("time_s,b\n{}", rows(2356, 2))), Format::Csv);
    let four: String = (0..208).map(|row| format!("0.1,0.25,0.3,{}\n", 0.4 + 1e-6 * row as f64)).collect();
    assert_eq!(detected(&four), Format::Csv, "208 frames of four channels");
    assert_eq!(detected("(0.1, 0.2)\n(0.1, 0.2)\n"), Format::Lines);
    assert_eq!(detected(&format!("ref,b\n{}", rows(100, 2))), Format::Columns);
    assert_eq!(detected(&rows(208, 4)), Format::Pyeidors);
    assert_eq!(detected(&rows(207, 4)), Format::Csv);
    assert_eq!(detected(&rows(256, 208)), Format::Csv);
    let head: Vec<String> = (0..208).map(|channel| format!("ch{channel}")).collect();
    assert_eq!(detected(&format!("{}\n{}", head.join(","), rows(2356, 208))), Format::Csv);
}

#[test]
fn choosing_by_name_takes_frames_for_columns() {
    let directory = tempfile::tempdir().unwrap();
    let path = write(directory.path(), "v.csv", b"rest,press\n1,10\n2,20\n3,30\n");
    let spec: FileSpec = format!("{}#press", path.display()).parse().unwrap();
    assert_eq!(read(&spec, None).unwrap().values(), [10.0, 20.0, 30.0]);
    assert_eq!(read(&FileSpec::all(&path), None).unwrap().frames(), 3);
    let message = read(&format!("{}#pres", path.display()).parse().unwrap(), None).unwrap_err().to_string();
    assert!(message.contains("no single frame 'pres'; expected one of rest, press"), "{message}");
}

#[test]
fn a_given_format_overrides_recognition() {
    let directory = tempfile::tempdir().unwrap();
    let path = write(directory.path(), "four.csv", rows(208, 4).as_bytes());
    assert_eq!(read(&FileSpec::all(&path), None).unwrap().frames(), 2);
    assert_eq!(read(&FileSpec::all(&path), Some(Format::Csv)).unwrap().frames(), 208);
    let message = read(&FileSpec::all(&path), Some(Format::Npy)).unwrap_err().to_string();
    assert!(message.ends_with("four.csv: expected a NumPy array (npy, version 1 to 3), found other text"), "{message}");
}

#[test]
fn arrays_are_recognised_under_any_name() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("frames.dat");
    npy::write_f64(&path, &[2, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]).unwrap();
    let frames = read(&format!("{}#1", path.display()).parse().unwrap(), None).unwrap();
    assert_eq!(frames.values(), [4.0, 5.0, 6.0]);
}

#[test]
fn foreign_and_missing_files_are_named() {
    let directory = tempfile::tempdir().unwrap();
    for (content, expected) in [
        (b"".as_slice(), "expected at least one frame, found none"),
        (b"\x89HDF\r\n\x1a\n\0\0", "found an HDF5 file"),
        (b"MATLAB 7.3 MAT-file, Platform: GLNXA64\0\0", "save it with -v7"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1\0\0", "save it as xlsx"),
        (b"{\"a\": 1}", "found JSON text"),
        (b"\0\x01\x02\xff", "found binary data"),
    ] {
        let path = write(directory.path(), "odd.csv", content);
        let message = read(&FileSpec::all(path), None).unwrap_err().to_string();
        assert!(message.contains("odd.csv") && message.contains(expected), "{message}");
    }
    let message = read(&FileSpec::all(directory.path().join("none.csv")), None).unwrap_err().to_string();
    assert!(message.contains("none.csv: cannot read"), "{message}");
    let message = read(&FileSpec::all(directory.path()), Some(Format::Csv)).unwrap_err().to_string();
    assert!(message.contains("found a directory"), "{message}");
}
