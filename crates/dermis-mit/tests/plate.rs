//! Compares coils over wide conducting plates with reference values computed elsewhere and with closed-form limits.

use crate::shared::{complex, number, reference, relative};
use dermis_mit::{Coil, Complex, ConductingPlate, MU0, MitError, Ring, RoundWinding};

fn plate(conductivity_s_per_m: f64, thickness_m: Option<f64>) -> ConductingPlate {
    ConductingPlate { face_z_m: 0.0, thickness_m, conductivity_s_per_m, relative_permeability: 1.0 }
}

#[test]
fn coils_over_plates_change_as_in_the_reference() {
    let file = reference("dodd_deeds.json");
    let mut worst: f64 = 0.0;
    for row in file["spiral"].as_array().unwrap().iter().step_by(7) {
        let at = |x: f64, y: f64| RoundWinding::annulus([x, y, number(&row["lift_m"])], 0.03, 0.07, 51.0).unwrap();
        let over = plate(number(&row["sigma"]), row["thickness_m"].as_f64());
        let keys = [("dM_self", 0.0, 0.0), ("dM_adjacent", 0.075, 0.0), ("dM_diagonal", 0.075, 0.075)];
        for (key, x, y) in keys.into_iter().chain([("dM_two", 0.15, 0.0)]) {
            let found = over.change_h(&at(0.0, 0.0), &at(x, y), number(&row["f_Hz"])).unwrap();
            worst = worst.max(relative(found, complex(&row[key])));
        }
    }
    for row in file["filament_checks"].as_array().unwrap() {
        let over = plate(3.5e7, row["t"].as_f64());
        let a = RoundWinding::ring([0.0, 0.0, number(&row["z"])], number(&row["a"])).unwrap();
        let b = RoundWinding::ring([number(&row["p"]), 0.0, number(&row["z"])], number(&row["b"])).unwrap();
        worst = worst.max(relative(over.change_h(&a, &b, number(&row["f"])).unwrap(), complex(&row["mp"])));
    }
    for row in file["thick_coil"].as_array().unwrap() {
        let size = |key: &str| number(&row["coil"][key]);
        let centre = [0.0, 0.0, size("z") + 0.5 * size("h")];
        let coil = RoundWinding::block(centre, 2.0 * size("a"), 2.0 * size("b"), size("h"), size("N")).unwrap();
        let found = plate(3.5e7, None).change_h(&coil, &coil, number(&row["f_Hz"])).unwrap();
        worst = worst.max(relative(found, complex(&row["dM"])));
    }
    println!("worst relative difference {worst:e}");
    // Both are quadratures to almost full precision; cancellation at large offsets costs two digits.
    assert!(worst < 1e-10, "{worst:e}");
}

#[test]
fn a_perfect_conductor_is_a_mirror() {
    let (a, b) = ([0.0, 0.0, 0.01], [0.075, 0.0, 0.015]);
    let over = plate(1e22, None);
    let [first, second] = [a, b].map(|centre| RoundWinding::ring(centre, 0.025).unwrap());
    let found = over.change_h(&first, &second, 1e6).unwrap();
    let expected = -Ring::flat([0.0, 0.0, -0.01], 0.025).mutual_h(&Ring::flat(b, 0.025));
    // Error of a skin depth of 5e-12 m relative to 10 mm.
    assert!(
        (found.re / expected - 1.0).abs() < 1e-8 && found.im.abs() < 1e-8 * expected.abs(),
        "{found:?} {expected:e}"
    );
    // The same with a shielded coil: the flux of its image is the whole change.
    let coil = |x: f64| Coil::circular_spiral([x, 0.0, 0.01], 0.03, 0.07, 5).unwrap();
    let rings = [coil(0.0), coil(0.075)].map(|coil| RoundWinding::of_coil(&coil).unwrap());
    let found = over.change_h(&rings[0], &rings[1], 1e6).unwrap();
    let expected =
        coil(0.0).with_shield(0.0).mutual_h(&coil(0.075).with_shield(0.0)) - coil(0.0).mutual_h(&coil(0.075));
    assert!((found.re / expected - 1.0).abs() < 1e-7, "{found:?} {expected:e}");
}

#[test]
fn a_magnetic_half_space_is_a_weaker_mirror_of_the_same_sign() {
    // At 1 Hz and 1 S/m no current flows; the image of a magnetic half space is (mu_r - 1)/(mu_r + 1).
    let over = ConductingPlate { relative_permeability: 5.0, ..plate(1.0, None) };
    let ring = RoundWinding::ring([0.0, 0.0, 0.01], 0.025).unwrap();
    let found = over.change_h(&ring, &ring, 1.0).unwrap();
    let expected = 4.0 / 6.0 * Ring::flat([0.0, 0.0, -0.01], 0.025).mutual_h(&Ring::flat([0.0, 0.0, 0.01], 0.025));
    assert!((found.re / expected - 1.0).abs() < 1e-7, "{found:?} {expected:e}");
}

#[test]
fn a_thin_weak_plate_takes_its_first_order() {
    // G -> -j w mu0 sigma t / (2k) for small k t and w mu0 sigma t / k.
    let over = plate(1.0, Some(1e-6));
    let (k, frequency_hz) = (50.0, 1e3);
    let expected = Complex::new(0.0, -std::f64::consts::TAU * frequency_hz * MU0 * 1e-6 / (2.0 * k));
    assert!(relative(over.reflection(k, frequency_hz), expected) < 1e-4, "{:?}", over.reflection(k, frequency_hz));
}

#[test]
fn coils_in_the_plate_and_bad_numbers_are_refused() {
    let (over, ring) = (plate(3.5e7, None), RoundWinding::ring([0.0, 0.0, 0.01], 0.025).unwrap());
    let below = RoundWinding::ring([0.0, 0.0, -0.001], 0.025).unwrap();
    assert!(over.change_h(&ring, &below, 1e3).unwrap_err().to_string().contains("-0.001"));
    assert!(over.change_h(&ring, &ring, 0.1).unwrap_err().to_string().contains("0.1"));
    assert!(plate(0.0, None).change_h(&ring, &ring, 1e3).unwrap_err().to_string().contains("conductivity_s_per_m = 0"));
    assert!(plate(3.5e7, Some(-1.0)).change_h(&ring, &ring, 1e3).is_err());
    let square = Coil::square_spiral([0.0, 0.0, 0.02], 0.025, 0.075, 3).unwrap();
    assert!(matches!(RoundWinding::of_coil(&square), Err(MitError::NotRound { .. })));
    assert!(RoundWinding::annulus([0.0; 3], 0.07, 0.03, 51.0).is_err());
}
