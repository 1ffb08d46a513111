//! `dermis run --foxglove` as a viewer sees it, with a plain client of the protocol `foxglove.sdk.v1`. The content of
//! the messages is checked by `scripts/check_foxglove.py` with other decoders.

use std::io::{BufRead, BufReader, Read};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::{WebSocketStream, client_async};

/// Only reached if something hangs.
const HANG: Duration = Duration::from_secs(120);

fn run(directory: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dermis"));
    command.arg("run").args(arguments).current_dir(directory).output().expect("the command starts")
}

/// A running command, its address, and the rest of its standard error.
struct Live {
    child: Child,
    address: String,
    said: std::thread::JoinHandle<String>,
}

impl Live {
    fn start(directory: &Path, arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_dermis"));
        command.arg("run").args(arguments).args(["--headless", "--foxglove", "127.0.0.1:0"]);
        let out = std::fs::File::create(directory.join("lines.jsonl")).expect("a file");
        let child = command.current_dir(directory).stdout(out).stderr(Stdio::piped()).spawn();
        let mut child = child.expect("the command starts");
        let mut stderr = BufReader::new(child.stderr.take().expect("a pipe"));
        let mut line = String::new();
        while !line.starts_with("foxglove: ws://") {
            line.clear();
            assert_ne!(stderr.read_line(&mut line).expect("UTF-8"), 0, "it ended without an address");
        }
        let address = line.trim().trim_start_matches("foxglove: ws://").to_owned();
        let said = std::thread::spawn(move || {
            let mut rest = String::new();
            stderr.read_to_string(&mut rest).expect("UTF-8");
            rest
        });
        Self { child, address, said }
    }

    /// Waits for its end; returns the exit code and its standard error.
    fn ended(mut self) -> (Option<i32>, String) {
        let code = self.child.wait().expect("it ends").code();
        (code, self.said.join().expect("its words"))
    }
}

/// A viewer, with its channels and services by name.
struct Viewer {
    socket: WebSocketStream<TcpStream>,
    info: Value,
    channels: Vec<Value>,
    services: Vec<Value>,
}

impl Viewer {
    async fn connect(address: &str) -> Self {
        let mut request = format!("ws://{address}/").into_client_request().expect("an address");
        request.headers_mut().insert("Sec-WebSocket-Protocol", "foxglove.sdk.v1".parse().expect("a header"));
        let stream = TcpStream::connect(address).await.expect("it listens");
        let (socket, answer) = client_async(request, stream).await.expect("it speaks WebSocket");
        assert_eq!(answer.headers()["sec-websocket-protocol"], "foxglove.sdk.v1");
        let mut viewer = Self { socket, info: Value::Null, channels: Vec::new(), services: Vec::new() };
        while viewer.info.is_null() || viewer.channels.is_empty() || viewer.services.is_empty() {
            let Message::Text(text) = viewer.next().await else { continue };
            let message: Value = serde_json::from_str(&text).expect("JSON");
            let list = |key: &str| message[key].as_array().cloned().unwrap_or_default();
            match message["op"].as_str() {
                Some("serverInfo") => viewer.info = message,
                Some("advertise") => viewer.channels.extend(list("channels")),
                Some("advertiseServices") => viewer.services.extend(list("services")),
                _ => {}
            }
        }
        viewer
    }

    async fn next(&mut self) -> Message {
        let message = timeout(HANG, self.socket.next()).await.expect("a message before the time limit");
        message.expect("an open connection").expect("a readable message")
    }

    async fn send(&mut self, message: Value) {
        self.socket.send(Message::text(message.to_string())).await.expect("it reads");
    }

    /// Subscribes to all channels, with the channels' numbers as subscription ids.
    async fn subscribe(&mut self) {
        let one = |channel: &Value| json!({ "id": channel["id"], "channelId": channel["id"] });
        let subscriptions: Vec<Value> = self.channels.iter().map(one).collect();
        self.send(json!({ "op": "subscribe", "subscriptions": subscriptions })).await;
    }

    /// Payload of the next message on a topic, with its log time.
    async fn on(&mut self, topic: &str) -> (u64, Vec<u8>) {
        let channel = self.channels.iter().find(|channel| channel["topic"] == topic);
        let id = channel.and_then(|channel| channel["id"].as_u64()).unwrap_or_else(|| panic!("no {topic}"));
        loop {
            let Message::Binary(bytes) = self.next().await else { continue };
            let number = |from: usize, to: usize| bytes[from..to].iter().rev().fold(0, |n, b| n << 8 | u64::from(*b));
            if bytes[0] == 1 && number(1, 5) == id {
                return (number(5, 13), bytes[13..].to_vec());
            }
        }
    }

