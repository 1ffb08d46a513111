//! Where the locator looks for touches: a lattice over the skin, with the physics' signatures there.

use dermis_touch::locator::SignatureMap;

use crate::Error;
use crate::prepare::Prepared;

/// Positions of the locator's map lie so far apart that there are about so many, but within these bounds, relative to
/// half the shorter side. On the gelatin skin 400 pokes place others 1.48, 1.31 and 1.28 mm off (median) with spacings
/// of 0.058, 0.042 and 0.027; the time for a frame grows with the number of positions.
const MAP_POSITIONS: usize = 2800;
const FINEST_SPACING: f64 = 0.025;
const MAP_SPACING: f64 = 0.04;

/// Where touches are looked for, with what they would read there by the skin file's physics, where that is wanted and
/// the wiring is known.
pub(super) fn signature_map(prepared: &Prepared, physics: bool) -> Result<SignatureMap, Error> {
    let positions = map_positions(prepared);
    if !(physics && prepared.skin.backend.wiring.is_known()) {
        return Ok(SignatureMap::without_physics(prepared.channels(), positions)?);
    }
    let signatures = prepared.signatures(&positions);
    Ok(SignatureMap::new(prepared.channels(), positions, signatures)?)
}

/// Positions for the locator's map: a square lattice within the outline.
fn map_positions(prepared: &Prepared) -> Vec<[f64; 2]> {
    let outline = &prepared.body.outline;
    let (low, high) = outline.bounds_m();
    let half_width_m = prepared.half_width_m();
    let spacing_m = (outline.area_m2() / MAP_POSITIONS as f64)
        .sqrt()
        .clamp(FINEST_SPACING * half_width_m, MAP_SPACING * half_width_m);
    let counts = [0, 1].map(|axis| ((high[axis] - low[axis]) / spacing_m).ceil().max(1.0) as usize);
    // In the middle of the bounds, so that a symmetric skin has a symmetric map.
    let at = |axis: usize, k: usize| {
        0.5 * (low[axis] + high[axis]) + (k as f64 - 0.5 * (counts[axis] - 1) as f64) * spacing_m
    };
    let lattice = (0..counts[1]).flat_map(|row| (0..counts[0]).map(move |column| (column, row)));
    lattice.map(|(column, row)| [at(0, column), at(1, row)]).filter(|place| outline.contains(*place)).collect()
}
