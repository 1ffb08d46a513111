//! Unpublished skins: each kind on its own outline, with its own electrodes, elements and coils.

use std::f64::consts::TAU;

use dermis_mit::{Coil, CoilArray, Coupling, Sphere};
use dermis_tomo::eit::{Drive, Driven, Measure, Order, Pattern, Protocol, ProtocolSpec};
use dermis_tomo::mesh::{Direction, ElectrodeShape, Outline};
use dermis_twin::mechanics::{ContactLaw, Cover, Indenter, Load, Memory, Shape, Springs};
use dermis_twin::physics::{Cut, PatchLayout};
use dermis_twin::{
    Conductor, ElectrodedLayer, ElementOptions, ElementSkin, Frontend, LiquidOptions, LiquidSkin, LiquidSolver,
    PatchedOptions, PatchedSkin, Sandwich, SandwichOptions, SheetOptions, SheetSkin, Treatment, Twin, TwinError,
    TwinOptions,
};

const CONTACT: ContactLaw =
    ContactLaw { threshold_pa: 1e3, reference_pa: 20e3, exponent: 1.5, saturation_s_per_m2: 500.0 };

fn protocol(electrode_count: usize) -> Protocol {
    let (drive, measure) = (Drive::Skip(2), Measure::Skip(2));
    let (order, driven, amplitude_a) = (Order::Absolute, Driven::Drop, 1e-3);
    Protocol::generate(&ProtocolSpec { electrode_count, drive, measure, order, driven, amplitude_a }).unwrap()
}

fn read(skin: &mut impl Frontend, indenters: &[Indenter]) -> Vec<f64> {
    let mut frame = vec![0.0; skin.channel_count()];
    skin.voltages(indenters, 0.1, &mut frame).unwrap();
    assert!(frame.iter().all(|v| v.is_finite()));
    frame
}

fn norm(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>().sqrt()
}

