//! Compares contacts with the same contacts as a floating electrode of the complete electrode model, compares
//! derivatives with differences, and tests searches on known patches.

use faer::Mat;
use faer::linalg::solvers::Solve;

use super::sheet::Touched;
use super::*;
use crate::eit::{Drive, Driven, EitError, ForwardModel, Measure, Order, Pattern, Protocol, ProtocolSpec};
use crate::mesh::{Contact, Direction, Electrode, ElectrodeShape, ElectrodedMesh, Outline, Point, SheetSpec, distance};

const SHEET_S: f64 = 5e-3;

fn protocol() -> Protocol {
    Protocol::generate(&ProtocolSpec {
        electrode_count: 16,
        drive: Drive::PseudoPolar,
        measure: Measure::PseudoPolar,
        order: Order::Absolute,
        driven: Driven::Drop,
        amplitude_a: 1e-3,
    })
    .unwrap()
}

/// A square of 100 mm with 16 pads of 6 mm along its rim.
fn body(element_size_m: f64) -> ElectrodedMesh {
    let pad = ElectrodeShape::PadRectangle { centre_m: [0.0; 2], width_m: 6e-3, height_m: 6e-3, angle_rad: 0.0 };
    let pads = pad.ring(5, 5, [23.5e-3; 2], Direction::CounterClockwise);
    let spec = SheetSpec::new(Outline::Rectangle { width_m: 0.1, height_m: 0.1 }, pads, element_size_m);
    spec.build(&[5e-4]).unwrap().0
}

fn sheet() -> ContactSheet {
    let model = ForwardModel::new(body(2.5e-3), protocol()).unwrap();
    let elements = model.body().mesh.element_count();
    ContactSheet::new(&model, &vec![SHEET_S; elements], 0.0).unwrap()
}

fn patch(x_mm: f64, y_mm: f64, radius_mm: f64) -> ContactPatch {
    ContactPatch { position_m: [1e-3 * x_mm, 1e-3 * y_mm], radius_m: 1e-3 * radius_mm, conductance_s_per_m2: 600.0 }
}

fn norm(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>().sqrt()
}

fn difference(a: &[f64], b: &[f64]) -> f64 {
    norm(&a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<_>>()) / norm(b)
}

/// The same patches as one electrode that carries no current: an independent computation of the same physics.
fn by_floating_electrode(patches: &[ContactPatch], size_m: f64) -> Vec<f64> {
    by_floating_electrodes(&[patches], size_m)
}

/// One such electrode for each group of patches.
fn by_floating_electrodes(groups: &[&[ContactPatch]], size_m: f64) -> Vec<f64> {
    let mut body = body(size_m);
    let centre = |cell: &[u32]| -> [f64; 2] {
        [0, 1].map(|axis| cell.iter().map(|&n| body.mesh.nodes()[n as usize][axis]).sum::<f64>() / 3.0)
    };
    let triangles_under = |patches: &[ContactPatch]| -> Vec<u32> {
        let inside = |at: Point| patches.iter().any(|p| distance(at, p.position_m) <= p.radius_m);
        body.mesh.elements().enumerate().filter(|(_, cell)| inside(centre(cell))).map(|(k, _)| k as u32).collect()
    };
    let floating: Vec<Electrode> = groups
        .iter()
        .map(|patches| Electrode {
            contact: Contact::Area(triangles_under(patches)),
            contact_impedance: 1.0 / patches[0].conductance_s_per_m2,
        })
        .collect();
    let protocol = protocol();
    let bare = ForwardModel::new(body.clone(), protocol.clone()).unwrap();
    let sigma = vec![SHEET_S; body.mesh.element_count()];
    let at_rest = bare.voltages(&sigma).unwrap();
    // Insert them first, so that the reference stays a pad; the numbers of the other electrodes rise.
    let count = groups.len();
    body.electrodes.splice(0..0, floating);
    let shifted =
        |pattern: &Pattern| Pattern::new(pattern.entries().iter().map(|&(e, w)| (e + count as u32, w)).collect());
    let stimulations = protocol.stimulations().iter().map(shifted).collect();
    let channels = protocol
        .measurements()
        .iter()
        .map(|m| (shifted(&protocol.patterns()[m.pattern as usize]), m.stimulation as usize))
        .collect();
    let joined = Protocol::from_patterns(16 + count, stimulations, channels).unwrap();
    let pressed = ForwardModel::new(body, joined).unwrap().voltages(&sigma).unwrap();
    pressed.iter().zip(&at_rest).map(|(a, b)| a - b).collect()
}

#[test]
fn contacts_are_a_floating_electrode() {
    for patches in [vec![patch(0.0, 0.0, 12.0)], vec![patch(-25.0, 5.0, 10.0), patch(20.0, -15.0, 12.5)]] {
        let ours = sheet().change_v(&patches).unwrap();
        let theirs = by_floating_electrode(&patches, 1.2e-3);
        // The reference resolves the edge of a patch to half a triangle (0.6 mm of 10); here it is blurred over 2.5
        // mm.
        let off = difference(&ours, &theirs);
        assert!(off < 0.03, "{} patches: {off}", patches.len());
    }
}

