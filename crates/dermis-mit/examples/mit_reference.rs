//! Compares edge elements with reference values: the cylinder and the plate over a pair of coils, and a coil over a
//! large plate, with problem sizes and times. Reads the folder of reference files from the command line.

use std::error::Error;
use std::time::Instant;

use dermis_mit::edge::{EddySystem, EdgeMesh, Grading, Material, Order, Shape, Source, SymmetricBody, body_tau, tau};
use dermis_mit::{Coil, Complex, HARMONICS, Polarizability, Sphere, skin_depth_m};
use serde_json::Value;

const ALUMINIUM: Material = Material { conductivity_s_per_m: 3.5e7, relative_permeability: 1.0 };

/// Aluminium spheres of 5 mm against the closed form; prints the worst error of each degree.
fn spheres() -> Result<(), Box<dyn Error>> {
    for (frequency_hz, around) in [(1e3, 8), (1e3, 16), (2e4, 16)] {
        let depth = skin_depth_m(ALUMINIUM.conductivity_s_per_m, 1.0, frequency_hz)?;
        let shape = Shape::Sphere { radius_m: 0.005 };
        let mesh = shape.mesh(&Grading { around, ..shape.grading(depth) })?;
        let start = Instant::now();
        let system = EddySystem::new(&mesh, &[ALUMINIUM], frequency_hz, Order::Second)?;
        let found = tau(&system)?;
        let sphere = Sphere { radius_m: 0.005, conductivity_s_per_m: 3.5e7, relative_permeability: 1.0 };
        let exact = Polarizability::sphere(&sphere, frequency_hz)?;
        let at = |i: usize| i * (HARMONICS + 1);
        let off = |i: usize| (found[at(i)] - exact.tau()[at(i)]).norm() / exact.tau()[at(i)].norm();
        let worst = [0..3, 3..8, 8..15].map(|range| 100.0 * range.map(off).fold(0.0, f64::max));
        println!("sphere {frequency_hz} Hz, around {around}: {worst:.3?} % in {:.2} s", start.elapsed().as_secs_f64());
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("expected the folder of the reference values")?;
    let read = |name: &str| -> Result<Value, Box<dyn Error>> {
        Ok(serde_json::from_str(&std::fs::read_to_string(format!("{folder}/{name}"))?)?)
    };
    spheres()?;
    let cylinder = Shape::Cylinder { radius_m: 0.005, height_m: 0.01 };
    let plate = Shape::Plate { size_m: [0.02, 0.02, 0.001] };
    for (name, shape) in [("edge_fem_cylinder.json", cylinder), ("edge_fem_plate.json", plate)] {
        for case in read(name)?.as_array().into_iter().flatten().filter(|case| case["order"] == 2) {
            pairs(name, &shape, case)?;
        }
    }
    dodd_deeds(&read("dodd_deeds.json")?)
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn complex(value: &Value) -> Complex {
    Complex::new(number(&value[0]), number(&value[1]))
}

fn octant(shape: &Shape, grading: &Grading) -> Result<EdgeMesh, Box<dyn Error>> {
    Ok(shape.mesh(grading)?.octant()?)
}

/// The reference coils around a body at the origin.
fn coils(centre: [f64; 3]) -> Result<[Coil; 2], Box<dyn Error>> {
    let coil = |x: f64| Coil::circular_spiral([x - centre[0], -centre[1], -centre[2]], 0.03, 0.07, 51);
    Ok([coil(-0.0375)?, coil(0.0375)?])
}

fn pairs(name: &str, shape: &Shape, case: &Value) -> Result<(), Box<dyn Error>> {
    let frequency_hz = number(&case["f_Hz"]);
    let depth = skin_depth_m(ALUMINIUM.conductivity_s_per_m, 1.0, frequency_hz)?;
    let start = Instant::now();
    let body = body_tau(shape, &ALUMINIUM, frequency_hz)?;
    println!("{name} {frequency_hz} Hz: tau in {:.2} s", start.elapsed().as_secs_f64());
    let mesh = octant(shape, &shape.grading(depth))?;
    let start = Instant::now();
    let system = SymmetricBody::new(&mesh, &[ALUMINIUM], frequency_hz, Order::Second)?;
    println!(
        "  {} tetrahedra of an eighth, factored in {:.2} s: {:?}",
        mesh.tetrahedron_count(),
        start.elapsed().as_secs_f64(),
        system.info()
    );
    let poses: Vec<&Value> = case["pairs"].as_array().into_iter().flatten().collect();
    let mut sources = Vec::new();
    for pose in &poses {
        sources.extend(coils([0, 1, 2].map(|k| number(&pose["center"][k])))?);
    }
    let start = Instant::now();
    let changes = system.changes_h(&sources.iter().map(|coil| coil as &dyn Source).collect::<Vec<_>>())?;
    println!("  {} sources in {:.2} s", sources.len(), start.elapsed().as_secs_f64());
    for (k, pose) in poses.iter().enumerate() {
        let (m, n, count) = (2 * k, 2 * k + 1, sources.len());
        let c = [m, n].map(|m| sources[m].expansion([0.0; 3]));
        let report = |label: &str, found: Complex, by_tau: Complex| {
            let expected = complex(&pose[label]);
            let off = |found: Complex| 100.0 * (found - expected).norm() / expected.norm();
            println!(
                "  {label} at {} gap {}: {:.3} % (tau {:.3} %)",
                pose["center"],
                pose["gap_m"],
                off(found),
                off(by_tau)
            );
        };
        report("dM12", changes[m * count + n], body.change_h(&c[0], &c[1]));
        report("dM11", changes[m * count + m], body.change_h(&c[0], &c[0]));
    }
    Ok(())
}

fn dodd_deeds(file: &Value) -> Result<(), Box<dyn Error>> {
    let thickness: f64 = 0.001;
    for frequency_hz in [1e3, 1e4] {
        let start = Instant::now();
        let depth = skin_depth_m(ALUMINIUM.conductivity_s_per_m, 1.0, frequency_hz)?;
        let grading = Grading {
            first_m: (0.5 * thickness / 2.0).min(0.7 * depth),
            growth: 1.8,
            most_m: 0.006,
            wide_m: 0.008,
            air_growth: 2.0,
            air_m: 0.6,
            around: 16,
        };
        let mesh = octant(&Shape::Cylinder { radius_m: 0.16, height_m: thickness }, &grading)?;
        let system = SymmetricBody::new(&mesh, &[ALUMINIUM], frequency_hz, Order::Second)?;
        println!(
            "dodd_deeds {frequency_hz} Hz: {} tetrahedra of an eighth, {:?}",
            mesh.tetrahedron_count(),
            system.info()
        );
        let rows: Vec<&Value> = file["spiral"].as_array().into_iter().flatten().collect();
        let rows: Vec<&&Value> =
            rows.iter().filter(|row| row["case"] == "Al 1mm" && number(&row["f_Hz"]) == frequency_hz).collect();
        let coil =
            |row: &Value| Coil::circular_spiral([0.0, 0.0, 0.5 * thickness + number(&row["lift_m"])], 0.03, 0.07, 51);
        let coils = rows.iter().map(|row| coil(row)).collect::<Result<Vec<_>, _>>()?;
        let changes = system.changes_h(&coils.iter().map(|coil| coil as &dyn Source).collect::<Vec<_>>())?;
        for (k, row) in rows.iter().enumerate() {
            let (found, expected) = (changes[k * coils.len() + k], complex(&row["dM_self"]));
            println!("  lift {}: {:.3} %", row["lift_m"], 100.0 * (found - expected).norm() / expected.norm());
        }
        println!("  in {:.2} s", start.elapsed().as_secs_f64());
    }
    Ok(())
}
