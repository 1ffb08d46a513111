//! TEAM Workshop Problem 7, an asymmetrical conductor with a hole (Fujiwara and Nakata, COMPEL 9, 1990, 137): prints the flux
//! density along the measured lines. `cargo run --release -p dermis-tomo --example team7 -- --frequency 50`.

use dermis_tomo::mit::edge::{EdgeMesh, EdgeModel, Material, Order};
use dermis_tomo::mit::{MU0, Segment};

type Vector = [f64; 3];

/// Middle of the coil, metres.
const COIL: [f64; 2] = [0.194, 0.100];
/// Middle of the plate: the mesh's origin, metres.
const MIDDLE: Vector = [0.147, 0.147, 0.0095];
/// Ampere-turns.
const AMPERE_TURNS: f64 = 2742.0;
/// Filaments across the winding and along its height, chords of a corner.
const ACROSS: usize = 5;
const HIGH: usize = 12;
const CHORDS: usize = 8;

/// The racetrack winding as straight filaments that carry its share of the current, counter-clockwise seen from above.
fn winding() -> (Vec<Segment>, f64) {
    let mut all = Vec::new();
    for (i, k) in (0..ACROSS).flat_map(|i| (0..HIGH).map(move |k| (i, k))) {
        let radius = 0.025 + 0.025 * (i as f64 + 0.5) / ACROSS as f64;
        let z = 0.049 + 0.1 * (k as f64 + 0.5) / HIGH as f64;
        // Chords of a corner that hold the arc's area.
        let angle = std::f64::consts::FRAC_PI_2 / CHORDS as f64;
        let swell = (angle / angle.sin()).sqrt();
        let mut points = Vec::new();
        for (quarter, [sx, sy]) in [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]].into_iter().enumerate() {
            for chord in 0..=CHORDS {
                let (s, c) = (std::f64::consts::FRAC_PI_2 * quarter as f64 + angle * chord as f64).sin_cos();
                let r = if chord == 0 || chord == CHORDS { radius } else { swell * radius };
                points.push([
                    COIL[0] + 0.05 * sx + r * c - MIDDLE[0],
                    COIL[1] + 0.05 * sy + r * s - MIDDLE[1],
                    z - MIDDLE[2],
                ]);
            }
        }
        let count = points.len();
        all.extend((0..count).map(|k| Segment { from_m: points[k], to_m: points[(k + 1) % count] }));
    }
    (all, AMPERE_TURNS / (ACROSS * HIGH) as f64)
}

/// Edges of the mesh along one axis: the plate's, finer where asked for, and air.
fn axis(inside: &[f64], middle: f64, beyond: &[f64]) -> Vec<f64> {
    let (first, last) = (inside[0], inside[inside.len() - 1]);
    let below = beyond.iter().rev().map(|b| first - b);
    below.chain(inside.iter().copied()).chain(beyond.iter().map(|b| last + b)).map(|v| 1e-3 * v - middle).collect()
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let frequency: f64 = match arguments.as_slice() {
        [] => 50.0,
        [name, value] if name == "--frequency" => value.parse()?,
        _ => return Err("expected --frequency HERTZ".into()),
    };
    let beyond = [18.0, 50.0, 110.0, 240.0];
    let plate = [
        0.0, 9.0, 18.0, 36.0, 54.0, 72.0, 90.0, 108.0, 117.0, 126.0, 135.0, 150.0, 171.0, 192.0, 216.0, 240.0, 262.0,
        282.0, 294.0,
    ];
    let (x, y) = (axis(&plate, MIDDLE[0], &beyond), axis(&plate, MIDDLE[1], &beyond));
    let z = axis(&[0.0, 4.0, 9.5, 15.0, 19.0], MIDDLE[2], &[10.0, 30.0, 80.0, 200.0]);
    let in_plate = |[x, y]: [f64; 2], z: f64| {
        let (x, y, z) = (x + MIDDLE[0], y + MIDDLE[1], z + MIDDLE[2]);
        let within = |v: f64, low: f64, high: f64| v > low && v < high;
        let hole = within(x, 0.018, 0.126) && within(y, 0.018, 0.126);
        within(x, 0.0, 0.294) && within(y, 0.0, 0.294) && within(z, 0.0, 0.019) && !hole
    };
    let mesh = EdgeMesh::grid(&x, &y, &z, in_plate, 0.21)?;
    let material = Material { conductivity_s_per_m: 3.526e7, relative_permeability: 1.0 };
    let model = EdgeModel::new(mesh, material, frequency, Order::SecondWithin(0.0))?;
    eprintln!("{} unknowns, factor of {:.0} MB", model.unknowns(), model.factor_bytes() as f64 / 1e6);
    let (segments, current) = winding();
    let sum = |of: &dyn Fn(&Segment) -> Vector| {
        segments.iter().fold([0.0; 3], |s, segment| {
            let v = of(segment);
            [s[0] + current * v[0], s[1] + current * v[1], s[2] + current * v[2]]
        })
    };
    // The plate is not magnetic: the coil's flux density in it is not asked for.
    let source = |p: Vector| (sum(&|segment| segment.vector_potential(p)), [0.0; 3]);
    let currents = model.currents(&source)?;
    println!("x_mm,Bz_A1B1_re,Bz_A1B1_im,Bz_A2B2_re,Bz_A2B2_im");
    for step in 0..=16 {
        let x_mm = 18.0 * f64::from(step);
        print!("{x_mm}");
        for y_mm in [72.0, 144.0] {
            let p = [1e-3 * x_mm - MIDDLE[0], 1e-3 * y_mm - MIDDLE[1], 0.034 - MIDDLE[2]];
            let (mut re, mut im) = (sum(&|segment| segment.flux_density(p))[2], 0.0);
            for (place, volume, density) in &currents {
                let r = [p[0] - place[0], p[1] - place[1], p[2] - place[2]];
                let factor =
                    MU0 / (4.0 * std::f64::consts::PI) * volume / (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]).powf(1.5);
                let turned = density[0] * r[1] - density[1] * r[0];
                re += factor * turned.re;
                im += factor * turned.im;
            }
            print!(",{:.4},{:.4}", 1e4 * re, 1e4 * im);
        }
        println!();
    }
    Ok(())
}
