//! Compares sensitivities by reciprocity with finite differences of closed forms and of edge elements.

use std::f64::consts::TAU;

use dermis_mit::edge::{Dipole, EddySystem, Harmonic, Material, Order, Sensitivity, Source, box_mesh};
use dermis_mit::sensitivity::{Sensitivities, VoxelLayer};
use dermis_mit::{
    Coil, CoilArray, CoilTables, Complex, ConductingPlate, HARMONICS, MU0, MitError, MultipoleArray, Polarizability,
    RoundWinding, Sphere,
};

fn relative(found: Complex, expected: Complex) -> f64 {
    (found - expected).norm() / expected.norm()
}

/// Derivative at a point by fourth-order differences.
fn slope(of: impl Fn(f64) -> Complex, at: f64, step: f64) -> Complex {
    let odd = |by: f64| of(at + by) - of(at - by);
    (odd(step) * 8.0 - odd(2.0 * step)) / (12.0 * step)
}

fn pair_of_coils() -> CoilArray {
    let coil = |x: f64, outer: f64| Coil::circular_spiral([x, 0.0, 0.0], 0.03, outer, 2).unwrap();
    CoilArray::of_coils(vec![coil(-0.025, 0.04), coil(0.025, 0.046)]).unwrap()
}

/// A wide layer: voxels around the coils, surrounded by four strips of a square three times as wide, repeatedly.
fn wide_layer(array: &CoilArray, low_m: f64, high_m: f64) -> [f64; 2] {
    let mut sums = [0.0; 2];
    let mut add = |x: [f64; 2], y: [f64; 2], counts: [usize; 3]| {
        let layer = VoxelLayer::new([x[0], y[0], low_m], [x[1], y[1], high_m], counts).unwrap();
        let found = layer.with_points(4).unwrap().sensitivities(array).unwrap();
        sums[0] += found.potentials().iter().sum::<f64>();
        sums[1] += found.fields().iter().sum::<f64>();
    };
    let mut half = 0.06;
    add([-half, half], [-half, half], [27, 27, 1]);
    for _ in 0..6 {
        let wide = 3.0 * half;
        add([-wide, wide], [-wide, -half], [27, 9, 1]);
        add([-wide, wide], [half, wide], [27, 9, 1]);
        add([-wide, -half], [-half, half], [9, 9, 1]);
        add([half, wide], [-half, half], [9, 9, 1]);
        half = wide;
    }
    sums
}

#[test]
fn voxels_of_a_wide_layer_add_up_to_the_derivatives_of_a_plate_in_closed_form() {
    let (array, low_m, high_m, frequency_hz) = (pair_of_coils(), 0.010, 0.012, 1e3);
    let [potentials, fields] = wide_layer(&array, low_m, high_m);
    // Seen from above, a plate over the coils is equivalent to a plate under them.
    let windings: Vec<RoundWinding> = array
        .coils()
        .iter()
        .map(|coil| RoundWinding::of_coil(&coil.clone().moved([0.0, 0.0, high_m])).unwrap())
        .collect();
    let plate = |conductivity_s_per_m: f64, relative_permeability: f64| {
        let plate = ConductingPlate {
            face_z_m: high_m - low_m,
            thickness_m: Some(high_m - low_m),
            conductivity_s_per_m,
            relative_permeability,
        };
        plate.change_h(&windings[0], &windings[1], frequency_hz).unwrap()
    };
    let by_conductivity = slope(|sigma| plate(sigma, 1.0), 1.0, 0.1);
    let found = Complex::new(0.0, -TAU * frequency_hz * potentials);
    println!("by conductivity {:e}", relative(found, by_conductivity));
    assert!(relative(found, by_conductivity) < 1e-5, "{found:?} {by_conductivity:?}");
    let by_permeability = slope(|mu_r| plate(1e-6, mu_r), 1.0, 1e-3) / MU0;
    println!("by permeability {:e}", relative(Complex::new(fields, 0.0), by_permeability));
    assert!(relative(Complex::new(fields, 0.0), by_permeability) < 1e-5, "{fields:?} {by_permeability:?}");
}

