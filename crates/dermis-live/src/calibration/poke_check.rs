//! Checks pokes before learning from them: counts, positions off the skin or in another unit, repetitions, channels
//! without information.

use std::collections::HashSet;

use dermis_tomo::mesh::Point;
use dermis_touch::locator::MIN_EXAMPLES;

use super::pokes::Pokes;
use crate::Error;
use crate::prepare::Prepared;

/// Minimum extent of pokes relative to the skin's half width; less means another unit.
const LEAST_SPREAD: f64 = 0.005;
/// A position this far out, relative to the centre, may be on the rim.
const RIM: f64 = 0.97;

/// Usable pokes.
pub(super) struct Sound {
    /// Indices of the pokes, without repetitions.
    pub rows: Vec<usize>,
    /// Number of repetitions.
    pub repeated: usize,
    /// Channels that read the same in every poke, or nothing.
    pub dead_channels: Vec<u32>,
}

/// Checks pokes against their difference data and the skin.
pub(super) fn check_pokes(prepared: &Prepared, differences: &[Vec<f64>], pokes: &Pokes) -> Result<Sound, Error> {
    let places = &pokes.positions_m;
    let refuse = |what: String, expected: String, got: String| Err(Error::Frames { what, expected, got });
    if places.len() != differences.len() {
        let expected = format!("{}, one a frame", differences.len());
        return refuse("positions of pokes".into(), expected, places.len().to_string());
    }
    if places.len() < MIN_EXAMPLES {
        return refuse("pokes".into(), format!("at least {MIN_EXAMPLES}"), places.len().to_string());
    }
    let (low, high) = prepared.body.outline.bounds_m();
    let centre = [0, 1].map(|axis| 0.5 * (low[axis] + high[axis]));
    let is_on = |p: Point| {
        let inward = [0, 1].map(|axis| centre[axis] + RIM * (p[axis] - centre[axis]));
        prepared.body.outline.contains(p) || prepared.body.outline.contains(inward)
    };
    if let Some(index) = places.iter().position(|p| !is_on(*p)) {
        let [x, y] = places[index];
        let millimetres = places.iter().all(|p| is_on(p.map(|v| 1e-3 * v)));
        let hint = if millimetres { ": all of them fit the skin if they are millimetres" } else { "" };
        let expected = format!("metres on the skin, within {low:?} to {high:?}");
        return refuse(format!("position of poke {index}"), expected, format!("({x}, {y}){hint}"));
    }
    let spread = |axis: usize| {
        let (least, most) = places
            .iter()
            .map(|p| p[axis])
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), v| (least.min(v), most.max(v)));
        most - least
    };
    let widest = spread(0).max(spread(1));
    if widest < LEAST_SPREAD * prepared.half_width_m() {
        let size = 2.0 * prepared.half_width_m();
        let expected = format!("places spread over a skin of {:.1} mm", 1e3 * size);
        return refuse(
            "positions of pokes".into(),
            expected,
            format!("{:.4} mm in all: are they metres?", 1e3 * widest),
        );
    }
    let mut seen = HashSet::with_capacity(places.len());
    let key = |i: usize| -> Vec<u64> { places[i].iter().chain(&differences[i]).map(|v| v.to_bits()).collect() };
    let rows: Vec<usize> = (0..places.len()).filter(|&i| seen.insert(key(i))).collect();
    if rows.len() < MIN_EXAMPLES {
        let got = format!("{} that differ, among {}", rows.len(), places.len());
        return refuse("pokes".into(), format!("at least {MIN_EXAMPLES}"), got);
    }
    let dead_channels: Vec<u32> = (0..prepared.channels())
        .filter(|&k| {
            let mut values = rows.iter().map(|&i| differences[i][k]).filter(|v| v.is_finite());
            values.next().is_none_or(|first| values.all(|v| v == first))
        })
        .map(|k| k as u32)
        .collect();
    if dead_channels.len() == prepared.channels() {
        let expected = "channels that tell pokes apart".to_string();
        return refuse("pokes".into(), expected, "the same frame in all of them".into());
    }
    Ok(Sound { repeated: places.len() - rows.len(), rows, dead_channels })
}
