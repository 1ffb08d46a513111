//! Compares coils and multipole bodies with reference values computed elsewhere and with closed forms.

use dermis_mit::{
    Coil, CoilArray, CoilTables, Complex, Coupling, Filament, HARMONICS, MU0, MitError, MultipoleArray, Polarizability,
    Ring, Sphere, complete_elliptic, skin_depth_m,
};
use serde_json::Value;

/// A file of reference values.
fn reference(name: &str) -> Value {
    serde_json::from_str(&dermis_testdata::oracle_text(&format!("mit/{name}"))).unwrap()
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap_or_else(|| panic!("{key} in {value}"))
}

fn complex(value: &Value) -> Complex {
    Complex::new(value[0].as_f64().unwrap(), value[1].as_f64().unwrap())
}

fn vector(value: &Value) -> [f64; 3] {
    [0, 1, 2].map(|k| value[k].as_f64().unwrap())
}

fn relative(found: Complex, expected: Complex) -> f64 {
    (found - expected).norm() / expected.norm()
}

/// The reference's coil: 51 rings, each in the middle of its turn's share of 15 to 35 mm.
fn spiral(x_m: f64) -> Coil {
    Coil::circular_spiral([x_m, 0.0, 0.0], 0.03, 0.07, 51).unwrap()
}

fn expand(coil: &Coil, centre_m: [f64; 3]) -> [f64; HARMONICS] {
    coil.expansion(centre_m)
}

#[test]
fn elliptic_integrals_obey_legendre() {
    for complement in [1e-12, 1e-4, 0.1, 0.5, 0.9, 1.0 - 1e-9] {
        let ((k, e), (k1, e1)) = (complete_elliptic(complement), complete_elliptic(1.0 - complement));
        // Legendre's relation between an integral and its complement.
        let found = e * k1 + e1 * k - k * k1;
        assert!((found - std::f64::consts::FRAC_PI_2).abs() < 1e-12 * (k * k1).max(1.0), "{complement}: {found}");
    }
}

#[test]
fn loops_have_the_reference_s_mutual_inductances() {
    let file = reference("filament_mutual.json");
    let mut worst: f64 = 0.0;
    for row in file["coaxial_and_parallel"].as_array().unwrap() {
        let centre = [number(row, "offset"), 0.0, number(row, "axial")];
        let found = Ring::flat([0.0; 3], number(row, "a")).mutual_h(&Ring::flat(centre, number(row, "b")));
        worst = worst.max((found / number(row, "M_H") - 1.0).abs());
    }
    for row in file["tilted"].as_array().unwrap() {
        let tilted =
            Ring { centre_m: vector(&row["center"]), axis: vector(&row["normal"]), radius_m: number(row, "b") };
        let found = Ring::flat([0.0; 3], number(row, "a")).mutual_h(&tilted);
        worst = worst.max((found / number(row, "M_H") - 1.0).abs());
    }
    println!("worst relative difference {worst:e}");
    assert!(worst < 1e-11, "{worst:e}");
}

#[test]
fn fields_are_the_curl_of_potentials_and_right_on_the_axis() {
    let ring = Ring { centre_m: [0.01, -0.02, 0.005], axis: [0.6, 0.0, 0.8], radius_m: 0.02 };
    let square = Coil::square_spiral([0.0; 3], 0.025, 0.075, 3).unwrap();
    let step = 1e-6;
    type Field<'a> = Box<dyn Fn([f64; 3]) -> [f64; 3] + 'a>;
    let fields: [(Field<'_>, Field<'_>); 2] = [
        (Box::new(|p| ring.vector_potential(p)), Box::new(|p| ring.flux_density(p))),
        (Box::new(|p| square.vector_potential(p)), Box::new(|p| square.flux_density(p))),
    ];
    for (potential, flux) in &fields {
        for p in [[0.03, 0.01, 0.02], [0.01, -0.02, 0.04], [-0.02, 0.015, -0.01]] {
            let slope = |axis: usize, of: usize| {
                let at = |by: f64| {
                    let mut q = p;
                    q[axis] += by;
                    potential(q)[of]
                };
                (at(step) - at(-step)) / (2.0 * step)
            };
            let curl = [slope(1, 2) - slope(2, 1), slope(2, 0) - slope(0, 2), slope(0, 1) - slope(1, 0)];
            let b = flux(p);
            let size = b.iter().map(|v| v * v).sum::<f64>().sqrt();
            // Central differences over a micrometre: the rounding error of A divided by the step.
            (0..3).for_each(|k| assert!((curl[k] - b[k]).abs() < 1e-7 * size + 1e-12, "{p:?} {curl:?} {b:?}"));
        }
    }
    let flat = Ring::flat([0.0; 3], 0.02);
    for z in [0.0, 0.01, 0.1] {
        let expected = MU0 * 0.02_f64.powi(2) / (2.0 * (0.02_f64.powi(2) + z * z).powf(1.5));
        for off in [0.0, 1e-12, 1e-7] {
            let found = flat.flux_density([off, 0.0, z])[2];
            // An offset of 0.1 um from the axis changes the field by (off/a)^2.
            assert!((found / expected - 1.0).abs() < 1e-9, "{z} {off}: {found} {expected}");
        }
    }
}

