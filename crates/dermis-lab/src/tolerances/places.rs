//! Places to press: spread evenly over the inner 85 % of the outline, in the order of a Halton sequence.

use dermis_tomo::mesh::{Outline, Point};

use crate::Error;

/// Share of the way from rim to centre that is not pressed.
const MARGIN: f64 = 0.15;
/// Points of the sequence to examine for each place wanted.
const LOOKED_AT: usize = 400;

/// `count` places, starting from a point of the sequence, metres.
///
/// # Errors
/// The skin has hardly any interior.
pub(super) fn pressed(outline: &Outline, count: usize, from: usize) -> Result<Vec<[f64; 2]>, Error> {
    let (low, high) = outline.bounds_m();
    let at = |k: usize| {
        let share = [halton(k + 1, 2), halton(k + 1, 3)];
        [0, 1].map(|axis| low[axis] + share[axis] * (high[axis] - low[axis]))
    };
    let deepest = (0..2000).map(|k| outline.inside_by_m(at(k))).fold(0.0, f64::max);
    let inside = |place: &Point| outline.inside_by_m(*place) >= MARGIN * deepest;
    let places: Vec<Point> = (from..from + LOOKED_AT * count).map(at).filter(inside).take(count).collect();
    if places.len() < count {
        return Err(Error::Live(dermis_live::Error::Frames {
            what: "places to press".into(),
            expected: format!("{count} inside 85 % of the outline"),
            got: places.len().to_string(),
        }));
    }
    Ok(places)
}

/// The radical inverse of a number in a base.
fn halton(mut k: usize, base: usize) -> f64 {
    let (mut value, mut digit) = (0.0, 1.0);
    while k > 0 {
        digit /= base as f64;
        value += digit * (k % base) as f64;
        k /= base;
    }
    value
}
