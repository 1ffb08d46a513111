//! The guard of `dermis run`: verdicts on a socket, in lines and in recordings.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use dermis_record::{Entry, Recording};
use serde_json::Value;

use super::{Served, lines, message, run};

/// Age at which a frame is stale in these tests, milliseconds: ten frames.
const STALE_AFTER_MS: u64 = 400;
/// Longest wait for a verdict on a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

/// A gel whose force law is known, without a demonstration.
fn gel(directory: &Path) {
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../skins/examples/gel-pad.toml");
    let text = std::fs::read_to_string(example).expect("an example");
    let guard = format!("[guard]\nforce_n = 3.0\nstale_after_ms = {STALE_AFTER_MS}.0\n");
    let twin = "[twin]\ndemonstration = \"none\"\n";
    std::fs::write(directory.join("gel.toml"), format!("{text}\n{guard}\n{twin}")).expect("a file");
}

/// Starts the command and returns the first line of its standard output or error that begins with `word`.
fn started(directory: &Path, arguments: &[&str], on_stderr: bool, word: &str) -> (Served, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dermis"));
    command.args(arguments).current_dir(directory).stdin(Stdio::piped());
    if on_stderr {
        let out = std::fs::File::create(directory.join("lines.jsonl")).expect("a file");
        command.stdout(out).stderr(Stdio::piped());
    } else {
        command.stdout(Stdio::piped());
    }
    let mut child: Child = command.spawn().expect("the command starts");
    let mut input: Box<dyn BufRead + Send> = match child.stderr.take() {
        Some(stderr) => Box::new(BufReader::new(stderr)),
        None => Box::new(BufReader::new(child.stdout.take().expect("a pipe"))),
    };
    let mut said = String::new();
    while !said.starts_with(word) {
        said.clear();
        assert_ne!(input.read_line(&mut said).expect("UTF-8"), 0, "it ended without {word}");
    }
    // Drain the rest of its output so the pipe doesn't fill up.
    std::thread::spawn(move || std::io::copy(&mut input, &mut std::io::sink()));
    (Served(child), said)
}

/// Reads the guard's lines.
struct Verdicts {
    input: BufReader<TcpStream>,
    seen: Vec<Value>,
}

impl Verdicts {
    fn connect(address: &str) -> (Self, Value) {
        let stream = TcpStream::connect(address.trim().trim_start_matches("guard: tcp://")).expect("a socket");
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
        let mut verdicts = Self { input: BufReader::new(stream), seen: Vec::new() };
        let greeting = verdicts.next().expect("a greeting");
        (verdicts, greeting)
    }

    fn next(&mut self) -> Option<Value> {
        let mut line = String::new();
        let read = self.input.read_line(&mut line).expect("a line in time");
        (read > 0).then(|| serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line}")))
    }

    /// Reads verdicts until one is `wanted`.
    fn until(&mut self, what: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        let begun = Instant::now();
        loop {
            let line = self.next().unwrap_or_else(|| panic!("the socket ended before {what}"));
            self.seen.push(line.clone());
            if wanted(&line) {
                return line;
            }
            assert!(begun.elapsed() < PATIENCE, "no {what}; last: {line}");
        }
    }
}

fn age_ms(line: &Value) -> f64 {
    let ns = |key: &str| line[key].as_u64().unwrap_or_else(|| panic!("{key}: {line}"));
    1e-6 * (ns("monotonic_ns") - ns("frame_ns")) as f64
}

