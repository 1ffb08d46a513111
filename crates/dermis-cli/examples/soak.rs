//! A load test of the complete `dermis run`. An instrument on a socket sends 208 channels at a fixed rate; image,
//! touches, recording and page follow, with three viewers, one of which never reads, and a reader of the guard's
//! verdicts.
//!
//! `cargo run --release -p dermis-cli --example soak -- [--skin NAME] [--seconds 3600] [--rate 1000] [--cut SECONDS]`
//! after `cargo build --release -p dermis-cli` prints a line every ten seconds and the figures at the end. It fails if
//! a frame was lost without being counted, or if memory grew by more than a tenth after the first minute. With `--cut`
//! the skin is cut after that many seconds, then left alone for six while the cut is recognised.

use std::collections::BTreeMap;
use std::error::Error;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use std::{env, fs, thread};

use dermis_device::instruments::wire::{DeviceInfo, WireDevice};
use dermis_device::{Frame, HostStamp, Status};
use dermis_lab::serve::device_info;
use dermis_live::latency::LatencyHistogram;
use dermis_skin::Skin;
use dermis_twin::TwinKit;
use dermis_twin::from_skin::{PressRange, press_range};
use dermis_twin::physics::Cut;
use dermis_twin::{Frontend, Treatment};

use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use tokio_tungstenite::client_async;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;

/// The skin, if none is named.
const SKIN: &str = "healing-square";
/// Radius of the circle on which the finger moves, as a share of the skin's shorter side.
const CIRCLE: f64 = 0.2;
/// Frames in the repeated sequence: first at rest, then pressed.
const LOOP: usize = 600;
/// Time between two frames of the twin that made them, seconds.
const TWIN_S: f64 = 0.04;
/// Largest relative growth of memory after the first minute.
const MOST_GROWTH: f64 = 0.1;

type Failure = Box<dyn Error + Send + Sync>;

fn main() -> Result<(), Failure> {
    let (seconds, rate) = (argument("--seconds", 3600.0)?, argument("--rate", 1000.0)?);
    let cut_s = argument("--cut", f64::INFINITY)?;
    let name: String = argument("--skin", SKIN.to_owned())?;
    let skin = Skin::open(&name)?;
    let intact = frames(&skin, false)?;
    let cut = if cut_s.is_finite() { frames(&skin, true)? } else { Vec::new() };
    let info = DeviceInfo { frames_per_s: rate as f32, ..device_info(&skin)? };
    let played = Played { intact, cut, cut_after: rate * cut_s, rest: 6.0 * rate };
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let port = listener.local_addr()?.port();
    let (stop, sent) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
    let device = {
        let (stop, sent) = (stop.clone(), sent.clone());
        thread::spawn(move || send(&listener, info, &played, &stop, &sent))
    };
    let folder = env::temp_dir().join(format!("dermis-soak-{}", std::process::id()));
    fs::create_dir_all(&folder)?;
    let recording = folder.join("soak.mcap");
    let page = TcpListener::bind("127.0.0.1:0")?.local_addr()?;
    let socket = folder.join("guard");
    let mut child = run(&name, port, page.port(), &recording, &socket)?;
    let reader = thread::spawn(move || read_verdicts(&socket));
    let outcome = tokio::runtime::Runtime::new()?.block_on(watch(page, &mut child, seconds, &sent));
    stop.store(true, Ordering::Relaxed);
    let ended = child.wait();
    let _ = device.join();
    fs::remove_dir_all(&folder)?;
    println!("dermis ended with {}", ended?);
    println!("{}", reader.join().map_err(|_| "the guard's reader failed")??);
    outcome
}

/// The frames that the instrument plays.
struct Played {
    intact: Vec<Vec<f64>>,
    cut: Vec<Vec<f64>>,
    /// Frames before the cut, and frames of rest after it.
    cut_after: f64,
    rest: f64,
}

impl Played {
    fn frame(&self, number: u64) -> &[f64] {
        let (since_cut, place) = (number as f64 - self.cut_after, number as usize % LOOP);
        match since_cut {
            _ if since_cut < 0.0 => &self.intact[place],
            _ if since_cut < self.rest => &self.cut[place % (LOOP / 2)],
            _ => &self.cut[place],
        }
    }
}