/// Points of a ball with volumes: Gauss-Legendre with eight points in radius and cosine, sixteen around.
fn ball(radius_m: f64) -> Vec<([f64; 3], f64)> {
    const RULE: [(f64, f64); 4] = [
        (0.183_434_642_495_649_8, 0.362_683_783_378_362),
        (0.525_532_409_916_329, 0.313_706_645_877_887_3),
        (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
        (0.960_289_856_497_536_3, 0.101_228_536_290_376_3),
    ];
    let rule: Vec<(f64, f64)> = RULE.iter().flat_map(|&(x, w)| [(-x, w), (x, w)]).collect();
    let mut points = Vec::new();
    for &(u, wr) in &rule {
        let r = 0.5 * radius_m * (1.0 + u);
        for &(cosine, wc) in &rule {
            for k in 0..16 {
                let (s, c) = (TAU * f64::from(k) / 16.0).sin_cos();
                let sine = (1.0_f64 - cosine * cosine).sqrt();
                let volume = 0.5 * radius_m * wr * wc * TAU / 16.0 * r * r;
                points.push(([r * sine * c, r * sine * s, r * cosine], volume));
            }
        }
    }
    points
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| a[k] * b[k]).sum()
}

#[test]
fn a_weak_sphere_answers_each_harmonic_by_the_integral_of_its_field() {
    let (radius_m, frequency_hz) = (0.005, 1e3);
    let tau = |conductivity_s_per_m: f64, relative_permeability: f64, i: usize| {
        let sphere = Sphere { radius_m, conductivity_s_per_m, relative_permeability };
        Polarizability::sphere(&sphere, frequency_hz).unwrap().tau()[i * (HARMONICS + 1)]
    };
    let points = ball(radius_m);
    for i in 0..HARMONICS {
        let harmonic = Harmonic::new(i).unwrap();
        let sum = |of: &dyn Fn([f64; 3]) -> [f64; 3]| points.iter().map(|(p, v)| v * dot(of(*p), of(*p))).sum::<f64>();
        // The potential of a harmonic has no radial component, so its currents follow it as in a layer without
        // bounds.
        let potentials = sum(&|p| harmonic.vector_potential(p));
        let found = Complex::new(0.0, -TAU * frequency_hz * potentials);
        let expected = slope(|sigma| tau(sigma, 1.0, i), 10.0, 1.0);
        assert!(relative(found, expected) < 1e-5, "{i}: {found:?} {expected:?}");
        let fields = sum(&|p| harmonic.flux_density(p)) / (MU0 * MU0);
        let expected = slope(|mu_r| tau(1e-3, mu_r, i), 1.0, 1e-3) / MU0;
        assert!(relative(Complex::new(fields, 0.0), expected) < 1e-5, "{i}: {fields:e} {expected:?}");
    }
}

#[test]
fn slopes_by_height_of_a_weak_body_agree_with_its_sensitivity() {
    let array = pair_of_coils();
    let (radius_m, place, height) = (0.0025, [0.004, 0.003], 0.02);
    let sphere = Sphere { radius_m, conductivity_s_per_m: 1e-3, relative_permeability: 1.0 + 1e-6 };
    let tables = CoilTables::new(&array, &[place], [0.012, 0.03], radius_m).unwrap();
    let mut bodies = MultipoleArray::new(vec![Polarizability::sphere(&sphere, 1e3).unwrap()], tables, None).unwrap();
    let mut slopes = [Complex::new(0.0, 0.0)];
    bodies.slopes(&[height], &mut slopes).unwrap();
    let points = ball(radius_m);
    let at = |z: f64| {
        let product = |p: [f64; 3]| {
            let p = [p[0] + place[0], p[1] + place[1], p[2] + z];
            dot(array.coils()[0].flux_density(p), array.coils()[1].flux_density(p))
        };
        let sum: f64 = points.iter().map(|(p, v)| v * product(*p)).sum();
        Complex::new(sum / (MU0 * MU0) * 1e-6 * MU0, 0.0)
    };
    let expected = slope(at, height, 1e-4);
    println!("{:e}", relative(slopes[0], expected));
    // Degrees above 3, at 2.5 mm and 20 mm: slightly more than (1/8)^6.
    assert!(relative(slopes[0], expected) < 1e-5, "{:?} {expected:?}", slopes[0]);
}

