//! Four tanks measured by others, from file to images and touches by the same call as `dermis reconstruct`. The data
//! are not part of this repository; without them the tests count as skipped.

mod golfball;
mod ktc;
mod order;
mod pyeidors;
mod sciospec;
mod segment;

use std::path::{Path, PathBuf};

use dermis::lab::reconstruct::{Report, Request, reconstruct};
use dermis::skin::Skin;
use dermis_device::FileSpec;

/// A file or folder of a set of measured data, if the set is there; otherwise the test counts as skipped.
pub(crate) fn measured(set: &str, path: &str) -> Option<PathBuf> {
    Some(dermis_testdata::set(set)?.join(path))
}

/// One row of a table of touches.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Row {
    pub(crate) frame: usize,
    pub(crate) id: u64,
    pub(crate) x_mm: f64,
    pub(crate) y_mm: f64,
    pub(crate) amplitude: f64,
}

/// Images of a reconstruction.
pub(crate) struct Images {
    pub(crate) rows: usize,
    pub(crate) columns: usize,
    pub(crate) frames: Vec<Vec<f64>>,
}

pub(crate) struct Outcome {
    pub(crate) report: Report,
    pub(crate) touches: Vec<Row>,
    pub(crate) images: Images,
}

/// The chosen frames of a file.
pub(crate) fn chosen(path: &Path, select: &str) -> FileSpec {
    FileSpec { path: path.to_path_buf(), select: select.parse().unwrap() }
}

/// Writes frames as comma-separated rows, missing values as `nan`.
pub(crate) fn write_frames(path: &Path, frames: &[Vec<f64>]) {
    let line = |frame: &Vec<f64>| frame.iter().map(f64::to_string).collect::<Vec<_>>().join(",").to_lowercase() + "\n";
    std::fs::write(path, frames.iter().map(line).collect::<String>()).unwrap();
}

/// Reconstructs with a built-in skin and reads back what was written.
pub(crate) fn run(skin: &str, baseline: FileSpec, frames: FileSpec) -> Outcome {
    run_with(Skin::open(skin).unwrap(), baseline, frames)
}

pub(crate) fn run_with(skin: Skin, baseline: FileSpec, frames: FileSpec) -> Outcome {
    let folder = tempfile::tempdir().unwrap();
    let (touches, images) = (folder.path().join("t.csv"), folder.path().join("i.npy"));
    let request = Request {
        skin,
        baseline: Some(baseline),
        frames,
        format: None,
        calibration: None,
        forces: None,
        hyperparameter: None,
        touches: Some(touches.clone()),
        images: Some(images.clone()),
    };
    let report = reconstruct(&request, |_, _| {}).unwrap();
    Outcome { report, touches: read_touches(&touches), images: read_images(&images) }
}

fn read_touches(path: &Path) -> Vec<Row> {
    let text = std::fs::read_to_string(path).unwrap();
    let row = |line: &str| {
        let cell: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        Row { frame: cell[0] as usize, id: cell[1] as u64, x_mm: cell[2], y_mm: cell[3], amplitude: cell[4] }
    };
    text.lines().skip(1).map(row).collect()
}

fn read_images(path: &Path) -> Images {
    let array = dermis_device::instruments::npy::read(path).unwrap();
    let [_, rows, columns] = array.shape[..] else { panic!("shape {:?}", array.shape) };
    Images { rows, columns, frames: array.values.chunks(rows * columns).map(<[f64]>::to_vec).collect() }
}

impl Images {
    /// Bilinear value at a place given from -1 to 1 across the image, y up; pixels outside the skin count as the
    /// nearest one inside.
    pub(crate) fn at(&self, frame: usize, x: f64, y: f64) -> f64 {
        let column = 0.5 * (x + 1.0) * self.columns as f64 - 0.5;
        let row = 0.5 * (1.0 - y) * self.rows as f64 - 0.5;
        let (right, down) = (column - column.floor(), row - row.floor());
        [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]
            .into_iter()
            .map(|(r, c): (f64, f64)| {
                let weight = (1.0 - (r - down).abs()) * (1.0 - (c - right).abs());
                weight * self.nearest(frame, row.floor() + r, column.floor() + c)
            })
            .sum()
    }

    /// The pixel itself or, where it holds no number, the nearest of those around it that does.
    fn nearest(&self, frame: usize, row: f64, column: f64) -> f64 {
        let mut best = (f64::INFINITY, f64::NAN);
        for dr in -3..=3 {
            for dc in -3..=3 {
                let (r, c) = (row + f64::from(dr), column + f64::from(dc));
                if r < 0.0 || c < 0.0 || r >= self.rows as f64 || c >= self.columns as f64 {
                    continue;
                }
                let value = self.frames[frame][r as usize * self.columns + c as usize];
                let distance = f64::from(dr * dr + dc * dc);
                if value.is_finite() && distance < best.0 {
                    best = (distance, value);
                }
            }
        }
        best.1
    }

    /// Number of pixels with their centre inside the inscribed disc that hold no number.
    pub(crate) fn holes(&self, frame: usize) -> usize {
        let centre = |k: usize, count: usize| (2.0 * k as f64 + 1.0) / count as f64 - 1.0;
        let inside =
            |k: &usize| centre(k % self.columns, self.columns).hypot(centre(k / self.columns, self.rows)) < 1.0;
        (0..self.rows * self.columns).filter(inside).filter(|&k| !self.frames[frame][k].is_finite()).count()
    }
}
