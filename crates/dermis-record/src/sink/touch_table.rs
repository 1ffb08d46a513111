//! Touches as a CSV table, with one row for every touch in every frame.

use std::fmt::Write as _;
use std::io::Write;
use std::path::{Path, PathBuf};

use super::interface::{Sink, Summary, TouchRow, load_names, load_numbers, other_numbers};
use super::staged::StagedFile;
use crate::Error;
use dermis_live::skin_frame::SkinFrame;
use dermis_touch::{LoadQuantity, Touch};

/// Header of the table.
const HEAD: &str = "frame,id,x_mm,y_mm,amplitude,area_mm2,sigma_x_mm,sigma_y_mm";
/// Columns added for forces.
const FORCES: &str = ",force_n,force_range,sigma_force_n";
/// Columns added for a calibration without labels, which may leave a position ambiguous.
const OTHER_PLACES: &str = ",other_x_mm,other_y_mm,other_probability";

/// Columns of a table of touches in addition to positions and amplitudes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TouchColumns {
    /// `force_n,force_range,sigma_force_n`, as in [`super::JsonLines`].
    pub forces: bool,
    /// The load read by a calibration by pokes: `depth_mm,sigma_depth_mm` or `poke_force_n,sigma_poke_force_n`, NaN
    /// for a touch without one.
    pub load: Option<LoadQuantity>,
    /// `other_x_mm,other_y_mm,other_probability`: an alternative position, and the probability that the touch is
    /// there instead; NaN, NaN and 0 for a touch without one.
    pub other_places: bool,
}

impl TouchColumns {
    fn head(self) -> String {
        let load = self.load.map_or(String::new(), |quantity| {
            let [value, sigma] = load_names(quantity);
            format!(",{value},{sigma}")
        });
        let [forces, others] =
            [(self.forces, FORCES), (self.other_places, OTHER_PLACES)].map(|(has, names)| if has { names } else { "" });
        format!("{HEAD}{forces}{load}{others}")
    }

    fn push(self, touch: &Touch, row: &mut String) {
        if self.forces {
            let range = touch.force.map_or("none", |force| force.range());
            let nearest = touch.force.and_then(|force| force.nearest_n()).unwrap_or(f64::NAN);
            let sigma = touch.force.and_then(|force| force.sigma_n()).unwrap_or(f64::NAN);
            let _ = write!(row, ",{nearest},{range},{sigma}");
        }
        if self.load.is_some() {
            let [value, sigma] = touch.load.map_or([f64::NAN; 2], |load| load_numbers(&load));
            let _ = write!(row, ",{value},{sigma}");
        }
        if self.other_places {
            let [x_mm, y_mm, probability] = touch.other_place.map_or([f64::NAN, f64::NAN, 0.0], other_numbers);
            let _ = write!(row, ",{x_mm},{y_mm},{probability}");
        }
    }
}

/// Writes `frame,id,x_mm,y_mm,amplitude,area_mm2,sigma_x_mm,sigma_y_mm` and [`TouchColumns`].
///
/// `frame` counts accepted frames from 0, so it is the index into an [`super::ImageStack`] of the same run, whatever
/// the device's numbers are. A frame without touch has no row. Positions are those measured in the frame (not
/// filtered), and sigmas are the square roots of their covariance's diagonal. Numbers have enough digits to be read
/// back exactly; `NaN` and `inf` are written as such.
#[derive(Debug)]
pub struct TouchTable {
    path: PathBuf,
    file: Option<StagedFile>,
    columns: TouchColumns,
    summary: Summary,
}

impl TouchTable {
    /// Starts a table, which appears at `path` once finished.
    ///
    /// # Errors
    /// An I/O error if no file can be created next to `path`.
    pub fn create(path: &Path, columns: TouchColumns) -> Result<Self, Error> {
        let mut file = StagedFile::create(path)?;
        writeln!(file, "{}", columns.head()).map_err(Error::io(path))?;
        Ok(Self { path: path.to_owned(), file: Some(file), columns, summary: Summary::default() })
    }
}

impl Sink for TouchTable {
    fn accept(&mut self, output: &SkinFrame<'_>) -> Result<(), Error> {
        let file = self.file.as_mut().ok_or_else(|| finished(&self.path))?;
        for touch in output.touches.iter() {
            let TouchRow { x_mm, y_mm, amplitude, area_mm2, sigma_x_mm, sigma_y_mm } = TouchRow::new(touch);
            let (frame, id) = (self.summary.frames, touch.id);
            let mut row = format!("{frame},{id},{x_mm},{y_mm},{amplitude},{area_mm2},{sigma_x_mm},{sigma_y_mm}");
            self.columns.push(touch, &mut row);
            writeln!(file, "{row}").map_err(Error::io(&self.path))?;
            self.summary.written += 1;
        }
        self.summary.frames += 1;
        Ok(())
    }

    fn finish(&mut self) -> Result<Summary, Error> {
        self.file.take().map_or(Ok(()), StagedFile::finish)?;
        Ok(self.summary)
    }
}

