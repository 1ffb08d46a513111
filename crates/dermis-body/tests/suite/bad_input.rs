//! Invalid robots, bodies and meshes give errors with file, line and expected content.

use std::path::Path;

use dermis_body::{Body, Error};
use dermis_skin::FileError;

const ARM: &str = r#"<robot name="arm">
  <link name="base"/>
  <link name="hand"><visual><geometry><mesh filename="package://arm/hand.stl"/></geometry></visual></link>
  <joint name="wrist" type="revolute">
    <parent link="base"/><child link="hand"/><axis xyz="0 0 1"/>
  </joint>
</robot>
"#;

const BODY: &str = "urdf = \"arm.urdf\"\n\n[[patch]]\nname = \"palm\"\nskin = \"healing-square\"\nlink = \"hand\"\n";

fn write(folder: &Path, urdf: &str, body: &str) {
    std::fs::write(folder.join("arm.urdf"), urdf).unwrap();
    std::fs::write(folder.join("arm.toml"), body).unwrap();
}

/// The error message for a robot and a body.
fn message(urdf: &str, body: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), urdf, body);
    let error = Body::open(&folder.path().join("arm.toml")).expect_err(body).to_string();
    error.replace(&format!("{}/", folder.path().display()), "")
}

#[test]
fn faults_of_a_robot_are_reported_with_their_line() {
    let joint = |from: &str, to: &str| ARM.replacen(from, to, 1);
    let cases = [
        (joint("</robot>", ""), "arm.urdf, line 6: not XML"),
        ("<model/>".to_owned(), "arm.urdf, line 1: <model>: expected <robot>"),
        ("<robot name=\"a\"/>".to_owned(), "arm.urdf, line 1: no <link>"),
        (
            joint("<child link=\"hand\"/>", "<child link=\"hnd\"/>"),
            "arm.urdf, line 4: joint wrist: child link \"hnd\": expected a link of the file: base, hand",
        ),
        (joint("<child link=\"hand\"/>", ""), "arm.urdf, line 4: joint wrist: expected a <child>"),
        (joint("type=\"revolute\"", "type=\"hinge\""), "arm.urdf, line 4: joint wrist: type=\"hinge\": expected fixed"),
        (joint("\"0 0 1\"", "\"0 0\""), "arm.urdf, line 5: <axis> xyz=\"0 0\": expected 3 numbers"),
        (joint("\"0 0 1\"", "\"0 0 nan\""), "expected 3 numbers"),
        (
            joint("\"0 0 1\"", "\"0 0 0\""),
            "arm.urdf, line 5: joint wrist: axis xyz=[0.0, 0.0, 0.0]: expected a direction",
        ),
        (joint("\"0 0 1\"", "\"0 0 ${q}\""), "xacro"),
        (
            joint("<link name=\"base\"/>", "<link name=\"base\"/><link name=\"base\"/>"),
            "arm.urdf, line 2: duplicate link \"base\"",
        ),
        (
            joint("<link name=\"base\"/>", "<link name=\"base\"/><link name=\"lost\"/>"),
            "are carried by no joint: expected one root",
        ),
        (joint("<parent link=\"base\"/>", "<parent link=\"hand\"/>"), "cycle"),
        (
            joint("<axis", "<mimic joint=\"elbow\"/><axis"),
            "arm.urdf, line 4: joint wrist: mimics \"elbow\": expected a joint of the file",
        ),
        (joint("<axis", "<mimic joint=\"wrist\"/><axis"), "a cycle"),
        (
            joint(
                "</robot>",
                "<joint name=\"wrist\" type=\"fixed\"><parent link=\"base\"/><child link=\"hand\"/></joint></robot>",
            ),
            "arm.urdf, line 7: duplicate joint \"wrist\"",
        ),
        (
            joint(
                "</robot>",
                "<joint name=\"b\" type=\"fixed\"><parent link=\"base\"/><child link=\"hand\"/></joint></robot>",
            ),
            "expected one joint to carry it, but wrist does (line 4)",
        ),
        (
            joint("type=\"revolute\"", "type=\"floating\""),
            "arm.toml, line 6: patch palm: link = \"hand\": expected a link reached through joints with one value each; wrist has several",
        ),
        ("<!DOCTYPE r [<!ENTITY a \"aaaa\">]><robot/>".to_owned(), "arm.urdf, line 1: not XML"),
        (joint("filename=", "file="), "arm.urdf, line 3: <mesh> without filename"),
    ];
    for (urdf, expected) in cases {
        let message = message(&urdf, BODY);
        assert!(message.contains(expected), "{message}\nexpected {expected}");
    }
}

