//! Tests of sheets: areas, angles, electrodes, refinement and refusals.

use std::f64::consts::{PI, TAU};

use proptest::prelude::*;

use super::*;
use crate::mesh::Direction;
use crate::mesh::plane::Point;

const DISC: Outline = Outline::Disc { radius_m: 0.1 };
const SQUARE: Outline = Outline::Rectangle { width_m: 0.1, height_m: 0.1 };

fn disc16() -> SheetSpec {
    let arcs = Outline::rim_arcs(16, 0.006, PI / 2.0, Direction::Clockwise);
    SheetSpec::new(DISC, arcs, 0.006)
}

fn area(mesh: &ElectrodedMesh) -> f64 {
    mesh.mesh.measures().iter().sum()
}

/// Mean position of an electrode's nodes.
fn middle(mesh: &ElectrodedMesh, electrode: usize) -> Point {
    let nodes: Vec<u32> = match &mesh.electrodes[electrode].contact {
        Contact::Faces(faces) => faces.concat(),
        Contact::Area(elements) => elements.iter().flat_map(|&e| mesh.mesh.element(e as usize).to_vec()).collect(),
        Contact::Point(node) => vec![*node],
    };
    let at = |axis: usize| nodes.iter().map(|&n| mesh.mesh.nodes()[n as usize][axis]).sum::<f64>() / nodes.len() as f64;
    [at(0), at(1)]
}

fn assert_relative(got: f64, wanted: f64, tolerance: f64) {
    assert!((got / wanted - 1.0).abs() < tolerance, "{got} is not {wanted} within {tolerance:e}");
}

#[test]
fn disc_area_is_that_of_its_rim_polygon() {
    let (mesh, quality) = disc16().build(&[0.01]).unwrap();
    assert!(quality.refinement_complete && quality.min_angle_deg >= 25.0, "{quality:?}");
    let mut angles: Vec<f64> = (mesh.mesh.boundary_faces().iter().flat_map(|(face, _)| face.clone()))
        .map(|node| mesh.mesh.nodes()[node as usize])
        .map(|p| p[1].atan2(p[0]))
        .collect();
    angles.sort_by(f64::total_cmp);
    angles.dedup_by(|a, b| (*a - *b).abs() < 1e-12);
    // Nodes added to a chord by refinement do not change the polygon, which only the circle's nodes span.
    let polygon: f64 = mesh
        .mesh
        .boundary_faces()
        .iter()
        .map(|(face, _)| {
            let [a, b] = [face[0], face[1]].map(|node| mesh.mesh.nodes()[node as usize]);
            (a[0] * b[1] - a[1] * b[0]).abs() / 2.0
        })
        .sum();
    // Sums of a few thousand terms: rounding of about 1e-13.
    assert_relative(area(&mesh), polygon, 1e-12);
    // A polygon of n equal edges misses 2 pi^2 / (3 n^2); graded edges miss slightly more.
    let loss = 2.0 * PI * PI / 3.0 / (angles.len() as f64).powi(2);
    let missing = 1.0 - area(&mesh) / DISC.area_m2();
    assert!(missing > 0.5 * loss && missing < 3.0 * loss, "{missing} {loss}");
}

#[test]
fn arcs_end_on_the_circle_and_chords_fall_short_by_the_stated_amount() {
    let (mesh, _) = disc16().build(&[0.01]).unwrap();
    for (index, length) in mesh.electrode_measures().into_iter().enumerate() {
        let Contact::Faces(faces) = &mesh.electrodes[index].contact else { panic!("no rim electrode") };
        assert!(faces.len() >= 4, "{}", faces.len());
        let expected = (0.06_f64).powi(2) / (24.0 * (faces.len() as f64).powi(2));
        let short = 1.0 - length / 0.006;
        // The next term of the series is smaller by (w/r/n)^2; uneven edges lose up to a few times as much as even
        // ones.
        assert!(short > 0.9 * expected && short < 4.0 * expected, "{short:e} {expected:e}");
        let radius = |node: u32| {
            let p = mesh.mesh.nodes()[node as usize];
            p[0].hypot(p[1])
        };
        assert_relative(radius(faces[0][0]), 0.1, 1e-14);
        assert_relative(radius(faces[faces.len() - 1][1]), 0.1, 1e-14);
    }
}

