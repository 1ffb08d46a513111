//! Compares thin sheets by stream functions with finite-element references and closed forms.

use std::f64::consts::{PI, TAU};

use crate::shared::{complex, number, reference, relative};
use dermis_mit::edge::{Dipole, Harmonic, Source};
use dermis_mit::sheet::{Plate, PlateCoupling, Plates, Sheet, SheetMaterial, SheetMesh};
use dermis_mit::{Coil, CoilArray, Complex, MU0, MitError};
use serde_json::Value;

const ALUMINIUM: SheetMaterial = SheetMaterial { thickness_m: 0.001, conductivity_s_per_m: 3.5e7 };

#[test]
fn a_disc_answers_as_in_an_axisymmetric_computation() {
    let file = reference("axisymmetric_bodies.json");
    let mesh = SheetMesh::disc(0.03, 10).unwrap();
    for row in file["rows"].as_array().unwrap().iter().filter(|row| row["kind"] == "disc") {
        let sheet = Sheet::new(&mesh, &ALUMINIUM, number(&row["f_Hz"])).unwrap();
        let uniform = Harmonic::new(0).unwrap();
        let coil =
            |case: &Value| Coil::circular_spiral([0.0, 0.0, -0.0005 - number(&case["gap_m"])], 0.03, 0.07, 51).unwrap();
        let coils: Vec<Coil> = row["coax"].as_array().unwrap().iter().map(coil).collect();
        let mut sources: Vec<&dyn Source> = vec![&uniform];
        sources.extend(coils.iter().map(|coil| coil as &dyn Source));
        let changes = sheet.changes_h(&sources);
        let mut worst = relative(changes[0] / MU0, complex(&row["alpha_z"]));
        for (k, case) in row["coax"].as_array().unwrap().iter().enumerate() {
            worst = worst.max(relative(changes[(k + 1) * (sources.len() + 1)], complex(&case["dM11"])));
        }
        println!("{} Hz: {worst:.4}", row["f_Hz"]);
        // Thickness of 0.4 skin depths at 1 kHz and 1.7 at 20 kHz, where currents also flow around the rim.
        assert!(worst < 0.01, "{row}: {worst}");
    }
}

#[test]
fn a_plate_between_and_over_coils_is_within_3_per_cent_of_the_reference() {
    let file = reference("edge_fem_plate.json");
    let case = file.as_array().unwrap().iter().find(|case| case["order"] == 2).unwrap();
    let mesh = SheetMesh::rectangle([0.02, 0.02], [12, 12]).unwrap();
    let sheet = Sheet::new(&mesh, &ALUMINIUM, number(&case["f_Hz"])).unwrap();
    for pose in case["pairs"].as_array().unwrap() {
        let c = [0, 1, 2].map(|k| number(&pose["center"][k]));
        let coils = [-0.0375, 0.0375].map(|x| Coil::circular_spiral([x - c[0], -c[1], -c[2]], 0.03, 0.07, 51).unwrap());
        let changes = sheet.changes_h(&[&coils[0], &coils[1]]);
        for (k, label) in ["dM11", "dM12"].into_iter().enumerate() {
            let off = relative(changes[k], complex(&pose[label]));
            println!("{} {label}: {off:.4}", pose["center"]);
            // The reference is trusted to about 1 %; twelve cells along a side have a similar error.
            assert!(off < 0.03, "{} {label}: {off}", pose["center"]);
        }
    }
}

