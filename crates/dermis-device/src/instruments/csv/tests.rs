use super::*;

#[test]
fn lines_longer_than_any_frame_are_refused_before_they_are_read() {
    let file = Path::new("wide.csv");
    let wide = "1,".repeat(scan::MOST_COLUMNS) + "2\n";
    let error = parse(wide.as_bytes(), file).unwrap_err().to_string();
    assert_eq!(
        error,
        format!(
            "wide.csv:1: expected at most {} values in a line, found {}",
            scan::MOST_COLUMNS,
            scan::MOST_COLUMNS + 1
        )
    );
    assert!(Shape::of(wide.as_bytes(), file).is_err());
    let ragged = format!("1,2\n{}\n", "1,".repeat(100_000));
    let error = parse(ragged.as_bytes(), file).unwrap_err().to_string();
    assert!(error.starts_with("wide.csv:2: expected 2 values as in the other rows, found 100001"), "{error}");
}

fn parsed(text: &str) -> Result<NumberTable, DeviceError> {
    parse(text.as_bytes(), Path::new("made.csv"))
}

fn message(text: &str) -> String {
    parsed(text).unwrap_err().to_string()
}

#[test]
fn every_separator_reads_the_same_table() {
    for text in [
        "1,2.5\n-3e2,4\n",
        "1;2.5\r\n-3e2;4\r\n",
        "1\t2.5\n-3e2\t4",
        " 1   2.5 \n\n-3e2 4\n",
        "\u{feff}1, 2.5\n# note\n-3e2 ,\"4\"\n",
    ] {
        let table = parsed(text).unwrap();
        assert_eq!((table.columns, table.values), (2, vec![1.0, 2.5, -300.0, 4.0]), "{text:?}");
    }
}

#[test]
fn a_head_of_names_is_kept() {
    let table = parsed("x_m,y_m\n0.5,-1\n").unwrap();
    assert_eq!(table.column_index("y_m"), Some(1));
    assert_eq!(table.column(1).collect::<Vec<_>>(), [-1.0]);
}

#[test]
fn columns_of_millimetres_become_metres_by_their_names() {
    let table = parsed("x_mm,y_m,force_n\n12.5,0.02,3\n").unwrap().in_metres();
    assert_eq!(table.header.unwrap(), ["x_m", "y_m", "force_n"]);
    assert_eq!(table.values, [0.0125, 0.02, 3.0]);
    let table = parsed("X (mm);Y [m];force_n\n12,5;0,02;3\n").unwrap();
    assert_eq!(table.clone().in_metres().header.unwrap(), ["x_m", "y_m", "force_n"]);
    assert_eq!(table.clone().in_metres().values, [0.0125, 0.02, 3.0]);
    assert_eq!(table.clone().in_millimetres().header.unwrap(), ["x_mm", "y_mm", "force_n"]);
    assert_eq!(table.in_millimetres().values, [12.5, 20.0, 3.0]);
}

#[test]
fn missing_cells_are_nan() {
    let table = parsed("1,,3\nnan,NaN,\n").unwrap();
    let missing: Vec<bool> = table.values.iter().map(|value| value.is_nan()).collect();
    assert_eq!(missing, [false, true, false, true, true, true]);
}

#[test]
fn ragged_rows_give_line_and_counts() {
    assert_eq!(message("# run\n1,2,3\n4,5\n"), "made.csv:3: expected 3 values as in the other rows, found 2");
    assert_eq!(message("a,b\n1,2,3\n"), "made.csv:2: expected 2 values as in the other rows, found 3");
}

#[test]
fn cells_that_are_no_finite_number_give_line_and_column() {
    let wanted = "expected a number with a decimal point, nan or nothing";
    assert_eq!(message("1,2\n3,four\n"), format!("made.csv:2: column 2: {wanted}, found 'four'"));
    assert_eq!(message("1,x\n3,4\n"), format!("made.csv:1: column 2: {wanted}, found 'x'"));
    assert_eq!(parsed("1,5;2,5\n").unwrap().values, [1.5, 2.5], "decimal commas");
    for infinite in ["inf", "-Infinity", "1e999"] {
        let expected = format!("made.csv:2: column 1: expected a finite number or nan, found '{infinite}'");
        assert_eq!(message(&format!("1,2\n{infinite},2\n")), expected);
    }
}

