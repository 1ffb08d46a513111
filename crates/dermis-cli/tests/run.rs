//! `dermis run` as a script sees it: lines, recordings, replays, exit codes.

#[path = "run/body.rs"]
mod body;
#[path = "run/guard.rs"]
mod guard;

use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

use dermis_device::{Frame, Pacing, Repeat, Source, SourceEvent};
use dermis_record::{Recording, Replay};
use serde_json::Value;

fn run(directory: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_dermis"))
        .arg("run")
        .args(arguments)
        .current_dir(directory)
        .output()
        .expect("the command starts")
}

fn lines(output: &Output) -> Vec<Value> {
    let text = String::from_utf8(output.stdout.clone()).expect("UTF-8");
    text.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}"))).collect()
}

fn message(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Checks that the command succeeded or, on a machine too slow for the twin's rate, reported a counted loss.
fn assert_done(output: &Output) {
    let text = message(output);
    match output.status.code() {
        Some(0) => assert!(!text.contains("frames were lost"), "{text}"),
        Some(3) => assert!(text.contains("frames were lost") && text.contains("lost="), "{text}"),
        other => panic!("exit code {other:?}: {text}"),
    }
}

/// Checks for the same touches in the same frames. A replay in real time stamps frames with its own clock, which
/// affects drift and the prediction of touches, so positions may differ by up to half a millimetre, a third of a
/// pixel.
fn assert_same_touches(replay: &[Value], live: &[Value]) {
    assert_eq!(replay.len(), live.len());
    for (replay, live) in replay.iter().zip(live) {
        assert_eq!(replay["sequence"], live["sequence"]);
        let list = |line: &Value| line["touches"].as_array().cloned().unwrap_or_default();
        let (again, first) = (list(replay), list(live));
        assert_eq!(again.len(), first.len(), "{replay} {live}");
        for (again, first) in again.iter().zip(&first) {
            assert_eq!((&again["id"], &again["phase"]), (&first["id"], &first["phase"]), "{replay} {live}");
            for key in ["x_mm", "y_mm"] {
                let number = |touch: &Value| touch[key].as_f64().unwrap_or(f64::NAN);
                assert!((number(again) - number(first)).abs() < 0.5, "{key}: {replay} {live}");
            }
        }
    }
}

#[test]
fn a_twin_prints_one_line_a_frame_and_its_recording_replays_the_same_touches() {
    let desk = tempfile::tempdir().expect("a directory");
    let live = run(desk.path(), &["--headless", "--frames", "100", "--record", "x.mcap"]);
    assert_done(&live);
    let live = lines(&live);
    assert_eq!(live.len(), 100);
    let touched = live.iter().filter(|line| line["touches"].as_array().is_some_and(|list| !list.is_empty())).count();
    // The demonstration starts after the baseline's frames and presses 25 frames (one second) later.
    assert!(touched > 20, "only {touched} of 100 lines have touches");

    let replay = run(desk.path(), &["--source", "x.mcap", "--speed", "0", "--headless"]);
    // Frames lost by the live run are also missing from its recording, so the replay reports them too.
    assert_done(&replay);
    assert_same_touches(&lines(&replay), &live);
}

#[test]
fn a_port_in_use_is_a_failure_that_names_the_port() {
    let desk = tempfile::tempdir().expect("a directory");
    let taken = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let port = taken.local_addr().expect("an address").port().to_string();
    let output = run(desk.path(), &["--no-open", "--port", &port, "--frames", "1"]);
    assert_eq!(output.status.code(), Some(1), "{}", message(&output));
    assert!(message(&output).contains(&port), "{}", message(&output));
}

#[test]
fn an_unknown_skin_is_bad_usage() {
    let desk = tempfile::tempdir().expect("a directory");
    let output = run(desk.path(), &["no-such-skin", "--headless", "--frames", "1"]);
    assert_eq!(output.status.code(), Some(2), "{}", message(&output));
    assert!(message(&output).contains("no-such-skin"), "{}", message(&output));
}

/// A served twin that is killed on drop.
struct Served(Child);

impl Drop for Served {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_twin_that_is_served_is_run_from_its_address() {
    let desk = tempfile::tempdir().expect("a directory");
    let child = Command::new(env!("CARGO_BIN_EXE_dermis"))
        .args(["twin", "serve", "healing-square", "--tcp", "127.0.0.1:0"])
        .stdout(Stdio::piped())
        .spawn();
    let mut served = Served(child.expect("the command starts"));
    let mut said = String::new();
    BufReader::new(served.0.stdout.take().expect("a pipe")).read_line(&mut said).expect("an address");
    let words: Vec<&str> = said.split_whitespace().collect();
    assert_eq!(words[..4], ["serving:", "dermis", "run", "healing-square"], "{said}");
    let live = run(desk.path(), &[&words[3..], &["--headless", "--frames", "220"]].concat());
    assert_done(&live);
    let lines = lines(&live);
    assert_eq!(lines.len(), 220);
    let touched = lines.iter().filter(|line| line["touches"].as_array().is_some_and(|list| !list.is_empty())).count();
    // Like the twin inside the command, it stays untouched until the host is ready, then starts the demonstration.
    assert!(touched > 20, "only {touched} of 220 lines have touches");
}

#[test]
fn a_twin_is_served_to_the_network_only_on_request() {
    let refused = Command::new(env!("CARGO_BIN_EXE_dermis")).args(["twin", "serve", "--tcp", "0.0.0.0:0"]).output();
    let refused = refused.expect("the command starts");
    assert_eq!(refused.status.code(), Some(2), "{}", message(&refused));
    assert!(message(&refused).contains("--to-network"), "{}", message(&refused));
}

#[test]
fn an_instrument_that_is_not_there_is_a_failure_with_its_reason() {
    let desk = tempfile::tempdir().expect("a directory");
    let port = TcpListener::bind("127.0.0.1:0").and_then(|gone| gone.local_addr()).expect("a free port").port();
    let source = format!("tcp:127.0.0.1:{port}");
    let output = run(desk.path(), &["--source", &source, "--headless", "--frames", "1"]);
    assert_eq!(output.status.code(), Some(1), "{}", message(&output));
    assert!(message(&output).contains(&format!("{source}: cannot connect: ")), "{}", message(&output));
}

#[test]
fn every_kind_of_file_is_a_source() {
    let desk = tempfile::tempdir().expect("a directory");
    let skin = dermis_skin::Skin::open("healing-square").expect("a built-in skin");
    let mut twin = dermis_twin::TwinKit::of(&skin).expect("it has a twin").twin;
    let (mut values, mut rows, mut flat) = (Vec::new(), String::new(), Vec::new());
    for n in 0..40 {
        twin.step(f64::from(n) * 0.02, &mut values).expect("it goes on");
        rows += &(values.iter().map(f64::to_string).collect::<Vec<_>>().join(",") + "\n");
        flat.extend_from_slice(&values);
    }
    std::fs::write(desk.path().join("frames.csv"), rows).expect("a file");
    dermis_device::instruments::npy::write_f64(&desk.path().join("frames.npy"), &[40, 208], &flat).expect("a file");
    let recorded = run(desk.path(), &["--source", "frames.npy", "--speed", "0", "--headless", "--record", "x.mcap"]);
    assert_eq!(recorded.status.code(), Some(0), "{}", message(&recorded));
    assert_eq!(lines(&recorded).len(), 40, "a NumPy table");
    // Frames without times are spaced at the skin's rate, however fast they are played.
    let recording = Recording::open(&desk.path().join("x.mcap")).expect("a recording");
    let mut replay = Replay::new(recording, Pacing::Immediate, Repeat::Once).expect("it plays");
    let (mut frame, mut last_ns) = (Frame::default(), None);
    while replay.next_frame(&mut frame, Duration::ZERO).expect("a frame") == SourceEvent::Frame {
        last_ns = frame.device_time_ns;
    }
    let frames_per_s = skin.backend.frames_per_s.expect("it has a pace");
    assert_eq!(last_ns, Some((39.0 / frames_per_s * 1e9) as u64));
    for (source, frames) in [("file:frames.csv#5..40", 35), ("file:x.mcap", 40)] {
        let output = run(desk.path(), &["--source", source, "--speed", "0", "--headless"]);
        assert_eq!(output.status.code(), Some(0), "{source}: {}", message(&output));
        assert_eq!(lines(&output).len(), frames, "{source}");
    }
}

#[test]
fn a_folder_of_sciospec_files_is_a_source() {
    let Some(measured) = dermis_testdata::set("sciospec").map(|folder| folder.join("run1/setup")) else { return };
    let desk = tempfile::tempdir().expect("a folder");
    let source = format!("file:{}#0..40", measured.display());
    let output = run(desk.path(), &["sciospec-tank", "--source", &source, "--speed", "0", "--headless"]);
    assert_eq!(output.status.code(), Some(0), "{}", message(&output));
    assert_eq!(lines(&output).len(), 40, "a folder of Sciospec files");
}

#[test]
fn a_device_is_asked_and_measures_once() {
    let ask = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_dermis")).arg("device").args(arguments).output();
        let output = output.expect("the command starts");
        (output.status.code(), String::from_utf8_lossy(&output.stdout).into_owned(), message(&output))
    };
    let (code, out, said) = ask(&["twin:healing-square", "--json"]);
    let known: Value = serde_json::from_str(&out).unwrap_or_else(|error| panic!("{error}: {out} {said}"));
    assert_eq!((code, &known["channels"], &known["electrodes"]), (Some(0), &Value::from(208), &Value::from(16)));
    let (code, out, said) = ask(&["twin:healing-square", "shot", "--json"]);
    let shot: Value = serde_json::from_str(&out).unwrap_or_else(|error| panic!("{error}: {out} {said}"));
    assert_eq!((code, shot["values_v"].as_array().map(Vec::len)), (Some(0), Some(208)));
    assert_eq!(shot["status"], 8, "taken in answer to a single shot");
    let (code, out, said) =
        ask(&["twin:healing-square", "self-test", "--amplitude-ua", "350", "--gain", "auto", "--json"]);
    let faults: Value = serde_json::from_str(&out).unwrap_or_else(|error| panic!("{error}: {out} {said}"));
    assert_eq!((code, &faults["self_test"][0]), (Some(0), &Value::from(0.0)), "nothing is broken");
    let (code, out, said) = ask(&["twin:healing-square", "impedance", "--json"]);
    let contacts: Value = serde_json::from_str(&out).unwrap_or_else(|error| panic!("{error}: {out} {said}"));
    let ohms: Vec<f64> = contacts["impedance_ohm"].as_array().into_iter().flatten().filter_map(Value::as_f64).collect();
    // 5e-4 ohm.m^2 over pads of 6 mm by 6 mm, in single precision.
    assert!(code == Some(0) && ohms.len() == 16 && ohms.iter().all(|ohm| (ohm - 13.8889).abs() < 1e-3), "{ohms:?}");
    // A twin measures as its skin file says, with its single gain.
    for (arguments, reason) in [
        (&["twin:healing-square", "--protocol", "adjacent"][..], "does not accept a protocol"),
        (&["twin:healing-square", "--gain", "3"], "cannot take this"),
        (&["frames.csv"], "expected an instrument"),
        (&["twin:healing-square", "--gain", "300"], "a code of 0 to 254"),
    ] {
        let (code, _, said) = ask(arguments);
        assert!(code != Some(0) && said.contains(reason), "{arguments:?}: {code:?} {said}");
    }
}
