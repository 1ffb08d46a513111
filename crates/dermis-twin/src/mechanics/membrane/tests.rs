use dermis_tomo::mesh::{Mesh, Outline, SheetSpec};

use super::*;
use crate::mechanics::{Load, Shape};

const RADIUS: f64 = 0.087;
const SHARP: Cover = Cover { smoothing_m: 2e-4 };

fn disc(element_size_m: f64) -> Mesh {
    SheetSpec::new(Outline::Disc { radius_m: RADIUS }, Vec::new(), element_size_m).build(&[]).unwrap().0.mesh
}

fn weightless(tension: f64) -> MembraneSpec {
    MembraneSpec { tension_n_per_m: tension, density_kg_per_m3: 0.0, gravity_m_per_s2: [0.0; 3] }
}

fn pressed(membrane: &mut Membrane, indenters: &[Indenter]) -> Vec<f64> {
    let mut load = vec![0.0; membrane.positions_m().len()];
    indenters.iter().for_each(|indenter| membrane.add_load(indenter, SHARP, &mut load));
    membrane.deflect(&load);
    membrane.deflection_m().to_vec()
}

/// Largest difference from a function of radius and height above the centre, relative to its largest value.
fn worst(membrane: &Membrane, w: &[f64], exact: impl Fn(f64, f64) -> f64) -> f64 {
    let values: Vec<f64> = membrane.positions_m().iter().map(|p| exact(p[0].hypot(p[1]), p[1])).collect();
    let scale = values.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
    values.iter().zip(w).map(|(exact, w)| (exact - w).abs()).fold(0.0, f64::max) / scale
}

#[test]
fn a_disc_pressed_in_the_middle_is_the_closed_form() {
    let (tension, a, p) = (40.0, 0.02, 500.0);
    let mut membrane = Membrane::new(&disc(2.5e-3), weightless(tension)).unwrap();
    let w = pressed(&mut membrane, &[Indenter::disc([0.0; 2], a, p)]);
    // T (r w')' / r = -p H(a - r) + c, w(R) = 0: outside, w = p a^2 / (2T) ln(R/r) - c (R^2 - r^2) / (4T);
    // inside, w = p (a^2 - r^2) / (4T) + p a^2 / (2T) ln(R/a) - c (R^2 - r^2) / (4T).
    // The volumes pi p a^2 (2 R^2 - a^2) / (8T) of the press and pi c R^4 / (8T) of the bowl cancel.
    let c = p * a * a * (2.0 * RADIUS * RADIUS - a * a) / RADIUS.powi(4);
    let exact = |r: f64, _: f64| {
        let bowl = c * (RADIUS * RADIUS - r * r) / (4.0 * tension);
        let log = p * a * a / (2.0 * tension) * (RADIUS / r.max(a)).ln();
        log + if r < a { p * (a * a - r * r) / (4.0 * tension) } else { 0.0 } - bowl
    };
    let error = worst(&membrane, &w, exact);
    let pressure_error = membrane.liquid_pressure_pa() / c - 1.0;
    println!("closed form of a pressed disc: {error:e} of its largest deflection, c off by {pressure_error:e}");
    // Linear elements of 1/8 of the indenter's radius: second order; the polygonal rim misses 0.1 % of the area.
    assert!(error < 5e-3, "{error}");
    assert!(pressure_error.abs() < 5e-3, "{pressure_error}");
}

#[test]
fn liquid_is_conserved_under_any_press() {
    let gravity = MembraneSpec { density_kg_per_m3: 1000.0, gravity_m_per_s2: [3.0, -4.0, -8.0], ..weightless(60.0) };
    let mut membrane = Membrane::new(&disc(5e-3), gravity).unwrap();
    let ring = Shape::Ring { inner_m: 0.03, outer_m: 0.033 };
    let line = Shape::Line { length_m: 0.05, width_m: 0.003, angle_rad: 1.0 };
    let indenters = [
        Indenter::weight([0.03, 0.01], 0.01, 26.0),
        Indenter { centre_m: [-0.01, 0.0], shape: ring, load: Load::ForceN(0.5) },
        Indenter { centre_m: [0.0, -0.04], shape: line, load: Load::ForceN(0.3) },
        Indenter::weight([0.08, 0.0], 0.01, 26.0),
    ];
    for count in 0..=indenters.len() {
        pressed(&mut membrane, &indenters[..count]);
        let share = membrane.volume_m3() / membrane.displaced_m3();
        assert!(share.abs() < 1e-10, "{count} indenters: {share:e}");
    }
}

#[test]
fn a_standing_skin_bulges_as_in_the_closed_form() {
    let (tension, density, g) = (60.0, 1000.0, 9.81);
    let standing = MembraneSpec { density_kg_per_m3: density, gravity_m_per_s2: [0.0, -g, 0.0], ..weightless(tension) };
    let membrane = Membrane::new(&disc(4e-3), standing).unwrap();
    // T lap w = -rho g y, w = 0 at R: w = rho g y (R^2 - r^2) / (8T). It is odd in y, so c = 0.
    let exact = |r: f64, y: f64| density * g * y * (RADIUS * RADIUS - r * r) / (8.0 * tension);
    let error = worst(&membrane, membrane.deflection_m(), exact);
    println!("closed form of a standing skin: {error:e} of the largest bulge");
    assert!(error < 1e-2, "{error}");
    // Positive w points into the liquid: the lower half bulges out, by 5 mm at this tension.
    let lowest = membrane.deflection_m().iter().copied().fold(0.0, f64::min);
    assert!((lowest + 5.18e-3).abs() < 0.1e-3, "{lowest}");
}

