//! TEAM Workshop Problem 7 (Fujiwara and Nakata, COMPEL 9, 1990): a racetrack coil over an aluminium plate with an
//! off-centre hole. Lengths are those of the problem sheet in millimetres, with the origin at the plate's corner.

use dermis_mit::edge::{Dipole, EddySystem, EdgeMesh, Material, Order, Source, Wires, box_mesh};
use dermis_mit::{MitError, Segment};
use dermis_tomo::mesh::Point;

/// Places along the measured lines, mm.
pub const X_MM: [f64; 17] =
    [0.0, 18.0, 36.0, 54.0, 72.0, 90.0, 108.0, 126.0, 144.0, 162.0, 180.0, 198.0, 216.0, 234.0, 252.0, 270.0, 288.0];
/// y of the lines A1-B1 and A2-B2, mm.
const LINES_Y_MM: [f64; 2] = [72.0, 144.0];
/// z of both lines, mm.
const LINES_Z_MM: f64 = 34.0;
const AMPERE_TURNS: f64 = 2742.0;
const CONDUCTIVITY_S_PER_M: f64 = 3.526e7;

/// Nodes and weights of Gauss quadrature on [0, 1].
fn gauss(count: usize) -> Vec<(f64, f64)> {
    let legendre = |x: f64| {
        let (mut before, mut value) = (1.0, x);
        for n in 2..=count {
            let n = n as f64;
            (before, value) = (value, ((2.0 * n - 1.0) * x * value - (n - 1.0) * before) / n);
        }
        (value, count as f64 * (x * value - before) / (x * x - 1.0))
    };
    let node = |k: usize| {
        let mut x = (std::f64::consts::PI * (k as f64 + 0.75) / (count as f64 + 0.5)).cos();
        for _ in 0..20 {
            let (value, slope) = legendre(x);
            x -= value / slope;
        }
        let slope = legendre(x).1;
        (0.5 * (1.0 - x), 1.0 / ((1.0 - x * x) * slope * slope))
    };
    (0..count).map(node).collect()
}

/// The coil as closed polygons: `across` by `along` of them over its section, and `bend` segments in each corner,
/// scaled to the arc's length.
pub fn coil(across: usize, along: usize, bend: usize) -> Wires {
    let mut wires = Vec::new();
    for (t, t_weight) in gauss(across) {
        for (h, h_weight) in gauss(along) {
            let z_m = 1e-3 * (49.0 + 100.0 * h);
            let points = racetrack(1e-3 * (25.0 + 25.0 * t), bend);
            for (k, [x, y]) in points.iter().enumerate() {
                let [to_x, to_y] = points[(k + 1) % points.len()];
                let segment = Segment { from_m: [*x, *y, z_m], to_m: [to_x, to_y, z_m] };
                wires.push((segment, AMPERE_TURNS * t_weight * h_weight));
            }
        }
    }
    Wires(wires)
}

/// A counter-clockwise racetrack. Its corners are arcs about points 50 mm from the centre in x and y.
fn racetrack(radius_m: f64, bend: usize) -> Vec<Point> {
    let quarter = std::f64::consts::FRAC_PI_2;
    let step = quarter / bend as f64;
    // Inner points lie outside the arc by as much as the chords would cut off.
    let out = (0.5 * step) / (0.5 * step).sin();
    let mut points = Vec::new();
    for (corner, [x, y]) in [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]].into_iter().enumerate() {
        for k in 0..=bend {
            let r = if k == 0 || k == bend { radius_m } else { radius_m * out };
            let (sine, cosine) = (corner as f64 * quarter + k as f64 * step).sin_cos();
            points.push([0.194 + 0.05 * x + r * cosine, 0.1 + 0.05 * y + r * sine]);
        }
    }
    points
}

/// The plate in air, with every interval between the planes divided into `fine` cells; 0 gives a coarser mesh for a
/// quick look.
///
/// # Errors
/// Never for these planes.
pub fn mesh(fine: usize) -> Result<EdgeMesh, MitError> {
    let divided = |marks: &[f64], parts: usize| {
        let parts = parts.max(1);
        let mut all = vec![marks[0]];
        for pair in marks.windows(2) {
            all.extend((1..=parts).map(|k| 1e-3 * (pair[0] + (pair[1] - pair[0]) * k as f64 / parts as f64)));
        }
        all[0] *= 1e-3;
        all
    };
    let mut flat = divided(&[-800.0, -250.0, -60.0, 0.0], fine);
    let plate: &[f64] = if fine == 0 {
        &[0.0, 18.0, 48.0, 96.0, 126.0, 180.0, 240.0, 279.0, 294.0]
    } else {
        &[0.0, 18.0, 42.0, 72.0, 102.0, 126.0, 150.0, 186.0, 222.0, 255.0, 279.0, 294.0]
    };
    flat.extend(divided(plate, fine).into_iter().skip(1));
    flat.extend(divided(&[294.0, 354.0, 544.0, 1094.0], fine).into_iter().skip(1));
    let z = divided(&[-700.0, -200.0, -45.0, 0.0, 9.5, 19.0, 64.0, 220.0, 720.0], fine);
    box_mesh(&[flat.clone(), flat, z], |[x, y, z]| {
        let within = |v: f64, low: f64, high: f64| v > low && v < high;
        let plate = within(x, 0.0, 0.294) && within(y, 0.0, 0.294) && within(z, 0.0, 0.019);
        u8::from(plate && !(within(x, 0.018, 0.126) && within(y, 0.018, 0.126)))
    })
}

/// Bz in 1e-4 T on the two lines, per place: phases 0 and 90 degrees of the first line, then of the second. Phase 90
/// is a quarter of a period later: minus the imaginary part under `e^{j w t}`.
///
/// # Errors
/// The frequency is invalid.
pub fn flux_density(mesh: &EdgeMesh, frequency_hz: f64) -> Result<Vec<[f64; 4]>, MitError> {
    let plate = Material { conductivity_s_per_m: CONDUCTIVITY_S_PER_M, relative_permeability: 1.0 };
    let system = EddySystem::new(mesh, &[plate], frequency_hz, Order::Second)?;
    for warning in system.info().warnings {
        tracing::warn!("{warning}");
    }
    let wires = coil(3, 5, 4);
    let fields = system.solve(&[&wires])?;
    let source = coil(6, 16, 8);
    let at = |x: f64, y: f64| {
        let p = [1e-3 * x, 1e-3 * y, 1e-3 * LINES_Z_MM];
        let upward = Dipole { position_m: p, moment: [0.0, 0.0, 1.0] };
        let added = fields.linked(0, &upward).map_or([0.0; 2], |b| [b.re, b.im]);
        [1e4 * (source.flux_density(p)[2] + added[0]), -1e4 * added[1]]
    };
    Ok(X_MM
        .iter()
        .map(|&x| {
            let [first, second] = LINES_Y_MM.map(|y| at(x, y));
            [first[0], first[1], second[0], second[1]]
        })
        .collect())
}
