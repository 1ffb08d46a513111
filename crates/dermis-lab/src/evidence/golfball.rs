//! `golfball`: balls in a 30 cm saline tank (EIDORS sample data).

use dermis_skin::Skin;
use dermis_tomo::mesh::Point;

use super::bench::{Bench, Row, Stop};
use super::finding::{Comparison, Figure};
use super::imaged::{Imaged, chosen, imaged};
use crate::Error;

/// Frames of the file with the positions of their balls, millimetres, measured with a ruler.
pub const SETUPS: [(&str, &[[f64; 2]]); 3] =
    [("setup2", &[[0.0, 0.0]]), ("setup3", &[[0.0, 70.0]]), ("setup4", &[[0.0, 70.0], [-70.0, 0.0]])];

/// Images one frame of the file against its reference.
///
/// # Errors
/// The file cannot be read or doesn't fit.
pub fn setup(file: &std::path::Path, frame: &str) -> Result<Imaged, Error> {
    imaged(Skin::open("golfball-tank")?, Some(chosen(file, "ref")?), chosen(file, frame)?, None)
}

/// Distance from a place to the nearest touch, millimetres; infinite without touches.
pub fn error_mm(found: &Imaged, place_mm: Point) -> f64 {
    found.touches.iter().map(|touch| touch.distance_mm(place_mm)).fold(f64::INFINITY, f64::min)
}

pub(super) fn measure(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let file = bench.need("phantom_A.csv")?;
    let (mut here, mut extra, mut balls) = (Vec::new(), 0, 0);
    for (frame, places) in SETUPS {
        bench.say(frame);
        let found = setup(&file, frame)?;
        let several = places.len() > 1;
        for place in places {
            let name = format!("{}ball at ({}, {})", if several { "of two, " } else { "" }, place[0], place[1]);
            here.push(Figure::new(&name, error_mm(&found, *place), "mm"));
        }
        balls += places.len();
        extra += found.touches.len().saturating_sub(places.len());
    }
    here.push(Figure::new("false touches", extra as f64, ""));
    here.last_mut().into_iter().for_each(|figure| figure.unit = format!("with {balls} balls"));
    bench.add(Row {
        measured: "distance from the balls' positions, measured by ruler, mm",
        known: "diameter of the tank, positions of the electrodes, protocol, one frame without balls",
        here,
        plain: Comparison::said("one linear step with a NOSER prior, computed elsewhere: 5 to 9, 15 to 17 and 23 mm"),
        published: Comparison::said("none: sample data"),
    });
    Ok(())
}