#[test]
fn slow_fields_drive_currents_in_proportion_to_the_radius() {
    // J = -j w sigma B rho / 2: the moment is -j w sigma t B pi R^4 / 8 as long as no flux is pushed out.
    let foil = SheetMaterial { thickness_m: 35e-6, conductivity_s_per_m: 5.8e7 };
    let (radius_m, frequency_hz) = (0.02, 1.0);
    let sheet = Sheet::new(&SheetMesh::disc(radius_m, 16).unwrap(), &foil, frequency_hz).unwrap();
    let found = sheet.changes_h(&[&Harmonic::new(0).unwrap()])[0] / MU0;
    let size = TAU * frequency_hz * MU0 * foil.conductivity_s_per_m * foil.thickness_m * PI * radius_m.powi(4) / 8.0;
    println!("{:e}", relative(found, Complex::new(0.0, -size)));
    // Triangles under a parabola: the square of a third of their size over the radius.
    assert!(relative(found, Complex::new(0.0, -size)) < 5e-3, "{found:?} {size:e}");
}

#[test]
fn the_impedance_is_that_of_both_limits() {
    let thin = SheetMaterial { thickness_m: 1e-5, ..ALUMINIUM }.impedance_ohm(1e3).unwrap();
    // 1/(sigma t) (1 + j (t/delta)^2 / 6).
    let expected = Complex::new(1.0 / 350.0, 1.0 / 350.0 * (1e-5_f64 / 2.6903e-3).powi(2) / 6.0);
    assert!((thin - expected).norm() < 1e-6 * thin.norm(), "{thin:?} {expected:?}");
    let thick = SheetMaterial { thickness_m: 0.1, ..ALUMINIUM }.impedance_ohm(1e6).unwrap();
    let depth = (PI * 1e6 * MU0 * 3.5e7).powf(-0.5);
    let expected = Complex::new(1.0, 1.0) / (2.0 * 3.5e7 * depth);
    assert!((thick - expected).norm() < 1e-12 * thick.norm(), "{thick:?} {expected:?}");
}

#[test]
fn a_tilted_sheet_responds_like_a_flat_one() {
    // A tilted plate, and a dipole rotated with it.
    let (mesh, angle) = (SheetMesh::rectangle([0.02, 0.02], [6, 6]).unwrap(), 0.3_f64);
    let (sine, cosine) = angle.sin_cos();
    let turned = |[x, y, z]: [f64; 3]| [cosine * x - sine * z, y, sine * x + cosine * z];
    let tilted = SheetMesh::rectangle([0.02 * cosine, 0.02], [6, 6]).unwrap();
    let tilted = tilted.with_heights(|[x, _]| x * sine / cosine).unwrap();
    let (place, moment) = ([0.004, 0.002, 0.015], [0.3, -0.2, 1.0]);
    let change = |mesh: &SheetMesh, dipole: Dipole| Sheet::new(mesh, &ALUMINIUM, 2e4).unwrap().changes_h(&[&dipole])[0];
    let flat = change(&mesh, Dipole { position_m: place, moment });
    let found = change(&tilted, Dipole { position_m: turned(place), moment: turned(moment) });
    assert!(relative(found, flat) < 1e-9, "{found:?} {flat:?}");
    // A dent towards the dipole increases the response.
    let dented = mesh.with_heights(|[x, y]| 0.003 * (-(x * x + y * y) / 5e-5).exp()).unwrap();
    let nearer = change(&dented, Dipole { position_m: place, moment });
    assert!(nearer.norm() > 1.1 * flat.norm(), "{nearer:?} {flat:?}");
}

#[test]
fn plates_far_apart_add_up_and_excite_each_other_as_dipoles() {
    let one = SheetMesh::rectangle([0.01, 0.01], [6, 6]).unwrap();
    let apart = 0.05;
    let (left, right) = (one.clone().moved([-0.5 * apart, 0.0, 0.0]), one.clone().moved([0.5 * apart, 0.0, 0.0]));
    let uniform = Harmonic::new(0).unwrap();
    let change = |mesh: &SheetMesh| Sheet::new(mesh, &ALUMINIUM, 2e4).unwrap().changes_h(&[&uniform])[0];
    let (alone, both) = (change(&one), change(&left.and(&right)));
    // alpha = dM / mu0 without the contribution of tangential fields. Each plate sees -alpha/(4 pi d^3) of the other's
    // moment, which gives 2 alpha / (1 + alpha/(4 pi d^3)).
    let alpha = alone / MU0;
    let expected = alone * 2.0 / (alpha / (4.0 * PI * apart.powi(3)) + 1.0);
    let (found, expected) = (both - alone * 2.0, expected - alone * 2.0);
    println!("{:e} {found:?} {expected:?}", relative(found, expected));
    // Contribution beyond dipoles: (5 mm / 50 mm)^2 of their small effect.
    assert!(relative(found, expected) < 0.03, "{found:?} {expected:?}");
}

