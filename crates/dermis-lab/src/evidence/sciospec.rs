//! `sciospec`: a cup is lowered into a tank, moved once around it by hand and taken out again, recorded in an
//! instrument's own files.

use std::path::Path;

use dermis_skin::Skin;

use super::bench::{Bench, Row, Stop};
use super::finding::{Comparison, Figure};
use super::imaged::{Imaged, chosen, imaged};
use crate::Error;

/// Number of frames known to be without the cup.
const EMPTY: usize = 55;
/// Stated frame at which the cup enters, counted from 0, within two frames.
const ENTERS: f64 = 60.0;
/// Threshold of the plain detector, as a multiple of the change in the empty tank.
const PLAIN_FACTOR: f64 = 5.0;

/// Images all frames of a run against the first ones, which are empty.
///
/// # Errors
/// The files cannot be read or don't fit.
pub fn run(folder: &Path) -> Result<Imaged, Error> {
    let empty = chosen(folder, &format!("0..{EMPTY}"))?;
    imaged(Skin::open("sciospec-tank")?, Some(empty), chosen(folder, "")?, None)
}

/// Largest movement of the cup between two frames, millimetres.
pub fn largest_step_mm(found: &Imaged) -> f64 {
    found.touches.windows(2).map(|pair| pair[1].distance_mm(pair[0].at_mm)).fold(0.0, f64::max)
}

pub(super) fn measure(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let folder = bench.need("run1/setup")?;
    bench.say("run1");
    let found = run(&folder)?;
    let mut here = Vec::new();
    if let (Some(first), Some(last)) = (found.touches.first(), found.touches.last()) {
        let mut identities: Vec<u64> = found.touches.iter().map(|touch| touch.id).collect();
        identities.sort_unstable();
        identities.dedup();
        here.push(Figure::new("first seen in frame", first.frame as f64, "(from 0)"));
        here.push(Figure::new("delay after the documented entry", first.frame as f64 - ENTERS, "frames"));
        here.push(Figure::new("last seen in frame", last.frame as f64, "(from 0)"));
        here.push(Figure::new("identities", identities.len() as f64, "for one cup"));
        here.push(Figure::new("largest step", largest_step_mm(&found), "mm"));
    } else {
        here.push(Figure::new("frames with a touch", 0.0, "in all"));
    }
    here.push(Figure::new("correlation of the baseline with the model", found.report.order.correlation, ""));
    let usual = found.change.iter().take(EMPTY).sum::<f64>() / EMPTY as f64;
    let fired = found.change.iter().position(|change| *change > PLAIN_FACTOR * usual).map_or(f64::NAN, |at| at as f64);
    bench.add(Row {
        measured: &format!("a cup enters a tank, {} frames", found.report.frames),
        known: "electrodes, protocol, that the first 55 frames are empty; not where the cup is",
        here,
        plain: Comparison::computed(
            "change of the frame above five times that of the empty tank",
            vec![Figure::new("fires in frame", fired, "(from 0)")],
        ),
        published: Comparison::said("none: sample data, with the cup at frame 60 ± 2"),
    });
    Ok(())
}
