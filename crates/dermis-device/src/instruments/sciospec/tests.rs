use super::*;

/// A file with four electrodes. Reading `i` is `i + 0.5 j`, shifted by `offset`.
fn made(second: f64, offset: f64) -> String {
    let mut text =
        format!("14\n2\nmade\n2024.02.29. 23:59:{second:06.3}\n5000.0\n5000.0\n1\n1\n0.001\n10.0\n0\n1\n1\n");
    text += "MeasurementChannels: 1,2,5,6\n";
    for (injection, pair) in ["1 2", "2 5", "5 6", "6 1"].iter().enumerate() {
        let readings: Vec<String> = (0..4).map(|e| format!("{}\t0.5", (4 * injection + e) as f64 + offset)).collect();
        text += &format!("{pair}\n{}\n", readings.join("\t"));
    }
    text
}

fn message(text: &str) -> String {
    parse(text.as_bytes(), Path::new("s.eit")).unwrap_err().to_string()
}

#[test]
fn header_and_readings_of_one_file() {
    let measurement = parse(made(58.5, 0.0).as_bytes(), Path::new("s.eit")).unwrap();
    // 2024-02-29 is day 19782 of the Unix calendar.
    let time_s = 19_782.0 * 86_400.0 + 86_398.5;
    let channels = vec![1, 2, 5, 6];
    let setup = Setup {
        name: "made".into(),
        time_s,
        frequency_hz: 5e3,
        frequencies_hz: vec![5e3],
        taken: vec![(0, 1.0)],
        amplitude_a: 1e-3,
        frames_per_s: 10.0,
        columns: channels.clone(),
        channels,
    };
    assert_eq!(measurement.setup, setup);
    assert_eq!(measurement.injections, [(0, 1), (1, 2), (2, 3), (3, 0)]);
    assert_eq!(measurement.real_v, (0..16).map(f64::from).collect::<Vec<_>>());
    assert_eq!(measurement.imaginary_v, [0.5; 16]);
}

#[test]
fn a_directory_is_read_in_the_order_of_its_numbers() {
    let directory = tempfile::tempdir().unwrap();
    let inner = directory.path().join("setup");
    fs::create_dir(&inner).unwrap();
    for (name, second, offset) in [("s_10", 3.0, 3.0), ("s_2", 1.0, 1.0), ("s_3", 2.0, 2.0)] {
        fs::write(inner.join(format!("{name}.eit")), made(second, offset)).unwrap();
    }
    fs::write(inner.join("notes.txt"), "none").unwrap();
    let table = read_directory(directory.path()).unwrap();
    assert_eq!((table.frames(), table.channels()), (3, 16));
    assert_eq!(table.rows().map(|row| row[0]).collect::<Vec<_>>(), [1.0, 2.0, 3.0]);
    assert_eq!(table.sequences(), Some([2, 3, 10].as_slice()));
    assert_eq!(table.times_s(), Some([0.0, 1.0, 2.0].as_slice()));
    assert_eq!(table.imaginary_row(1), Some([0.5; 16].as_slice()));
}

#[test]
fn a_file_that_differs_from_the_first_is_named() {
    let directory = tempfile::tempdir().unwrap();
    let whole = made(1.0, 0.0);
    let short = whole.rsplitn(4, '\n').last().unwrap().to_owned();
    for (changed, expected) in [
        (whole.replace("1,2,5,6", "1,2,6,5"), "measurement channels"),
        (whole.replace("5000", "6000"), "frequency: expected 5000 Hz as in the first file, found '6000 Hz'"),
        (whole.replace("6 1", "6 2"), "injection: expected (3, 0) (from 0) as in the first file"),
        (short, "expected 4 injections as in the first file, found 3"),
    ] {
        fs::write(directory.path().join("a_1.eit"), &whole).unwrap();
        fs::write(directory.path().join("a_2.eit"), changed).unwrap();
        let message = read_directory(directory.path()).unwrap_err().to_string();
        assert!(message.contains("a_2.eit") && message.contains(expected), "{message}");
    }
}

#[test]
fn directories_without_files_are_refused() {
    let directory = tempfile::tempdir().unwrap();
    let message = read_directory(directory.path()).unwrap_err().to_string();
    assert!(message.contains("without .eit files and 0 sub-directories"), "{message}");
}