#[test]
fn faults_of_a_body_are_reported_with_their_line() {
    let body = |from: &str, to: &str| BODY.replacen(from, to, 1);
    let cases = [
        (
            body("link = \"hand\"", "link = \"hnd\""),
            "arm.toml, line 6: patch palm: link = \"hnd\": expected a link of the robot: base, hand",
        ),
        (body("link = \"hand\"\n", ""), "arm.toml, line 4: patch palm: link = left out: expected a link of the robot"),
        (body("link = \"hand\"", "lnk = \"hand\""), "unknown field `lnk`"),
        (body("urdf = \"arm.urdf\"", "urdf = \"leg.urdf\""), "arm.toml, line 1: urdf = leg.urdf: expected a URDF file"),
        (body("urdf = \"arm.urdf\"", ""), "(there is no urdf)"),
        (body("healing-square", "no-such-skin"), "arm.toml, line 5: patch palm: skin"),
        (body("\"palm\"", "\"pal m\""), "arm.toml, line 4: patch.name = \"pal m\": expected a name of"),
        (format!("{BODY}xyz_mm = [1, 2]\n"), "arm.toml: TOML parse error at line 7"),
        (format!("{BODY}xyz_mm = [1, 2, nan]\n"), "arm.toml, line 7: patch palm: xyz_mm = NaN: expected three numbers"),
        (format!("{BODY}rpy_deg = [0, 0, 3600]\n"), "arm.toml, line 7: patch palm: rpy_deg = 3600"),
        (
            format!("{BODY}{}", &BODY[BODY.find("\n[[").unwrap()..]),
            "arm.toml, line 9: patch.name = \"palm\": expected a name that no other patch has; line 4 has the same",
        ),
        (
            format!("joints.source = \"tcp:robot\"\n{BODY}"),
            "arm.toml, line 1: joints.source = tcp:robot: expected - (standard input), tcp:HOST:PORT",
        ),
        (
            format!("joints.source = \"none.jsonl\"\n{BODY}"),
            "arm.toml, line 1: joints.source = none.jsonl: expected - (standard input), tcp:HOST:PORT",
        ),
        ("urdf = \"arm.urdf\"\n".to_owned(), "arm.toml: no [[patch]]"),
        (
            format!("joints.at.elbow = 1\n{BODY}"),
            "arm.toml, line 1: joints.at.elbow = 1: expected a joint that moves by itself: wrist",
        ),
        (
            format!("joints.stale_after_ms = -1\n{BODY}"),
            "arm.toml, line 1: joints.stale_after_ms = -1: expected milliseconds",
        ),
    ];
    for (body, expected) in cases {
        let message = message(ARM, &body);
        assert!(message.contains(expected), "{message}\nexpected {expected}");
    }
    let missing = Body::open(Path::new("/nowhere/arm.toml")).unwrap_err();
    assert!(matches!(missing, Error::Io(FileError { .. })));
}

