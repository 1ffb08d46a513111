//! Places electrodes with manufacturing errors. Every electrode stays on the sheet and keeps at least a fifth of the
//! drawn gap to its neighbours, since the builder would notice anything worse.

use dermis_tomo::mesh::{ElectrodeShape, Outline, Point, to_segment};

use super::Dice;

/// Minimum share of a gap to keep.
const LEAST_GAP: f64 = 0.2;
/// Attempts before an electrode is put at its nominal place.
const DRAWS: usize = 20;
/// A pad drawn up to the rim still ends there, unless it is off by more than this share of its width. Any less, and
/// no sheet shows beyond it.
const AT_RIM: f64 = 0.05;

/// Electrodes with errors of these standard deviations, in metres and relative.
pub fn built_electrodes(
    outline: &Outline,
    drawn: &[ElectrodeShape],
    place_m: f64,
    width: f64,
    dice: [&mut Dice; 2],
) -> Vec<ElectrodeShape> {
    let [places, widths] = dice;
    let mut built = drawn.to_vec();
    for (index, shape) in drawn.iter().enumerate() {
        for _ in 0..DRAWS {
            let along = [place_m * places.normal(), place_m * places.normal()];
            let moved = moved(outline, shape, along, (1.0 + width * widths.normal()).max(0.1));
            let apart = (0..drawn.len()).filter(|other| *other != index).all(|other| {
                let room = LEAST_GAP * gap(outline, shape, &drawn[other]).max(0.0);
                gap(outline, &moved, &built[other]) >= room - 1e-12
            });
            let room = LEAST_GAP * clearance(outline, shape).max(0.0);
            if apart && clearance(outline, &moved) >= room - 1e-9 {
                built[index] = moved;
                break;
            }
        }
    }
    built
}

fn moved(outline: &Outline, shape: &ElectrodeShape, [along, up]: [f64; 2], factor: f64) -> ElectrodeShape {
    match *shape {
        ElectrodeShape::RimArc { centre_rad, width_m } => {
            let radius_m = outline.perimeter_m() / std::f64::consts::TAU;
            ElectrodeShape::RimArc { centre_rad: centre_rad + along / radius_m, width_m: factor * width_m }
        }
        ElectrodeShape::RimSegment { centre_m, width_m } => {
            ElectrodeShape::RimSegment { centre_m: centre_m + along, width_m: factor * width_m }
        }
        ElectrodeShape::RimPoint { position_m } => ElectrodeShape::RimPoint { position_m: position_m + along },
        ElectrodeShape::Point { position_m: [x, y] } => ElectrodeShape::Point { position_m: [x + along, y + up] },
        ElectrodeShape::PadCircle { centre_m: [x, y], radius_m } => {
            ElectrodeShape::PadCircle { centre_m: [x + along, y + up], radius_m: factor * radius_m }
        }
        ElectrodeShape::PadRectangle { centre_m, width_m, height_m, angle_rad } => {
            let (low, high) = outline.bounds_m();
            let centre = |axis: usize, side_m: f64, error_m: f64| {
                let (half, new) = (0.5 * side_m, 0.5 * factor * side_m);
                let inward = if error_m.abs() < AT_RIM * side_m { 0.0 } else { error_m.abs() };
                let at_rim = |gap_m: f64| angle_rad == 0.0 && gap_m.abs() < 1e-9;
                match centre_m[axis] {
                    c if at_rim(c - half - low[axis]) => low[axis] + new + inward,
                    c if at_rim(high[axis] - c - half) => high[axis] - new - inward,
                    c => c + error_m,
                }
            };
            ElectrodeShape::PadRectangle {
                centre_m: [centre(0, width_m, along), centre(1, height_m, up)],
                width_m: factor * width_m,
                height_m: factor * height_m,
                angle_rad,
            }
        }
    }
}

/// Width of sheet between two electrodes, metres; negative if they overlap.
fn gap(outline: &Outline, a: &ElectrodeShape, b: &ElectrodeShape) -> f64 {
    if let (Some((s, half)), Some((t, other))) = (a.on_rim(outline), b.on_rim(outline)) {
        let perimeter = outline.perimeter_m();
        let apart = (s - t).rem_euclid(perimeter);
        return apart.min(perimeter - apart) - half - other;
    }
    match (a.pad_box(), b.pad_box()) {
        (Some((p, half)), Some((q, other))) => {
            let along = |axis: usize| (p[axis] - q[axis]).abs() - half[axis] - other[axis];
            along(0).max(along(1))
        }
        _ => f64::INFINITY,
    }
}

/// Width of sheet between a pad and the rim, metres; negative if it crosses the rim.
fn clearance(outline: &Outline, shape: &ElectrodeShape) -> f64 {
    let Some((centre, half)) = shape.pad_box() else { return f64::INFINITY };
    if let ElectrodeShape::PadCircle { radius_m, .. } = shape {
        return to_rim(outline, centre) - radius_m;
    }
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    corners
        .map(|[a, b]| to_rim(outline, [centre[0] + a * half[0], centre[1] + b * half[1]]))
        .into_iter()
        .fold(f64::INFINITY, f64::min)
}

/// Distance to the nearest rim, including holes, metres; negative off the sheet.
fn to_rim(outline: &Outline, p: Point) -> f64 {
    match outline {
        Outline::Disc { radius_m } => radius_m - p[0].hypot(p[1]),
        Outline::Rectangle { width_m, height_m } => (0.5 * width_m - p[0].abs()).min(0.5 * height_m - p[1].abs()),
        Outline::Polygon { outer, holes } => {
            let rings = std::iter::once(outer).chain(holes);
            let edges = rings.flat_map(|ring| (0..ring.len()).map(move |k| [ring[k], ring[(k + 1) % ring.len()]]));
            let distance = edges.map(|[a, b]| to_segment(p, a, b).0).fold(f64::INFINITY, f64::min);
            if outline.contains(p) { distance } else { -distance }
        }
    }
}
