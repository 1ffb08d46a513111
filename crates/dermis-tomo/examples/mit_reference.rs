//! Edge elements against reference values: `cargo run --release -p dermis-tomo --example mit_reference`.

use std::time::Instant;

use dermis_tomo::mit::edge::{EdgeMesh, EdgeModel, Fineness, Material, Order};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let material = Material { conductivity_s_per_m: 3.5e7, relative_permeability: 1.0 };
    for (frequency, surface, around) in [(1e3, 1.0e-3, 24), (20e3, 0.35e-3, 24), (100e3, 0.15e-3, 24)] {
        for order in [Order::First, Order::Second] {
            let fineness = Fineness { surface_m: surface, inside_m: 1.6e-3, growth: 1.8, border_m: 0.06, around };
            let start = Instant::now();
            let mesh = EdgeMesh::cylinder(0.005, 0.01, &fineness)?;
            let cells = mesh.tetrahedra.len();
            let model = EdgeModel::new(mesh, material, frequency, order)?;
            let built = start.elapsed();
            let body = model.body("cylinder")?;
            // tau_11 = mu0 alpha for the dipole.
            let alpha = |k: usize| body.tau()[k * 16] * (1.0 / dermis_tomo::mit::MU0);
            println!(
                "{frequency} Hz {order:?}: {cells} cells, {} unknowns, {:.0} MB, {built:.1?} + {:.1?}; alpha_z {:.5e} alpha_x {:.5e} {:.5e}",
                model.unknowns(),
                model.factor_bytes() as f64 / 1e6,
                start.elapsed() - built,
                alpha(0),
                alpha(1),
                alpha(2)
            );
        }
    }
    Ok(())
}
