//! Link frames compared with pinocchio and yourdfpy, patches with a table made by hand, and cells with the area of
//! their skin.

use dermis_body::urdf::Urdf;
use dermis_body::{Body, ForceEstimate, Kinematics, SpatialTouch, Taxels, Transform};
use dermis_tomo::mesh::{PixelMap, Surface};
use dermis_touch::{ContactSign, Observation, Touch, TouchPhase};

use super::data;

const JOINTS: [&str; 5] = ["rail", "turn", "shoulder", "elbow", "finger"];
const LINKS: [&str; 3] = ["palm", "thumb_tip", "finger_tip"];

/// The rows of `branched.f64`, made by `reference.py`.
fn reference() -> Vec<[f64; 14]> {
    let bytes = std::fs::read(data("branched.f64")).expect("the reference");
    let numbers: Vec<f64> = bytes.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
    numbers.as_chunks::<14>().0.to_vec()
}

#[test]
fn link_poses_agree_with_pinocchio_and_yourdfpy_at_a_thousand_joint_states() {
    let file = data("branched.urdf");
    let kinematics = Kinematics::new(&Urdf::open(&file).unwrap(), &file).unwrap();
    let rows = reference();
    assert_eq!(rows.len(), 1000);
    let mut largest: f64 = 0.0;
    for row in rows {
        let mut joints = kinematics.unknown();
        for (name, value) in JOINTS.iter().zip(row) {
            kinematics.assign(&mut joints, name, value).unwrap();
        }
        let all = kinematics.root_from_links(&joints);
        for (name, expected) in LINKS.iter().zip(row[5..].as_chunks::<3>().0) {
            let link = kinematics.link(name).unwrap();
            let climbed = kinematics.root_from_link(link, &joints).unwrap();
            for root_from_link in [climbed, all[link].unwrap()] {
                let point = root_from_link.point_m([0.03, -0.02, 0.05]);
                let errors = point.iter().zip(expected).map(|(a, b)| (a - b).abs());
                largest = errors.fold(largest, f64::max);
            }
        }
    }
    assert!(largest < 1e-9, "{largest} m");
    assert!(largest < 1e-14, "{largest} m: more than rounding");
}

#[test]
fn patches_on_an_arm_have_the_tabulated_poses() {
    let body = Body::open(&data("link-frames/arm.toml")).unwrap();
    let table = std::fs::read_to_string(data("link-frames/expected.csv")).unwrap();
    let mut compared = 0;
    for line in table.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |column: usize| cells[column].parse::<f64>().unwrap();
        let mut joints = body.kinematics.unknown();
        body.kinematics.assign(&mut joints, "shoulder", number(0)).unwrap();
        body.kinematics.assign(&mut joints, "elbow", number(1)).unwrap();
        let patch = body.patches.iter().position(|patch| patch.skin.name == cells[2]).unwrap();
        let root_from_patch = body.root_from_patch(patch, &joints).unwrap();
        let touch = touch([1e-3 * number(3), 1e-3 * number(4)], [[0.0; 2]; 2]);
        let found = SpatialTouch::of(&touch, &body.patches[patch].surface(), None).in_frame(&root_from_patch);
        for axis in 0..3 {
            assert!((found.position_m[axis] - number(5 + axis)).abs() < 1e-9, "{line}: {found:?}");
            assert!((found.normal[axis] - number(8 + axis)).abs() < 1e-9, "{line}: {found:?}");
        }
        compared += 1;
    }
    assert_eq!(compared, 16);
    assert_eq!(body.needed_joints().into_iter().collect::<Vec<_>>(), ["elbow", "shoulder"]);
    assert_eq!(body.root(), "base");
}

#[test]
fn forces_act_on_the_sensor_and_errors_lie_in_the_skin() {
    let surface = Surface::Cylinder { radius_m: 0.1 };
    let quarter_m = 0.1 * std::f64::consts::FRAC_PI_2;
    let touch = touch([quarter_m, 0.02], [[4e-6, 1e-6], [1e-6, 9e-6]]);
    let force = Some(ForceEstimate { force_n: 3.0, sigma_n: 0.1 });
    let on_patch = SpatialTouch::of(&touch, &surface, force);
    // A quarter of the way around, the normal points along x, and the sheet's x runs against z.
    let close = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-15);
    assert!(close(on_patch.position_m, [0.1, 0.02, -0.1]) && close(on_patch.normal, [1.0, 0.0, 0.0]));
    assert!(close(on_patch.force_n.unwrap(), [-3.0, 0.0, 0.0]));
    let expected = [[0.0, 0.0, 0.0], [0.0, 9e-6, -1e-6], [0.0, -1e-6, 4e-6]];
    for (row, expected) in on_patch.covariance_m2.into_iter().zip(expected) {
        assert!(row.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-20), "{row:?}");
    }
    let turned = on_patch.in_frame(&Transform::from_xyz_rpy([1.0, 0.0, 0.0], [0.0, 0.0, std::f64::consts::FRAC_PI_2]));
    assert!(close(turned.force_n.unwrap(), [0.0, -3.0, 0.0]) && close(turned.normal, [0.0, 1.0, 0.0]));
    assert!((turned.covariance_m2[0][0] - 9e-6).abs() < 1e-18 && turned.covariance_m2[1][1].abs() < 1e-18);
}

#[test]
fn cells_cover_the_skin_and_point_outward() {
    for name in ["healing-square", "piezo-cylinder", "hydrogel-disc"] {
        let skin = dermis_skin::Skin::open(name).unwrap();
        let body = skin.body().unwrap();
        let map = PixelMap::new(skin.grid().unwrap(), &body.mesh.mesh).unwrap();
        let taxels = Taxels::of(&map, &skin.surface());
        let (area, outline): (f64, f64) = (taxels.areas_m2.iter().sum(), body.outline.area_m2());
        // Pixels that are less than half skin are not cells.
        assert!((0.95..1.001).contains(&(area / outline)), "{name}: {area} of {outline}");
        assert_eq!(taxels.len(), map.inside_count());
        if let Surface::Cylinder { radius_m } = skin.surface() {
            for (position, normal) in taxels.positions_m.iter().zip(&taxels.normals) {
                // The axis lies one radius below the centre of the sheet.
                let from_axis = [position[0] / radius_m, (position[2] + radius_m) / radius_m];
                assert!((normal[0] - from_axis[0]).abs() < 1e-12 && (normal[2] - from_axis[1]).abs() < 1e-12);
            }
        }
    }
}

fn touch(position_m: [f64; 2], covariance_m2: [[f64; 2]; 2]) -> Touch {
    Touch {
        id: 1,
        phase: TouchPhase::Move,
        observation: Observation::Measured,
        sign: ContactSign::Positive,
        position_m,
        covariance_m2,
        filtered_position_m: position_m,
        velocity_m_per_s: [0.0; 2],
        amplitude: 0.2,
        area_m2: 1e-4,
        force: None,
        radius_m: None,
        load: None,
        other_place: None,
        age_frames: 3,
        begin_time_ns: 0,
        time_ns: 0,
    }
}
