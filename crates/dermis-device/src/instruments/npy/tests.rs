use super::*;

/// A file of the given version, as NumPy writes it.
fn made(version: u8, descr: &str, fortran: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n");
    let mut content = MAGIC.to_vec();
    content.extend([version, 0]);
    match version {
        1 => content.extend((header.len() as u16).to_le_bytes()),
        _ => content.extend((header.len() as u32).to_le_bytes()),
    }
    content.extend(header.as_bytes());
    content.extend(data);
    content
}

fn decoded(content: &[u8]) -> Result<Array, DeviceError> {
    decode(content, Path::new("a.npy"))
}

#[test]
fn every_type_byte_order_and_version() {
    let numbers = [1.0, -2.0, 300.0];
    type Encode = fn(f64) -> Vec<u8>;
    let kinds: [(&str, Encode); 9] = [
        ("<f8", |x| x.to_le_bytes().into()),
        (">f8", |x| x.to_be_bytes().into()),
        ("<f4", |x| (x as f32).to_le_bytes().into()),
        (">f4", |x| (x as f32).to_be_bytes().into()),
        ("<i4", |x| (x as i32).to_le_bytes().into()),
        (">i4", |x| (x as i32).to_be_bytes().into()),
        ("<i2", |x| (x as i16).to_le_bytes().into()),
        (">i2", |x| (x as i16).to_be_bytes().into()),
        ("<u2", |x| (x.abs() as u16).to_le_bytes().into()),
    ];
    for version in 1..=3 {
        for (descr, encode) in kinds {
            let data: Vec<u8> = numbers.into_iter().flat_map(encode).collect();
            let array = decoded(&made(version, descr, "False", "(3,)", &data)).unwrap();
            let expected = if descr == "<u2" { numbers.map(f64::abs) } else { numbers };
            assert_eq!((array.shape, array.values), (vec![3], expected.to_vec()), "{descr} {version}");
        }
    }
}

#[test]
fn fortran_order_is_rearranged() {
    let data: Vec<u8> = (0..24_i16).flat_map(i16::to_le_bytes).collect();
    let array = decoded(&made(1, "<i2", "True", "(2, 3, 4)", &data)).unwrap();
    for i in 0..2 {
        for j in 0..3 {
            for k in 0..4 {
                assert_eq!(array.values[(i * 3 + j) * 4 + k], (i + 2 * (j + 3 * k)) as f64);
            }
        }
    }
}

#[test]
fn one_dimension_is_one_frame() {
    let data: Vec<u8> = (0..6_i16).flat_map(i16::to_le_bytes).collect();
    let file = Path::new("a.npy");
    let frames = |shape| decoded(&made(1, "<i2", "False", shape, &data)).unwrap().into_frames(file);
    assert_eq!(frames("(6,)").unwrap().frames(), 1);
    assert_eq!(frames("(3, 2)").unwrap().row(2), Some([4.0, 5.0].as_slice()));
    assert_eq!(frames("(1, 3, 2)").unwrap().channels(), 6);
}