#[test]
fn order_and_direction_follow_the_generator() {
    let (mesh, _) = disc16().build(&[0.01]).unwrap();
    for (index, angle) in [(0, PI / 2.0), (1, PI / 2.0 - TAU / 16.0), (4, 0.0), (12, PI)] {
        let [x, y] = middle(&mesh, index);
        let off = (y.atan2(x) - angle).sin();
        // Edges divide the arc evenly to one part in a million.
        assert!(off.abs() < 1e-6, "electrode {index} is {off} rad off");
    }
    let counter = Outline::rim_arcs(16, 0.006, 0.0, Direction::CounterClockwise);
    let (mesh, _) = SheetSpec::new(DISC, counter, 0.02).build(&[0.01]).unwrap();
    let [x, y] = middle(&mesh, 4);
    assert!(x.abs() < 1e-7 && y > 0.0, "{x} {y}");
    assert_eq!(mesh.electrodes[15].contact_impedance, 0.01);
}

#[test]
fn square_with_electrodes_per_side_begins_bottom_left() {
    let electrodes = SQUARE.rim_per_side(4, 0.01, Direction::CounterClockwise);
    let (mesh, quality) = SheetSpec::new(SQUARE, electrodes, 0.005).build(&[0.01]).unwrap();
    assert!(quality.min_angle_deg >= 25.0, "{quality:?}");
    assert_relative(area(&mesh), 0.01, 1e-12);
    for length in mesh.electrode_measures() {
        assert_relative(length, 0.01, 1e-12);
    }
    let close = |electrode: usize, wanted: [f64; 2]| {
        let found = middle(&mesh, electrode);
        assert!(distance(found, wanted) < 1e-9, "electrode {electrode} at {found:?}");
    };
    close(0, [-0.0375, -0.05]);
    close(4, [0.05, -0.0375]);
    close(8, [0.0375, 0.05]);
    close(15, [-0.05, -0.0375]);
    let clockwise = SQUARE.rim_per_side(4, 0.01, Direction::Clockwise);
    assert_eq!(clockwise[0], SQUARE.rim_per_side(4, 0.01, Direction::CounterClockwise)[0]);
    assert_eq!(clockwise[1], SQUARE.rim_per_side(4, 0.01, Direction::CounterClockwise)[15]);
}

#[test]
fn rim_electrodes_may_run_round_a_corner() {
    let electrodes = vec![ElectrodeShape::RimSegment { centre_m: 0.0, width_m: 0.02 }];
    let (mesh, _) = SheetSpec::new(SQUARE, electrodes, 0.01).build(&[0.01]).unwrap();
    assert_relative(mesh.electrode_measures()[0], 0.02, 1e-12);
}

#[test]
fn pads_keep_their_area() {
    let round = ElectrodeShape::PadCircle { centre_m: [0.02, 0.01], radius_m: 0.004 };
    let turned =
        ElectrodeShape::PadRectangle { centre_m: [-0.02, 0.01], width_m: 0.008, height_m: 0.003, angle_rad: 0.4 };
    let point = ElectrodeShape::Point { position_m: [0.0, -0.02] };
    let rim = ElectrodeShape::RimPoint { position_m: 0.0 };
    let (mesh, quality) = SheetSpec::new(DISC, vec![round, turned, point, rim], 0.008).build(&[1e-4]).unwrap();
    let areas = mesh.electrode_measures();
    assert_relative(areas[0], PI * 0.004 * 0.004, 1e-12);
    assert_relative(areas[1], 0.008 * 0.003, 1e-12);
    assert!(quality.min_angle_deg >= 25.0, "{quality:?}");
    let Contact::Point(node) = mesh.electrodes[2].contact else { panic!("no point") };
    assert_eq!(mesh.mesh.nodes()[node as usize], [0.0, -0.02, 0.0]);
    let Contact::Point(node) = mesh.electrodes[3].contact else { panic!("no point") };
    assert_eq!(mesh.mesh.nodes()[node as usize], [0.1, 0.0, 0.0]);
}

