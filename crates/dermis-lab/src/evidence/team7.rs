//! `team7`: TEAM Workshop Problem 7, the measured flux density over a plate with a hole under a racetrack coil.
//! Current densities are not compared, because the solver determines the potential only up to a gradient.

mod problem;

use std::path::Path;

use super::bench::{Bench, Row, Stop};
use super::finding::{Comparison, Figure};
use crate::Error;

pub use problem::{X_MM, coil, flux_density, mesh};

const FLUX: &str = "team7_Bz_gauss_50hz.csv";
const FREQUENCY_HZ: f64 = 50.0;

/// Measured values of a table: one row per x, with two lines at phases 0 and 90 degrees.
///
/// # Errors
/// The file is not a table with five numbers per row at the places of [`X_MM`].
pub fn measured(file: &Path) -> Result<Vec<[f64; 4]>, Error> {
    let table = dermis_device::instruments::csv::read_numbers(file)?;
    let rows: Vec<&[f64]> = (0..table.rows()).filter_map(|row| table.row(row)).collect();
    let fits = rows.len() == X_MM.len()
        && rows.iter().zip(&X_MM).all(|(row, x)| row.len() == 5 && row[0] == *x && row.iter().all(|v| v.is_finite()));
    if !fits {
        let reason = format!("expected x_mm and four numbers in {} rows, x_mm as on the problem sheet", X_MM.len());
        return Err(Error::Live(dermis_live::Error::Content { file: file.into(), field: "rows".into(), reason }));
    }
    Ok(rows.iter().map(|row| [row[1], row[2], row[3], row[4]]).collect())
}

/// Root mean square deviations at phases 0 and 90 degrees, over both lines.
pub fn deviations(found: &[[f64; 4]], measured: &[[f64; 4]]) -> [f64; 2] {
    let mut squares = [0.0; 2];
    for (found, measured) in found.iter().zip(measured) {
        (0..4).for_each(|k| squares[k % 2] += (found[k] - measured[k]).powi(2));
    }
    squares.map(|sum: f64| (sum / (2 * measured.len()) as f64).sqrt())
}

pub(super) fn measure(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let measured = measured(&bench.need(FLUX)?)?;
    bench.say("edge elements");
    let found = flux_density(&mesh(usize::from(!bench.is_quick()))?, FREQUENCY_HZ)?;
    let [rms, zero] = [&found, &vec![[0.0; 4]; measured.len()]].map(|found| deviations(found, &measured));
    let figures = |[first, second]: [f64; 2]| {
        vec![Figure::new("rms at phase 0", first, "1e-4 T"), Figure::new("rms at phase 90", second, "1e-4 T")]
    };
    let mut here = figures(rms);
    let peak = measured.iter().flatten().fold(0.0, |most: f64, value| most.max(value.abs()));
    here.push(Figure::new("measured peak", peak, "1e-4 T"));
    bench.add(Row {
        measured: "deviation of the flux density Bz over the plate, at 34 points",
        known: "geometry, conductivity, ampere-turns and frequency of the problem sheet; nothing else",
        here,
        plain: Comparison::computed("zero everywhere", figures(zero)),
        published: Comparison::said("a third-order computation by others: 1.1 to 1.2 and 0.3 (1e-4 T)"),
    });
    Ok(())
}