#[test]
fn a_body_leaves_out_its_bad_patches_and_names_each() {
    let folder = tempfile::tempdir().unwrap();
    let bad = "\n[[patch]]\nname = \"back\"\nskin = \"broken.toml\"\nlink = \"base\"\n";
    write(folder.path(), ARM, &format!("{BODY}{bad}"));
    std::fs::write(folder.path().join("broken.toml"), "name = 3\n").unwrap();
    let (body, problems) = Body::examine(&folder.path().join("arm.toml")).unwrap();
    assert_eq!(body.patches.iter().map(|patch| patch.name.as_str()).collect::<Vec<_>>(), ["palm"]);
    let messages: Vec<String> = problems.iter().map(|problem| problem.error.to_string()).collect();
    assert_eq!(problems.iter().map(|problem| problem.only_drawn).collect::<Vec<_>>(), [true, false]);
    assert!(
        messages[0].contains("arm.urdf, line 3: mesh \"package://arm/hand.stl\": package arm was not found"),
        "{messages:?}"
    );
    assert!(messages[1].contains("line 10: patch back: ") && messages[1].contains("broken.toml"), "{messages:?}");
}

#[test]
fn meshes_are_found_in_packages_and_read() {
    let folder = tempfile::tempdir().unwrap();
    let problems = |body: &str| {
        write(folder.path(), ARM, body);
        let (_, problems) = Body::examine(&folder.path().join("arm.toml")).unwrap();
        problems.into_iter().map(|problem| problem.error.to_string()).collect::<Vec<_>>()
    };
    let with_package = format!("packages.arm = \"meshes\"\n{BODY}");
    assert!(problems(&with_package)[0].contains("meshes/hand.stl"), "{:?}", problems(&with_package));
    std::fs::create_dir(folder.path().join("meshes")).unwrap();
    std::fs::write(folder.path().join("meshes/hand.stl"), b"no mesh").unwrap();
    assert!(problems(&with_package)[0].contains("no STL file, or cut off"), "{:?}", problems(&with_package));
    let mut binary = vec![0; 80];
    binary.extend(1u32.to_le_bytes());
    binary.extend([0; 50]);
    std::fs::write(folder.path().join("meshes/hand.stl"), &binary).unwrap();
    assert_eq!(problems(&with_package), Vec::<String>::new());
    std::fs::rename(folder.path().join("meshes/hand.stl"), folder.path().join("meshes/hand.3ds")).unwrap();
    write(folder.path(), &ARM.replace("hand.stl", "hand.3ds"), &with_package);
    let (_, old) = Body::examine(&folder.path().join("arm.toml")).unwrap();
    assert!(old[0].only_drawn && old[0].error.to_string().contains("format \"3DS\": expected STL"), "{old:?}");
    std::fs::rename(folder.path().join("meshes/hand.3ds"), folder.path().join("meshes/hand.stl")).unwrap();
    // A folder with the package's name next to the robot is found without being specified.
    std::fs::rename(folder.path().join("meshes"), folder.path().join("arm")).unwrap();
    assert_eq!(problems(BODY), Vec::<String>::new());
}

#[test]
fn a_skin_file_may_state_its_mount() {
    let folder = tempfile::tempdir().unwrap();
    let mut skin = dermis_skin::Skin::open("healing-square").unwrap();
    skin.mount = Some(dermis_skin::Mount { link: "hand".into(), xyz_mm: [0.0, 0.0, 20.0], rpy_deg: [0.0, 180.0, 0.0] });
    std::fs::write(folder.path().join("skin.toml"), skin.to_toml()).unwrap();
    let mounted = BODY.replace("healing-square", "skin.toml").replace("link = \"hand\"\n", "");
    write(folder.path(), ARM, &mounted);
    let body = Body::open(&folder.path().join("arm.toml")).unwrap();
    let place = body.patches[0].link_from_patch.point_m([0.01, 0.0, 0.0]);
    assert!((place[0] + 0.01).abs() < 1e-15 && (place[2] - 0.02).abs() < 1e-15, "{place:?}");
    // A pose without a link would apply to the skin file's link.
    let message = message_in(folder.path(), &format!("{mounted}xyz_mm = [1, 0, 0]\n"));
    assert!(message.contains("patch palm: link = left out"), "{message}");
}

fn message_in(folder: &Path, body: &str) -> String {
    write(folder, ARM, body);
    Body::open(&folder.join("arm.toml")).expect_err(body).to_string()
}
