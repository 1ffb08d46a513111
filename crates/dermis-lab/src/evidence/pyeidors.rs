//! `pyeidors-tank`: metal and plastic objects near the electrodes that the folder names state (PyEIDORS sample data).

use std::path::{Path, PathBuf};

use dermis_skin::{FileError, Skin};

use super::bench::{Bench, Row, Stop};
use super::finding::{Comparison, Figure};
use super::imaged::{Imaged, chosen, imaged};
use crate::Error;

/// Angle between electrodes, degrees.
const PITCH_DEG: f64 = 22.5;

/// An object at an electrode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Object {
    /// Electrode from 1 to 17, possibly fractional.
    pub electrode: f64,
    /// 1 for metal, -1 for plastic.
    pub sign: f64,
}

impl Object {
    /// Signed distance from an electrode, in electrode pitches.
    pub fn pitches_from(&self, electrode: f64) -> f64 {
        (self.electrode - electrode + 8.0).rem_euclid(16.0) - 8.0
    }
}

/// Objects from a folder's name, which has parts such as `electrode05_plastic`.
///
/// # Errors
/// The name has another form.
pub fn objects(folder: &Path) -> Result<Vec<Object>, Error> {
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let words: Vec<&str> = name.split('_').collect();
    let object = |pair: &[&str]| -> Option<Object> {
        let [electrode, material] = pair else { return None };
        let electrode: f64 = electrode.strip_prefix("electrode")?.parse().ok()?;
        let sign = match *material {
            "metal" => 1.0,
            "plastic" => -1.0,
            _ => return None,
        };
        (1.0..=16.0).contains(&electrode).then_some(Object { electrode, sign })
    };
    words.chunks(2).map(object).collect::<Option<_>>().ok_or_else(|| {
        Error::Live(dermis_live::Error::Content {
            file: folder.into(),
            field: "name".into(),
            reason: "expected electrodeNN_metal or electrodeNN_plastic, joined by underscores".into(),
        })
    })
}

/// Images the target of a file against its reference.
///
/// # Errors
/// The file cannot be read or doesn't fit.
pub fn target(file: &Path) -> Result<Imaged, Error> {
    imaged(Skin::open("pyeidors-tank")?, Some(chosen(file, "reference")?), chosen(file, "target")?, None)
}

/// The touches in a target as objects. Electrodes count counter-clockwise from the top; the skin is a 200 mm disc.
pub fn found(target: &Imaged) -> Vec<Object> {
    let object = |touch: &super::imaged::TouchRow| {
        let [x, y] = touch.at_mm;
        let electrode = (y.atan2(x).to_degrees() - 90.0).rem_euclid(360.0) / PITCH_DEG + 1.0;
        Object { electrode, sign: target.images.at(0, x / 100.0, y / 100.0).signum() }
    };
    target.touches.iter().map(object).collect()
}

/// The folders with their files, in the order of their names.
///
/// # Errors
/// A folder cannot be read.
pub fn files(root: &Path) -> Result<Vec<(PathBuf, PathBuf)>, Error> {
    let listed = |folder: &Path| -> Result<Vec<PathBuf>, Error> {
        let failed = |source| Error::Live(dermis_live::Error::Io(FileError { file: folder.into(), source }));
        let mut paths = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(failed)? {
            paths.push(entry.map_err(failed)?.path());
        }
        paths.sort();
        Ok(paths)
    };
    let mut files = Vec::new();
    for folder in listed(root)?.into_iter().filter(|path| path.is_dir()) {
        let inside = listed(&folder)?.into_iter().filter(|path| path.extension().is_some_and(|end| end == "csv"));
        files.extend(inside.map(|file| (folder.clone(), file)));
    }
    Ok(files)
}

pub(super) fn measure(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let root = bench.need("")?;
    let files = files(&root)?;
    if files.is_empty() {
        return Err(Stop::Missing(root.join("electrode01_metal")));
    }
    let (mut all, mut right, mut touches, mut largest): (usize, usize, usize, f64) = (0, 0, 0, 0.0);
    for (folder, file) in &files {
        bench.say(&file.file_name().unwrap_or_default().to_string_lossy());
        let expected = objects(folder)?;
        let found = found(&target(file)?);
        for object in &expected {
            let of_sign = found.iter().filter(|other| other.sign == object.sign);
            let nearest = of_sign.map(|other| other.pitches_from(object.electrode).abs()).fold(f64::INFINITY, f64::min);
            all += 1;
            if nearest <= 0.5 {
                right += 1;
                largest = largest.max(nearest);
            }
        }
        touches += found.len();
    }
    bench.add(Row {
        measured: &format!("direction and sign of the objects in {} files", files.len()),
        known: "electrodes, protocol, one frame without objects; that instruments may add an offset",
        here: vec![
            Figure::count("right sign within half a pitch", right, all),
            Figure::new("largest angular error of these", PITCH_DEG * largest, "deg"),
            Figure::new("false touches", touches.saturating_sub(right) as f64, "in all"),
        ],
        plain: Comparison::said("none computed"),
        published: Comparison::said("none: sample data"),
    });
    Ok(())
}