/// Two coils like those of the array, close enough for one plate to be seen by both.
fn two_coils() -> CoilArray {
    let coil = |x: f64| Coil::circular_spiral([x, 0.0, 0.0], 0.03, 0.07, 5).unwrap();
    CoilArray::of_coils(vec![coil(-0.0375), coil(0.0375)]).unwrap()
}

#[test]
fn a_plate_of_a_few_points_responds_like_its_sheet() {
    let array = two_coils();
    let material = SheetMaterial { thickness_m: 0.001, conductivity_s_per_m: 3.5e7 };
    let sheet = Sheet::new(&SheetMesh::rectangle([0.02, 0.03], [8, 8]).unwrap(), &material, 2e4).unwrap();
    let plate = Plate::new([0.02, 0.03], &material, 2e4, 8, 6).unwrap();
    for (place, most) in [([0.0, 0.0, 0.01], 5e-3), ([-0.02, 0.01, 0.01], 5e-3), ([0.03, -0.01, 0.02], 1e-3)] {
        let coils: Vec<Coil> = array.coils().iter().map(|c| c.clone().moved(place.map(|x: f64| -x))).collect();
        let expected = sheet.changes_h(&[&coils[0], &coils[1]]);
        let samples: Vec<_> = array.coils().iter().map(|coil| plate.sample(coil, place)).collect();
        let size = expected[0].norm().max(expected[3].norm());
        for k in 0..4 {
            let found = plate.change_h(&samples[k / 2], &samples[k % 2]);
            println!("{place:?} {k}: {:e}", (found - expected[k]).norm() / size);
            // (1 + sqrt 2)^-6 at a gap of half the width, above sharp single turns.
            assert!((found - expected[k]).norm() < most * size, "{place:?} {k}: {found:?} {:?}", expected[k]);
        }
    }
}

#[test]
fn plates_over_coils_excite_each_other_as_one_sheet_of_many_pieces() {
    let array = two_coils();
    let (places, heights) = ([[-0.0125, 0.0], [0.0125, 0.0], [-0.0125, 0.025]], [0.012, 0.016, 0.02]);
    let plate = Plate::new([0.02, 0.02], &ALUMINIUM, 2e4, 6, 6).unwrap();
    let with = |coupling: Option<PlateCoupling>| {
        let mut plates = Plates::new(&array, plate.clone(), &places, [0.01, 0.022], coupling).unwrap();
        let mut changes = [Complex::new(0.0, 0.0)];
        plates.changes(&heights, &mut changes).unwrap();
        changes[0]
    };
    let one = SheetMesh::rectangle([0.02, 0.02], [6, 6]).unwrap();
    let piece = |k: usize| one.clone().moved([places[k][0], places[k][1], heights[k]]);
    let whole = Sheet::new(&piece(0).and(&piece(1)).and(&piece(2)), &ALUMINIUM, 2e4).unwrap();
    let expected = whole.changes_h(&[&array.coils()[0], &array.coils()[1]])[1];
    let coupled = |sweeps: usize| with(Some(PlateCoupling { reach_m: 0.05, sweeps }));
    let (alone, two, settled) = (relative(with(None), expected), relative(coupled(2), expected), coupled(8));
    println!("alone {alone:.4}, two sweeps {two:.4}, settled {:.4}", relative(settled, expected));
    // Gaps of 5 mm between plates of 20 mm, represented by nine dipoles each.
    assert!(relative(settled, expected) < 0.01 && two < 0.02 && alone > 3.0 * two, "{alone} {two}");
    assert!(relative(coupled(9), settled) < 1e-4);
}