    /// Calls a service with JSON and returns its reply.
    async fn call(&mut self, service: &str, payload: &str) -> Value {
        let id = self.services.iter().find(|known| known["name"] == service).expect("the service")["id"].as_u64();
        let id = u32::try_from(id.expect("a number")).expect("32 bits");
        let head: Vec<u8> = [id, 7, 4].iter().flat_map(|number| number.to_le_bytes()).collect();
        let request = [&[2][..], &head, b"json", payload.as_bytes()].concat();
        self.socket.send(Message::binary(request)).await.expect("it reads");
        loop {
            match self.next().await {
                Message::Binary(bytes) if bytes[0] == 3 => {
                    return serde_json::from_slice(&bytes[17..]).expect("JSON");
                }
                Message::Text(text) if text.contains("serviceCallFailure") => {
                    return serde_json::from_str(&text).expect("JSON");
                }
                _ => {}
            }
        }
    }
}

#[tokio::test]
async fn a_viewer_gets_frames_and_late_the_baseline_and_tares() {
    let desk = tempfile::tempdir().expect("a directory");
    let mut live = Live::start(desk.path(), &["healing-square"]);
    let mut viewer = Viewer::connect(&live.address).await;
    let name = viewer.info["name"].as_str().expect("a name");
    assert_eq!(name, format!("dermis {}: healing-square", env!("CARGO_PKG_VERSION")));
    viewer.subscribe().await;
    // The frame's monotonic time is the third field and its wall-clock time the fifth; the log time equals the latter.
    let (log_ns, frame) = viewer.on("/dermis/frames").await;
    let wall_ns = u64::from_le_bytes(frame[36..44].try_into().expect("eight bytes"));
    assert_eq!(wall_ns, log_ns);
    viewer.on("/dermis/scene").await;
    // The demonstration presses on and off, so one of several unforced tares finds the skin untouched.
    let refused = viewer.call("/dermis/tare", "{\"now\": true}").await;
    assert!(refused["message"].as_str().is_some_and(|text| text.contains("unknown field `now`")), "{refused}");
    let done = viewer.call("/dermis/tare", "{\"force\": true}").await;
    assert_eq!((&done["success"], &done["message"]), (&true.into(), &"taring over 32 frames".into()), "{done}");

    // A late subscriber gets the baseline at once.
    let mut late = Viewer::connect(&live.address).await;
    late.subscribe().await;
    late.on("/dermis/baselines").await;
    live.child.kill().expect("it runs");
    live.ended();
}

#[tokio::test]
async fn viewers_that_stop_reading_delay_neither_the_frames_nor_the_end() {
    let desk = tempfile::tempdir().expect("a directory");
    let live = Live::start(desk.path(), &["healing-square", "--speed", "0", "--frames", "1500"]);
    let mut stalled = Vec::new();
    for _ in 0..3 {
        let mut viewer = Viewer::connect(&live.address).await;
        viewer.subscribe().await;
        stalled.push(viewer);
    }
    let begun = Instant::now();
    let (code, said) = tokio::task::spawn_blocking(|| live.ended()).await.expect("it ends");
    assert_eq!(code, Some(0), "{said}");
    assert!(begun.elapsed() < HANG, "{:?}", begun.elapsed());
    let lines = std::fs::read_to_string(desk.path().join("lines.jsonl")).expect("lines");
    assert_eq!(lines.lines().count(), 1500);
    drop(stalled);
}

#[test]
fn an_address_that_cannot_be_used_is_named() {
    let desk = tempfile::tempdir().expect("a directory");
    let taken = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = taken.local_addr().expect("an address").to_string();
    for (address, code, text) in
        [(address.as_str(), 1, "another program uses this port"), ("8765", 2, "expected HOST:PORT")]
    {
        let output = run(desk.path(), &["healing-square", "--headless", "--frames", "1", "--foxglove", address]);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{message}");
        assert!(message.contains(address) && message.contains(text), "{message}");
    }
    let output = run(desk.path(), &["--headless", "--frames", "1", "--foxglove", "0.0.0.0:0"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && message.contains("warning: anyone who can reach 0.0.0.0:"), "{message}");
}