#[test]
fn pads_may_be_flush_with_the_rim_and_its_corners() {
    let pad = ElectrodeShape::PadRectangle { centre_m: [0.0; 2], width_m: 0.006, height_m: 0.006, angle_rad: 0.0 };
    let pads = pad.ring(5, 5, [0.0235; 2], Direction::CounterClockwise);
    assert_eq!(pads.len(), 16);
    let (mesh, quality) = SheetSpec::new(SQUARE, pads, 0.005).build(&[1e-4]).unwrap();
    assert!(quality.refinement_complete && quality.min_angle_deg >= 25.0, "{quality:?}");
    assert_relative(area(&mesh), 0.01, 1e-12);
    for pad in mesh.electrode_measures() {
        assert_relative(pad, 0.006 * 0.006, 1e-9);
    }
    let [x, y] = middle(&mesh, 4);
    assert!(x > 0.044 && y < -0.044, "{x} {y}");
}

#[test]
fn sixty_four_pads_in_rows_from_the_top_left() {
    let pad = ElectrodeShape::PadCircle { centre_m: [0.0; 2], radius_m: 0.002 };
    let (mesh, quality) = SheetSpec::new(SQUARE, pad.grid(8, 8, [0.0116; 2]), 0.004).build(&[1e-4]).unwrap();
    assert!(quality.min_angle_deg >= 25.0, "{quality:?}");
    let [x, y] = middle(&mesh, 0);
    assert!(x < -0.04 && y > 0.04, "{x} {y}");
    let [x, y] = middle(&mesh, 7);
    assert!(x > 0.04 && y > 0.04, "{x} {y}");
    for pad in mesh.electrode_measures() {
        assert_relative(pad, PI * 4e-6, 1e-12);
    }
}

#[test]
fn elements_are_small_at_electrodes_and_grow_away_from_them() {
    let mut spec = disc16();
    spec.electrodes.truncate(1);
    spec.element_size_m = 0.012;
    spec.electrode_element_size_m = 0.0008;
    let (mesh, quality) = spec.build(&[0.01]).unwrap();
    assert!(quality.min_angle_deg >= 25.0, "{quality:?}");
    let mean_edge = |near: bool| {
        let distance = |k: &usize| {
            let c = mesh.mesh.centroid(*k);
            c[0].hypot(c[1] - 0.1)
        };
        let chosen: Vec<usize> = (0..mesh.mesh.element_count())
            .filter(|k| if near { distance(k) < 0.0015 } else { distance(k) > 0.06 })
            .collect();
        let mean = chosen.iter().map(|&k| mesh.mesh.measures()[k]).sum::<f64>() / chosen.len() as f64;
        (mean / 0.433).sqrt()
    };
    let (near, far) = (mean_edge(true), mean_edge(false));
    // The size grows by 0.35 x 1.5 mm over that distance.
    assert!(near < 1.6 * 0.0008, "{near}");
    assert!(far > 0.8 * 0.012 && far < 1.2 * 0.012, "{far}");
}

#[test]
fn polygon_with_a_hole_in_either_orientation() {
    let outer = vec![[0.0, 0.0], [0.2, 0.0], [0.2, 0.05], [0.08, 0.05], [0.08, 0.15], [0.0, 0.15]];
    let hole = vec![[0.02, 0.02], [0.05, 0.02], [0.05, 0.04], [0.02, 0.04]];
    let expected = 0.2 * 0.05 + 0.08 * 0.1 - 0.03 * 0.02;
    let reversed = || {
        let (mut outer, mut hole) = (outer.clone(), hole.clone());
        outer[1..].reverse();
        hole[1..].reverse();
        Outline::Polygon { outer, holes: vec![hole] }
    };
    let mut results = Vec::new();
    for outline in [Outline::Polygon { outer: outer.clone(), holes: vec![hole.clone()] }, reversed()] {
        let electrodes = vec![ElectrodeShape::RimSegment { centre_m: 0.1, width_m: 0.02 }];
        let (mesh, quality) = SheetSpec::new(outline.clone(), electrodes, 0.008).build(&[0.01]).unwrap();
        assert!(quality.refinement_complete && quality.min_angle_deg >= 25.0, "{quality:?}");
        assert_relative(area(&mesh), expected, 1e-12);
        assert_relative(outline.area_m2(), expected, 1e-12);
        assert_relative(mesh.electrode_measures()[0], 0.02, 1e-12);
        let [_, y] = middle(&mesh, 0);
        assert!(y.abs() < 1e-12, "the electrode is on the first side");
        // A hole removes one node from Euler's formula: V - E + F = 0 for a ring.
        let faces = mesh.mesh.element_count();
        let edges = (3 * faces + mesh.mesh.boundary_faces().len()) / 2;
        assert_eq!(mesh.mesh.nodes().len() + faces, edges);
        results.push(mesh);
    }
    assert!(results[0] == results[1], "orientation does not matter");
}