#[test]
fn the_liquids_weight_stiffens_a_skin_face_up_and_bursts_a_slack_one_face_down() {
    let lying = MembraneSpec { density_kg_per_m3: 1000.0, gravity_m_per_s2: [0.0, 0.0, -9.81], ..weightless(30.0) };
    let deepest = |spec| {
        let mut membrane = Membrane::new(&disc(4e-3), spec).unwrap();
        pressed(&mut membrane, &[Indenter::weight([0.0; 2], 0.01, 26.0)]).into_iter().fold(0.0, f64::max)
    };
    let hanging = MembraneSpec { gravity_m_per_s2: [0.0, 0.0, 9.81], ..lying };
    assert!(deepest(lying) < deepest(weightless(30.0)) && deepest(weightless(30.0)) < deepest(hanging));
    // The first mode is stable as long as T (2.405/R)^2 > rho g: 12.8 N/m.
    let slack = |tension| Membrane::new(&disc(4e-3), MembraneSpec { tension_n_per_m: tension, ..hanging });
    assert!(slack(13.5).is_ok());
    assert!(matches!(slack(12.0), Err(dermis_tomo::sparse::SparseError::NotPositiveDefinite { .. })));
}

#[test]
fn loads_carry_their_force_and_superpose() {
    let mut membrane = Membrane::new(&disc(4e-3), weightless(50.0)).unwrap();
    let one = Indenter::weight([0.03, -0.02], 0.01, 6.5);
    let other = Indenter::weight([-0.05, 0.01], 0.01, 13.0);
    let mut load = vec![0.0; membrane.positions_m().len()];
    membrane.add_load(&one, Cover { smoothing_m: 0.5e-3 }, &mut load);
    // Nine points per triangle of 4 mm, with an edge smoothed over half a millimetre: errors average out along the
    // edge.
    assert!((load.iter().sum::<f64>() / one.force_n() - 1.0).abs() < 2e-3);
    let (a, b) = (pressed(&mut membrane, &[one]), pressed(&mut membrane, &[other]));
    let both = pressed(&mut membrane, &[one, other]);
    let error = both.iter().zip(a.iter().zip(&b)).map(|(w, (a, b))| (w - a - b).abs()).fold(0.0, f64::max);
    assert!(error < 1e-12, "{error}");
}

#[test]
fn bad_input_is_refused_by_name() {
    let error = check_membrane(&weightless(-1.0)).unwrap_err().to_string();
    assert_eq!(error, "tension_n_per_m: -1 refused; expected zero (an open tank) or more, finite");
    let gravity = MembraneSpec { gravity_m_per_s2: [f64::NAN, 0.0, 0.0], ..weightless(1.0) };
    assert!(check_membrane(&gravity).is_err() && Membrane::new(&disc(0.02), gravity).is_err());
}

#[test]
fn an_open_tank_yields_to_pressure_and_conserves_its_liquid() {
    let open = MembraneSpec { density_kg_per_m3: 1000.0, gravity_m_per_s2: [0.0, 0.0, -9.81], ..weightless(0.0) };
    let mut tank = Membrane::new(&disc(4e-3), open).unwrap();
    let (radius_m, pressure_pa) = (0.03, 20.0);
    let w = pressed(&mut tank, &[Indenter::disc([0.0; 2], radius_m, pressure_pa)]);
    // p = rho g w + c: down by 2.04 mm, minus the rise of the whole surface, which is the share of the area.
    let share = (radius_m / RADIUS).powi(2);
    for (position, w) in tank.positions_m().iter().zip(&w) {
        let distance = position[0].hypot(position[1]);
        let pressed = f64::from(u8::from(distance < radius_m));
        if (distance - radius_m).abs() > 8e-3 {
            let exact = pressure_pa / 9810.0 * (pressed - share);
            assert!((w - exact).abs() < 0.01 * pressure_pa / 9810.0, "{distance}: {w} {exact}");
        }
    }
    assert!(tank.volume_m3().abs() < 1e-15);
    // In a tilted tank the surface stays level.
    let tilted = MembraneSpec { gravity_m_per_s2: [1.0, 0.0, -9.75], ..open };
    let tank = Membrane::new(&disc(4e-3), tilted).unwrap();
    for (position, w) in tank.positions_m().iter().zip(tank.deflection_m()) {
        // A lumped mass averages over a node's triangles: half an element at the rim.
        assert!((w + position[0] / 9.75).abs() < 3e-3 / 9.75, "{position:?} {w}");
    }
    for gravity_m_per_s2 in [[0.0; 3], [0.0, -9.81, 0.0], [0.0, 0.0, 9.81]] {
        let error = check_membrane(&MembraneSpec { gravity_m_per_s2, ..open }).unwrap_err().to_string();
        assert!(error.starts_with("gravity_m_per_s2 along z: ") && error.contains("open tank"), "{error}");
    }
}