#[test]
fn two_contacts_are_joined_by_the_layer() {
    let sheet = sheet();
    let (a, b) = (patch(-25.0, 0.0, 10.0), patch(25.0, 0.0, 10.0));
    let both = sheet.change_v(&[a, b]).unwrap();
    let sum: Vec<f64> =
        sheet.change_v(&[a]).unwrap().iter().zip(sheet.change_v(&[b]).unwrap()).map(|(a, b)| a + b).collect();
    assert!(difference(&both, &sum) > 0.5, "the layer between them carries most of the current");
}

#[test]
fn known_patches_are_found() {
    let sheet = sheet();
    let places: Vec<Point> =
        (0..81).map(|k| [f64::from(k % 9) - 4.0, f64::from(k / 9) - 4.0].map(|v| 10e-3 * v)).collect();
    let typical = ContactPatch { position_m: [0.0; 2], radius_m: 10e-3, conductance_s_per_m2: 500.0 };
    let search = PatchSearch::new(&sheet, typical, &places).unwrap();
    let truth = [
        vec![patch(7.0, -12.0, 9.0)],
        vec![patch(-25.0, 12.0, 10.0), patch(14.0, -23.0, 12.0)],
        vec![patch(-28.0, 0.0, 10.0), patch(22.0, 22.0, 10.0), patch(22.0, -22.0, 11.0)],
    ];
    for patches in truth {
        let change = sheet.change_v(&patches).unwrap();
        let deviation = vec![1e-3 * norm(&change) / (change.len() as f64).sqrt(); change.len()];
        let mut sets = search.begin(&sheet, &change, &deviation).unwrap();
        let starts: Vec<_> = (0..3).map(|_| search.look(&mut sets).unwrap()).collect();
        for truth in &patches {
            let distances = starts[patches.len() - 1].iter().map(|patch| distance(patch.position_m, truth.position_m));
            let near = distances.fold(f64::INFINITY, f64::min);
            // Near enough for a fit: no other patch is nearer.
            assert!(near < 20e-3, "{near} m off");
        }
    }
}

#[test]
fn nonsense_is_refused() {
    let sheet = sheet();
    let flat = ContactPatch { radius_m: 0.0, ..patch(0.0, 0.0, 1.0) };
    assert!(matches!(sheet.change_v(&[flat]), Err(EitError::Contact { .. })));
    assert_eq!(norm(&sheet.change_v(&[patch(500.0, 0.0, 5.0)]).unwrap()), 0.0, "off the skin nothing is touched");
}

/// Integral over each cell of a plated sheet.
fn over_cells(sheet: &PlatedSheet, density: impl Fn(Point) -> f64) -> Vec<f64> {
    let mut sums = vec![0.0; sheet.cell_count()];
    for PlatePoint { position_m, area_m2, cell } in sheet.points() {
        sums[*cell as usize] += area_m2 * density(*position_m);
    }
    sums
}

#[test]
fn plates_are_separate_floating_electrodes() {
    let model = ForwardModel::new(body(2e-3), protocol()).unwrap();
    let sheet_s = vec![SHEET_S; model.body().mesh.element_count()];
    let plated = |plate_at: &dyn Fn(Point) -> Option<u32>| PlatedSheet::new(&model, &sheet_s, plate_at).unwrap();
    let patches = [patch(-18.0, 5.0, 9.0), patch(16.0, -4.0, 9.0)];
    let conductance = |sheet: &PlatedSheet| {
        let covers = |p: &ContactPatch, at: Point| {
            let off_m = distance(at, p.position_m);
            // Blurred over a node's size, as the patches of a sandwich are.
            ((p.radius_m - off_m) / 2e-3 + 0.5).clamp(0.0, 1.0)
        };
        let share = |at| patches.iter().map(|p| covers(p, at)).fold(0.0, f64::max);
        over_cells(sheet, |at| 600.0 * share(at))
    };
    let separate = plated(&|at| Some(u32::from(at[0] > 0.0)));
    let apart = separate.contact(&conductance(&separate)).unwrap().change_v;
    let one = plated(&|_| Some(0));
    let joined = one.contact(&conductance(&one)).unwrap().change_v;
    // Two discretisations of the same discs, whose edges cut elements of 2 mm.
    assert!(difference(&apart, &by_floating_electrodes(&[&patches[..1], &patches[1..]], 2e-3)) < 0.1);
    assert!(difference(&joined, &by_floating_electrodes(&[&patches], 2e-3)) < 0.1);
    assert!(difference(&apart, &joined) > 0.3, "joined plates carry current from one disc to the other");
}

