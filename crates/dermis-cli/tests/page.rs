//! The live page's server facing strangers and slow pages: access, refused requests, the updates lost by a page that
//! doesn't keep up, and presses that end with their page.

#[path = "page/access.rs"]
mod access;
#[path = "page/body.rs"]
mod body;

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use crossbeam_channel::{Receiver, bounded};
use dermis_cli::page::{
    self, Command, GridView, Hub, Level, PageError, PageOptions, Request, Scene, ServerHandle, Update,
};
use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::protocol::frame::coding::CloseCode;
use tokio_tungstenite::tungstenite::{Error as SocketError, Message};
use tokio_tungstenite::{WebSocketStream, client_async};

/// Only reached if something hangs.
const HANG: Duration = Duration::from_secs(300);
const LOOPBACK: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), 0);

type Socket = WebSocketStream<tokio::net::TcpStream>;

struct Served {
    server: ServerHandle,
    hub: Hub,
    requests: Receiver<Request>,
}

fn scene(is_twin: bool) -> Scene {
    Scene {
        skin: "test".into(),
        is_twin,
        outline_mm: vec![vec![[-50.0, -50.0], [50.0, -50.0], [50.0, 50.0], [-50.0, 50.0]]],
        grid: GridView { rows: 2, cols: 2, x_min_mm: -50.0, x_max_mm: 50.0, y_min_mm: -50.0, y_max_mm: 50.0 },
        channel_labels: (0..4).map(|channel| channel.to_string()).collect(),
        ..Scene::default()
    }
}

fn serve_with(options: PageOptions, is_twin: bool, queue: usize) -> Served {
    let hub = Hub::new();
    let (commands, requests) = bounded(queue);
    let server = page::serve(LOOPBACK, options, hub.clone(), scene(is_twin), commands).expect("a free port");
    Served { server, hub, requests }
}

fn serve() -> Served {
    serve_with(PageOptions::default(), true, 64)
}

fn update(frame: u64, side: usize) -> Update {
    let mut update = Update { frame, ..Update::default() };
    update.image.rows = side;
    update.image.cols = side;
    update.image.values = vec![frame as f32; side * side];
    update
}

/// Sends a raw request and returns the whole answer.
fn raw(address: SocketAddr, request: &str) -> String {
    let mut stream = TcpStream::connect(address).expect("it listens");
    stream.set_read_timeout(Some(HANG)).expect("a time limit");
    stream.write_all(request.as_bytes()).expect("it reads");
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).expect("it answers");
    String::from_utf8_lossy(&answer).into_owned()
}

fn get(address: SocketAddr, path: &str, headers: &[&str]) -> String {
    let mut request = format!("GET {path} HTTP/1.1\r\nConnection: close\r\n");
    if !headers.iter().any(|header| header.starts_with("Host:")) {
        request += &format!("Host: {address}\r\n");
    }
    for header in headers {
        request += &format!("{header}\r\n");
    }
    raw(address, &(request + "\r\n"))
}

fn status(answer: &str) -> u16 {
    answer.split(' ').nth(1).and_then(|code| code.parse().ok()).unwrap_or_else(|| panic!("no status in {answer:?}"))
}

async fn open_with(address: SocketAddr, origin: Option<&str>, cookie: Option<&str>) -> Result<Socket, SocketError> {
    open_with_at(address, "/ws", origin, cookie).await
}

async fn open_with_at(
    address: SocketAddr,
    path: &str,
    origin: Option<&str>,
    cookie: Option<&str>,
) -> Result<Socket, SocketError> {
    let mut request = format!("ws://{address}{path}").into_client_request()?;
    for (name, value) in [("Origin", origin), ("Cookie", cookie)] {
        if let Some(value) = value {
            request.headers_mut().insert(name, value.parse().expect("a header"));
        }
    }
    let stream = tokio::net::TcpStream::connect(address).await.expect("it listens");
    client_async(request, stream).await.map(|(socket, _)| socket)
}

async fn open(address: SocketAddr) -> Socket {
    open_at(address, "/ws").await
}

async fn open_at(address: SocketAddr, path: &str) -> Socket {
    let origin = format!("http://{address}");
    open_with_at(address, path, Some(&origin), None).await.expect("the page's own socket")
}

fn refused_with(opened: Result<Socket, SocketError>) -> u16 {
    match opened {
        Err(SocketError::Http(answer)) => answer.status().as_u16(),
        other => panic!("expected a refusal, got {other:?}"),
    }
}

async fn next(socket: &mut Socket) -> Message {
    let message = timeout(HANG, socket.next()).await.expect("a message before the time limit");
    message.expect("an open connection").expect("a readable message")
}

