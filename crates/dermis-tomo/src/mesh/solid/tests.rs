//! Tests of slabs and prisms: volumes, conforming faces, electrode areas, refusals.

use std::f64::consts::{PI, TAU};

use super::*;

fn volume(mesh: &ElectrodedMesh) -> f64 {
    mesh.mesh.measures().iter().sum()
}

/// Area of the whole surface; larger than the true area if tetrahedra do not conform.
fn surface(mesh: &ElectrodedMesh) -> f64 {
    mesh.mesh.boundary_faces().iter().map(|(face, _)| mesh.mesh.face_measure(face)).sum()
}

fn assert_relative(got: f64, wanted: f64, tolerance: f64) {
    assert!((got / wanted - 1.0).abs() < tolerance, "{got} is not {wanted} within {tolerance:e}");
}

fn slab(electrodes: Vec<SlabElectrode>) -> SlabSpec {
    SlabSpec { size_m: [0.1, 0.08, 0.01], cells: [20, 16, 3], electrodes }
}

fn on(face: SlabFace, shape: PatchShape) -> SlabElectrode {
    SlabElectrode { face, shape }
}

#[test]
fn slab_fills_its_box_and_its_rectangles_are_exact() {
    let below = PatchShape::Rectangle { centre_m: [0.0123, -0.0077], width_m: 0.011, height_m: 0.007 };
    let beside = PatchShape::Rectangle { centre_m: [0.01, 0.004], width_m: 0.013, height_m: 0.003 };
    let round = PatchShape::Circle { centre_m: [-0.02, 0.01], radius_m: 0.012 };
    let point = PatchShape::Point { position_m: [0.0311, 0.0213] };
    let electrodes = vec![
        on(SlabFace::Bottom, below.clone()),
        on(SlabFace::Top, below),
        on(SlabFace::Right, beside.clone()),
        on(SlabFace::Front, beside),
        on(SlabFace::Bottom, round),
        on(SlabFace::Bottom, point),
    ];
    let mesh = slab(electrodes).build(&[1e-4]).unwrap();
    assert_relative(volume(&mesh), 0.1 * 0.08 * 0.01, 1e-12);
    assert_relative(surface(&mesh), 2.0 * (0.1 * 0.08 + 0.1 * 0.01 + 0.08 * 0.01), 1e-12);
    let areas = mesh.electrode_measures();
    for (index, area) in [(0, 0.011 * 0.007), (1, 0.011 * 0.007), (2, 0.013 * 0.003), (3, 0.013 * 0.003)] {
        assert_relative(areas[index], area, 1e-12);
    }
    // A staircase of 5 mm boxes, two triangles each, around a circle of 12 mm.
    assert_relative(areas[4], PI * 0.012 * 0.012, 0.15);
    let Contact::Point(node) = mesh.electrodes[5].contact else { panic!("no point") };
    let p = mesh.mesh.nodes()[node as usize];
    assert!((p[0] - 0.0311).abs() < 1e-15 && (p[1] - 0.0213).abs() < 1e-15 && p[2] == 0.0, "{p:?}");
}

#[test]
fn cylinder_has_the_volume_of_its_polygon_and_exact_wall_electrodes() {
    let ring = |low_m: f64, high_m: f64, start: f64| {
        (0..8).map(move |k| PrismElectrode::Side {
            rim: ElectrodeShape::RimArc { centre_rad: start + TAU * k as f64 / 8.0, width_m: 0.01 },
            low_m,
            high_m,
        })
    };
    // The upper ring is rotated by a quarter of the electrode pitch, so its arcs overlap those of the lower ring seen
    // from above.
    let electrodes: Vec<_> = ring(0.01, 0.02, 0.0).chain(ring(0.04, 0.05, 0.1)).collect();
    let mesh = PrismSpec::cylinder(0.05, 0.06, 0.008, 6, electrodes).build(&[1e-3]).unwrap();
    let rim: f64 = mesh
        .mesh
        .boundary_faces()
        .iter()
        .map(|(face, _)| {
            let corners = [face[0], face[1], face[2]].map(|node| mesh.mesh.nodes()[node as usize]);
            if corners.iter().all(|c| c[2] == 0.0) { mesh.mesh.face_measure(face) } else { 0.0 }
        })
        .sum();
    assert_relative(volume(&mesh), rim * 0.06, 1e-12);
    // The polygon of at least 40 edges misses 2 pi^2 / 3 / 40^2 = 0.4 % of the circle.
    assert_relative(rim, PI * 0.05 * 0.05, 0.005);
    for area in mesh.electrode_measures() {
        // Chords of 10 mm in at least 4 edges on a radius of 50 mm: (0.2)^2 / 24 / 16 = 1e-4 short.
        assert_relative(area, 0.01 * 0.01, 5e-4);
    }
    let count = |z: f64| mesh.mesh.nodes().iter().filter(|p| p[2] == z).count();
    assert!(count(0.01) > 0 && count(0.02) > 0, "layers run along the electrodes' edges");
}

