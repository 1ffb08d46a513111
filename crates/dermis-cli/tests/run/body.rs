//! `dermis run` and `dermis body` with a body file: frames, joints, isolated failures, and one recording of
//! everything.

use std::path::Path;
use std::process::Command;

use super::{lines, message, run};
use serde_json::Value;

const ARM: &str = r#"<robot name="arm">
  <link name="base"/><link name="forearm"/>
  <joint name="elbow" type="revolute">
    <parent link="base"/><child link="forearm"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>
  </joint>
</robot>"#;

const BODY: &str = r#"urdf = "arm.urdf"

[joints]
stale_after_ms = 60000

[[patch]]
name = "outer"
skin = "healing-square"
link = "forearm"
xyz_mm = [100, 0, 30]
rpy_deg = [0, 0, 90]

[[patch]]
name = "chest"
skin = "healing-square"
link = "base"
rpy_deg = [90, 0, 90]
"#;

fn desk(body: &str) -> tempfile::TempDir {
    let desk = tempfile::tempdir().expect("a directory");
    std::fs::write(desk.path().join("arm.urdf"), ARM).expect("a file");
    std::fs::write(desk.path().join("arm.toml"), body).expect("a file");
    desk
}

fn body(directory: &Path, arguments: &[&str]) -> std::process::Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dermis"));
    command.arg("body").args(arguments).current_dir(directory).output().expect("the command starts")
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap_or_else(|| panic!("{value}")).iter().map(|v| v.as_f64().expect("a number")).collect()
}

#[test]
fn touches_of_two_patches_are_reported_in_every_frame_and_replay_from_one_recording() {
    let desk = desk(BODY);
    std::fs::write(desk.path().join("joints.jsonl"), "{\"joints\": {\"elbow\": 0.7}}\n").expect("a file");
    let arguments = [
        "arm.toml",
        "--headless",
        "--frames",
        "90",
        "--speed",
        "0",
        "--joints",
        "joints.jsonl",
        "--record",
        "arm.mcap",
    ];
    let output = run(desk.path(), &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", message(&output));
    let all = lines(&output);
    let of = |patch: &str| all.iter().filter(|line| line["patch"] == patch).cloned().collect::<Vec<_>>();
    let (outer, chest) = (of("outer"), of("chest"));
    assert_eq!((outer.len(), chest.len()), (90, 90));
    let health = &all.last().expect("lines")["health"];
    assert_eq!((&health["patches"][0]["state"], &health["patches"][1]["frames"]), (&"ended".into(), &90.into()));
    let (mut touched, mut pressed) = (0, 0);
    for line in &outer {
        assert_eq!((&line["link"], &line["root"]), (&"forearm".into(), &"base".into()));
        for touch in line["touches"].as_array().expect("touches") {
            let [x, y] = ["x_mm", "y_mm"].map(|key| touch[key].as_f64().expect("a number"));
            assert_eq!(numbers(&touch["in_patch"]["position_mm"]), [x, y, 0.0]);
            // A quarter turn about z, then the arm about y, written out.
            let (s, c) = 0.7f64.sin_cos();
            let on_link = [100.0 - y, x, 30.0];
            let expected = [c * on_link[0] + s * on_link[2], on_link[1], 300.0 - s * on_link[0] + c * on_link[2]];
            if line["joints"]["state"] == "fresh" {
                let found = numbers(&touch["in_root"]["position_mm"]);
                assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?} {expected:?}");
                let normal = numbers(&touch["in_root"]["normal"]);
                assert!((normal[0] - s).abs() < 1e-12 && (normal[2] - c).abs() < 1e-12, "{normal:?}");
                // The force follows from the layer's law and acts on the skin.
                let force_n = touch["force_n"].as_f64().expect("a force");
                let expected = [-s * force_n, 0.0, -c * force_n];
                let found = numbers(&touch["in_root"]["force_n"]);
                assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?} {expected:?}");
                touched += 1;
            }
        }
        let present = line["touches"].as_array().into_iter().flatten().filter(|touch| touch["phase"] != "end");
        let sum_n: f64 = present.map(|touch| touch["force_n"].as_f64().expect("a force")).sum();
        if line["sequence"].as_u64() > Some(34) {
            let net_n = numbers(&line["link_wrench"]["force_n"]);
            assert!(net_n[0].abs() + net_n[1].abs() + (net_n[2] + sum_n).abs() < 1e-9, "{net_n:?} for {sum_n}");
            pressed += usize::from(sum_n > 0.0);
        }
    }
    assert!(touched > 10 && pressed > 10, "{touched} touches in the root's frame, {pressed} frames with a net force");

    let again = run(desk.path(), &["--source", "arm.mcap/outer", "--speed", "0", "--headless"]);
    assert_eq!(again.status.code(), Some(0), "{}", message(&again));
    super::assert_same_touches(&lines(&again), &outer);
    let whole = run(desk.path(), &["--source", "arm.mcap", "--headless"]);
    assert_eq!(whole.status.code(), Some(2));
    assert!(message(&whole).contains("expected a patch of it, FILE/PATCH: chest, outer"), "{}", message(&whole));
    for recording in ["arm.mcap", "arm.mcap/outer"] {
        let mut recover = Command::new(env!("CARGO_BIN_EXE_dermis"));
        let refused = recover.args(["recover", recording, "--out", "new.mcap"]).current_dir(desk.path()).output();
        let refused = refused.expect("the command starts");
        assert_eq!(refused.status.code(), Some(2));
        assert!(message(&refused).contains("arm.mcap: metadata: the recording of a body"), "{}", message(&refused));
    }
}