#[test]
fn derivatives_of_plates_agree_with_differences() {
    let model = ForwardModel::new(body(4e-3), protocol()).unwrap();
    let sheet_s = vec![SHEET_S; model.body().mesh.element_count()];
    // Stripes of 8 mm with gaps of 2 mm between them.
    let stripe = |at: Point| {
        let along = (at[0] + 0.05) / 0.01;
        ((along - along.floor() - 0.5).abs() < 0.4).then_some(along.floor() as u32)
    };
    let sheet = PlatedSheet::new(&model, &sheet_s, stripe).unwrap();
    // A bump of contact that moves in x and grows.
    let density = |at: Point, x_m: f64, log: f64| {
        let square = (at[0] - x_m).powi(2) + at[1].powi(2);
        log.exp() * 300.0 * (-square / 2e-4).exp()
    };
    let conductance = |x_m: f64, log: f64| over_cells(&sheet, |at| density(at, x_m, log));
    let by_log = conductance(3e-3, 0.0);
    let at = sheet.contact(&by_log).unwrap();
    let by_x = over_cells(&sheet, |at| density(at, 3e-3, 0.0) * (at[0] - 3e-3) / 1e-4);
    let moves: Vec<[f64; 4]> = by_x.into_iter().zip(by_log).map(|(x, log)| [x, 0.0, log, 0.0]).collect();
    let moves = at.of_cells(&moves);
    let jacobian = sheet.derivatives(&at, &moves);
    // Steps over which rounding errors of single precision are small.
    for (parameter, [x, log]) in [(0, [1e-4, 0.0]), (2, [0.0, 1e-2])] {
        let change = |sign: f64| sheet.contact(&conductance(3e-3 + sign * x, sign * log)).unwrap().change_v;
        let step = 2.0 * (x + log);
        let differences: Vec<f64> = change(1.0).iter().zip(change(-1.0)).map(|(a, b)| (a - b) / step).collect();
        let derivatives: Vec<f64> = jacobian.iter().skip(parameter).step_by(4).copied().collect();
        assert!(difference(&derivatives, &differences) < 2e-3, "parameter {parameter}");
    }
}

#[test]
fn the_points_near_a_place_are_those_within_its_reach_and_few_others() {
    let model = ForwardModel::new(body(4e-3), protocol()).unwrap();
    let sheet_s = vec![SHEET_S; model.body().mesh.element_count()];
    let sheet = PlatedSheet::new(&model, &sheet_s, |_| Some(0)).unwrap();
    // In the middle, at the rim, and outside.
    for (centre, reach_m) in [([3e-3, -7e-3], 0.018), ([0.049, 0.01], 0.012), ([-0.07, 0.0], 0.03), ([0.2, 0.2], 0.01)]
    {
        let near: Vec<usize> = sheet.points_near(centre, reach_m).flatten().collect();
        assert!(near.is_sorted());
        let within: Vec<usize> =
            (0..sheet.points().len()).filter(|&k| distance(sheet.points()[k].position_m, centre) <= reach_m).collect();
        assert!(within.iter().all(|point| near.binary_search(point).is_ok()), "{centre:?}");
        // Columns are as wide as an element: they stand out from the disc by at most that.
        let beyond = near.iter().map(|&k| distance(sheet.points()[k].position_m, centre)).fold(0.0, f64::max);
        assert!(beyond <= reach_m.max(0.0) + 8e-3, "{beyond}");
    }
}

#[test]
fn single_precision_changes_contacts_by_less_than_any_instrument_sees() {
    let sheet = sheet();
    for (conductance_s_per_m2, radius_mm) in [(6.0, 4.0), (600.0, 9.0), (6e4, 20.0), (6e6, 9.0)] {
        let patch = ContactPatch { conductance_s_per_m2, ..patch(12.0, -7.0, radius_mm) };
        let touched = sheet.touch(&[patch]).unwrap();
        // The same contacts, eliminated in double precision without any preparation: contacts at the potential v of the
        // plate carry the currents i with (G + 1/g) i + v = f, and their sum is 0.
        let count = touched.nodes.len();
        let green = sheet.green.whole();
        let system = Mat::from_fn(count + 1, count + 1, |row, column| match (row < count, column < count) {
            (true, true) => {
                let own = if row == column { 1.0 / touched.conductance_s[row] } else { 0.0 };
                f64::from(green[(touched.nodes[row] as usize, touched.nodes[column] as usize)]) + own
            }
            (false, false) => 0.0,
            _ => 1.0,
        });
        let driving = Mat::from_fn(count + 1, sheet.field_count(), |row, field| {
            if row < count { sheet.fields[(field, touched.nodes[row] as usize)] } else { 0.0 }
        });
        let solved = system.partial_piv_lu().solve(&driving);
        let exact = Touched { currents: solved.subrows(0, count).to_owned(), ..touched.clone() };
        let off = difference(&sheet.change_of(&touched), &sheet.change_of(&exact));
        // Noise of 1e-4 of a press's change would need readings with 100 dB.
        assert!(off < 1e-4, "{conductance_s_per_m2} S/m2 over {radius_mm} mm: {off}");
    }
}