/// Frames of the twin on an intact or cut skin. In half of them a moving finger presses.
fn frames(skin: &Skin, cut: bool) -> Result<Vec<Vec<f64>>, Failure> {
    let mut kit = TwinKit::of(skin)?;
    let PressRange { initial_radius_m, initial_pressure_pa, .. } = press_range(skin);
    let (low, high) = skin.outline().bounds_m();
    let circle_m = CIRCLE * (high[0] - low[0]).min(high[1] - low[1]);
    let middle = [0, 1].map(|axis| 0.5 * (low[axis] + high[axis]));
    if cut {
        kit.twin.frontend_mut().treat(&Treatment::Cut(Cut::open([0.015, 0.018], [0.031, 0.03])))?;
    }
    let (mut frames, mut values) = (Vec::new(), Vec::new());
    for k in 0..LOOP {
        let (sin, cos) = (0.02 * k as f64).sin_cos();
        let [x, y] = [middle[0] + circle_m * cos, middle[1] + circle_m * sin];
        match k {
            _ if k == LOOP / 2 => kit.twin.scene_mut().press(0, x, y, initial_radius_m, initial_pressure_pa)?,
            _ if k == LOOP - 20 => kit.twin.scene_mut().release_all(),
            _ if k > LOOP / 2 && k < LOOP - 20 => kit.twin.scene_mut().move_to(0, x, y)?,
            _ => {}
        }
        kit.twin.step(TWIN_S * k as f64, &mut values)?;
        frames.push(values.clone());
    }
    Ok(frames)
}

/// Plays the instrument to one host until stopped.
fn send(
    listener: &TcpListener,
    info: DeviceInfo,
    played: &Played,
    stop: &AtomicBool,
    sent: &AtomicU64,
) -> Result<(), Failure> {
    let rate = f64::from(info.frames_per_s);
    let mut device = WireDevice::new(info);
    let (mut stream, _) = listener.accept()?;
    stream.set_nodelay(true)?;
    let (mut buffer, mut bytes, mut frame) = ([0; 4096], Vec::new(), Frame::default());
    while !device.is_running() {
        let count = stream.read(&mut buffer)?;
        bytes.clear();
        device.receive(&buffer[..count], &mut bytes);
        stream.write_all(&bytes)?;
    }
    stream.set_nonblocking(true)?;
    let began = Instant::now();
    let mut number = 0;
    while !stop.load(Ordering::Relaxed) {
        if let Ok(count) = stream.read(&mut buffer) {
            bytes.clear();
            device.receive(&buffer[..count], &mut bytes);
            write_all(&mut stream, &bytes)?;
        }
        while (number as f64) < rate * began.elapsed().as_secs_f64() {
            let at_ns = (1e9 * number as f64 / rate) as u64;
            frame.refill(number, HostStamp { monotonic_ns: at_ns, wall_ns: at_ns }, played.frame(number), &[]);
            frame.device_time_ns = Some(at_ns);
            bytes.clear();
            device.frame(&frame, Status::default(), &mut bytes);
            write_all(&mut stream, &bytes)?;
            number += 1;
            sent.store(number, Ordering::Relaxed);
        }
        thread::sleep(Duration::from_micros(200));
    }
    Ok(())
}