#[test]
fn spirals_have_the_reference_s_inductances() {
    let file = reference("spirals.json");
    let row = &file["circular_51t_30_70"];
    let pitch = 0.02 / 51.0;
    let round = 0.5 * (-0.25_f64).exp();
    for (share, key) in
        [(1.0, "round_wire_dia=1.0pitch"), (0.8, "round_wire_dia=0.8pitch"), (0.6, "round_wire_dia=0.6pitch")]
    {
        let found = spiral(0.0).with_mean_distance(round * share * pitch).self_inductance_h();
        assert!((found / number(row, key) - 1.0).abs() < 1e-6, "{key}: {found:e} {}", number(row, key));
    }
    for row in file["circular_array_4x4_pitch75mm_mutuals"].as_array().unwrap() {
        let found =
            spiral(0.0).mutual_h(&spiral(0.0).moved([0.075 * number(row, "dx"), 0.075 * number(row, "dy"), 0.0]));
        // The reference integrates an annular sheet instead of 51 rings: the square of one turn's width over the
        // coil's.
        assert!((found / number(row, "M_H") - 1.0).abs() < 1e-3, "{}: {found:e} {}", row["pair"], number(row, "M_H"));
    }
    // A spiral of 51 turns wound inward, against 51 squares, and the measured 157 uH.
    let square = Coil::square_spiral([0.0; 3], 0.025, 0.075, 51).unwrap().self_inductance_h();
    let expected = number(&file["square_25_75"], "square_spiral_n51_gmd0.8pitch");
    println!("square {square:e}, reference's spiral {expected:e}");
    assert!((square / expected - 1.0).abs() < 0.02, "{square:e} {expected:e}");
    let (coil, factor) = spiral(0.0).calibrated_to(155e-6).unwrap();
    assert!((coil.self_inductance_h() / 155e-6 - 1.0).abs() < 1e-12 && (factor - 1.018).abs() < 0.002, "{factor}");
}

#[test]
fn no_flux_passes_through_a_shield() {
    let coil = spiral(0.0).with_shield(-0.004);
    for (x, y) in [(0.0, 0.0), (0.02, 0.01), (0.06, -0.03)] {
        let b = coil.flux_density([x, y, -0.004]);
        assert!(b[2].abs() < 1e-12 * b[0].hypot(b[1]).max(1e-6), "{b:?}");
    }
    assert!(coil.self_inductance_h() < 0.6 * spiral(0.0).self_inductance_h());
    let (a, b) = (spiral(0.0).with_shield(-0.004), spiral(0.075).with_shield(-0.004));
    assert!((a.mutual_h(&b) / b.mutual_h(&a) - 1.0).abs() < 1e-9);
}

#[test]
fn the_response_of_spheres_agrees_with_the_closed_form() {
    let file = reference("sphere_polarizability.json");
    let mut worst: f64 = 0.0;
    for row in file["rows"].as_array().unwrap() {
        let sphere = Sphere {
            radius_m: number(row, "a"),
            conductivity_s_per_m: number(row, "sigma"),
            relative_permeability: number(row, "mur"),
        };
        let frequency = number(row, "f_Hz");
        let responses = sphere.responses(frequency, 4).unwrap();
        for (found, expected) in responses.iter().zip(row["T"].as_array().unwrap()) {
            worst = worst.max(relative(*found, complex(expected)));
        }
        worst = worst.max(relative(sphere.polarizability_m3(frequency).unwrap(), complex(&row["alpha_m"])));
        let depth = skin_depth_m(sphere.conductivity_s_per_m, sphere.relative_permeability, frequency).unwrap();
        worst = worst.max((depth / number(row, "delta_m") - 1.0).abs());
    }
    println!("worst relative difference {worst:e}");
    assert!(worst < 1e-9, "{worst:e}");
}