#[test]
fn a_patch_that_cannot_start_is_named_and_the_others_may_continue() {
    let broken = BODY.replacen("link = \"base\"", "link = \"base\"\nsource = \"nowhere.csv\"", 1);
    let desk = desk(&broken);
    let strict = run(desk.path(), &["arm.toml", "--headless", "--frames", "40", "--speed", "0"]);
    assert_eq!(strict.status.code(), Some(2), "{}", message(&strict));
    assert!(
        message(&strict).contains("patch chest: ") && message(&strict).contains("nowhere.csv"),
        "{}",
        message(&strict)
    );

    let going = run(desk.path(), &["arm.toml", "--headless", "--frames", "40", "--speed", "0", "--keep-going"]);
    assert_eq!(going.status.code(), Some(3), "{}", message(&going));
    let all = lines(&going);
    assert_eq!(all.iter().filter(|line| line["patch"] == "outer").count(), 40);
    let rows = &all.last().expect("lines")["health"]["patches"];
    assert_eq!((&rows[0]["state"], &rows[1]["state"]), (&"ended".into(), &"failed".into()));
    assert!(rows[1]["problem"].as_str().is_some_and(|why| why.contains("nowhere.csv")), "{rows}");
    // The load on a failed patch is unknown, so the sum is unknown too.
    let last = all.iter().rfind(|line| line["patch"] == "outer").expect("lines");
    assert!(last["body_wrench"]["unknown"].to_string().contains("chest: "), "{last}");
    assert!(message(&going).contains("joints without a source: elbow"), "{}", message(&going));
}

#[test]
fn without_joint_values_the_root_frame_is_unknown() {
    let desk = desk(&BODY.replace("stale_after_ms = 60000", "source = \"tcp:127.0.0.1:9\""));
    let output = run(desk.path(), &["arm.toml", "--headless", "--frames", "70", "--speed", "0"]);
    let all = lines(&output);
    let touches: Vec<&Value> = all
        .iter()
        .filter(|line| line["patch"] == "outer")
        .filter_map(|line| line["touches"].as_array())
        .flatten()
        .collect();
    assert!(touches.len() > 5, "{}", message(&output));
    assert!(touches.iter().all(|touch| touch["in_root"].is_null() && touch["in_link"].is_object()));
    assert!(all.iter().filter(|line| line["patch"] == "outer").all(|line| line["joints"]["state"] == "stale"));
    let health = &all.last().expect("lines")["health"];
    assert!(health["joints_problem"].as_str().is_some_and(|why| why.contains("127.0.0.1:9")), "{health}");
}

