//! Presses for a data set: read from a table, or drawn at random.

use std::collections::BTreeMap;
use std::path::Path;

use dermis_device::instruments::csv;
use dermis_tomo::mesh::Outline;
use dermis_twin::PressRange;
use dermis_twin::mechanics::{Indenter, Load, Shape};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};

use crate::Error;

/// Maximum number of presses in one request.
const MOST_PRESSES: usize = 1_000_000;
/// Random presses stay within this share of the outline about its centre.
const INSIDE_SHARE: f64 = 0.85;
/// Halve the required distance from the rim after this many misses in a row.
const MOST_MISSED: usize = 10_000;
/// Smallest distance from the rim, as a share of the shorter side.
const LEAST_MARGIN: f64 = 1e-6;

/// Reads a table of presses.
///
/// Columns are x_mm, y_mm (or x_m, y_m), either force_n or pressure_kpa, and optionally radius_mm (default: the
/// skin's usual one) and group: rows of the same group press together.
///
/// # Errors
/// The file is not such a table, or a value is missing or invalid; the message names the row.
pub fn read_presses(path: &Path, usual: &PressRange) -> Result<Vec<Vec<Indenter>>, Error> {
    let table = csv::read_numbers(path)?.in_millimetres();
    let content = |field: String, reason: String| {
        Error::Live(dermis_live::Error::Content { file: path.to_path_buf(), field, reason })
    };
    let expected =
        "expected a header with x_mm, y_mm, one of force_n and pressure_kpa, and optionally radius_mm and group";
    let Some(header) = &table.header else { return Err(content("columns".into(), expected.into())) };
    let known = ["x_mm", "y_mm", "force_n", "pressure_kpa", "radius_mm", "group"];
    if let Some(other) = header.iter().find(|name| !known.contains(&name.trim())) {
        return Err(content(format!("column {other:?}"), expected.into()));
    }
    let column = |name: &str| table.column_index(name);
    let (Some(x), Some(y)) = (column("x_mm"), column("y_mm")) else {
        return Err(content("columns".into(), expected.into()));
    };
    let load = match (column("force_n"), column("pressure_kpa")) {
        (Some(force), None) => (force, true),
        (None, Some(pressure)) => (pressure, false),
        _ => return Err(content("columns".into(), "expected one of force_n and pressure_kpa".into())),
    };
    if table.rows() > MOST_PRESSES {
        return Err(content("rows".into(), format!("{} rows; expected at most {MOST_PRESSES}", table.rows())));
    }
    let mut presses: Vec<Vec<Indenter>> = Vec::new();
    let mut groups: BTreeMap<u64, usize> = BTreeMap::new();
    for row in 0..table.rows() {
        let values = table.row(row).unwrap_or_default();
        let number = |index: usize, name: &str, low: f64, high: f64| {
            let value = values.get(index).copied().unwrap_or(f64::NAN);
            if value >= low && value <= high {
                return Ok(value);
            }
            // The header is line 1.
            let reason = format!("{value}; expected {low} to {high}");
            Err(content(format!("line {}, {name}", row + 2), reason))
        };
        let centre_m = [1e-3 * number(x, "x_mm", -1e4, 1e4)?, 1e-3 * number(y, "y_mm", -1e4, 1e4)?];
        let radius_m = match column("radius_mm") {
            Some(index) => 1e-3 * number(index, "radius_mm", 1e-2, 1e4)?,
            None => usual.initial_radius_m,
        };
        let load = match load {
            (index, true) => Load::ForceN(number(index, "force_n", 0.0, 1e6)?),
            (index, false) => Load::PressurePa(1e3 * number(index, "pressure_kpa", 0.0, 1e6)?),
        };
        let indenter = Indenter { centre_m, shape: Shape::Disc { radius_m }, load };
        match column("group") {
            Some(index) => {
                let group = number(index, "group", 0.0, 1e15)?;
                let next = presses.len();
                let place = *groups.entry(group as u64).or_insert(next);
                if place == next {
                    presses.push(Vec::new());
                }
                presses[place].push(indenter);
            }
            None => presses.push(vec![indenter]),
        }
    }
    if presses.is_empty() {
        return Err(content("rows".into(), "no press; expected at least one".into()));
    }
    Ok(presses)
}