#[test]
fn plates_that_intersect_each_other_or_wire_are_refused() {
    let array = two_coils();
    let plate = Plate::new([0.02, 0.02], &ALUMINIUM, 2e4, 4, 4).unwrap();
    let new = |places: &[[f64; 2]], heights| Plates::new(&array, plate.clone(), places, heights, None);
    let overlap = new(&[[0.0, 0.0], [0.015, 0.0]], [0.01, 0.02]).unwrap_err();
    assert!(matches!(overlap, MitError::BodiesOverlap { first: 1, second: 2, .. }), "{overlap}");
    let inside = new(&[[-0.0125, 0.0]], [-0.001, 0.02]).unwrap_err();
    assert!(matches!(inside, MitError::WireInside { body: 1, .. }), "{inside}");
    assert!(new(&[], [0.01, 0.02]).is_err() && new(&[[0.0, 0.0]], [0.02, 0.01]).is_err());
    let mut plates = new(&[[0.0, 0.0]], [0.01, 0.02]).unwrap();
    let mut changes = [Complex::new(0.0, 0.0)];
    assert!(matches!(plates.changes(&[0.03], &mut changes), Err(MitError::OutsideTable { body: 1, .. })));
    assert!(plates.changes(&[0.015, 0.015], &mut changes).is_err() && plates.changes(&[0.015], &mut []).is_err());
    assert!(Plate::new([0.02, 0.02], &ALUMINIUM, 2e4, 4, 2).is_err());
}

#[test]
fn sheets_that_are_not_thin_or_not_whole_are_refused() {
    let mesh = SheetMesh::rectangle([0.02, 0.02], [4, 4]).unwrap();
    let with = |material: SheetMaterial, frequency_hz: f64| {
        Sheet::new(&mesh, &material, frequency_hz).map(|_| ()).unwrap_err().to_string()
    };
    assert!(with(ALUMINIUM, 0.1).contains("0.1"));
    assert!(with(ALUMINIUM, 3e6).contains("3000000"));
    assert!(with(SheetMaterial { conductivity_s_per_m: 0.0, ..ALUMINIUM }, 1e3).contains("conductivity_s_per_m = 0"));
    assert!(with(SheetMaterial { thickness_m: -0.1, ..ALUMINIUM }, 1e3).contains("-0.1"));
    assert!(with(SheetMaterial { thickness_m: 0.01, ..ALUMINIUM }, 1e3).contains("thickness over width"));
    assert!(SheetMesh::rectangle([0.02, -0.02], [4, 4]).is_err());
    assert!(SheetMesh::rectangle([0.02, 0.02], [4, 1]).is_err());
    assert!(SheetMesh::disc(0.02, 1).is_err());
    let p = |x: f64, y: f64| [x, y, 0.0];
    let square = vec![p(0.0, 0.0), p(1.0, 0.0), p(1.0, 1.0), p(0.0, 1.0)];
    assert!(matches!(SheetMesh::new(square.clone(), vec![[0, 1, 4]]), Err(MitError::Count { got: 4, .. })));
    assert!(SheetMesh::new(square.clone(), vec![[0, 1, 1]]).is_err());
    assert!(SheetMesh::new(square, vec![[0, 1, 2], [0, 1, 2]]).is_err());
    // A square with a square hole.
    let mut holed: Vec<[f64; 3]> = Vec::new();
    for side in [3.0, 1.0] {
        holed.extend([p(-side, -side), p(side, -side), p(side, side), p(-side, side)]);
    }
    let ring = (0..4_u32).flat_map(|k| {
        let next = (k + 1) % 4;
        [[k, next, next + 4], [k, next + 4, k + 4]]
    });
    let refused = SheetMesh::new(holed, ring.collect()).unwrap_err();
    assert!(refused.to_string().contains("no holes"), "{refused}");
}