#[test]
fn the_same_specification_gives_the_same_mesh() {
    assert!(disc16().build(&[0.01]).unwrap().0 == disc16().build(&[0.01]).unwrap().0);
}

#[test]
fn target_counts_are_met() {
    for (count, electrodes) in [(5000, 16), (20_000, 16), (1500, 32)] {
        let arcs = Outline::rim_arcs(electrodes, 0.006, 0.0, Direction::CounterClockwise);
        let spec = SheetSpec::new(DISC, arcs, 0.005).with_target_elements(count).unwrap();
        let (_, quality) = spec.build(&[0.01]).unwrap();
        let off = quality.element_count as f64 / count as f64 - 1.0;
        assert!(off.abs() < 0.05, "{} elements instead of {count}", quality.element_count);
        assert!(quality.min_angle_deg >= 25.0, "{quality:?}");
    }
}

#[test]
fn built_to_a_count_is_built_with_that_target() {
    for count in [300, 2000] {
        let sized = disc16().with_target_elements(count).unwrap();
        let (mesh, quality) = sized.build(&[0.01]).unwrap();
        assert!(disc16().build_to(count, &[0.01]).unwrap() == (sized, mesh, quality), "{count}");
    }
    assert!(disc16().build_to(0, &[0.01]).is_err());
    assert!(disc16().build_to(300, &[0.01, 0.02]).is_err());
}