#[test]
fn broken_files_give_line_field_and_expectation() {
    let whole = made(1.0, 0.0);
    let replace_line = |number: usize, by: &str| {
        let mut lines: Vec<&str> = whole.lines().collect();
        lines[number - 1] = by;
        lines.join("\n")
    };
    for (text, expected) in [
        (
            replace_line(1, "10"),
            "s.eit:1: number of header lines: expected 9 (version 1) or 11 to 64 (version 2), found '10'",
        ),
        (
            replace_line(1, "60"),
            "s.eit:23: header: expected 60 header lines as line 1 says, found 'the end of the file'",
        ),
        (replace_line(2, "1"), "s.eit:2: version: expected 2, found '1'"),
        (replace_line(4, "2024.13.01. 00:00:00"), "s.eit:4: date: expected year.month.day."),
        (replace_line(8, "0"), "s.eit:8: number of frequencies: expected 1 to 1024, found '0'"),
        (replace_line(8, "3"), "s.eit:8: frequency: expected --frequency-hz with one of"),
        (replace_line(9, "NaN"), "s.eit:9: amplitude: expected a positive number of amperes, found 'NaN'"),
        (replace_line(14, "MeasurementChannels: 1,1,5,6"), "s.eit:14: measurement channels"),
        (replace_line(15, "1 3"), "s.eit:15: injection: expected two different numbers"),
        (replace_line(17, "1 2"), "s.eit:17: injection: expected a pair that is not in the file yet"),
        (replace_line(16, "1 2 3"), "s.eit:16: readings: expected 8 numbers (real and imaginary part of 4 channels)"),
        (replace_line(16, "1 2 3 x 5 6 7 8"), "s.eit:16: column 4: expected a finite number or NaN, found 'x'"),
        (replace_line(16, "1 2 3 4 inf 6 7 8"), "s.eit:16: column 5"),
        (whole.rsplitn(3, '\n').last().unwrap().to_owned(), "s.eit:22: readings: expected a line of readings"),
        (whole.lines().take(14).collect::<Vec<_>>().join("\n"), "expected at least one frame, found none"),
        (
            "---Draeger EIT-Software---".to_owned(),
            "expected a Sciospec .eit file (text, version 1 or 2), found a Draeger",
        ),
        (String::new(), "found an empty file"),
    ] {
        let message = message(&text);
        assert!(message.contains(expected), "{message}\n  lacks {expected}");
    }
}

#[test]
fn channels_that_do_not_measure_are_skipped() {
    let text =
        made(1.0, 0.0).replacen("\n1\n1\nMeasurement", &format!("\n1\n{PRESENT_KEY} 1,2,3,4,5,6\nMeasurement"), 1);
    let widened: Vec<String> = text
        .lines()
        .map(|line| match line.split('\t').collect::<Vec<_>>()[..] {
            [a, b, c, d, ref rest @ ..] if rest.len() == 4 => {
                format!("{a}\t{b}\t{c}\t{d}\t9\t9\t9\t9\t{}", rest.join("\t"))
            }
            _ => line.to_owned(),
        })
        .collect();
    let narrow = parse(text.as_bytes(), Path::new("s.eit")).unwrap();
    let wide = parse(widened.join("\n").as_bytes(), Path::new("s.eit")).unwrap();
    assert_eq!(narrow.setup.channels, wide.setup.channels);
    assert_eq!(
        (narrow.injections, narrow.real_v, narrow.imaginary_v),
        (wide.injections, wide.real_v, wide.imaginary_v)
    );
}

#[test]
fn headers_without_channels_take_them_from_the_first_row() {
    let text = made(1.0, 0.0).replace("MeasurementChannels: 1,2,5,6", "1").replace('5', "3").replace('6', "4");
    let measurement = parse(text.as_bytes(), Path::new("s.eit")).unwrap();
    assert_eq!(measurement.setup.channels, [1, 2, 3, 4]);
}

/// Two injections with three electrodes at three frequencies. The digits of a reading are injection, frequency and
/// electrode.
fn swept(head: &str) -> String {
    let mut text = head.to_owned();
    for (injection, pair) in ["1 2", "2 3"].iter().enumerate() {
        text += &format!("{pair}\n");
        for step in 0..3 {
            let readings: Vec<String> =
                (0..3).map(|e| format!("{}\t{}", 100 * (injection + 1) + 10 * step + e, step)).collect();
            text += &format!("{}\n", readings.join("\t"));
        }
    }
    text
}

#[test]
fn a_sweep_is_read_at_one_frequency_or_as_a_difference_of_two() {
    let head = "12\n2\nmade\n2024.02.29. 23:59:01.250\n1000\n100000\n1\n3\n0.001\n10\n0\nMeasurementChannels: 1,2,3\n";
    let text = swept(head);
    let read = |frequencies_hz| {
        let options = ReadOptions { frequencies_hz, ..ReadOptions::default() };
        decode_with(text.as_bytes(), Path::new("s_1.eit"), &options)
    };
    let question = read(Frequencies::Only).unwrap_err().to_string();
    assert!(question.contains("--frequency-hz with one of 1000, 10000, 100000, or two"), "{question}");
    let table = read(Frequencies::One(10_050.0)).unwrap();
    assert_eq!(table.values(), [110.0, 111.0, 112.0, 210.0, 211.0, 212.0]);
    assert!(table.understood().contains("10000 Hz"), "{}", table.understood());
    let table = read(Frequencies::Difference(1e5, 1e3)).unwrap();
    assert_eq!((table.values(), table.imaginary().unwrap()), ([20.0; 6].as_slice(), [2.0; 6].as_slice()));
    assert!(read(Frequencies::One(5e3)).is_err());
    let cut = &text[..text.len() - 20];
    assert!(
        decode_with(
            cut.as_bytes(),
            Path::new("s.eit"),
            &ReadOptions { frequencies_hz: Frequencies::One(1e3), ..ReadOptions::default() }
        )
        .is_err()
    );
}

#[test]
fn version_1_has_nine_lines_of_header() {
    let text = swept("9\nmade\n2019.02.28. 12:00:00.5\n1000\n3000\n0\n3\n0.001\n10\n");
    let options = ReadOptions { frequencies_hz: Frequencies::One(2000.0), ..ReadOptions::default() };
    let table = decode_with(text.as_bytes(), Path::new("s_1.eit"), &options).unwrap();
    assert_eq!(table.values(), [110.0, 111.0, 112.0, 210.0, 211.0, 212.0]);
    assert_eq!(table.layout(), &Layout::SingleEnded { electrodes: 3, stimulations: vec![(0, 1), (1, 2)] });
}