#[test]
fn a_press_stops_and_silence_is_stale_within_its_limit() {
    let desk = tempfile::tempdir().expect("a directory");
    gel(desk.path());
    let (mut twin, said) =
        started(desk.path(), &["twin", "serve", "gel.toml", "--tcp", "127.0.0.1:0"], false, "serving:");
    let source = said.split_whitespace().find(|word| word.starts_with("tcp:")).expect("an address").to_owned();
    let arguments =
        ["run", "gel.toml", "--source", &source, "--headless", "--guard", "tcp://127.0.0.1:0", "--record", "x.mcap"];
    let (mut live, address) = started(desk.path(), &arguments, true, "guard: ");
    let (mut verdicts, greeting) = Verdicts::connect(&address);
    assert_eq!((&greeting["safety_rated"], &greeting["patches"]), (&false.into(), &serde_json::json!(["gel-pad"])));
    let mut tell = |line: &str| writeln!(twin.0.stdin.as_mut().expect("a pipe"), "{line}").expect("it listens");

    verdicts.until("ok", |line| line["verdict"] == "ok");
    tell("press 10 5 1 8");
    std::thread::sleep(Duration::from_millis(1500));
    tell("press 10 5 6 8");
    let has = |line: &Value, reason: &str| line["reasons"].as_array().is_some_and(|all| all.contains(&reason.into()));
    let stop = verdicts.until("stop", |line| line["verdict"] == "stop" && has(line, "force"));
    assert_eq!((&stop["all"], &stop["safety_rated"]), (&"stop".into(), &false.into()));
    tell("release");
    verdicts.until("ok again", |line| line["verdict"] == "ok");

    // The instrument falls silent: no frame comes, but the verdict changes in time.
    drop(twin);
    let stale =
        verdicts.until("stale", |line| line["verdict"] == "stale" && age_ms(line) > 0.9 * STALE_AFTER_MS as f64);
    assert_eq!(stale["reasons"], serde_json::json!(["no-frames"]));
    assert_eq!(stale["valid_ms"].as_f64(), Some(STALE_AFTER_MS as f64));
    let heartbeat = verdicts.until("a heartbeat", |_| true);
    assert_eq!(heartbeat["verdict"], "stale");
    for line in &verdicts.seen {
        assert!(line["verdict"] != "ok" || age_ms(line) <= STALE_AFTER_MS as f64, "{line}");
    }

    let ended = Command::new("kill").args(["-INT", &live.0.id().to_string()]).status().expect("it is told to end");
    assert!(ended.success());
    verdicts.until("the end", |line| line["verdict"] == "stop" && has(line, "ended"));
    assert!(verdicts.next().is_none(), "the socket is closed");
    live.0.wait().expect("it ends");

    // A gentle press appears in the lines, with the verdict ok.
    let text = std::fs::read_to_string(desk.path().join("lines.jsonl")).expect("lines");
    let gentle = text.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok()).any(|line| {
        line["touches"].as_array().is_some_and(|touches| !touches.is_empty()) && line["guard"]["verdict"] == "ok"
    });
    assert!(gentle, "no touch below the limit is ok");
    let mut recording = Recording::open(&desk.path().join("x.mcap")).expect("a recording");
    let mut events = Vec::new();
    while let Some(entry) = recording.next_entry().expect("an entry") {
        match entry {
            Entry::Event { entry, .. } if entry.event == "guard" => events.push(entry.detail.clone()),
            _ => {}
        }
    }
    assert!(
        events.iter().any(|detail| detail == "ok") && events.iter().any(|detail| detail.contains("force")),
        "{events:?}"
    );
}

#[test]
fn patches_have_limits_of_their_own_and_bad_ones_are_refused_with_their_line() {
    let desk = tempfile::tempdir().expect("a directory");
    let patch = |name: &str, guard: &str| format!("[[patch]]\nname = \"{name}\"\nskin = \"healing-square\"\n{guard}\n");
    let body = patch("left", "guard = { any_touch = false }") + &patch("right", "guard = {}") + &patch("free", "");
    std::fs::write(desk.path().join("body.toml"), &body).expect("a file");
    let output = run(desk.path(), &["body.toml", "--headless", "--frames", "90", "--speed", "0"]);
    assert_eq!(output.status.code(), Some(0), "{}", message(&output));
    let all = lines(&output);
    let has_touch_reason = |line: &Value| line["guard"]["reasons"].to_string().contains("\"touch\"");
    let of = |patch: &str| all.iter().filter(|line| line["patch"] == patch).collect::<Vec<_>>();
    assert!(of("right").iter().any(|line| has_touch_reason(line) && line["guard"]["verdict"] == "stop"));
    assert!(of("left").iter().all(|line| line["guard"].is_object() && !has_touch_reason(line)));
    assert!(of("free").iter().all(|line| line["guard"].is_null()));

    std::fs::write(desk.path().join("body.toml"), body.replace("guard = {}", "guard = { force_n = -1.0 }"))
        .expect("a file");
    let refused = run(desk.path(), &["body.toml", "--headless", "--frames", "1"]);
    assert_eq!(refused.status.code(), Some(2), "{}", message(&refused));
    let expected = "body.toml, line 8: patch right: healing-square: guard.force_n = -1: expected 1e-6 to 1e6";
    assert!(message(&refused).contains(expected), "{}", message(&refused));
}

#[test]
fn a_guard_is_published_on_this_machine_alone() {
    let desk = tempfile::tempdir().expect("a directory");
    let refused = run(desk.path(), &["--headless", "--frames", "1", "--guard", "tcp://0.0.0.0:7879"]);
    assert_eq!(refused.status.code(), Some(2), "{}", message(&refused));
    assert!(message(&refused).contains("expected tcp://127.0.0.1:PORT"), "{}", message(&refused));
    let taken = std::net::TcpListener::bind("127.0.0.1:0").and_then(|taken| taken.local_addr().map(|at| (taken, at)));
    let (_taken, at) = taken.expect("a free port");
    let refused = run(desk.path(), &["--headless", "--frames", "1", "--guard", &format!("tcp://{at}")]);
    assert_eq!(refused.status.code(), Some(1), "{}", message(&refused));
    assert!(message(&refused).contains(&format!("tcp://{at}: ")), "{}", message(&refused));
}