/// The error for a frame that comes after the end.
pub(super) fn finished(path: &Path) -> Error {
    let reason = "came after the file was finished".to_owned();
    Error::Live(dermis_live::Error::Content { file: path.to_owned(), field: "frame".to_owned(), reason })
}

#[cfg(test)]
mod tests {
    use super::super::testing::{output, touch};
    use super::*;
    use dermis_touch::{PlaceHypothesis, TouchPhase};

    #[test]
    fn rows_carry_millimetres_and_frames_without_touch_have_none() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("t.csv");
        let mut table = TouchTable::create(&path, TouchColumns::default()).unwrap();
        let touches = [touch(1, TouchPhase::Begin, 12.5, -3.0), touch(2, TouchPhase::Move, 0.0, 0.25)];
        for (sequence, touches) in [(70, &touches[..1]), (71, &[]), (75, &touches)] {
            table.accept(&output(sequence, &[0.0; 6], touches, &[])).unwrap();
        }
        assert!(!path.exists(), "nothing may stand under the final name before the end");
        assert_eq!(table.finish().unwrap(), Summary { frames: 3, written: 3 });
        let text = std::fs::read_to_string(&path).unwrap();
        let mut lines = text.lines();
        assert_eq!(lines.next(), Some("frame,id,x_mm,y_mm,amplitude,area_mm2,sigma_x_mm,sigma_y_mm"));
        let rows: Vec<Vec<f64>> =
            lines.map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect()).collect();
        let expected = [
            [0.0, 1.0, 12.5, -3.0, 0.75, 100.0, 0.5, 0.25],
            [2.0, 1.0, 12.5, -3.0, 0.75, 100.0, 0.5, 0.25],
            [2.0, 2.0, 0.0, 0.25, 0.75, 100.0, 0.5, 0.25],
        ];
        assert_eq!(rows.len(), 3);
        for (row, expected) in rows.iter().zip(expected) {
            // Two roundings: to metres and back.
            assert!(row.iter().zip(expected).all(|(a, b)| (a - b).abs() <= 4.0 * f64::EPSILON * b.abs()), "{row:?}");
        }
        assert!(table.accept(&output(76, &[0.0; 6], &[], &[])).is_err());
    }

    #[test]
    fn forces_have_columns_of_their_own() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("t.csv");
        let mut table = TouchTable::create(&path, TouchColumns { forces: true, ..TouchColumns::default() }).unwrap();
        let mut touch = touch(1, TouchPhase::Move, 0.0, 0.0);
        touch.force = Some(dermis_touch::force::ForceReading::AboveRange { most_n: 0.5 });
        table.accept(&output(1, &[0.0; 6], &[touch], &[])).unwrap();
        table.finish().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert!(
            lines[0].ends_with("sigma_y_mm,force_n,force_range,sigma_force_n") && lines[1].ends_with(",0.5,above,NaN"),
            "{text}"
        );
    }

    #[test]
    fn loads_of_pokes_have_columns_of_their_own() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("t.csv");
        let columns = TouchColumns { load: Some(LoadQuantity::DepthM), ..TouchColumns::default() };
        let mut table = TouchTable::create(&path, columns).unwrap();
        let mut deep = touch(1, TouchPhase::Move, 0.0, 0.0);
        deep.load = Some(dermis_touch::TouchLoad { quantity: LoadQuantity::DepthM, value: 0.002, sigma: 0.0005 });
        table.accept(&output(1, &[0.0; 6], &[deep, touch(2, TouchPhase::Move, 0.0, 0.0)], &[])).unwrap();
        table.finish().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].ends_with("sigma_y_mm,depth_mm,sigma_depth_mm"), "{text}");
        assert!(lines[1].ends_with(",2,0.5") && lines[2].ends_with(",NaN,NaN"), "{text}");
    }

    #[test]
    fn other_places_have_columns_of_their_own() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("t.csv");
        let columns = TouchColumns { other_places: true, ..TouchColumns::default() };
        let mut table = TouchTable::create(&path, columns).unwrap();
        let mut doubted = touch(1, TouchPhase::Move, 0.0, 0.0);
        let (position_m, covariance_m2) = ([0.25, -0.5], [[1e-6, 0.0], [0.0, 1e-6]]);
        doubted.other_place = Some(PlaceHypothesis { position_m, covariance_m2, probability: 0.25 });
        table.accept(&output(1, &[0.0; 6], &[doubted, touch(2, TouchPhase::Move, 0.0, 0.0)], &[])).unwrap();
        table.finish().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].ends_with("sigma_y_mm,other_x_mm,other_y_mm,other_probability"), "{text}");
        assert!(lines[1].ends_with(",250,-500,0.25") && lines[2].ends_with(",NaN,NaN,0"), "{text}");
    }

    #[test]
    fn an_abandoned_table_leaves_nothing() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("t.csv");
        std::fs::write(&path, "before").unwrap();
        drop(TouchTable::create(&path, TouchColumns::default()).unwrap());
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "before");
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 1);
        assert!(TouchTable::create(directory.path(), TouchColumns::default()).is_err());
        assert!(TouchTable::create(&directory.path().join("none/t.csv"), TouchColumns::default()).is_err());
    }
}
