//! Runs files through the function behind `dermis reconstruct`, keeping touches and images in memory.

use dermis_device::{FileSpec, FrameSelect};
use dermis_live::calibration::Calibration;
use dermis_live::skin_frame::SkinFrame;
use dermis_record::sink::{Sink, Summary};
use dermis_skin::Skin;
use dermis_tomo::mesh::{Point, distance};

use crate::Error;
use crate::reconstruct::{Report, Request, reconstruct_into};

/// A touch in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TouchRow {
    /// Frame number, from 0.
    pub frame: usize,
    /// Identity.
    pub id: u64,
    /// Position, millimetres.
    pub at_mm: Point,
    /// Standard deviations of the position, millimetres.
    pub sigma_mm: [f64; 2],
    /// Amplitude, as in the table of touches.
    pub amplitude: f64,
}

impl TouchRow {
    /// Distance from a position, millimetres.
    pub fn distance_mm(&self, place_mm: Point) -> f64 {
        distance(self.at_mm, place_mm)
    }
}

/// Images of a reconstruction.
#[derive(Clone, Debug, Default)]
pub struct Images {
    /// Pixels from top to bottom.
    pub rows: usize,
    /// Pixels per row.
    pub columns: usize,
    /// One image per frame, row 0 at the top, NaN outside the skin.
    pub frames: Vec<Vec<f32>>,
}

/// Results of a reconstruction.
#[derive(Clone, Debug)]
pub struct Imaged {
    /// The report.
    pub report: Report,
    /// Touches, in frame order.
    pub touches: Vec<TouchRow>,
    /// Images.
    pub images: Images,
    /// Root mean square of each frame's difference from the baseline, model volts.
    pub change: Vec<f64>,
}

/// Selects frames of a file, in the syntax of `FILE#FRAMES`.
///
/// # Errors
/// The selection is invalid.
pub fn chosen(path: &std::path::Path, frames: &str) -> Result<FileSpec, Error> {
    Ok(FileSpec { path: path.to_path_buf(), select: frames.parse::<FrameSelect>()? })
}

/// Does what `dermis reconstruct SKIN --baseline --frames --calibration` does. Without a baseline the frames are
/// taken as differences.
///
/// # Errors
/// As for [`reconstruct_into`].
pub fn imaged(
    skin: Skin,
    baseline: Option<FileSpec>,
    frames: FileSpec,
    calibration: Option<&Calibration>,
) -> Result<Imaged, Error> {
    let request = Request {
        skin,
        baseline,
        frames,
        read: Default::default(),
        as_skin: false,
        calibration: None,
        forces: None,
        hyperparameter: None,
        touches: None,
        images: None,
    };
    let mut kept = Kept::default();
    let report = reconstruct_into(&request, calibration, &mut kept, |_, _| {})?;
    Ok(Imaged { report, touches: kept.touches, images: kept.images, change: kept.change })
}

#[derive(Default)]
struct Kept {
    touches: Vec<TouchRow>,
    images: Images,
    change: Vec<f64>,
}

impl Sink for Kept {
    fn accept(&mut self, output: &SkinFrame<'_>) -> Result<(), dermis_record::Error> {
        let frame = self.images.frames.len();
        self.touches.extend(output.touches.iter().map(|touch| TouchRow {
            frame,
            id: touch.id,
            at_mm: touch.position_m.map(|m| 1e3 * m),
            sigma_mm: [0, 1].map(|axis| 1e3 * touch.covariance_m2[axis][axis].sqrt()),
            amplitude: touch.amplitude,
        }));
        (self.images.rows, self.images.columns) = (output.rows, output.columns);
        self.images.frames.push(output.image.to_vec());
        let finite = output.compensated.iter().filter(|value| value.is_finite());
        let (sum, count) = finite.fold((0.0, 0.0), |(sum, count), value| (sum + value * value, count + 1.0));
        self.change.push(f64::sqrt(sum / f64::max(count, 1.0)));
        Ok(())
    }

    fn finish(&mut self) -> Result<Summary, dermis_record::Error> {
        let frames = self.images.frames.len() as u64;
        Ok(Summary { frames, written: frames })
    }
}

impl Images {
    /// Bilinear interpolation at a position given from -1 to 1 across the image, y up. Pixels outside the skin take
    /// the value of the nearest one inside.
    pub fn at(&self, frame: usize, x: f64, y: f64) -> f64 {
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

    /// The pixel itself or, if it holds NaN, the nearest finite pixel around it.
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
                    best = (distance, f64::from(value));
                }
            }
        }
        best.1
    }

    /// Number of NaN pixels whose centre lies inside the inscribed disc.
    pub fn holes(&self, frame: usize) -> usize {
        let centre = |k: usize, count: usize| (2.0 * k as f64 + 1.0) / count as f64 - 1.0;
        let inside =
            |k: &usize| centre(k % self.columns, self.columns).hypot(centre(k / self.columns, self.rows)) < 1.0;
        (0..self.rows * self.columns).filter(inside).filter(|&k| !self.frames[frame][k].is_finite()).count()
    }
}