#[test]
fn a_sphere_between_two_coils_as_tabulated() {
    let file = reference("sphere_coilpair.json");
    let (first, second) = (spiral(-0.0375), spiral(0.0375));
    let (mut worst, mut beyond) = ([0.0_f64; 4], 0.0_f64);
    for row in file["rows"].as_array().unwrap() {
        let centre = vector(&row["sphere_center"]);
        let sphere = Sphere {
            radius_m: number(row, "a"),
            conductivity_s_per_m: number(row, "sigma"),
            relative_permeability: 1.0,
        };
        let body = Polarizability::sphere(&sphere, number(row, "f_Hz")).unwrap();
        let (c1, c2) = (expand(&first, centre), expand(&second, centre));
        let keys = [("dM12_dipole_only", 1), ("dM12_l2", 2), ("dM12_l3", 3)];
        for (k, (key, degree)) in keys.into_iter().enumerate() {
            worst[k] = worst[k].max(relative(body.truncated(degree).change_h(&c1, &c2), complex(&row[key])));
        }
        worst[3] = worst[3].max(relative(body.truncated(1).change_h(&c1, &c1), complex(&row["dM11_dipole_only"])));
        let off = relative(body.truncated(3).change_h(&c1, &c2), complex(&row["dM12"]));
        // The table's own l <= 3 truncation, compared with 51 rings and 1e-8 of quadrature error.
        assert!((off - number(row, "rel_err_l3_12")).abs() < 1e-6, "{centre:?}: {off:e}");
        // More degrees leave a smaller error, down to the accuracy of the table itself.
        let all = relative(body.change_h(&c1, &c2), complex(&row["dM12"]));
        beyond = beyond.max(all);
        assert!(all < 0.5 * off + 1e-7, "{centre:?}: {all:e} after {off:e}");
    }
    println!("worst relative differences: {worst:?}; with all degrees {beyond:e} of the exact values");
    // Expansion by quadrature at a fiftieth of the distance: 1e-8 of the field's size, some of which cancels in the
    // sum.
    assert!(worst.iter().all(|w| *w < 1e-6), "{worst:?}");
}

fn aluminium(radius_m: f64) -> Polarizability {
    let sphere = Sphere { radius_m, conductivity_s_per_m: 3.5e7, relative_permeability: 1.0 };
    Polarizability::sphere(&sphere, 20e3).unwrap()
}

#[test]
fn tables_over_height_hold_the_expansions_and_their_slopes() {
    for array in [CoilArray::em_16_circular().unwrap(), CoilArray::em_16_square().unwrap()] {
        let places = [[0.0, 0.0], [0.03, -0.02], [-0.11, 0.07]];
        let tables = CoilTables::new(&array, &places, [0.010, 0.035], 0.006).unwrap();
        let bodies = vec![aluminium(0.005); 3];
        let mut over = MultipoleArray::new(bodies.clone(), tables, None).unwrap();
        let heights = [0.0123, 0.02, 0.0311];
        let mut changes = vec![Complex::new(0.0, 0.0); over.pairs().len()];
        over.changes(&heights, &mut changes).unwrap();
        let centre = |k: usize| [places[k][0], places[k][1], heights[k]];
        let largest = changes.iter().map(|c| c.norm()).fold(0.0, f64::max);
        for (k, [m, n]) in array.pairs().into_iter().enumerate().step_by(7) {
            let of_body = |b: usize| {
                bodies[b].change_h(&expand(&array.coils()[m], centre(b)), &expand(&array.coils()[n], centre(b)))
            };
            let expected: Complex = (0..3).map(of_body).sum();
            // Sixteen Chebyshev polynomials over 25 mm, 10 mm above the wire.
            assert!((changes[k] - expected).norm() < 1e-7 * largest, "{m} {n}: {:?} {expected:?}", changes[k]);
        }
        let mut slopes = vec![Complex::new(0.0, 0.0); 3 * changes.len()];
        over.slopes(&heights, &mut slopes).unwrap();
        let step = 1e-6;
        let mut moved = |by: f64| {
            let mut changed = changes.clone();
            over.changes(&[heights[0], heights[1] + by, heights[2]], &mut changed).unwrap();
            changed
        };
        let (more, less) = (moved(step), moved(-step));
        let steepest = (0..changes.len()).map(|k| slopes[3 * k + 1].norm()).fold(0.0, f64::max);
        for k in 0..changes.len() {
            let difference = (more[k] - less[k]) * (0.5 / step);
            assert!((difference - slopes[3 * k + 1]).norm() < 1e-5 * steepest, "{k}");
        }
    }
}