#[test]
fn mistakes_are_named() {
    let refused = |outline: &Outline, electrodes: Vec<ElectrodeShape>| {
        SheetSpec::new(outline.clone(), electrodes, 0.01).build(&[0.01]).unwrap_err().to_string()
    };
    let arc = |centre_rad: f64, width_m: f64| ElectrodeShape::RimArc { centre_rad, width_m };
    let pad = |x: f64, width_m: f64| ElectrodeShape::PadRectangle {
        centre_m: [x, 0.0],
        width_m,
        height_m: 0.01,
        angle_rad: 0.0,
    };
    let cases = [
        (&DISC, vec![arc(0.0, 0.02), arc(0.1, 0.02)], "electrode 1: overlaps electrode 0"),
        (&DISC, vec![arc(-0.05, 0.02), arc(3.0, 0.02), arc(0.05, 0.02)], "electrode 2: overlaps electrode 0"),
        (&DISC, vec![arc(0.0, 0.7)], "less than the rim's"),
        (&DISC, vec![arc(0.0, f64::NAN)], "width_m: NaN"),
        (&DISC, vec![arc(0.0, -0.1)], "width_m: -0.1"),
        (&SQUARE, vec![arc(0.0, 0.01)], "for discs only"),
        (&SQUARE, vec![pad(0.0, 0.01), pad(0.009, 0.01)], "electrode 1: overlaps or touches electrode 0"),
        (&SQUARE, vec![pad(0.0, 0.04), pad(0.0, 0.005)], "electrode 1: overlaps or touches electrode 0"),
        (&SQUARE, vec![pad(0.048, 0.01)], "electrode 0: reaches off the sheet"),
        (&SQUARE, vec![ElectrodeShape::Point { position_m: [0.06, 0.0] }], "not strictly inside"),
        (&SQUARE, vec![pad(0.0, 0.01), ElectrodeShape::Point { position_m: [0.0, 0.0] }], "overlaps electrode 0"),
        (&Outline::Disc { radius_m: 0.0 }, vec![], "radius_m: 0"),
        (&Outline::Rectangle { width_m: f64::INFINITY, height_m: 1.0 }, vec![], "width_m: inf"),
    ];
    for (outline, electrodes, expected) in cases {
        let message = refused(outline, electrodes);
        assert!(message.contains(expected), "{message:?} should say {expected:?}");
    }
    let polygon = |outer: &[Point], hole: &[Point]| {
        refused(&Outline::Polygon { outer: outer.to_vec(), holes: vec![hole.to_vec()] }, vec![])
    };
    let unit = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    let bow = [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]];
    assert!(polygon(&bow, &[]).contains("simple polygon"));
    assert!(polygon(&unit, &unit).contains("strictly inside"));
    assert!(polygon(&unit, &unit.map(|p| [p[0] + 3.0, p[1]])).contains("strictly inside"));
    assert!(polygon(&unit[..2], &[]).contains("at least 3"));
    let with = |change: fn(&mut SheetSpec)| {
        let mut spec = disc16();
        change(&mut spec);
        spec.build(&[0.01]).unwrap_err().to_string()
    };
    assert!(with(|spec| spec.min_angle_deg = 34.0).contains("min_angle_deg: 34"));
    assert!(with(|spec| spec.element_size_m = 0.0).contains("element_size_m: 0"));
    assert!(with(|spec| spec.electrode_element_size_m = f64::NAN).contains("electrode_element_size_m: NaN"));
    assert!(with(|spec| spec.element_size_m = 1e-6).contains("coarse enough"));
    let error = disc16().build(&[0.01, 0.02]).unwrap_err();
    assert!(matches!(error, MeshError::Count { got: 2, .. }), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// Star-shaped polygons with random spikes: the mesh covers exactly the polygon, and the angle bound holds except
    /// at sharper corners of the outline.
    #[test]
    fn random_polygons_are_covered_exactly(radii in prop::collection::vec(0.3f64..1.0, 3..14), turn in 0.0f64..6.0) {
        let count = radii.len() as f64;
        let corner = |(k, r): (usize, &f64)| {
            let angle = turn + TAU * k as f64 / count;
            [r * angle.cos(), r * angle.sin()]
        };
        let outer: Vec<Point> = radii.iter().enumerate().map(corner).collect();
        let sharpest = (0..outer.len()).map(|k| {
            let (a, b, c) = (outer[(k + outer.len() - 1) % outer.len()], outer[k], outer[(k + 1) % outer.len()]);
            let (u, v) = ([a[0] - b[0], a[1] - b[1]], [c[0] - b[0], c[1] - b[1]]);
            (u[0] * v[1] - u[1] * v[0]).abs().atan2(u[0] * v[0] + u[1] * v[1]).to_degrees()
        }).fold(180.0, f64::min);
        let outline = Outline::Polygon { outer, holes: vec![] };
        let (mesh, quality) = SheetSpec::new(outline.clone(), vec![], 0.15).build(&[0.01]).unwrap();
        prop_assert!((area(&mesh) / outline.area_m2() - 1.0).abs() < 1e-11);
        prop_assert!(quality.refinement_complete);
        // Ruppert's bound does not hold between sides that meet at less than 60 degrees.
        prop_assert!(sharpest < 60.0 || quality.min_angle_deg >= 25.0, "{} with {}", quality.min_angle_deg, sharpest);
    }
}

fn any_outline() -> impl Strategy<Value = Outline> {
    prop_oneof![
        (0.02f64..0.2).prop_map(|radius_m| Outline::Disc { radius_m }),
        (0.02f64..0.2, 0.02f64..0.2).prop_map(|(width_m, height_m)| Outline::Rectangle { width_m, height_m }),
        (0.0f64..6.0, 0.2f64..0.9).prop_map(|(turn, waist)| {
            let corner = |k: usize| {
                let (angle, r) = (turn + TAU * k as f64 / 10.0, if k.is_multiple_of(2) { 0.1 } else { 0.1 * waist });
                [r * angle.cos(), r * angle.sin()]
            };
            let hole = |k: usize| [0.015 * (1.1 * k as f64).cos(), 0.015 * (1.1 * k as f64).sin()];
            Outline::Polygon { outer: (0..10).map(corner).collect(), holes: vec![(0..5).map(hole).collect()] }
        }),
    ]
}