#[test]
fn announced_sizes_are_checked_before_they_are_believed() {
    for (shape, expected) in [
        ("(3,)", "expected 24 bytes of array elements, found 16"),
        ("(1,)", "expected 8 bytes"),
        ("(1000000000000, 4)", "expected 32000000000000 bytes"),
        ("(18446744073709551615, 18446744073709551615)", "array elements, found 16"),
        ("(99999999999999999999,)", "shape: expected a tuple of at most 16 lengths"),
        ("(1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,2)", "at most 16 lengths"),
        ("(-2,)", "a tuple of"),
        ("2", "a tuple of"),
    ] {
        let message = decoded(&made(1, "<f8", "False", shape, &[0; 16])).unwrap_err().to_string();
        assert!(message.contains(expected), "{shape}: {message}");
    }
    let mut long = made(2, "<f8", "False", "(2,)", &[0; 16]);
    long[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(decoded(&long).unwrap_err().to_string().contains("expected 4294967307 bytes of header"));
}

#[test]
fn unusable_headers_name_the_entry() {
    for (content, expected) in [
        (made(1, "<f16", "False", "(1,)", &[0; 16]), "descr: expected '<' or '>' with f2"),
        (made(1, "<U16", "False", "(1,)", &[0; 64]), "descr: expected '<' or '>' with f2"),
        (made(1, "|O", "False", "(1,)", &[0; 8]), "objects are not unpickled"),
        (made(1, "<f8", "Maybe", "(1,)", &[0; 8]), "fortran_order: expected True or False, found 'Maybe"),
        (made(9, "<f8", "False", "(1,)", &[0; 8]), "format version: expected 1, 2 or 3, found '9'"),
        (b"1,2,3\n".to_vec(), "expected a NumPy array (npy, version 1 to 3), found other text"),
        (MAGIC.to_vec(), "bytes of header"),
    ] {
        let message = decoded(&content).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn written_data_are_read_back_unchanged() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.npy");
    for shape in [vec![], vec![6], vec![2, 3], vec![1, 2, 3], vec![0, 4]] {
        let values: Vec<f64> = (0..shape.iter().product::<usize>()).map(|i| i as f64 / 3.0).collect();
        write_f64(&path, &shape, &values).unwrap();
        assert_eq!(std::fs::read(&path).unwrap().len() % 8, 0);
        assert_eq!(read(&path).unwrap(), Array { shape, values, imaginary: None });
    }
    write_f32(&path, &[2], &[f32::NAN, 0.1]).unwrap();
    let array = read(&path).unwrap();
    assert!(array.values[0].is_nan() && array.values[1] == f64::from(0.1_f32));
    assert!(write_f64(&path, &[3], &[0.0]).is_err());
    assert_eq!(read(&path).unwrap().values.len(), 2, "a refused write must leave the old file");
}

/// Frames from an array of this shape with elements 0, 1, 2, ..., for a skin with these channel counts.
fn shaped(shape: &str, count: usize, channels: &[usize]) -> Result<FrameTable, String> {
    let data: Vec<u8> = (0..count as u32).flat_map(u32::to_le_bytes).collect();
    let options = ReadOptions::default().with_channels(channels.iter().copied());
    let array = decoded(&made(1, "<u4", "False", shape, &data)).unwrap();
    array.into_frames_with(Path::new("a.npy"), &options).map_err(|error| error.to_string())
}

#[test]
fn shapes_are_interpreted_according_to_the_skin() {
    for (shape, count, channels, frames) in [
        ("(3, 4, 2)", 24, vec![8], 3),
        ("(3, 2, 4)", 24, vec![8, 16], 3),
        ("(3, 4, 2)", 24, vec![], 3),
        ("(4, 2)", 8, vec![8], 1),
        ("(12, 2)", 24, vec![8], 3),
        ("(1, 3, 8)", 24, vec![8], 3),
        ("(3, 2, 2, 2)", 24, vec![8], 3),
    ] {
        let table = shaped(shape, count, &channels).unwrap();
        assert_eq!((table.frames(), table.channels()), (frames, 8), "{shape}");
        assert!(table.values().iter().enumerate().all(|(index, value)| *value == index as f64));
    }
    // Real and imaginary parts as `dermis export` writes them.
    let table = shaped("(3, 2, 4)", 24, &[4]).unwrap();
    assert_eq!((table.frames(), table.channels()), (3, 4));
    assert_eq!(table.imaginary_row(1), Some([12.0, 13.0, 14.0, 15.0].as_slice()));
    let table = shaped("(3, 4, 2)", 24, &[4]).unwrap();
    assert_eq!(table.row(1), Some([8.0, 10.0, 12.0, 14.0].as_slice()));
}

#[test]
fn a_transposed_array_draws_a_question_and_an_option_answers_it() {
    let question = shaped("(8, 3)", 24, &[8, 16]).unwrap_err();
    assert!(question.contains("8 frames of 3 readings") && question.contains("transposed?"), "{question}");
    let data: Vec<u8> = (0..24_u8).collect();
    let options = ReadOptions { transpose: true, channels: vec![8], ..ReadOptions::default() };
    let array = decoded(&made(1, "|u1", "False", "(8, 3)", &data)).unwrap();
    let table = array.into_frames_with(Path::new("a.npy"), &options).unwrap();
    assert_eq!(table.row(1), Some([1.0, 4.0, 7.0, 10.0, 13.0, 16.0, 19.0, 22.0].as_slice()));
}

#[test]
fn complex_numbers_and_half_floats_are_read() {
    let data: Vec<u8> = [1.5_f32, -2.0, 3.0, 4.0].into_iter().flat_map(f32::to_be_bytes).collect();
    let array = decoded(&made(1, ">c8", "False", "(1, 2)", &data)).unwrap();
    assert_eq!((array.values, array.imaginary), (vec![1.5, 3.0], Some(vec![-2.0, 4.0])));
    // 1, -2, the largest, the smallest, an odd one, infinity: IEEE 754 binary16.
    let halves = [0x3c00_u16, 0xc000, 0x7bff, 0x0001, 0x3555];
    let data: Vec<u8> = halves.into_iter().flat_map(u16::to_le_bytes).collect();
    let array = decoded(&made(1, "<f2", "False", "(5,)", &data)).unwrap();
    assert_eq!(array.values, [1.0, -2.0, 65504.0, 2.0_f64.powi(-24), 0.333251953125]);
}
