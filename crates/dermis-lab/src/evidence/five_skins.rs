//! `five-skins`: skins of one family that differ in the pattern cast into the gel, each pressed 2,500 times by a
//! robot. Their electrode positions are not published. Every folder of the set counts as a skin, even a new one.

use std::path::{Path, PathBuf};

use dermis_skin::{FileError, Shape, Skin};

use super::bench::{Bench, Row, Stop};
use super::finding::Comparison;
use super::place_errors::{PlaceErrors, Presses, shuffled};
use crate::Error;

/// Presses to judge, if a skin has enough.
const JUDGED: usize = 500;
const FILES: [&str; 2] = ["differences.csv", "positions.csv"];
/// Skins that the repository's tests use.
const KNOWN: [&str; 2] = ["plain", "circles"];
/// Side of the square assumed as the outline, millimetres.
const SIDE_MM: f64 = 100.0;

/// Reads the presses in one skin's folder. The skin has an outline and channels, but no electrodes.
///
/// # Errors
/// The files cannot be read or don't match.
pub fn presses(folder: &Path) -> Result<Presses, Error> {
    let [differences, places] = FILES.map(|name| folder.join(name));
    let table = dermis_device::instruments::csv::read_numbers(&differences)?;
    let outline = Shape::Rectangle { width_mm: SIDE_MM, height_mm: SIDE_MM };
    let mut skin = Skin::of_channels(&name_of(folder), outline, table.columns)?;
    skin.backend.differences = true;
    Presses::read(skin, None, &differences, &places)
}

fn name_of(folder: &Path) -> String {
    folder.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

pub(super) fn measure(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let root = bench.need("")?;
    let failed = |source| Error::Live(dermis_live::Error::Io(FileError { file: root.clone(), source }));
    let mut folders: Vec<PathBuf> = KNOWN.map(|name| root.join(name)).to_vec();
    for entry in std::fs::read_dir(&root).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.is_dir() && !folders.contains(&path) {
            folders.push(path);
        }
    }
    folders[KNOWN.len()..].sort();
    for folder in folders {
        match FILES.iter().map(|name| folder.join(name)).find(|path| !path.exists()) {
            Some(path) => bench.missing.push(path),
            None => measure_skin(bench, &folder)?,
        }
    }
    Ok(())
}

fn measure_skin(bench: &mut Bench<'_>, folder: &Path) -> Result<(), Stop> {
    let (name, presses) = (name_of(folder), presses(folder)?);
    let count = presses.count();
    let judged = JUDGED.min(count / 5);
    let (draws, pokes): (u64, &[usize]) = if bench.is_quick() { (1, &[50, 400]) } else { (3, &[50, 400, 2000]) };
    for &taught in pokes.iter().filter(|taught| **taught + judged <= count) {
        let (mut here, mut plain) = (Vec::new(), Vec::new());
        for seed in 1..=draws {
            bench.say(&format!("{name}, {taught} pokes, draw {seed} of {draws}"));
            let order = shuffled(count, seed);
            let (taught, judged) = (&order[..taught], &order[count - judged..]);
            here.push(presses.judge(judged, Some(&presses.calibrate(taught)?))?);
            plain.push(presses.judge_plain(taught, judged));
        }
        bench.add(Row {
            measured: &format!("`{name}`, positions after {taught} pokes"),
            known: &format!(
                "a guessed square of {SIDE_MM} mm and these pokes; no electrodes, baseline or physics; judged on {judged} \
                 other presses in each of {draws} draws"
            ),
            here: PlaceErrors::figures(&here),
            plain: Comparison::computed("kernel ridge regression", PlaceErrors::without_sigmas(&plain)),
            published: Comparison::said("none known"),
        });
    }
    Ok(())
}