/// Single presses at random places within 85 % of the outline, with the skin's usual radius and pressure. If the
/// outline is so thin that hardly any place is that far from its rim, places nearer to the rim are accepted.
///
/// # Errors
/// The outline has hardly any interior.
pub fn random_presses(
    outline: &Outline,
    usual: &PressRange,
    count: usize,
    seed: u64,
) -> Result<Vec<Vec<Indenter>>, Error> {
    let mut random = StdRng::seed_from_u64(seed);
    let (low, high) = outline.bounds_m();
    let middle = [0, 1].map(|axis| 0.5 * (low[axis] + high[axis]));
    let load = Load::PressurePa(usual.initial_pressure_pa);
    let shape = Shape::Disc { radius_m: usual.initial_radius_m };
    let shorter_m = (high[0] - low[0]).min(high[1] - low[1]);
    let mut margin = 0.5 * (1.0 - INSIDE_SHARE) * shorter_m;
    let mut presses = Vec::with_capacity(count);
    let mut missed = 0;
    while presses.len() < count {
        let place = [0, 1].map(|axis| random.random_range(low[axis]..=high[axis]));
        let is_in = match outline {
            // Stay away from every rim.
            Outline::Polygon { .. } => {
                let clear = |k: u32| {
                    let angle = f64::from(k) * std::f64::consts::TAU / 16.0;
                    outline.contains([place[0] + margin * angle.cos(), place[1] + margin * angle.sin()])
                };
                outline.contains(place) && (0..16).all(clear)
            }
            // Shrink the outline about its centre.
            _ => outline.contains([0, 1].map(|axis| middle[axis] + (place[axis] - middle[axis]) / INSIDE_SHARE)),
        };
        if is_in {
            presses.push(vec![Indenter { centre_m: place, shape, load }]);
            missed = 0;
            continue;
        }
        missed += 1;
        if missed == MOST_MISSED {
            (margin, missed) = (0.5 * margin, 0);
            if margin < LEAST_MARGIN * shorter_m {
                return Err(Error::Live(dermis_live::Error::Frames {
                    what: "places to press".into(),
                    expected: format!("{count} inside the outline"),
                    got: presses.len().to_string(),
                }));
            }
        }
    }
    Ok(presses)
}

#[cfg(test)]
mod tests {
    use dermis_skin::Skin;

    use super::*;

    fn usual() -> PressRange {
        let skin = Skin::open("ionic-disc").unwrap();
        dermis_twin::from_skin::press_range(&skin)
    }

    fn table(text: &str) -> Result<Vec<Vec<Indenter>>, Error> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.csv");
        std::fs::write(&path, text).unwrap();
        read_presses(&path, &usual())
    }

    #[test]
    fn rows_of_a_group_press_together() {
        let presses = table("x_mm,y_mm,force_n,group\n1,2,0.1,7\n3,4,0.2,8\n5,6,0.3,7\n").unwrap();
        assert_eq!(presses.iter().map(Vec::len).collect::<Vec<_>>(), [2, 1]);
        assert_eq!(presses[0][1].centre_m, [5e-3, 6e-3]);
        assert_eq!(table("x_mm,y_mm,pressure_kpa\n1,2,3\n1,2,3\n").unwrap().len(), 2);
    }

    #[test]
    fn bad_tables_are_refused_with_line_and_column() {
        for (text, says) in [
            ("x_mm,y_mm\n1,2\n", "one of force_n and pressure_kpa"),
            ("x_mm,y_mm,force_n,pressure_kpa\n1,2,3,4\n", "one of force_n and pressure_kpa"),
            ("x,y,force_n\n1,2,3\n", "column \"x\""),
            ("x_mm,y_mm,force_n\n1,2,-3\n", "line 2, force_n: -3"),
            ("x_mm,y_mm,force_n,radius_mm\n1,2,3,0\n", "line 2, radius_mm: 0"),
        ] {
            let error = table(text).unwrap_err().to_string();
            assert!(error.contains(says), "{text:?}: {error}");
        }
    }

    #[test]
    fn thin_outlines_are_pressed_nearer_to_their_rim() {
        // A strip across the square: 0.5 % of its area, and nowhere further than 0.25 mm from a rim.
        let outer = vec![[-0.05, -0.05], [-0.0493, -0.05], [0.05, 0.05], [0.0493, 0.05]];
        let strip = Outline::Polygon { outer, holes: Vec::new() };
        let presses = random_presses(&strip, &usual(), 5, 1).unwrap();
        assert!(presses.len() == 5 && presses.iter().all(|press| strip.contains(press[0].centre_m)));
        let none = Outline::Polygon { outer: vec![[0.0, 0.0], [0.1, 0.1], [0.1, 0.1 + 1e-12]], holes: Vec::new() };
        let refused = random_presses(&none, &usual(), 5, 1).unwrap_err().to_string();
        assert!(refused.contains("places to press: expected 5 inside the outline, got"), "{refused}");
    }
}
