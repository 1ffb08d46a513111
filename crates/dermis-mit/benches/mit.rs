//! Speed of the live magnetic model: one frame of bodies over coils, and the precomputations.

use criterion::{Criterion, criterion_group, criterion_main};
use dermis_mit::sheet::{Plate, PlateCoupling, Plates, SheetMaterial};
use dermis_mit::{CoilArray, CoilTables, Complex, Coupling, MitError, MultipoleArray, Polarizability, Sphere};

fn places() -> Vec<[f64; 2]> {
    (0..25).map(|k| [0.02 * ((k % 5) as f64 - 2.0), 0.02 * ((k / 5) as f64 - 2.0)]).collect()
}

fn frames(c: &mut Criterion) -> Result<(), MitError> {
    let array = CoilArray::em_16_circular()?;
    let sphere = Sphere { radius_m: 0.005, conductivity_s_per_m: 3.5e7, relative_permeability: 1.0 };
    c.bench_function("response of a sphere, degrees 1 to 5", |b| b.iter(|| sphere.responses(20e3, 5)));
    c.bench_function("tables of 16 coils at 25 bodies", |b| {
        b.iter(|| CoilTables::new(&array, &places(), [0.008, 0.03], 0.005))
    });
    let tables = CoilTables::new(&array, &places(), [0.008, 0.03], 0.005)?;
    let heights: Vec<f64> = (0..25).map(|k| 0.01 + 0.0005 * f64::from(k)).collect();
    let neighbours = Coupling { degree: 2, reach_m: 0.03, sweeps: 1 };
    for (name, coupling) in [("alone", None), ("exciting their neighbours", Some(neighbours))] {
        let mut bodies =
            MultipoleArray::new(vec![Polarizability::sphere(&sphere, 20e3)?; 25], tables.clone(), coupling)?;
        let mut changes = vec![Complex::new(0.0, 0.0); bodies.pairs().len()];
        c.bench_function(&format!("frame of 16 coils over 25 bodies, {name}"), |b| {
            b.iter(|| bodies.changes(&heights, &mut changes))
        });
    }
    let places: Vec<[f64; 2]> =
        (0..64).map(|k| [0.035 * (f64::from(k % 8) - 3.5), 0.035 * (f64::from(k / 8) - 3.5)]).collect();
    let material = SheetMaterial { thickness_m: 0.001, conductivity_s_per_m: 3.5e7 };
    let plate = Plate::new([0.022, 0.022], &material, 20e3, 12, 5)?;
    let heights: Vec<f64> = (0..64).map(|k| 0.014 + 0.0002 * f64::from(k)).collect();
    let neighbours = PlateCoupling { reach_m: 0.05, sweeps: 2 };
    for (name, coupling) in [("alone", None), ("exciting their neighbours", Some(neighbours))] {
        let mut plates = Plates::new(&array, plate.clone(), &places, [0.012, 0.03], coupling)?;
        let mut changes = vec![Complex::new(0.0, 0.0); plates.pairs().len()];
        c.bench_function(&format!("frame of 16 coils over 64 plates, {name}"), |b| {
            b.iter(|| plates.changes(&heights, &mut changes))
        });
    }
    Ok(())
}

fn all(c: &mut Criterion) {
    if let Err(error) = frames(c) {
        eprintln!("a case could not be set up: {error}");
    }
}

criterion_group!(benches, all);
criterion_main!(benches);