/// The next JSON message of this type.
async fn next_json(socket: &mut Socket, kind: &str) -> Value {
    loop {
        if let Message::Text(text) = next(socket).await {
            let message: Value = serde_json::from_str(&text).expect("JSON");
            assert_eq!(message["v"], 1, "every message states the version");
            if message["type"] == kind {
                return message;
            }
        }
    }
}

/// Reads until the server closes, and returns the reason.
async fn closed(socket: &mut Socket) -> CloseCode {
    loop {
        match timeout(HANG, socket.next()).await.expect("an end before the time limit") {
            Some(Ok(Message::Close(Some(frame)))) => return frame.code,
            Some(Ok(_)) => {}
            other => panic!("expected a close frame, got {other:?}"),
        }
    }
}

async fn say(socket: &mut Socket, message: Value) {
    socket.send(Message::text(message.to_string())).await.expect("an open connection");
}

async fn ask(socket: &mut Socket, id: u64, command: Value) {
    say(socket, json!({"v": 1, "id": id, "command": command})).await;
}

fn press(pointer_id: u64, x_mm: f64) -> Value {
    json!({"press": {"pointer_id": pointer_id, "x_mm": x_mm, "y_mm": 0, "radius_mm": 10, "pressure_kpa": 80}})
}

async fn request(requests: &Receiver<Request>) -> Request {
    let requests = requests.clone();
    let received = tokio::task::spawn_blocking(move || requests.recv_timeout(HANG)).await.expect("no panic");
    received.expect("a request before the time limit")
}

#[test]
fn a_port_in_use_is_named_with_advice() {
    let served = serve();
    let address = served.server.local_addr();
    let (commands, _requests) = bounded(1);
    let error =
        page::serve(address, PageOptions::default(), Hub::new(), scene(true), commands).expect_err("it is in use");
    assert!(matches!(error, PageError::PortInUse { .. }));
    let text = error.to_string();
    assert!(text.contains(&format!("port {} on 127.0.0.1", address.port())) && text.contains("--port 0"), "{text}");
}

#[test]
fn after_shutdown_the_port_is_free_again() {
    let served = serve();
    let address = served.server.local_addr();
    served.server.shutdown();
    let (commands, _requests) = bounded(1);
    page::serve(address, PageOptions::default(), Hub::new(), scene(true), commands).expect("free again");
}

#[tokio::test]
async fn pages_are_told_when_the_server_stops() {
    let served = serve();
    let mut socket = open(served.server.local_addr()).await;
    next_json(&mut socket, "scene").await;
    tokio::task::spawn_blocking(move || served.server.shutdown()).await.expect("no panic");
    assert_eq!(closed(&mut socket).await, CloseCode::Away);
}