#[test]
fn cylinder_with_pads_beneath_and_points() {
    let pad = ElectrodeShape::PadCircle { centre_m: [0.01, 0.0], radius_m: 0.005 };
    let plate = ElectrodeShape::PadRectangle { centre_m: [-0.02, 0.0], width_m: 0.01, height_m: 0.02, angle_rad: 0.3 };
    let electrodes = vec![
        PrismElectrode::Top(pad.clone()),
        PrismElectrode::Bottom(plate),
        PrismElectrode::Bottom(pad),
        PrismElectrode::Bottom(ElectrodeShape::Point { position_m: [0.0, 0.03] }),
        PrismElectrode::SidePoint { position_m: 0.0, height_m: 0.013 },
    ];
    let mesh = PrismSpec::cylinder(0.05, 0.02, 0.008, 4, electrodes).build(&[1e-3]).unwrap();
    let areas = mesh.electrode_measures();
    assert_relative(areas[0], PI * 25e-6, 1e-12);
    assert_relative(areas[1], 2e-4, 1e-12);
    assert_relative(areas[2], PI * 25e-6, 1e-12);
    let at = |index: usize| match mesh.electrodes[index].contact {
        Contact::Point(node) => mesh.mesh.nodes()[node as usize],
        _ => panic!("no point"),
    };
    assert_eq!(at(3), [0.0, 0.03, 0.0]);
    assert_eq!(at(4), [0.05, 0.0, 0.013]);
    let Contact::Faces(faces) = &mesh.electrodes[0].contact else { panic!("no faces") };
    assert!(faces.iter().flatten().all(|&node| mesh.mesh.nodes()[node as usize][2] == 0.02));
}

#[test]
fn mistakes_are_named() {
    let refused = |electrodes: Vec<SlabElectrode>| slab(electrodes).build(&[1e-4]).unwrap_err().to_string();
    let plate = |x: f64| PatchShape::Rectangle { centre_m: [x, 0.0], width_m: 0.02, height_m: 0.02 };
    let tiny = PatchShape::Circle { centre_m: [0.0, 0.0], radius_m: 1e-5 };
    assert!(refused(vec![on(SlabFace::Bottom, plate(0.045))]).contains("electrode 0: reaches from"));
    assert!(refused(vec![on(SlabFace::Bottom, plate(0.0)), on(SlabFace::Bottom, plate(0.01))]).contains("overlaps"));
    assert!(refused(vec![on(SlabFace::Bottom, tiny)]).contains("electrode 0: touches no part"));
    assert!(refused(vec![on(SlabFace::Left, plate(f64::NAN))]).contains("NaN"));
    let mut spec = slab(vec![]);
    spec.cells = [100_000, 100_000, 1000];
    assert!(spec.build(&[1.0]).unwrap_err().to_string().contains("few enough"));
    spec.size_m[2] = -1.0;
    assert!(spec.build(&[1.0]).unwrap_err().to_string().contains("size_m[2]: -1"));

    let arc = |low_m: f64, high_m: f64| PrismElectrode::Side {
        rim: ElectrodeShape::RimArc { centre_rad: 0.0, width_m: 0.01 },
        low_m,
        high_m,
    };
    let refused = |electrodes: Vec<PrismElectrode>| {
        PrismSpec::cylinder(0.05, 0.06, 0.01, 3, electrodes).build(&[1e-3]).unwrap_err().to_string()
    };
    assert!(refused(vec![arc(0.05, 0.07)]).contains("electrode 0: heights 0.05 to 0.07"));
    assert!(refused(vec![arc(0.03, 0.01)]).contains("not a range"));
    assert!(refused(vec![arc(0.01, 0.03), arc(0.02, 0.04)]).contains("electrode 1: overlaps electrode 0"));
    let pad = |x: f64| ElectrodeShape::PadCircle { centre_m: [x, 0.0], radius_m: 0.005 };
    let crossing = vec![arc(0.01, 0.02), PrismElectrode::Bottom(pad(0.0)), PrismElectrode::Top(pad(0.004))];
    assert!(refused(crossing).contains("electrode 2: overlaps or touches electrode 1"));
    let misplaced = PrismElectrode::Bottom(ElectrodeShape::RimArc { centre_rad: 0.0, width_m: 0.01 });
    assert!(refused(vec![misplaced]).contains("belong on the side"));
}