fn minus(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

/// Change of a frame under a press, relative to the frame at rest; also checks that the skin recovers completely.
fn change(skin: &mut impl Frontend, indenters: &[Indenter]) -> f64 {
    let rest = read(skin, &[]);
    let pressed = read(skin, indenters);
    assert_eq!(read(skin, &[]), rest, "a skin without memory forgets");
    norm(&minus(&pressed, &rest)) / norm(&rest)
}

/// Largest difference of channels with driven and measured pairs swapped, relative to the largest voltage.
fn asymmetry(protocol: &Protocol, frame: &[f64]) -> f64 {
    // Up to a common sign and scale.
    let key = |pattern: &Pattern| -> Vec<(u32, i32)> {
        let first = pattern.entries()[0].1.signum();
        pattern.entries().iter().map(|entry| (entry.0, (first * entry.1.signum()) as i32)).collect()
    };
    let sign = |pattern: &Pattern| pattern.entries()[0].1.signum();
    let channels: Vec<_> = (0..frame.len()).map(|c| (protocol.stimulation_of(c), protocol.pattern_of(c))).collect();
    let (mut worst, mut pairs) = (0.0_f64, 0);
    for (a, (drive, measure)) in channels.iter().enumerate() {
        let swapped = |other: &(&Pattern, &Pattern)| key(other.0) == key(measure) && key(other.1) == key(drive);
        let Some(b) = channels.iter().position(swapped) else { continue };
        let value = |at: usize| sign(channels[at].0) * sign(channels[at].1) * frame[at];
        (worst, pairs) = (worst.max((value(a) - value(b)).abs()), pairs + 1);
    }
    assert!(pairs > frame.len() / 2, "{pairs} of {} channels have a partner", frame.len());
    worst / frame.iter().fold(0.0, |most: f64, v| most.max(v.abs()))
}

fn disc(x_mm: f64, y_mm: f64, pressure_pa: f64) -> Indenter {
    Indenter::disc([1e-3 * x_mm, 1e-3 * y_mm], 8e-3, pressure_pa)
}

fn loop_of(count: usize, [a_m, b_m]: [f64; 2]) -> Vec<[f64; 2]> {
    (0..count).map(|k| TAU * k as f64 / count as f64).map(|turn| [a_m * turn.cos(), b_m * turn.sin()]).collect()
}

fn refusal(skin: impl Frontend + 'static, x_m: f64, y_m: f64) -> String {
    let mut twin = Twin::of(skin, &TwinOptions::default()).unwrap().boxed();
    let press = Indenter::disc([x_m, y_m], 5e-3, 1e3);
    assert!(twin.frontend().check_indenter(&press).is_err());
    twin.scene_mut().press_with(1, press).unwrap_err().to_string()
}

fn strip() -> SheetOptions {
    let outline = Outline::Rectangle { width_m: 0.15, height_m: 0.06 };
    SheetOptions {
        layer: ElectrodedLayer {
            electrodes: outline.rim_segments(20, 6e-3, 0.01, Direction::CounterClockwise),
            outline,
            contact_impedances_ohm_m2: (0..20).map(|k| 1e-3 * (1.0 + 0.1 * f64::from(k))).collect(),
            protocol: protocol(20),
            conductance: Default::default(),
            element_size_m: 5e-3,
            electrode_element_size_m: 2e-3,
        },
        sheet_s: 1e-3,
        pressure_coefficient_per_pa: 0.0,
        gauge_factor: 2.0,
        modulus_pa: 100e3,
        cover: Cover { smoothing_m: 2e-3 },
        memory: None,
    }
}

#[test]
fn a_strip_of_gel_obeys_its_law() {
    let mut skin = SheetSkin::new(strip()).unwrap();
    assert!(change(&mut skin, &[disc(40.0, 10.0, 20e3)]) > 1e-3);
    let pressed = read(&mut skin, &[disc(40.0, 10.0, 20e3), disc(-30.0, -5.0, 10e3)]);
    assert!(asymmetry(skin.stimulation(), &pressed) < 1e-12);
    // With the whole skin under one pressure, every reading minus the contacts' share grows like the sheet's
    // resistance.
    let all = |pressure_pa: f64| {
        let shape = Shape::Rectangle { width_m: 0.3, height_m: 0.3, angle_rad: 0.0 };
        Indenter { centre_m: [0.0; 2], shape, load: Load::PressurePa(pressure_pa) }
    };
    for (pressure_pa, factor) in [(20e3, (-0.4_f64).exp()), (1e6, 0.02)] {
        read(&mut skin, &[all(pressure_pa)]);
        assert!(skin.conductance_s().iter().all(|s| (s / (1e-3 * factor) - 1.0).abs() < 1e-9), "{pressure_pa}");
    }
    // Small presses add up, and a fabric's coefficient raises what thinning lowers.
    let rest = read(&mut skin, &[]);
    let (one, other) = (disc(40.0, 10.0, 5.0), disc(-50.0, -10.0, 5.0));
    let [first, second, both] =
        [vec![one], vec![other], vec![one, other]].map(|presses| minus(&read(&mut skin, &presses), &rest));
    let sum: Vec<f64> = first.iter().zip(&second).map(|(a, b)| a + b).collect();
    assert!(norm(&minus(&both, &sum)) < 1e-3 * norm(&sum));
    let even = SheetOptions { pressure_coefficient_per_pa: 2.0 / 100e3, ..strip() };
    assert!(change(&mut SheetSkin::new(even).unwrap(), &[disc(0.0, 0.0, 20e3)]) < 1e-12);
}

#[test]
fn a_strip_of_gel_is_cut_remembers_and_refuses() {
    let mut skin = SheetSkin::new(strip()).unwrap();
    let rest = read(&mut skin, &[]);
    skin.treat(&Treatment::Cut(Cut::open([0.0, -0.02], [0.0, 0.02]))).unwrap();
    assert!(norm(&minus(&read(&mut skin, &[]), &rest)) > 0.05 * norm(&rest));
    assert_eq!(skin.wounds().len(), 1);
    skin.treat(&Treatment::Renew).unwrap();
    assert_eq!(read(&mut skin, &[]), rest);
    let heat = dermis_twin::Heating { centre_m: [0.0; 2], radius_m: 0.01, temperature_c: 80.0, duration_s: 60.0 };
    assert!(matches!(skin.treat(&Treatment::Heat(heat)), Err(TwinError::NotTreatable)));
    let memory = Some(Memory { share: 0.5, time_constant_s: 1.0 });
    let mut late = SheetSkin::new(SheetOptions { memory, ..strip() }).unwrap();
    read(&mut late, &[disc(0.0, 0.0, 20e3)]);
    assert_ne!(read(&mut late, &[]), rest, "the memory goes on");
    assert!(refusal(skin, 0.0, 0.031).starts_with("y of the indenter, m: 0.031"));
    let refused = |options: SheetOptions| SheetSkin::new(options).unwrap_err().to_string();
    assert_eq!(
        refused(SheetOptions { modulus_pa: 0.0, ..strip() }),
        "modulus_pa: 0 refused; expected positive and finite"
    );
    let mut many = strip();
    many.layer.protocol = protocol(16);
    let error = refused(many);
    assert_eq!(error, "electrodes: 20 refused; expected 16, as the protocol has");
}

#[test]
fn a_sandwich_may_be_an_l() {
    let corner = |x_mm: f64, y_mm: f64| [1e-3 * x_mm, 1e-3 * y_mm];
    let outer = [[0.0, 0.0], [120.0, 0.0], [120.0, 50.0], [50.0, 50.0], [50.0, 120.0], [0.0, 120.0]];
    let outline = Outline::Polygon { outer: outer.map(|[x, y]| corner(x, y)).to_vec(), holes: Vec::new() };
    let mut skin = Sandwich::new(SandwichOptions {
        layer: ElectrodedLayer {
            electrodes: outline.rim_segments(24, 6e-3, 0.01, Direction::CounterClockwise),
            outline,
            contact_impedances_ohm_m2: vec![0.05],
            protocol: protocol(24),
            conductance: Default::default(),
            element_size_m: 5e-3,
            electrode_element_size_m: 2e-3,
        },
        sheet_s: 2e-3,
        shortcut_s: 1e3,
        cover: Cover { smoothing_m: 2e-3 },
        contact: CONTACT,
        memory: None,
        healing: None,
    })
    .unwrap();
    assert!(change(&mut skin, &[disc(25.0, 90.0, 40e3)]) > 1e-2);
    let presses = [disc(25.0, 90.0, 40e3), disc(90.0, 25.0, 20e3)];
    let both = read(&mut skin, &presses);
    assert!(asymmetry(skin.stimulation(), &both) < 1e-9);
    let rest = read(&mut skin, &[]);
    skin.treat(&Treatment::Cut(Cut::open(corner(20.0, 30.0), corner(35.0, 45.0)))).unwrap();
    let cut = read(&mut skin, &[]);
    assert!(norm(&minus(&cut, &rest)) > 1e-3 * norm(&rest));
    skin.treat(&Treatment::Renew).unwrap();
    assert!(norm(&minus(&read(&mut skin, &[]), &rest)) < 1e-9 * norm(&rest));
    assert_eq!(
        refusal(skin, 0.09, 0.09),
        "indenter at (0.09, 0.09) m refused; expected a middle on the skin, within its rim and in none of its holes"
    );
}

fn ring() -> PatchedOptions {
    let pad = |place: &[f64; 2]| ElectrodeShape::PadCircle { centre_m: *place, radius_m: 1.5e-3 };
    let (inner, outer) = (loop_of(16, [0.042; 2]), loop_of(16, [0.064; 2]));
    PatchedOptions {
        layer: ElectrodedLayer {
            outline: Outline::Polygon { outer: loop_of(48, [0.075; 2]), holes: vec![loop_of(32, [0.03; 2])] },
            electrodes: inner.iter().chain(&outer).map(pad).collect(),
            contact_impedances_ohm_m2: vec![1e-3],
            protocol: protocol(32),
            conductance: Default::default(),
            element_size_m: 5e-3,
            electrode_element_size_m: 2e-3,
        },
        sheet_s: 5e-4,
        patches: PatchLayout { pitch_m: 12e-3, gap_m: 1.5e-3, cells_per_side: 2 },
        cover: Cover { smoothing_m: 2e-3 },
        contact: CONTACT,
        memory: None,
    }
}

#[test]
fn a_patched_skin_may_be_a_ring() {
    let mut skin = PatchedSkin::new(ring()).unwrap();
    assert!(skin.cells().iter().all(|cell| cell.centre_m[0].hypot(cell.centre_m[1]) > 0.025));
    assert!(change(&mut skin, &[disc(52.0, 0.0, 20e3)]) > 1e-3);
    let rest = read(&mut skin, &[]);
    let (one, other) = (disc(52.0, 0.0, 10e3), disc(-52.0, 5.0, 10e3));
    let [first, second, both] =
        [vec![one], vec![other], vec![one, other]].map(|presses| minus(&read(&mut skin, &presses), &rest));
    // Distant touches on separate patches almost add up.
    let sum: Vec<f64> = first.iter().zip(&second).map(|(a, b)| a + b).collect();
    assert!(norm(&minus(&both, &sum)) < 0.03 * norm(&sum), "{}", norm(&minus(&both, &sum)) / norm(&sum));
    let pressed = read(&mut skin, &[one, other]);
    assert!(asymmetry(skin.stimulation(), &pressed) < 1e-10);
    assert!(refusal(skin.clone(), 0.01, 0.0).starts_with("indenter at (0.01, 0) m refused"));
    assert!(refusal(skin, 0.0, 0.08).starts_with("indenter at (0, 0.08) m refused"));
    let mut fine = ring();
    fine.patches = PatchLayout { pitch_m: 1e-3, gap_m: 0.1e-3, cells_per_side: 1 };
    let error = PatchedSkin::new(fine).unwrap_err().to_string();
    assert!(error.contains("at most 8000 (512 MB of memory)"), "{error}");
}

fn ellipse() -> LiquidOptions {
    let outline = Outline::Polygon { outer: loop_of(64, [0.09, 0.06]), holes: Vec::new() };
    LiquidOptions {
        layer: ElectrodedLayer {
            electrodes: outline.rim_segments(12, 6e-3, 0.0, Direction::CounterClockwise),
            outline,
            contact_impedances_ohm_m2: vec![1e-4; 12],
            protocol: protocol(12),
            conductance: Default::default(),
            element_size_m: 6e-3,
            electrode_element_size_m: 2e-3,
        },
        electrode_height_m: 5e-3,
        electrode_middle_m: 4e-3,
        depth_m: 8e-3,
        conductivity_s_per_m: 0.7,
        density_kg_per_m3: 1100.0,
        tension_n_per_m: 40.0,
        gravity_m_per_s2: [0.0, 0.0, -9.81],
        cover: Cover { smoothing_m: 1e-3 },
        memory: None,
        solver: LiquidSolver::DepthAveraged,
    }
}

#[test]
fn a_liquid_may_be_an_ellipse_open_or_closed_with_pads_on_its_bottom() {
    let press = [disc(30.0, 10.0, 200.0)];
    let mut closed = LiquidSkin::new(ellipse()).unwrap();
    assert!(change(&mut closed, &press) > 1e-4);
    let pressed = read(&mut closed, &press);
    assert!(asymmetry(closed.fields().protocol(), &pressed) < 1e-12);
    let mut solid = LiquidSkin::new(LiquidOptions { solver: LiquidSolver::Solid { layers: 2 }, ..ellipse() }).unwrap();
    let (flat, deep) = (change(&mut closed, &press), change(&mut solid, &press));
    assert!((deep / flat - 1.0).abs() < 0.1, "{flat} {deep}");
    assert!(refusal(closed, 0.08, 0.04).starts_with("indenter at (0.08, 0.04) m refused"));
    // In an open tank the surface is lower by p / (rho g), minus the rise of the rest.
    let open = LiquidOptions { tension_n_per_m: 0.0, ..ellipse() };
    let mut tank = LiquidSkin::new(open.clone()).unwrap();
    assert!(change(&mut tank, &[disc(30.0, 10.0, 20.0)]) > 1e-4);
    read(&mut tank, &[disc(30.0, 10.0, 20.0)]);
    let deepest = tank.membrane().deflection_m().iter().copied().fold(0.0, f64::max);
    assert!((deepest / (20.0 / (1100.0 * 9.81)) - 1.0).abs() < 0.1, "{deepest}");
    let mut few = ellipse();
    few.layer.contact_impedances_ohm_m2 = vec![1e-4; 5];
    let error = LiquidSkin::new(few).unwrap_err().to_string();
    assert_eq!(error, "contact_impedances_ohm_m2: 5 refused; expected 1 for all electrodes, or 12: one for each");
    let hanging = LiquidOptions { gravity_m_per_s2: [0.0, -9.81, 0.0], ..open };
    let error = LiquidSkin::new(hanging).unwrap_err().to_string();
    assert!(error.starts_with("gravity_m_per_s2 along z: 0 refused"), "{error}");
    // Pads on the bottom do not depend on the wall.
    let pads = loop_of(12, [0.07, 0.045]);
    let pad = |place: &[f64; 2]| ElectrodeShape::PadCircle { centre_m: *place, radius_m: 2e-3 };
    let mut bottom = LiquidOptions { electrode_height_m: 0.0, ..ellipse() };
    bottom.layer.electrodes = pads.iter().map(pad).collect();
    let mut skin = LiquidSkin::new(bottom.clone()).unwrap();
    assert!(change(&mut skin, &press) > 1e-4);
    let solid = LiquidOptions { solver: LiquidSolver::Solid { layers: 2 }, ..bottom };
    let error = LiquidSkin::new(solid).unwrap_err().to_string();
    assert!(error.contains("electrode 0") && error.contains("expected a stretch of the rim"), "{error}");
}

#[test]
fn elements_may_be_six_by_eight_over_three_by_four_coils() {
    let at = |k: usize, n: usize, pitch_m: f64| (k as f64 - 0.5 * (n as f64 - 1.0)) * pitch_m;
    let coil =
        |k: usize| Coil::circular_spiral([at(k % 3, 3, 0.04), at(k / 3, 4, 0.04), 0.0], 0.012, 0.036, 12).unwrap();
    let sphere = Sphere { radius_m: 5e-3, conductivity_s_per_m: 3.5e7, relative_permeability: 1.0 };
    let options = ElementOptions {
        outline: Outline::Rectangle { width_m: 0.13, height_m: 0.17 },
        coils: CoilArray::of_coils((0..12).map(coil).collect()).unwrap().with_shield(-0.02).unwrap(),
        places_m: (0..48).map(|k| [at(k % 6, 6, 0.02), at(k / 6, 8, 0.018)]).collect(),
        cell_m: [0.02, 0.018],
        rest_m: 0.015,
        tolerance_m: 0.1e-3,
        element: Conductor::Sphere(sphere),
        springs: Springs { stiffness_n_per_m: 300.0, limit_m: 7e-3, sharpness: 2.0, coupling_n_per_m: 10.0 },
        memory: None,
        coupling: Some(Coupling { degree: 2, reach_m: 0.025, sweeps: 1 }),
        current_a: 0.1,
        frequency_hz: 100e3,
        nearby: None,
        seed: 4,
    };
    let mut skin = ElementSkin::new(options.clone()).unwrap();
    assert_eq!((skin.channel_count(), skin.pairs().len()), (66, 66));
    let press = Indenter { load: Load::ForceN(1.0), ..Indenter::disc(skin.places_m()[20], 5e-3, 0.0) };
    assert!(change(&mut skin, &[press]) > 1e-5);
    read(&mut skin, &[press]);
    let travel = skin.travel_m().to_vec();
    // Next to it along x and y, by one cell; not diagonally.
    for near in [14, 19, 21, 26] {
        assert!(travel[near] > 1e-5 && travel[near] < 0.1 * travel[20], "{near}: {travel:?}");
        assert!(travel[near] > 5.0 * travel[13]);
    }
    // The same elements in another order are the same skin, except for their tolerances.
    let mut even = ElementSkin::new(ElementOptions { tolerance_m: 0.0, ..options.clone() }).unwrap();
    let places_m = options.places_m.iter().rev().copied().collect();
    let reversed = ElementOptions { tolerance_m: 0.0, places_m, ..options.clone() };
    let mut reversed = ElementSkin::new(reversed).unwrap();
    let (a, b) = (read(&mut even, &[press]), read(&mut reversed, &[press]));
    assert!(norm(&minus(&a, &b)) < 1e-9 * norm(&a));
    assert!(refusal(skin, 0.07, 0.0).starts_with("x of the indenter, m: 0.07"));
    let refused = |options: ElementOptions| ElementSkin::new(options).unwrap_err().to_string();
    assert!(refused(ElementOptions { places_m: Vec::new(), ..options.clone() }).starts_with("number of elements: 0"));
    assert!(refused(ElementOptions { tolerance_m: 2e-3, ..options }).starts_with("tolerance_m: 0.002"));
}