fn any_electrode() -> impl Strategy<Value = ElectrodeShape> {
    let place = || prop::array::uniform2(-0.1f64..0.1);
    let size = || 1e-4f64..0.04;
    prop_oneof![
        (-7.0f64..7.0, size()).prop_map(|(centre_rad, width_m)| ElectrodeShape::RimArc { centre_rad, width_m }),
        (-1.0f64..1.0, size()).prop_map(|(centre_m, width_m)| ElectrodeShape::RimSegment { centre_m, width_m }),
        (-1.0f64..1.0).prop_map(|position_m| ElectrodeShape::RimPoint { position_m }),
        (place(), size()).prop_map(|(centre_m, radius_m)| ElectrodeShape::PadCircle { centre_m, radius_m }),
        (place(), size(), size(), 0.0f64..3.0).prop_map(|(centre_m, width_m, height_m, angle_rad)| {
            ElectrodeShape::PadRectangle { centre_m, width_m, height_m, angle_rad }
        }),
        place().prop_map(|position_m| ElectrodeShape::Point { position_m }),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    /// Every specification is either refused, or meshed so that the sheet and every pad are covered exactly.
    #[test]
    fn any_specification_is_meshed_or_refused(
        outline in any_outline(),
        electrodes in prop::collection::vec(any_electrode(), 0..5),
        size in 0.004f64..0.03,
        ratio in 0.05f64..2.0,
    ) {
        let mut spec = SheetSpec::new(outline.clone(), electrodes.clone(), size);
        spec.electrode_element_size_m = ratio * size;
        if let Ok((mesh, quality)) = spec.build(&[0.1]) {
            prop_assert!(quality.refinement_complete, "{quality:?}");
            let covered = area(&mesh) / outline.area_m2();
            if let Outline::Disc { .. } = outline {
                prop_assert!(covered > 0.98 && covered < 1.0, "{covered}");
            } else {
                prop_assert!((covered - 1.0).abs() < 1e-9, "{covered}");
            }
            for (shape, measure) in electrodes.iter().zip(mesh.electrode_measures()) {
                let (wanted, tolerance) = match shape {
                    ElectrodeShape::RimArc { width_m, .. } | ElectrodeShape::RimSegment { width_m, .. } => (*width_m, 0.05),
                    ElectrodeShape::PadCircle { radius_m, .. } => (PI * radius_m * radius_m, 1e-8),
                    ElectrodeShape::PadRectangle { width_m, height_m, .. } => (width_m * height_m, 1e-8),
                    _ => continue,
                };
                prop_assert!((measure / wanted - 1.0).abs() < tolerance, "{shape:?}: {measure}");
            }
        }
    }
}

#[test]
fn places_are_as_far_inside_as_the_rim_and_holes_are_away() {
    let disc = Outline::Disc { radius_m: 0.05 };
    let rectangle = Outline::Rectangle { width_m: 0.1, height_m: 0.04 };
    let square = |half: f64| vec![[-half, -half], [half, -half], [half, half], [-half, half]];
    let ring = Outline::Polygon { outer: square(0.05), holes: vec![square(0.01)] };
    for (outline, place, expected) in [
        (&disc, [0.03, -0.02], 0.05 - 0.03_f64.hypot(0.02)),
        (&disc, [0.05, 0.01], 0.0),
        (&rectangle, [0.045, 0.0], 0.005),
        (&rectangle, [0.0, -0.015], 0.005),
        (&rectangle, [0.0, 0.021], 0.0),
        (&ring, [0.04, 0.0], 0.01),
        (&ring, [0.0, 0.013], 0.003),
        (&ring, [0.0, 0.005], 0.0),
        (&ring, [0.06, 0.0], 0.0),
    ] {
        let inside = outline.inside_by_m(place);
        assert!((inside - expected).abs() < 1e-12, "{outline:?} {place:?}: {inside}");
    }
}