#[test]
fn empty_and_foreign_content_are_distinguished() {
    assert!(message("").contains("found none"));
    assert!(message("# only\n\n").contains("found none"));
    assert!(message("a,b\n").contains("found none"));
    let zip = parse(b"PK\x03\x04\0\0\xff", Path::new("a.csv")).unwrap_err().to_string();
    assert_eq!(
        zip,
        "a.csv: expected a text table of numbers, found a ZIP archive that is neither npz nor xlsx (save sheets as xlsx or CSV)"
    );
}

#[test]
fn exported_frames_are_read_back_with_numbers_and_times() {
    let text = "sequence,device_time_ns,host_monotonic_ns,host_wall_ns,1-2 > 3-4,\"2-3 > 4,5\"\n\
                7,,1000000000,1790000000000000000,0.1,-2\n9,,1040000000,1790000000040000000,NaN,3\n";
    let table = decode(text.as_bytes(), Path::new("made.csv")).unwrap();
    assert_eq!((table.frames(), table.channels()), (2, 2));
    assert_eq!(table.sequences(), Some([7, 9].as_slice()));
    let times = table.times_s().unwrap();
    assert!(times[0] == 0.0 && (times[1] - 0.04).abs() < 1e-12, "{times:?}");
    assert!(table.row(0) == Some(&[0.1, -2.0][..]) && table.row(1).unwrap()[0].is_nan());
    let complex = decode(b"sequence,re a,re b,im a,im b\n0,1,2,3,4\n", Path::new("made.csv")).unwrap();
    assert_eq!((complex.values(), complex.imaginary()), ([1.0, 2.0].as_slice(), Some([3.0, 4.0].as_slice())));
    assert!(decode(b"sequence,re a,im a,im b\n0,1,2,3\n", Path::new("made.csv")).is_err());
    assert!(decode(b"sequence,time_s\n0,1\n", Path::new("made.csv")).is_err());
}

#[test]
fn complex_readings_in_one_cell_are_read_as_numpy_and_matlab_write_them() {
    let decoded = |text: &str| decode(text.as_bytes(), Path::new("made.csv"));
    // numpy.savetxt with and without a delimiter, MATLAB's writematrix, and a plain number among complex ones.
    for text in [
        "(1.5e+00+2.0e-01j),(-3e0+-4e0j)\n5,nan-1j\n",
        " (1.5+0.2j) (-3-4j)\n (5+0j) (nan-1j)\n",
        "1.5+0.2i;-3-4i\n5;NaN-1i\n",
        "time_s,a,b\n0,1.5+2e-1j,-3e+0-4e+0J\n1,5,nan-1j\n",
    ] {
        let table = decoded(text).unwrap_or_else(|error| panic!("{text}: {error}"));
        assert_eq!((table.frames(), table.channels()), (2, 2), "{text}");
        assert_eq!(table.imaginary(), Some([0.2, -4.0, 0.0, -1.0].as_slice()), "{text}");
        assert!(table.values()[..3] == [1.5, -3.0, 5.0] && table.values()[3].is_nan(), "{text}");
    }
    let alone = decoded("2j,1\n").unwrap();
    assert_eq!((alone.values(), alone.imaginary()), ([0.0, 1.0].as_slice(), Some([2.0, 0.0].as_slice())));
    assert!(decoded("1,2\n").unwrap().imaginary().is_none());
    for broken in ["1,1+infj", "1,1+j", "1,1+2k", "1,(1+2j", "1,1 + 2j3"] {
        let message = decoded(&format!("3,4\n{broken}\n")).unwrap_err().to_string();
        assert!(message.starts_with("made.csv:2: column 2"), "{broken}: {message}");
    }
    // Positions can't be complex.
    assert!(message("1,2\n1+2j,3\n").contains("expected a number"), "{}", message("1,2\n1+2j,3\n"));
}

#[test]
fn a_leading_time_column_gives_times() {
    let table = decode(b"time_s,a,b\n0,1,2\n0.05,3,4\n", Path::new("made.csv")).unwrap();
    assert_eq!(table.times_s(), Some([0.0, 0.05].as_slice()));
    assert_eq!(table.values(), [1.0, 2.0, 3.0, 4.0]);
}

fn read_for(text: &str, channels: &[usize]) -> Result<FrameTable, String> {
    let options = ReadOptions::default().with_channels(channels.iter().copied());
    decode_with(text.as_bytes(), Path::new("made.csv"), &options).map_err(|error| error.to_string())
}