#[test]
fn bodies_are_checked_drawn_and_demonstrated() {
    let desk = desk(&BODY.replacen("link = \"base\"", "link = \"trunk\"", 1));
    let checked = body(desk.path(), &["check", "arm.toml"]);
    assert_eq!(checked.status.code(), Some(1));
    let text = String::from_utf8_lossy(&checked.stdout).into_owned();
    assert!(
        text.contains("arm.toml, line 16: patch chest: link = \"trunk\": expected a link of the robot: base, forearm"),
        "{text}"
    );
    assert!(
        text.contains("outer: healing-square on forearm, from twin; centre at (100.0, 0.0, 330.0) mm of base"),
        "{text}"
    );
    let refused = run(desk.path(), &["arm.toml", "--headless", "--frames", "1"]);
    assert_eq!(refused.status.code(), Some(2), "{}", message(&refused));

    for (key, expected) in [
        ("calibration = \"none.json\"", "arm.toml, line 14: patch chest: none.json: cannot read"),
        ("forces = \"arm.urdf\"", "arm.toml, line 14: patch chest: arm.urdf: line 1, column 1"),
        ("baseline = \"none.csv\"", "arm.toml, line 14: patch chest: none.csv: cannot read"),
        ("source = \"none.csv\"", "arm.toml, line 14: patch chest: none.csv: "),
        ("source = \"usb:3\"", "arm.toml, line 14: patch chest: 'usb:3': expected file:PATH"),
    ] {
        std::fs::write(desk.path().join("files.toml"), format!("{BODY}{key}\n")).expect("a file");
        let checked = body(desk.path(), &["check", "files.toml"]);
        let text = String::from_utf8_lossy(&checked.stdout).into_owned();
        assert_eq!(checked.status.code(), Some(1), "{text}");
        assert!(text.contains(&expected.replace("arm.toml", "files.toml")), "{text}\nexpected {expected}");
        assert!(text.contains("2 patches, 1 problem"), "{text}");
    }

    assert_eq!(body(desk.path(), &["demo", "demo"]).status.code(), Some(0));
    assert_eq!(body(desk.path(), &["demo", "demo"]).status.code(), Some(2), "nothing is overwritten");
    let checked = body(desk.path(), &["check", "demo/arm.toml"]);
    let text = String::from_utf8_lossy(&checked.stdout).into_owned();
    assert_eq!(checked.status.code(), Some(0), "{text}");
    assert!(text.contains("4 patches, 0 problems") && text.contains("facing (1, 0, 0)"), "{text}");
    let drawn = body(desk.path(), &["draw", "demo/arm.toml", "--out", "arm.svg", "--joint", "elbow=1.2"]);
    assert_eq!(drawn.status.code(), Some(0), "{}", message(&drawn));
    let picture = std::fs::read_to_string(desk.path().join("arm.svg")).expect("a picture");
    assert!(["forearm", "palm", "chest", "back"].iter().all(|name| picture.contains(&format!(">{name}<"))));
    let unknown = body(desk.path(), &["draw", "demo/arm.toml", "--out", "arm.svg", "--joint", "knee=1"]);
    assert!(message(&unknown).contains("--joint knee: expected a joint that moves by itself: shoulder_yaw"));
}

#[test]
fn options_of_single_skins_are_refused_with_a_body_and_vice_versa() {
    let desk = desk(BODY);
    for (arguments, expected) in [
        (&["arm.toml", "--headless", "--source", "x.csv"][..], "--source: expected source = \"...\" in a [[patch]]"),
        (&["arm.toml", "--headless", "--speed", "-1"], "--speed -1: expected"),
        (&["healing-square", "--headless", "--joints", "-"], "expected a body file"),
        (&["arm.toml", "--headless", "--joints", "no.jsonl"], "joint values from no.jsonl"),
        (&["arm.toml", "--headless", "--joints", "tcp:robot"], "'tcp:robot' for '--joints <SOURCE>'"),
        (&["arm.toml", "--headless", "--joints", "page"], "expected another source with --headless"),
        (&["arm.toml", "--model", "x.json"], "--model: only for single skins"),
    ] {
        let output = run(desk.path(), arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", message(&output));
        assert!(message(&output).contains(expected), "{arguments:?}: {}", message(&output));
    }
}