#[test]
fn coils_over_each_other_have_tables_of_their_own() {
    let coil = |z: f64| Coil::circular_spiral([0.0, 0.0, z], 0.012, 0.036, 6).unwrap();
    let array = CoilArray::of_coils(vec![coil(0.0), coil(-0.01)]).unwrap();
    let tables = CoilTables::new(&array, &[[0.01, 0.005]], [0.010, 0.025], 0.005).unwrap();
    let mut over = MultipoleArray::new(vec![aluminium(0.004)], tables, None).unwrap();
    let mut changes = [Complex::new(0.0, 0.0)];
    over.changes(&[0.015], &mut changes).unwrap();
    let centre = [0.01, 0.005, 0.015];
    let [upper, lower] = [0, 1].map(|k| expand(&array.coils()[k], centre));
    let expected = aluminium(0.004).change_h(&upper, &lower);
    // Sixteen Chebyshev polynomials over 15 mm, 10 mm above the wire.
    assert!((changes[0] - expected).norm() < 1e-7 * expected.norm(), "{:?} {expected:?}", changes[0]);
}

#[test]
fn mutual_excitation_of_neighbours_agrees_with_a_direct_solution() {
    let array = CoilArray::of_coils(vec![spiral(-0.0375), spiral(0.0375)]).unwrap();
    let places: Vec<[f64; 2]> =
        (0..9).map(|k| [0.02 * ((k % 3) as f64 - 1.0), 0.02 * ((k / 3) as f64 - 1.0)]).collect();
    let changes = |coupling: Option<Coupling>, body: Polarizability| {
        let tables = CoilTables::new(&array, &places, [0.008, 0.03], 0.005).unwrap();
        let mut over = MultipoleArray::new(vec![body; 9], tables, coupling).unwrap();
        let mut changes = [Complex::new(0.0, 0.0)];
        over.changes(&[0.0105; 9], &mut changes).unwrap();
        changes[0]
    };
    let with =
        |degree: usize, sweeps: usize| changes(Some(Coupling { degree, reach_m: 1.0, sweeps }), aluminium(0.005));
    let (alone, settled) = (changes(None, aluminium(0.005)), with(3, 30));
    let (one, two, four) = (with(3, 1), with(3, 2), with(3, 4));
    println!(
        "coupling changes {:.2} %; left after 1, 2, 4 sweeps {:e} {:e} {:e}; degree 1 and 2 {:e} {:e}",
        100.0 * relative(alone, settled),
        relative(one, settled),
        relative(two, settled),
        relative(four, settled),
        relative(with(1, 30), settled),
        relative(with(2, 30), settled)
    );
    // Sweeps converge geometrically to a solution that another sweep does not change.
    assert!(relative(four, settled) < 0.1 * relative(two, settled) && relative(with(3, 31), settled) < 1e-12);
    // Two distant dipoles: the closed form d = alpha (H + G d) with the dipole field G, in the limit of degree 1.
    let far = |x: f64| {
        let places = [[0.0, 0.0], [x, 0.0]];
        let tables = CoilTables::new(&array, &places, [0.008, 0.03], 0.005).unwrap();
        let coupling = Some(Coupling { degree: 1, reach_m: 1.0, sweeps: 30 });
        let body = aluminium(0.005).truncated(1);
        let mut over = MultipoleArray::new(vec![body; 2], tables, coupling).unwrap();
        let mut changes = [Complex::new(0.0, 0.0)];
        over.changes(&[0.015; 2], &mut changes).unwrap();
        changes[0]
    };
    let x: f64 = 0.03;
    let sphere = Sphere { radius_m: 0.005, conductivity_s_per_m: 3.5e7, relative_permeability: 1.0 };
    let alpha = sphere.polarizability_m3(20e3).unwrap();
    let field = |coil: &Coil, at: f64| coil.flux_density([at, 0.0, 0.015]).map(|b| b / MU0);
    // Components along the line couple by 2/(4 pi x^3), those across it by -1/(4 pi x^3).
    let g = |axis: usize| if axis == 0 { 2.0 } else { -1.0 } / (4.0 * std::f64::consts::PI * x.powi(3));
    let (first, second) = (&array.coils()[0], &array.coils()[1]);
    let expected: Complex = (0..3)
        .map(|axis| {
            let (h1, h2) = (field(second, 0.0)[axis], field(second, x)[axis]);
            // m1 = alpha (h1 + g m2), m2 = alpha (h2 + g m1).
            let determinant = Complex::new(1.0, 0.0) - alpha * alpha * (g(axis) * g(axis));
            let m1 = (alpha * h1 + alpha * alpha * (g(axis) * h2)) / determinant;
            let m2 = (alpha * h2 + alpha * alpha * (g(axis) * h1)) / determinant;
            (m1 * field(first, 0.0)[axis] + m2 * field(first, x)[axis]) * MU0
        })
        .sum();
    assert!(relative(far(x), expected) < 1e-7, "{:?} {expected:?}", far(x));
}