#[test]
fn a_header_of_numbers_is_no_frame() {
    let header: Vec<String> = (0..10).map(|n| n.to_string()).collect();
    let row = |n: usize| (0..10).map(|k| format!("0.0{n}{k}")).collect::<Vec<_>>().join(",");
    let text = format!("{}\n{}\n{}\n", header.join(","), row(1), row(2));
    let table = read_for(&text, &[]).unwrap();
    assert_eq!((table.frames(), table.values()[0]), (2, 0.01));
    // pandas writes it like this, with its index.
    let indexed = format!(",{}\n0,{}\n1,{}\n", header.join(","), row(1), row(2));
    let table = read_for(&indexed, &[]).unwrap();
    assert_eq!((table.frames(), table.channels(), table.values()[0]), (2, 10, 0.01));
    assert!(table.understood().contains("it counts the rows"), "{}", table.understood());
    // ADC counts below it. If the rows continue the count, the table was made by hand.
    let counts = read_for("0,1,2,3\n17,18,4,9\n20,19,5,9\n", &[]).unwrap();
    assert_eq!((counts.frames(), counts.values()[0]), (2, 17.0));
    assert_eq!(read_for("1,2,3,4\n5,6,7,8\n", &[]).unwrap().frames(), 2);
    assert_eq!(read_for("1,2,3\n7,5,6\n", &[]).unwrap().frames(), 2);
    // A header alone isn't a frame.
    assert!(read_for(&format!("{}\n", header.join(",")), &[]).unwrap_err().contains("found none"));
}

#[test]
fn decimal_commas_between_commas_are_refused_with_advice() {
    for text in ["0,0626722,0,027776\n0,0626,0,02777\n", "62,672203,27,775993\n62,672100,7,775990\n"] {
        let message = read_for(text, &[]).unwrap_err();
        assert!(message.contains("decimal commas") && message.contains("separator other than"), "{message}");
    }
    assert_eq!(read_for("100,12345,2,0\n7,8,9,10\n", &[]).unwrap().channels(), 4);
}

#[test]
fn marks_between_thousands_are_refused_with_their_place() {
    for text in ["987;1,234\n1,001;1,120\n998;998\n1,003;1,140\n", "987\t1.234\n1.001\t1.120\n998\t998\n1.003\t1.140\n"]
    {
        let message = read_for(text, &[]).unwrap_err();
        assert!(message.starts_with("made.csv:2: numbers: expected numbers without thousands separators"), "{message}");
    }
    // Between commas, points are decimal points.
    let places = read_for("12.875,998\n13,1.002\n-4.125,1.001\n7.375,3.004\n", &[]).unwrap();
    assert_eq!((places.values()[0], places.values()[3]), (12.875, 1.002));
    // Counts reach a thousand late in the file.
    let late: String = (0..300).map(|row| if row < 250 { "5;7\n" } else { "1,001;1,120\n" }).collect();
    assert!(read_for(&late, &[]).unwrap_err().starts_with("made.csv:251: column 1: expected a number"));
    // Fractions have the same number of digits everywhere, or as many as they need.
    for text in
        ["0;1,234\n1;2,345\n2;3,456\n", "1;1,234\n2,5;2,345\n2;3,456\n1,25;4,567\n", "5;0,125\n7;1,250\n0,1;3\n"]
    {
        assert!(read_for(text, &[]).is_ok(), "{text}");
    }
}

#[test]
fn magnitudes_and_phases_become_complex_readings() {
    let close = |table: &FrameTable| {
        let expected = [(0.0, 2.0), (-3.0, 0.0)];
        let found = table.values().iter().zip(table.imaginary().unwrap());
        assert!(found.zip(expected).all(|((re, im), (a, b))| (re - a).abs() < 1e-12 && (im - b).abs() < 1e-12));
    };
    close(&read_for("mag1,phase1 (deg),mag2,phase2 (deg)\n2,90,3,180\n", &[]).unwrap());
    close(&read_for("|Z| 1;|Z| 2;phi 1;phi 2\n2;3;90,0;180,0\n", &[]).unwrap());
    close(&read_for("re 1,im 1,re 2,im 2\n0,2,-3,0\n", &[]).unwrap());
    let question = read_for("mag1,phase1,mag2,phase2\n2,0.5,3,0.1\n", &[]).unwrap_err();
    assert!(question.contains("phase1_rad"), "{question}");
}

