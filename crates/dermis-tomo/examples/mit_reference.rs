//! Edge elements against values of independent solvers, for the aluminium cylinder of 10 mm by 10 mm:
//! `cargo run --release -p dermis-tomo --example mit_reference [AROUND INSIDE_MM GROWTH BORDER_MM]`.

use std::time::Instant;

use dermis_tomo::mit::edge::{EdgeMesh, EdgeModel, Fineness, Material, Order};
use dermis_tomo::mit::{Complex, HARMONICS, MU0};

/// Polarisability along the axis by an axisymmetric method of fifth order, m^3.
const ALONG: [(f64, f64, f64); 3] = [
    (1e3, -3.1639056722049605e-7, -4.115704309710133e-7),
    (20e3, -1.027690899655377e-6, -1.8790393029907137e-7),
    (100e3, -1.1471729826959503e-6, -9.146005341259009e-8),
];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<f64> = std::env::args().skip(1).map(|a| a.parse()).collect::<Result<_, _>>()?;
    let argument = |k: usize, default: f64| arguments.get(k).copied().unwrap_or(default);
    let material = Material { conductivity_s_per_m: 3.5e7, relative_permeability: 1.0 };
    for (frequency, re, im) in ALONG {
        let depth = dermis_tomo::mit::skin_depth_m(material.conductivity_s_per_m, 1.0, frequency)?;
        let inside_m = argument(1, 2.5) * 1e-3;
        let fineness = Fineness {
            surface_m: (0.6 * depth).min(inside_m),
            inside_m,
            growth: argument(2, 2.2),
            border_m: argument(3, 45.0) * 1e-3,
            around: argument(0, 16.0) as usize,
        };
        for order in [Order::First, Order::SecondWithin(2.0)] {
            let start = Instant::now();
            let mesh = EdgeMesh::cylinder(0.005, 0.01, &fineness)?;
            let cells = mesh.tetrahedra.len();
            let model = EdgeModel::new(mesh, material, frequency, order)?;
            let built = start.elapsed();
            let tau = model.body("cylinder")?;
            let alpha = |k: usize| tau.tau()[k * (HARMONICS + 1)] * (1.0 / MU0);
            let expected = Complex::new(re, im);
            println!(
                "{:6.0} kHz {order:?}: {cells} cells, {} unknowns, factor {:.0} MB, {built:.1?} and 15 sources {:.1?}; \
                 along the axis {:.2} % off, across {:.5e}",
                frequency / 1e3,
                model.unknowns(),
                model.factor_bytes() as f64 / 1e6,
                start.elapsed() - built,
                100.0 * (alpha(0) - expected).norm() / expected.norm(),
                alpha(1)
            );
        }
    }
    Ok(())
}