#[test]
fn impossible_input_is_refused_with_its_numbers() {
    let near = CoilArray::of_coils(vec![spiral(0.0), spiral(0.06)]).unwrap_err();
    assert!(matches!(near, MitError::CoilsOverlap { first: 1, second: 2, .. }), "{near}");
    assert!(CoilArray::of_coils(Vec::new()).is_err());
    let nowhere = CoilArray::of_coils(vec![spiral(f64::NAN)]).unwrap_err();
    assert!(nowhere.to_string().contains("NaN"), "{nowhere}");
    assert!(Coil::circular_spiral([0.0; 3], 0.07, 0.03, 51).is_err());
    assert!(Coil::circular_spiral([0.0; 3], 0.03, 0.07, 0).is_err());
    let array = CoilArray::em_8().unwrap();
    assert_eq!(array.pairs().len(), 28);
    let inside = CoilTables::new(&array, &[[0.062, 0.045]], [0.001, 0.03], 0.007).unwrap_err();
    assert!(matches!(inside, MitError::WireInside { body: 1, .. }), "{inside}");
    assert!(CoilTables::new(&array, &[[f64::NAN, 0.0]], [0.01, 0.03], 0.006).is_err());
    let tables = CoilTables::new(&array, &[[0.0, 0.0], [0.008, 0.0]], [0.01, 0.03], 0.006).unwrap();
    let coupling = Some(Coupling { degree: 1, reach_m: 0.1, sweeps: 1 });
    let overlap = MultipoleArray::new(vec![aluminium(0.005); 2], tables.clone(), coupling).unwrap_err();
    assert!(matches!(overlap, MitError::BodiesOverlap { first: 1, second: 2, .. }), "{overlap}");
    // Bodies that do not excite each other may come closer, but must not overlap.
    let inside = MultipoleArray::new(vec![aluminium(0.005); 2], tables.clone(), None).unwrap_err();
    assert!(matches!(inside, MitError::BodiesOverlap { distance_m: 0.008, .. }), "{inside}");
    let mut bodies = MultipoleArray::new(vec![aluminium(0.003); 2], tables, None).unwrap();
    let mut changes = vec![Complex::new(0.0, 0.0); 28];
    assert!(matches!(bodies.changes(&[0.02, 0.04], &mut changes), Err(MitError::OutsideTable { body: 2, .. })));
    assert!(bodies.changes(&[0.02], &mut changes).is_err());
    let sphere = Sphere { radius_m: 0.005, conductivity_s_per_m: 3.5e7, relative_permeability: 1.0 };
    assert!(sphere.responses(0.1, 1).is_err() && sphere.responses(2e6, 1).is_err());
    assert!(Sphere { conductivity_s_per_m: 0.0, ..sphere }.responses(1e3, 1).is_err());
    assert!(Polarizability::from_tau("x", 0.005, vec![Complex::new(0.0, 0.0); 3]).is_err());
    let mut lopsided = vec![Complex::new(0.0, 0.0); HARMONICS * HARMONICS];
    lopsided[1] = Complex::new(1.0, 0.0);
    assert!(Polarizability::from_tau("x", 0.005, lopsided).is_err());
    assert!(matches!(spiral(0.0).filaments()[0], Filament::Ring(_)));
}
