//! Positions at which the locator searches for touches: a lattice over the skin, with the signatures of physics
//! there.

use dermis_tomo::mesh::Point;
use dermis_touch::locator::SignatureMap;

use crate::Error;
use crate::prepare::Prepared;

/// Target number of map positions, and bounds on their spacing relative to half the shorter side. On the gelatin
/// skin, 400 pokes locate others to 1.48, 1.31 and 1.28 mm (median) with spacings of 0.058, 0.042 and 0.027. The time
/// per frame grows with the number of positions.
const MAP_POSITIONS: usize = 2800;
const FINEST_SPACING: f64 = 0.025;
const MAP_SPACING: f64 = 0.04;

/// Positions at which touches are searched for, with the readings that the skin file's physics predicts there, if
/// wanted and the wiring is known.
pub(super) fn signature_map(prepared: &Prepared, physics: bool) -> Result<SignatureMap, Error> {
    let positions = map_positions(prepared);
    if !(physics && prepared.skin.backend.wiring.is_known()) {
        return Ok(SignatureMap::without_physics(prepared.channels(), positions)?);
    }
    let signatures = prepared.signatures(&positions);
    Ok(SignatureMap::new(prepared.channels(), positions, signatures)?)
}

/// Positions for the locator's map: a square lattice within the outline.
fn map_positions(prepared: &Prepared) -> Vec<Point> {
    let outline = &prepared.body.outline;
    let (low, high) = outline.bounds_m();
    let half_width_m = prepared.half_width_m();
    let spacing_m = (outline.area_m2() / MAP_POSITIONS as f64)
        .sqrt()
        .clamp(FINEST_SPACING * half_width_m, MAP_SPACING * half_width_m);
    let counts = [0, 1].map(|axis| ((high[axis] - low[axis]) / spacing_m).ceil().max(1.0) as usize);
    // Centred within the bounds, so that a symmetric skin has a symmetric map.
    let at = |axis: usize, k: usize| {
        0.5 * (low[axis] + high[axis]) + (k as f64 - 0.5 * (counts[axis] - 1) as f64) * spacing_m
    };
    let lattice = (0..counts[1]).flat_map(|row| (0..counts[0]).map(move |column| (column, row)));
    lattice.map(|(column, row)| [at(0, column), at(1, row)]).filter(|place| outline.contains(*place)).collect()
}