/// Two adjacent blocks of different materials in air, between dipoles.
fn blocks(materials: [Material; 2]) -> (Vec<Complex>, Vec<Sensitivity>) {
    let axis = vec![-0.02, -0.004, 0.0, 0.004, 0.02];
    let inside = |p: [f64; 3]| u8::from(p.iter().all(|x| x.abs() < 0.004)) * if p[0] < 0.0 { 1 } else { 2 };
    let mesh = box_mesh(&[axis.clone(), axis.clone(), axis], inside).unwrap();
    let system = EddySystem::new(&mesh, &materials, 2e3, Order::Second).unwrap();
    let dipole = |position_m, moment| Dipole { position_m, moment };
    let (a, b) = (dipole([0.002, 0.01, 0.02], [0.3, 0.0, 1.0]), dipole([-0.015, 0.0, 0.018], [0.0, 0.5, 1.0]));
    let sources: [&dyn Source; 2] = [&a, &b];
    let fields = system.solve(&sources).unwrap();
    (fields.changes_h().to_vec(), fields.sensitivities(&sources).unwrap())
}

#[test]
fn materials_of_bodies_change_edge_elements_as_their_sensitivities_say() {
    let base = [
        Material { conductivity_s_per_m: 2e7, relative_permeability: 2.0 },
        Material { conductivity_s_per_m: 1e6, relative_permeability: 5.0 },
    ];
    let (_, sensitivities) = blocks(base);
    let step = 0.02;
    for region in 0..2 {
        let with = |factor: f64, is_conductivity: bool| {
            let mut materials = base;
            if is_conductivity {
                materials[region].conductivity_s_per_m *= factor;
            } else {
                materials[region].relative_permeability *= factor;
            }
            blocks(materials).0
        };
        for is_conductivity in [true, false] {
            let [more, less, most, least] =
                [step, -step, 2.0 * step, -2.0 * step].map(|by| with(1.0 + by, is_conductivity));
            let unit = if is_conductivity {
                base[region].conductivity_s_per_m
            } else {
                base[region].relative_permeability * MU0
            };
            for pair in 0..4 {
                let difference = ((more[pair] - less[pair]) * 8.0 - (most[pair] - least[pair])) / (12.0 * step * unit);
                let of = sensitivities[pair * 2 + region];
                let found = if is_conductivity { of.by_conductivity } else { of.by_permeability };
                // Fourth-order differences over 2 % are accurate to 1e-7; the iteration stops at 1e-8 of the field.
                assert!(
                    relative(found, difference) < 1e-5,
                    "body {region}, pair {pair}, conductivity {is_conductivity}: {found:?} {difference:?}"
                );
            }
        }
    }
}

#[test]
fn every_pair_has_its_row_and_every_voxel_its_column() {
    let array = CoilArray::em_8().unwrap();
    let layer = VoxelLayer::new([-0.05, -0.04, 0.01], [0.05, 0.04, 0.02], [20, 16, 2]).unwrap();
    let all: Sensitivities = layer.sensitivities(&array).unwrap();
    assert_eq!((all.pairs().len(), all.voxel_count(), all.potentials().len()), (28, 640, 28 * 640));
    let centre = layer.centre_m(64).unwrap();
    assert!((0..3).all(|k| (centre[k] - [-0.0275, -0.0225, 0.0125][k]).abs() < 1e-12), "{centre:?}");
    assert_eq!(layer.centre_m(640), None);
    // One pair in one voxel, using only its centre.
    let (pair, voxel) = (17, 423);
    let one = layer.clone().with_points(1).unwrap().sensitivities(&array).unwrap();
    let [m, n] = all.pairs()[pair];
    let p = layer.centre_m(voxel).unwrap();
    let volume: f64 = layer.voxel_m().iter().product();
    let product = dot(array.coils()[m].vector_potential(p), array.coils()[n].vector_potential(p));
    let at = pair * 640 + voxel;
    assert!((one.potentials()[at] / (product * volume) - 1.0).abs() < 1e-12);
    let w = TAU * 2e4;
    let (by_m, by_z) = (all.inductance_by_conductivity(2e4)[at], all.impedance_by_conductivity(2e4)[at]);
    assert!((by_m * Complex::new(0.0, w) - by_z).norm() < 1e-12 * by_z.abs());
}

#[test]
fn layers_that_hold_wire_are_refused() {
    let array = pair_of_coils();
    let through = VoxelLayer::new([-0.05, -0.05, -0.005], [0.05, 0.05, 0.005], [50, 50, 5]).unwrap();
    let refused = through.sensitivities(&array).map(|_| ()).unwrap_err();
    assert!(matches!(refused, MitError::WireInVoxel { .. }), "{refused}");
    assert!(VoxelLayer::new([0.0; 3], [0.1, 0.1, -0.1], [1, 1, 1]).is_err());
    assert!(VoxelLayer::new([0.0; 3], [0.1, 0.1, 0.1], [1, 0, 1]).is_err());
    assert!(through.with_points(0).is_err());
}
