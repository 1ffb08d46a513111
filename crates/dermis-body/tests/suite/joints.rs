//! Joint values: known, unknown and mimicked ones, and JSON lines of them.

use dermis_body::joint_lines::take_line;
use dermis_body::urdf::Urdf;
use dermis_body::{Assigned, Kinematics};

use super::data;

fn branched() -> Kinematics {
    let file = data("branched.urdf");
    Kinematics::new(&Urdf::open(&file).unwrap(), &file).unwrap()
}

#[test]
fn a_link_has_no_pose_until_every_joint_on_the_way_has_a_value() {
    let kinematics = branched();
    let mut joints = kinematics.unknown();
    let palm = kinematics.link("palm").unwrap();
    let needed: Vec<&str> = kinematics.joints_of(palm).unwrap().into_iter().collect();
    assert_eq!(needed, ["elbow", "rail", "shoulder", "turn"]);
    for name in needed {
        assert_eq!(kinematics.root_from_link(palm, &joints), None);
        assert_eq!(kinematics.assign(&mut joints, name, 0.1).unwrap(), Assigned::Taken);
    }
    assert!(kinematics.root_from_link(palm, &joints).is_some());
    let all = kinematics.root_from_links(&joints);
    assert!(all[palm].is_some() && all[kinematics.link("thumb_tip").unwrap()].is_none());
}

#[test]
fn a_joint_that_mimics_follows_and_has_no_value_of_its_own() {
    let kinematics = branched();
    let mut joints = kinematics.unknown();
    assert_eq!(kinematics.assign(&mut joints, "thumb", 1.0).unwrap(), Assigned::NotItsOwn);
    assert_eq!(kinematics.assign(&mut joints, "plate", 1.0).unwrap(), Assigned::NotItsOwn);
    assert_eq!(kinematics.assign(&mut joints, "toe", 1.0).unwrap(), Assigned::Unknown);
    kinematics.assign(&mut joints, "finger", 0.6).unwrap();
    assert!((kinematics.value(&joints, "thumb").unwrap() - (0.2 - 0.3)).abs() < 1e-15);
    let thumb = kinematics.joints_of(kinematics.link("thumb_tip").unwrap()).unwrap();
    assert!(thumb.contains("finger") && !thumb.contains("thumb"));
    assert_eq!(kinematics.moving_joints().collect::<Vec<_>>(), ["rail", "turn", "shoulder", "elbow", "finger"]);
    assert_eq!(kinematics.limits("finger"), Some([0.0, 1.5]));
}

#[test]
fn lines_of_both_kinds_move_joints() {
    let kinematics = branched();
    let mut joints = kinematics.unknown();
    let line = take_line(r#"{"time_s": 2.5, "joints": {"elbow": 0.7, "toe": 1}}"#, &kinematics, &mut joints).unwrap();
    assert_eq!((line.time_s, line.taken, line.unknown), (Some(2.5), 1, vec!["toe".to_owned()]));
    let state = r#"{"header": {"frame_id": ""}, "name": ["rail", "thumb"], "position": [-0.1, 3], "velocity": [], "effort": []}"#;
    assert_eq!(take_line(state, &kinematics, &mut joints).unwrap().taken, 1);
    assert_eq!((kinematics.value(&joints, "elbow"), kinematics.value(&joints, "rail")), (Some(0.7), Some(-0.1)));
}

#[test]
fn a_bad_line_is_reported_and_moves_nothing() {
    let kinematics = branched();
    let before = kinematics.at_rest();
    let cases = [
        (r#"{"joints": {"elbow": 0.7}"#, "EOF"),
        (r#"{"joints": {"elbow": null}}"#, "invalid type: null"),
        (r#"{"joints": {"elbow": 1e999}}"#, "number out of range"),
        (r#"{"name": ["elbow"], "position": []}"#, "1 names and 0 positions"),
        (r#"{"name": ["elbow"]}"#, "expected either"),
        (r#"{"angles": {"elbow": 1}}"#, "unknown field"),
        ("[1, 2]", "joint values: "),
    ];
    for (text, expected) in cases {
        let mut joints = before.clone();
        let error = take_line(text, &kinematics, &mut joints).unwrap_err().to_string();
        assert!(error.starts_with("joint values: ") && error.contains(expected), "{text}: {error}");
        assert_eq!(joints, before, "{text}");
    }
    let long = format!(r#"{{"joints": {{"elbow": 0.7}}}}{}"#, " ".repeat(200_000));
    assert!(take_line(&long, &kinematics, &mut before.clone()).unwrap_err().to_string().contains("at most"));
}
