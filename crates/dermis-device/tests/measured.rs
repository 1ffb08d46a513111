//! Recordings of real instruments. Without them each test counts as skipped.

use std::path::PathBuf;

use dermis_device::{FileSpec, Format, FrameTable, Layout, read};

/// A file or folder in a set of measured data.
fn measured(set: &str, path: &str) -> Option<PathBuf> {
    Some(dermis_testdata::set(set)?.join(path))
}

fn table(path: PathBuf, select: &str) -> FrameTable {
    read(&FileSpec { path, select: select.parse().unwrap() }, None).unwrap()
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let product = |x: &[f64], mean_x: f64, y: &[f64], mean_y: f64| -> f64 {
        x.iter().zip(y).map(|(x, y)| (x - mean_x) * (y - mean_y)).sum()
    };
    product(a, mean_a, b, mean_b) / (product(a, mean_a, a, mean_a) * product(b, mean_b, b, mean_b)).sqrt()
}

#[test]
fn sciospec_directory() {
    let Some(path) = measured("sciospec", "run1") else { return };
    let run = table(path, "");
    let adjacent = (0..16).map(|k| (k, (k + 1) % 16)).collect();
    assert_eq!(run.layout(), &Layout::SingleEnded { electrodes: 16, stimulations: adjacent });
    assert_eq!(run.frames(), 255);
    assert_eq!(run.sequences().unwrap(), (1..=255).collect::<Vec<u64>>());
    // 20 frames per second: 254 intervals of 50 ms, recorded to the millisecond.
    let last_s = run.times_s().unwrap()[254];
    assert!((last_s - 12.7).abs() < 0.02, "{last_s}");
    // The current enters at the first electrode of a pair, which is the most positive. The second is the most
    // negative.
    for (stimulation, potentials) in run.row(0).unwrap().chunks(16).enumerate() {
        let by_value = |a: &usize, b: &usize| potentials[*a].total_cmp(&potentials[*b]);
        assert_eq!((0..16).max_by(by_value), Some(stimulation));
        assert_eq!((0..16).min_by(by_value), Some((stimulation + 1) % 16));
    }
    assert!(correlation(run.row(0).unwrap(), run.row(59).unwrap()) > 0.999, "nothing happens before frame 60");
}

#[test]
fn sciospec_choice_of_frames() {
    let Some(path) = measured("sciospec", "run1/setup") else { return };
    assert_eq!(table(path, "0..60").frames(), 60);
}

#[test]
fn ktc_columns() {
    let Some(path) = measured("ktc", "voltages.csv") else { return };
    let frames = table(path.clone(), "");
    assert_eq!((frames.frames(), frames.channels()), (5, 2356));
    assert_eq!(frames.names().unwrap(), ["ref", "train1", "train2", "train3", "train4"]);
    let chosen = table(path, "train1,train2");
    assert_eq!(chosen.row(1), frames.row(2));
    // An inclusion changes a tank's voltages by a few percent.
    for frame in 1..5 {
        let similar = correlation(frames.row(0).unwrap(), frames.row(frame).unwrap());
        assert!((0.9..0.99999).contains(&similar), "{similar}");
    }
}

#[test]
fn golfball_matrices() {
    let Some(path) = measured("golfball", "phantom_A.csv") else { return };
    let frames = table(path, "");
    assert_eq!(frames.layout(), &Layout::FullMatrix { electrodes: 16 });
    assert_eq!(frames.names().unwrap()[0], "ref");
    let row = frames.row(0).unwrap();
    assert!(row.iter().all(|&value| value >= 0.0), "magnitudes");
    let transposed: Vec<f64> = (0..256).map(|channel| row[channel % 16 * 16 + channel / 16]).collect();
    // Reciprocity: a matrix in drive-major order is symmetric apart from noise; in any other order it isn't.
    let reciprocal = correlation(row, &transposed);
    assert!(reciprocal > 0.99, "{reciprocal}");
}

#[test]
fn pyeidors_pairs() {
    let Some(directory) = measured("pyeidors-tank", "electrode01_metal") else { return };
    for entry in std::fs::read_dir(directory).unwrap() {
        let frames = table(entry.unwrap().path(), "");
        assert_eq!((frames.frames(), frames.channels()), (2, 208));
        assert!(correlation(frames.row(0).unwrap(), frames.row(1).unwrap()) > 0.95);
        assert!(correlation(frames.imaginary_row(0).unwrap(), frames.imaginary_row(1).unwrap()) > 0.9);
        assert_eq!(frames.clone().select(&"target".parse().unwrap()).unwrap().row(0), frames.row(1));
    }
}

#[test]
fn hydrogel_rows() {
    let Some(path) = measured("hydrogel", "ohmc16_before.csv") else { return };
    let content = std::fs::read(&path).unwrap();
    assert_eq!(Format::detect(&path, &content).unwrap(), Format::Csv);
    let before = table(path.clone(), "");
    assert_eq!((before.frames(), before.channels()), (500, 192));
    assert!(before.values().iter().all(|&value| value > 0.0), "unsigned magnitudes");
    let positions =
        dermis_device::instruments::csv::read_numbers(&path.with_file_name("ohmc16_positions.csv")).unwrap();
    assert_eq!((positions.rows(), positions.column_index("depth_m")), (500, Some(2)));
}
