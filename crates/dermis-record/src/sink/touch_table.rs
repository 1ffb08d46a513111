//! Touches as a table: CSV with one row for every touch in every frame.

use std::io::Write;
use std::path::{Path, PathBuf};

use super::interface::{Sink, Summary, TouchRow, load_names, load_numbers};
use super::staged::StagedFile;
use crate::Error;
use dermis_live::output::Output;
use dermis_touch::LoadQuantity;

/// The table's head.
const HEAD: &str = "frame,id,x_mm,y_mm,amplitude,area_mm2,sigma_x_mm,sigma_y_mm";
/// What a force calibration adds.
const FORCES: &str = ",force_n,force_range";

/// Writes `frame,id,x_mm,y_mm,amplitude,area_mm2,sigma_x_mm,sigma_y_mm` and, where forces are read,
/// `force_n,force_range` as [`super::JsonLines`] has them; where a calibration by pokes reads depths or forces,
/// `depth_mm,sigma_depth_mm` or `poke_force_n,sigma_poke_force_n`, NaN for a touch without.
///
/// `frame` counts accepted frames from 0, so that it is the index into an [`super::ImageStack`] of the same run
/// whatever the device's numbers are. A frame without touch has no row. Positions are those measured in the frame (not
/// filtered), sigmas the square roots of their covariance's diagonal. Numbers have as many digits as it takes to read
/// them back exactly; `NaN` and `inf` are written as such.
#[derive(Debug)]
pub struct TouchTable {
    path: PathBuf,
    file: Option<StagedFile>,
    forces: bool,
    load: Option<LoadQuantity>,
    summary: Summary,
}

impl TouchTable {
    /// Starts a table that will stand at `path` once finished, with columns for forces or without.
    ///
    /// # Errors
    /// [`Error::Io`] when no file can be made beside `path`.
    pub fn create(path: &Path, forces: bool) -> Result<Self, Error> {
        Self::create_with_load(path, forces, None)
    }

    /// As [`TouchTable::create`], with columns for what a calibration by pokes reads beside the place.
    ///
    /// # Errors
    /// As [`TouchTable::create`].
    pub fn create_with_load(path: &Path, forces: bool, load: Option<LoadQuantity>) -> Result<Self, Error> {
        let mut file = StagedFile::create(path)?;
        let load_head = load.map_or(String::new(), |quantity| {
            let [value, sigma] = load_names(quantity);
            format!(",{value},{sigma}")
        });
        writeln!(file, "{HEAD}{}{load_head}", if forces { FORCES } else { "" }).map_err(Error::io(path))?;
        Ok(Self { path: path.to_owned(), file: Some(file), forces, load, summary: Summary::default() })
    }
}

impl Sink for TouchTable {
    fn accept(&mut self, output: &Output<'_>) -> Result<(), Error> {
        let file = self.file.as_mut().ok_or_else(|| finished(&self.path))?;
        for touch in output.touches {
            let TouchRow { x_mm, y_mm, amplitude, area_mm2, sigma_x_mm, sigma_y_mm } = TouchRow::new(touch);
            let (frame, id) = (self.summary.frames, touch.id);
            write!(file, "{frame},{id},{x_mm},{y_mm},{amplitude},{area_mm2},{sigma_x_mm},{sigma_y_mm}")
                .and_then(|()| match touch.force.filter(|_| self.forces) {
                    Some(force) => {
                        let nearest = force.nearest_n().unwrap_or(f64::NAN);
                        write!(file, ",{nearest},{}", force.range())
                    }
                    None => write!(file, "{}", if self.forces { ",NaN,none" } else { "" }),
                })
                .and_then(|()| match (self.load, touch.load) {
                    (Some(_), Some(load)) => {
                        let [value, sigma] = load_numbers(&load);
                        writeln!(file, ",{value},{sigma}")
                    }
                    (Some(_), None) => writeln!(file, ",NaN,NaN"),
                    (None, _) => writeln!(file),
                })
                .map_err(Error::io(&self.path))?;
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

/// A frame that comes after the end.
pub(super) fn finished(path: &Path) -> Error {
    let reason = "came after the file was finished".to_owned();
    Error::Content { file: path.to_owned(), field: "frame".to_owned(), reason }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{output, touch};
    use super::*;
    use dermis_touch::TouchPhase;

    #[test]
    fn rows_carry_millimetres_and_frames_without_touch_have_none() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("t.csv");
        let mut table = TouchTable::create(&path, false).unwrap();
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
        let mut table = TouchTable::create(&path, true).unwrap();
        let mut touch = touch(1, TouchPhase::Move, 0.0, 0.0);
        touch.force = Some(dermis_touch::force::ForceReading::AboveRange { most_n: 0.5 });
        table.accept(&output(1, &[0.0; 6], &[touch], &[])).unwrap();
        table.finish().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].ends_with("sigma_y_mm,force_n,force_range") && lines[1].ends_with(",0.5,above"), "{text}");
    }

    #[test]
    fn loads_of_pokes_have_columns_of_their_own() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("t.csv");
        let mut table = TouchTable::create_with_load(&path, false, Some(LoadQuantity::DepthM)).unwrap();
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
    fn an_abandoned_table_leaves_nothing() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("t.csv");
        std::fs::write(&path, "before").unwrap();
        drop(TouchTable::create(&path, false).unwrap());
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "before");
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 1);
        assert!(TouchTable::create(directory.path(), false).is_err());
        assert!(TouchTable::create(&directory.path().join("none/t.csv"), false).is_err());
    }
}