fn write_all(stream: &mut TcpStream, mut bytes: &[u8]) -> Result<(), Failure> {
    while !bytes.is_empty() {
        match stream.write(bytes) {
            Ok(count) => bytes = &bytes[count..],
            Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => thread::sleep(Duration::from_micros(100)),
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}

/// Starts `dermis run` of the same build, next to this example's folder.
fn run(skin: &str, device: u16, page: u16, recording: &PathBuf, guard: &Path) -> Result<Child, Failure> {
    let examples = env::current_exe()?;
    let folder = examples.parent().and_then(|folder| folder.parent()).ok_or("no folder of builds")?;
    let source = format!("tcp:127.0.0.1:{device}");
    Ok(Command::new(folder.join("dermis"))
        .args(["run", skin, "--no-open", "--as-set", "--source", &source, "--port", &page.to_string(), "--record"])
        .arg(recording)
        .arg("--guard")
        .arg(format!("unix://{}", guard.display()))
        .stdout(Stdio::null())
        .spawn()?)
}

/// Reads the guard's verdicts until the socket closes, and returns their numbers and the time from a frame's first byte
/// to the arrival of its verdict here.
fn read_verdicts(socket: &Path) -> Result<String, Failure> {
    let mut stream = UnixStream::connect(socket);
    for _ in 0..600 {
        if stream.is_ok() {
            break;
        }
        thread::sleep(Duration::from_millis(100));
        stream = UnixStream::connect(socket);
    }
    let mut latency = LatencyHistogram::new();
    let (mut verdicts, mut last) = (BTreeMap::<String, u64>::new(), Value::Null);
    for line in BufReader::new(stream?).lines() {
        let line: Value = serde_json::from_str(&line?)?;
        let now_ns = HostStamp::on_system_clock(HostStamp::now().monotonic_ns);
        let (Some(verdict), Some(frame_ns)) = (line["verdict"].as_str(), line["frame_ns"].as_u64()) else { continue };
        // Heartbeats repeat a frame's verdict.
        if line["sequence"] == last {
            continue;
        }
        last = line["sequence"].clone();
        *verdicts.entry(verdict.to_owned()).or_default() += 1;
        latency.record(Duration::from_nanos(now_ns.saturating_sub(frame_ns)));
    }
    let [p50_us, p99_us] = [0.5, 0.99].map(|share| latency.quantile_us(share));
    Ok(format!("verdicts {verdicts:?}, first byte to verdict p50 {p50_us:.0} us, p99 {p99_us:.0} us"))
}

/// Runs three viewers, prints the messages to the first one, and checks all three at the end.
async fn watch(page: SocketAddr, child: &mut Child, seconds: f64, sent: &AtomicU64) -> Result<(), Failure> {
    let mut first = None;
    for _ in 0..100 {
        match connect(page).await {
            Ok(socket) => {
                first = Some(socket);
                break;
            }
            Err(_) => tokio::time::sleep(Duration::from_millis(100)).await,
        }
    }
    let mut viewer = first.ok_or("the page cannot be reached")?;
    let (second, _stuck) = (connect(page).await?, connect(page).await?);
    tokio::spawn(view(second));
    let began = Instant::now();
    let (mut settled_kib, mut printed, mut last) = (None, 0, Value::Null);
    while began.elapsed().as_secs_f64() < seconds {
        let Some(message) = viewer.next().await else { return Err("the page was closed".into()) };
        let Message::Text(text) = message? else { continue };
        let state: Value = serde_json::from_str(&text)?;
        if state["type"] != "state" {
            continue;
        }
        viewer.send(Message::text(json!({"v": 1, "ack": state["sequence"]}).to_string())).await?;
        last = state;
        let elapsed = began.elapsed().as_secs();
        if elapsed >= 60 && settled_kib.is_none() {
            settled_kib = Some(memory_kib(child.id())?);
        }
        if elapsed / 10 > printed {
            printed = elapsed / 10;
            println!("{elapsed} s: {} KiB, {}", memory_kib(child.id())?, figures(&last));
        }
    }
    let kib = memory_kib(child.id())?;
    println!("sent {}, then: {kib} KiB, {}", sent.load(Ordering::Relaxed), figures(&last));
    end(child.id())?;
    let counter = |name: &str| {
        last["counters"]
            .as_array()
            .into_iter()
            .flatten()
            .find(|c| c["name"] == name)
            .map(|c| c["value"].as_f64().unwrap_or(0.0))
    };
    let losses: f64 = last["counters"]
        .as_array()
        .into_iter()
        .flatten()
        .filter(|c| c["is_loss"] == true)
        .filter_map(|c| c["value"].as_f64())
        .sum();
    println!("frames {:?}, losses {losses}", counter("frames"));
    if let Some(before) = settled_kib
        && kib as f64 > (1.0 + MOST_GROWTH) * before as f64
    {
        return Err(format!("memory grew from {before} to {kib} KiB").into());
    }
    Ok(())
}

type Socket = tokio_tungstenite::WebSocketStream<tokio::net::TcpStream>;

async fn connect(page: SocketAddr) -> Result<Socket, Failure> {
    let mut request = format!("ws://{page}/ws").into_client_request()?;
    request.headers_mut().insert("Origin", format!("http://{page}").parse()?);
    Ok(client_async(request, tokio::net::TcpStream::connect(page).await?).await?.0)
}

/// Reads and acknowledges like a page.
async fn view(mut socket: Socket) {
    while let Some(Ok(message)) = socket.next().await {
        let Message::Text(text) = message else { continue };
        let Ok(state) = serde_json::from_str::<Value>(&text) else { continue };
        if state["type"] == "state" {
            let ack = json!({"v": 1, "ack": state["sequence"]}).to_string();
            if socket.send(Message::text(ack)).await.is_err() {
                return;
            }
        }
    }
}

fn figures(state: &Value) -> String {
    let latency = state["latency"].as_array().into_iter().flatten();
    let total = latency.clone().find(|stage| stage["stage"] == "total").unwrap_or(&Value::Null);
    let counters: Vec<String> = state["counters"]
        .as_array()
        .into_iter()
        .flatten()
        .map(|counter| format!("{} {}", counter["name"].as_str().unwrap_or(""), counter["value"]))
        .collect();
    format!(
        "p50 {} us, p99 {} us, {} frames/s; {}",
        total["p50_us"],
        total["p99_us"],
        state["fps"],
        counters.join(", ")
    )
}

/// Resident memory of a process, KiB.
fn memory_kib(process: u32) -> Result<u64, Failure> {
    let status = fs::read_to_string(format!("/proc/{process}/status"))?;
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).ok_or("no VmRSS")?;
    Ok(line.split_whitespace().nth(1).ok_or("no figure")?.parse()?)
}

/// Asks a process to end, as Ctrl-C does.
fn end(process: u32) -> Result<(), Failure> {
    let status = Command::new("kill").args(["-INT", &process.to_string()]).status()?;
    if status.success() { Ok(()) } else { Err("dermis could not be told to end".into()) }
}

fn argument<T: FromStr>(name: &str, default: T) -> Result<T, Failure> {
    let arguments: Vec<String> = env::args().collect();
    let Some(at) = arguments.iter().position(|argument| argument == name) else { return Ok(default) };
    let value = arguments.get(at + 1).ok_or_else(|| format!("{name}: expected a value after it"))?;
    Ok(value.parse().map_err(|_| format!("{name} {value}: not a valid value"))?)
}