#[tokio::test]
async fn a_page_gets_the_scene_first_and_then_what_is_newest() {
    let served = serve();
    served.hub.publish(&update(41, 2)).expect("well formed");
    served.hub.publish(&update(42, 2)).expect("well formed");
    served.hub.publish_noise(&[0.5, 0.25]);
    let mut socket = open(served.server.local_addr()).await;
    let Message::Text(first) = next(&mut socket).await else { panic!("expected the scene first") };
    let first: Value = serde_json::from_str(&first).expect("JSON");
    assert_eq!((&first["type"], &first["skin"], &first["grid"]["rows"]), (&json!("scene"), &json!("test"), &json!(2)));
    let (mut image, mut noise, mut state) = (None, None, None);
    while image.is_none() || noise.is_none() || state.is_none() {
        match next(&mut socket).await {
            Message::Binary(bytes) if bytes[6] == 1 => image = Some(bytes),
            Message::Binary(bytes) if bytes[6] == 3 && bytes.len() > 32 => noise = Some(bytes),
            Message::Text(text) if text.contains(r#""type":"state""#) => state = Some(text),
            _ => {}
        }
    }
    let image = image.expect("just checked");
    assert_eq!((&image[8..16], &image[32..36]), (&42u64.to_le_bytes()[..], &42f32.to_le_bytes()[..]));
    assert_eq!(noise.expect("just checked")[32..40], [0.5f32.to_le_bytes(), 0.25f32.to_le_bytes()].concat());
    assert!(state.expect("just checked").contains(r#""frame":42"#));
}

#[tokio::test]
async fn commands_arrive_and_their_answers_return() {
    let served = serve();
    let mut socket = open(served.server.local_addr()).await;
    ask(&mut socket, 5, json!({"tare": {"force": false}})).await;
    let asked = request(&served.requests).await;
    assert_eq!(asked.command, Command::Tare { force: false });
    asked.reply.refuse("tare refused: a touch is on the skin");
    let answer = next_json(&mut socket, "answer").await;
    assert_eq!((&answer["id"], &answer["ok"]), (&json!(5), &json!(false)));
    assert_eq!(answer["text"], "tare refused: a touch is on the skin");

    ask(&mut socket, 6, json!({"choose_channels": [0, 3]})).await;
    assert_eq!(request(&served.requests).await.command, Command::ChooseChannels(vec![0, 3]));
    served.hub.announce(Level::Error, "7 frames were lost");
    let notice = next_json(&mut socket, "notice").await;
    assert_eq!((&notice["level"], &notice["text"]), (&json!("error"), &json!("7 frames were lost")));
}

#[tokio::test]
async fn what_no_pipeline_could_do_is_refused_with_the_value_and_the_expectation() {
    let served = serve();
    let mut socket = open(served.server.local_addr()).await;
    for (command, hint) in [
        (json!({"hyperparameter": -1.0}), "hyperparameter -1 refused: expected a positive"),
        (json!({"choose_channels": [4]}), "channel 4 refused: expected an index below 4"),
        (press(1, 1e6), "x_mm is 1000000, expected -100 to 100"),
        (press(1, 70.0), "press refused: (70.0, 0.0) mm is off the skin"),
        (json!({"release": {"pointer_id": 9}}), "pointer_id 9 refused: it is not pressing"),
        (json!("explode"), "unknown variant `explode`"),
        (press(u64::from(u32::MAX) + 1, 0.0), "expected at most 4294967295"),
    ] {
        ask(&mut socket, 1, command).await;
        let answer = next_json(&mut socket, "answer").await;
        let text = answer["text"].as_str().expect("text");
        assert!(answer["ok"] == false && text.contains(hint), "{text}");
    }
    assert!(served.requests.is_empty(), "nothing of this reached the pipeline");
}

#[tokio::test]
async fn a_real_skin_cannot_be_pressed_from_the_page() {
    let served = serve_with(PageOptions::default(), false, 8);
    let mut socket = open(served.server.local_addr()).await;
    ask(&mut socket, 1, press(1, 0.0)).await;
    let answer = next_json(&mut socket, "answer").await;
    assert!(answer["text"].as_str().is_some_and(|text| text.contains("this skin is real")), "{answer}");
}

#[tokio::test]
async fn presses_of_two_pages_are_told_apart_and_end_with_their_page() {
    let served = serve();
    let address = served.server.local_addr();
    let (mut one, mut two) = (open(address).await, open(address).await);
    ask(&mut one, 1, press(7, 1.0)).await;
    let Command::Press(first) = request(&served.requests).await.command else { panic!("expected a press") };
    ask(&mut two, 1, press(7, 2.0)).await;
    let Command::Press(second) = request(&served.requests).await.command else { panic!("expected a press") };
    assert_ne!(first.pointer_id, second.pointer_id);
    drop(one);
    assert_eq!(request(&served.requests).await.command, Command::Release { pointer_id: first.pointer_id });
    ask(&mut two, 2, json!({"release": {"pointer_id": 7}})).await;
    assert_eq!(request(&served.requests).await.command, Command::Release { pointer_id: second.pointer_id });
}

#[tokio::test]
async fn of_hyperparameters_the_last_one_counts_even_where_the_queue_is_full() {
    let served = serve_with(PageOptions::default(), true, 1);
    let mut socket = open(served.server.local_addr()).await;
    ask(&mut socket, 1, press(1, 0.0)).await;
    for id in 2..42_u32 {
        ask(&mut socket, id.into(), json!({"hyperparameter": f64::from(id)})).await;
    }
    // All except the last are answered as replaced by a later one.
    for id in 2..41_u32 {
        let answer = next_json(&mut socket, "answer").await;
        assert_eq!((&answer["id"], &answer["ok"]), (&json!(id), &json!(true)), "{answer}");
    }
    let Command::Press(_) = request(&served.requests).await.command else { panic!("expected the press") };
    assert_eq!(request(&served.requests).await.command, Command::Hyperparameter(41.0));
}

#[tokio::test]
async fn a_full_queue_refuses_presses_but_never_loses_a_release() {
    let served = serve_with(PageOptions::default(), true, 1);
    let mut socket = open(served.server.local_addr()).await;
    ask(&mut socket, 1, press(1, 0.0)).await;
    ask(&mut socket, 2, press(2, 0.0)).await;
    let answer = next_json(&mut socket, "answer").await;
    assert_eq!(answer["id"], 2);
    assert!(answer["text"].as_str().is_some_and(|text| text.contains("busy")), "{answer}");
    ask(&mut socket, 3, json!({"release": {"pointer_id": 1}})).await;
    // This refusal shows that the queue was full when the release arrived.
    assert_eq!(next_json(&mut socket, "answer").await["id"], 3);
    let Command::Press(pressed) = request(&served.requests).await.command else { panic!("expected a press") };
    assert_eq!(request(&served.requests).await.command, Command::Release { pointer_id: pressed.pointer_id });
}

#[tokio::test]
async fn a_message_beyond_the_limit_ends_the_connection() {
    let served = serve();
    let mut socket = open(served.server.local_addr()).await;
    // One byte more than 16 KiB.
    socket.send(Message::text(" ".repeat(16 * 1024 + 1))).await.expect("an open connection");
    assert_eq!(closed(&mut socket).await, CloseCode::Size);
    assert!(served.requests.is_empty());
}

#[tokio::test]
async fn too_many_messages_end_the_connection() {
    let served = serve_with(PageOptions { most_messages_per_s: 1, ..PageOptions::default() }, true, 64);
    let mut socket = open(served.server.local_addr()).await;
    // Far more than one per second, even if this machine takes seconds for some.
    for id in 0..200 {
        // The server may close the connection while this is still sending.
        let message = json!({"v": 1, "id": id, "command": "record_stop"}).to_string();
        if socket.send(Message::text(message)).await.is_err() {
            break;
        }
    }
    assert_eq!(closed(&mut socket).await, CloseCode::Policy);
}

#[tokio::test]
async fn a_page_too_many_is_told_so_and_a_place_becomes_free() {
    let served = serve_with(PageOptions { most_clients: 2, ..PageOptions::default() }, true, 64);
    let address = served.server.local_addr();
    let (mut one, mut two) = (open(address).await, open(address).await);
    next_json(&mut one, "scene").await;
    next_json(&mut two, "scene").await;
    assert_eq!(closed(&mut open(address).await).await, CloseCode::Again);
    assert_eq!(served.hub.stats().clients, 2);
    drop(one);
    // The server notices at its next write to the lost connection, at most a second later.
    timeout(HANG, async {
        while served.hub.stats().clients == 2 {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    })
    .await
    .expect("a place becomes free");
    next_json(&mut open(address).await, "scene").await;
}

#[tokio::test]
async fn a_page_that_does_not_acknowledge_misses_updates_and_others_do_not() {
    let served = serve_with(PageOptions { most_updates_per_s: 1000, ..PageOptions::default() }, true, 64);
    let address = served.server.local_addr();
    let (mut stuck, mut quick) = (open(address).await, open(address).await);
    next_json(&mut stuck, "scene").await;
    next_json(&mut quick, "scene").await;
    for frame in 1..=60 {
        served.hub.publish(&update(frame, 2)).expect("well formed");
        let state = next_json(&mut quick, "state").await;
        assert_eq!(state["frame"], frame);
        say(&mut quick, json!({"v": 1, "ack": state["sequence"]})).await;
    }
    // Exactly eight may be in flight without acknowledgement.
    let mut last = Value::Null;
    for _ in 0..8 {
        last = next_json(&mut stuck, "state").await;
    }
    assert!(last["frame"].as_u64().is_some_and(|frame| frame <= 60));
    say(&mut stuck, json!({"v": 1, "ack": last["sequence"]})).await;
    // When it resumes, it gets the newest update, unless that was one of the eight.
    while last["frame"] != 60 {
        last = next_json(&mut stuck, "state").await;
        say(&mut stuck, json!({"v": 1, "ack": last["sequence"]})).await;
    }
    let dropped = served.hub.stats().dropped;
    assert!((1..60).contains(&dropped), "{dropped} updates dropped for the stuck page");
}

#[tokio::test]
async fn a_page_that_never_reads_blocks_nobody() {
    let served = serve_with(PageOptions { most_updates_per_s: 1000, ..PageOptions::default() }, true, 64);
    let address = served.server.local_addr();
    let _stuck = open(address).await;
    let mut quick = open(address).await;
    next_json(&mut quick, "scene").await;
    // 1 MiB each: far more than the system buffers for an unread connection.
    for frame in 1..=40 {
        served.hub.publish(&update(frame, 512)).expect("well formed");
        let state = next_json(&mut quick, "state").await;
        assert_eq!(state["frame"], frame);
        say(&mut quick, json!({"v": 1, "ack": state["sequence"]})).await;
    }
}

#[test]
fn publishing_needs_no_page_and_no_server() {
    let hub = Hub::new();
    for frame in 0..1000 {
        hub.publish(&update(frame, 8)).expect("well formed");
        hub.announce(Level::Info, "nobody listens");
    }
    assert_eq!(hub.stats().published, 1000);
    assert_eq!(hub.stats().dropped, 0);
}