#[test]
fn the_name_z_alone_is_a_magnitude_but_z_phase_is_a_phase() {
    let table = read_for("Z0_mag,Z0_phase,Z1_mag,Z1_phase\n2,90,3,180\n", &[]).unwrap();
    assert_eq!((table.channels(), table.imaginary().is_some()), (2, true));
    assert!((table.imaginary().unwrap()[0] - 2.0).abs() < 1e-12);
    assert_eq!(read_for("Zre1,Zim1\n2,3\n", &[]).unwrap().imaginary(), Some([3.0].as_slice()));
    assert_eq!(read_for("Z 1,theta 1 (deg)\n2,90\n", &[]).unwrap().channels(), 1);
}

#[test]
fn numbers_with_marks_between_thousands_are_refused() {
    for row in ["1,234.5;987.6;2,000.0", "1.234,5;987,6;2.000,0", "\"1,234.5\",\"7,987.6\",\"2,000.0\""] {
        let message = read_for(&format!("{row}\n{row}\n{row}\n"), &[]).unwrap_err();
        assert!(message.contains("numbers without thousands separators, such as 1234.5"), "{message}");
    }
}

#[test]
fn one_reading_per_row_with_its_channel_is_a_long_table() {
    let rows = |last: usize| -> String {
        (0..last).map(|row| format!("{},{},{}\n", 0.02 * (row / 4) as f64, row % 4 + 1, 10 + row)).collect()
    };
    let table = read_for(&format!("time_s,channel,voltage\n{}", rows(12)), &[]).unwrap();
    assert_eq!((table.frames(), table.channels()), (3, 4));
    assert_eq!(table.row(1), Some([14.0, 15.0, 16.0, 17.0].as_slice()));
    assert_eq!(table.times_s(), Some([0.0, 0.02, 0.04].as_slice()));
    assert!(
        table.understood().contains("channel in column `channel`; 4 rows make one frame"),
        "{}",
        table.understood()
    );
    // A truncated frame isn't such a table: two columns of readings remain.
    assert_eq!(read_for(&format!("time_s,channel,voltage\n{}", rows(11)), &[]).unwrap().channels(), 2);
    let complex = read_for("frame,ch,re,im\n0,0,1,2\n0,1,3,4\n0,2,5,6\n1,0,7,8\n1,1,9,1\n1,2,2,3\n", &[]).unwrap();
    assert_eq!((complex.frames(), complex.channels()), (2, 3));
    assert_eq!(complex.imaginary_row(0), Some([2.0, 4.0, 6.0].as_slice()));
    // A sawtooth of a few values next to another reading stays a reading where it does not count from the start.
    assert_eq!(read_for("a,b\n0.5,1\n1.5,2\n0.5,3\n1.5,4\n", &[]).unwrap().channels(), 2);
}

#[test]
fn frames_wrapped_over_rows_are_put_together() {
    let rows: String = (0..8).map(|row| format!("0.{row},1.{row},2.{row}\n")).collect();
    let table = read_for(&rows, &[12, 144]).unwrap();
    assert_eq!((table.frames(), table.channels()), (2, 12));
    assert!(table.understood().contains("4 rows of 3 make one frame"), "{}", table.understood());
    let grouped: String =
        (0..8).map(|row| format!("0.{row},1.{row},2.{row}\n{}", if row == 3 { "\n" } else { "" })).collect();
    assert_eq!(read_for(&grouped, &[]).unwrap().channels(), 12);
    assert_eq!(read_for(&rows, &[3]).unwrap().frames(), 8);
    let question = read_for(&rows, &[8]).unwrap_err();
    assert!(question.contains("transposed?"), "{question}");
}

#[test]
fn chosen_columns_and_skipped_rows() {
    let text = "1 2 3\nt a b c\n0 0.1 0.2 0.3\n1 0.4 0.5 0.6\n";
    let options =
        |columns: &str| ReadOptions { columns: columns.parse().unwrap(), skip_rows: 1, ..ReadOptions::default() };
    let read = |columns: &str| decode_with(text.as_bytes(), Path::new("made.csv"), &options(columns));
    assert_eq!(read("c,a").unwrap().values(), [0.3, 0.1, 0.6, 0.4]);
    assert_eq!(read("1..3").unwrap().values(), [0.1, 0.2, 0.4, 0.5]);
    assert_eq!(read("a").unwrap().times_s(), Some([0.0, 1.0].as_slice()));
    let message = read("d").unwrap_err().to_string();
    assert!(message.contains("--columns: expected columns from 0 to 3, or names such as t, a"), "{message}");
}
