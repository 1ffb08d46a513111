//! Streams over loopback sockets: devices that are unplugged, silent, foreign or absent. Every loop is bounded, and no
//! other machine is contacted.

mod own_clock;
#[path = "streams/sciospec.rs"]
mod sciospec;

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use dermis_device::instruments::floats::Floats;
use dermis_device::instruments::lines::Lines;
use dermis_device::instruments::wire::{DeviceInfo, WireDevice, WireHost};
use dermis_device::stream::{Dialogue, StreamOptions, StreamSource, TcpConnect};
use dermis_device::{DeviceError, Frame, HostStamp, Source, SourceEvent, SourceSelector, open_stream};
use dermis_wire::Status;

use own_clock::{EventConnect, Events, Timeless};

/// Time limit that only a hanging test reaches.
const LIMIT: Duration = Duration::from_secs(540);

fn options() -> StreamOptions {
    StreamOptions {
        patience: LIMIT,
        // Only applies while a device is stalled.
        silence: Duration::from_millis(20),
        frame: LIMIT,
        first_wait: Duration::from_millis(5),
        longest_wait: Duration::from_millis(20),
        queue: 4096,
    }
}

fn listen() -> (TcpListener, String) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let port = listener.local_addr().expect("an address").port();
    (listener, format!("tcp:127.0.0.1:{port}"))
}

/// Opens a selector, with this machine's clock.
fn open_timed(selector: &str, options: StreamOptions) -> Result<StreamSource, DeviceError> {
    open_stream(&selector.parse::<SourceSelector>().expect("a selector"), options)
}

/// Opens a dialogue over the same sockets, with timeouts that depend on events.
fn open_by(selector: &str, dialogue: impl Dialogue + 'static, events: &Events) -> StreamSource {
    let port = selector.rsplit(':').next().and_then(|port| port.parse().ok()).expect("a port");
    let connect = EventConnect { inner: TcpConnect::new(selector, "127.0.0.1", port), events: events.clone() };
    StreamSource::open(Box::new(connect), Box::new(Timeless(dialogue)), options()).expect("it answers")
}

fn open(selector: &str, events: &Events) -> StreamSource {
    open_by(selector, WireHost::new(), events)
}

fn device() -> WireDevice {
    WireDevice::new(DeviceInfo {
        device: "made".into(),
        serial: "1".into(),
        firmware: "0".into(),
        protocol: "adjacent".into(),
        boot: 5,
        electrodes: 16,
        channels: 4,
        frames_per_s: 1000.0,
        amplitude_a: 0.0,
        frequency_hz: 0.0,
        magnitude: false,
    })
}

/// Answers until the host has started the device. Returns the number of bytes that took.
fn shake_hands(stream: &mut TcpStream, device: &mut WireDevice) -> u64 {
    device.reset_link();
    stream.set_read_timeout(Some(LIMIT)).expect("a timeout");
    let (mut buffer, mut bytes) = ([0; 1024], 0);
    for _ in 0..100 {
        if device.is_running() {
            return bytes;
        }
        let count = stream.read(&mut buffer).expect("the host speaks");
        assert!(count > 0, "the host has gone");
        let mut answer = Vec::new();
        device.receive(&buffer[..count], &mut answer);
        stream.write_all(&answer).expect("the host listens");
        bytes += answer.len() as u64;
    }
    panic!("no start in 100 reads");
}

fn frame_bytes(device: &mut WireDevice, sequence: u64) -> Vec<u8> {
    let mut frame = Frame::default();
    frame.refill(sequence, HostStamp { monotonic_ns: 0, wall_ns: 0 }, &[sequence as f64; 4], &[]);
    let mut bytes = Vec::new();
    device.frame(&frame, Status::default(), &mut bytes);
    bytes
}

/// The numbers and first values of the next `count` frames.
fn collect(source: &mut StreamSource, count: usize) -> Vec<(u64, f64)> {
    let mut frame = Frame::default();
    let mut seen = Vec::new();
    let began = Instant::now();
    while seen.len() < count {
        assert!(began.elapsed() < LIMIT, "{} of {count} frames; {:?}", seen.len(), source.problem());
        if source.next_frame(&mut frame, Duration::from_millis(50)).expect("a stream never ends") == SourceEvent::Frame
        {
            seen.push((frame.sequence, frame.values[0]));
        }
    }
    seen
}

/// Waits for an event, however long it takes.
fn wait_until(mut has_come: impl FnMut() -> bool) {
    let began = Instant::now();
    while !has_come() {
        assert!(began.elapsed() < LIMIT, "it never came");
        thread::sleep(Duration::from_millis(2));
    }
}

/// Closes a stream whose device still has its line open. Without a stall the host would wait for the next byte.
fn close(source: StreamSource, events: &Events) {
    events.stall();
    drop(source);
}

fn done(server: JoinHandle<()>) {
    server.join().expect("the device did its part");
}

#[test]
fn twenty_unplugged_devices_resume_with_every_gap_counted() {
    const TIMES: u64 = 20;
    let (listener, selector) = listen();
    let server = thread::spawn(move || {
        let mut device = device();
        for connection in 0..TIMES {
            let (mut stream, _) = listener.accept().expect("a host");
            shake_hands(&mut stream, &mut device);
            // Ten of every thirty frames; unplugging cuts the last one in two.
            for sequence in 30 * connection..30 * connection + 10 {
                stream.write_all(&frame_bytes(&mut device, sequence)).expect("the host listens");
            }
            let cut = frame_bytes(&mut device, 30 * connection + 10);
            stream.write_all(&cut[..cut.len() / 2]).expect("the host listens");
        }
    });
    let mut source = open(&selector, &Events::default());
    let seen = collect(&mut source, 10 * TIMES as usize);
    let expected: Vec<(u64, f64)> =
        (0..TIMES).flat_map(|c| 30 * c..30 * c + 10).map(|sequence| (sequence, sequence as f64)).collect();
    assert_eq!(seen, expected);
    let counters = source.counters();
    assert_eq!((counters.frames, counters.lost, counters.bad), (10 * TIMES, 20 * (TIMES - 1), 0));
    assert!(source.connections() >= TIMES);
    done(server);
}

#[test]
fn a_stream_begins_when_its_first_frame_is_asked_for() {
    const EARLY: u64 = 2000;
    let (listener, selector) = listen();
    let (asked, wait) = std::sync::mpsc::channel();
    let (sent, ready) = std::sync::mpsc::channel();
    let server = thread::spawn(move || {
        let mut device = device();
        let (mut stream, _) = listener.accept().expect("a host");
        let mut bytes = shake_hands(&mut stream, &mut device);
        for sequence in 0..EARLY {
            let frame = frame_bytes(&mut device, sequence);
            bytes += frame.len() as u64;
            stream.write_all(&frame).expect("the host listens");
        }
        sent.send(bytes).expect("a test");
        wait.recv().expect("a test");
        for sequence in EARLY..EARLY + 200 {
            stream.write_all(&frame_bytes(&mut device, sequence)).expect("the host listens");
        }
        // The host hangs up in the end.
        let _ = stream.read(&mut [0; 64]);
    });
    let events = Events::default();
    let mut source = open(&selector, &events);
    let bytes = ready.recv().expect("a device");
    // Bytes in transit through the socket arrive too.
    wait_until(|| events.processed() >= bytes);
    assert_eq!(source.next_frame(&mut Frame::default(), Duration::ZERO).unwrap(), SourceEvent::Idle);
    asked.send(()).expect("a device");
    let seen = collect(&mut source, 200);
    assert!(seen.iter().zip(EARLY..).all(|((_, value), number)| *value == number as f64), "{seen:?}");
    assert_eq!((source.counters().frames, source.counters().lost), (200, 0));
    close(source, &events);
    done(server);
}

#[test]
fn a_stalled_device_is_idle_then_reconnected_and_never_blocks_its_reader() {
    let (listener, selector) = listen();
    let events = Events::default();
    let told = events.clone();
    let server = thread::spawn(move || {
        let mut device = device();
        let (mut stalled, _) = listener.accept().expect("a host");
        shake_hands(&mut stalled, &mut device);
        stalled.write_all(&frame_bytes(&mut device, 1)).expect("the host listens");
        // The connection stays open but silent; the host must reconnect by itself.
        told.stall();
        let (mut stream, _) = listener.accept().expect("the host again");
        shake_hands(&mut stream, &mut device);
        stream.write_all(&frame_bytes(&mut device, 4)).expect("the host listens");
        // The host hangs up in the end.
        let _ = stream.read(&mut [0; 64]);
    });
    let mut source = open(&selector, &events);
    assert_eq!(collect(&mut source, 1), [(0, 1.0)]);
    assert_eq!(source.next_frame(&mut Frame::default(), Duration::ZERO).unwrap(), SourceEvent::Idle);
    assert_eq!(collect(&mut source, 1), [(3, 4.0)]);
    assert_eq!(source.counters().lost, 2);
    close(source, &events);
    done(server);
}

#[test]
fn an_absent_or_silent_device_is_an_error_with_the_reason() {
    let (listener, selector) = listen();
    drop(listener);
    let expected = format!("{selector}: cannot connect: ");
    let message = refusal(&selector, |message| message.starts_with(&expected));
    assert!(message.starts_with(&expected), "{message}");

    let (listener, selector) = listen();
    let message = refusal(&selector, |message| message.contains("no answer"));
    assert!(message.contains("no answer"), "{message}");
    drop(listener);
}

/// The reason why a device can't be opened. A busy machine may not try within a short timeout, so longer ones follow.
fn refusal(selector: &str, is_expected: impl Fn(&str) -> bool) -> String {
    let mut message = String::new();
    for patience_s in [0.3, 3.0, 30.0] {
        let silence = Duration::from_secs(60);
        let short = StreamOptions { patience: Duration::from_secs_f64(patience_s), silence, ..options() };
        message = open_timed(selector, short).unwrap_err().to_string();
        if is_expected(&message) {
            break;
        }
    }
    message
}

#[test]
fn text_instead_of_the_wire_is_no_frame() {
    let (listener, selector) = listen();
    let server = thread::spawn(move || {
        let (mut stream, _) = listener.accept().expect("a host");
        // Write until the host hangs up.
        for line in 0..u32::MAX {
            if stream.write_all(format!("{line},2,3\n").as_bytes()).is_err() {
                return;
            }
            thread::sleep(Duration::from_millis(10));
        }
    });
    // A single connection, which is not given up for silence.
    let short = StreamOptions { patience: Duration::from_millis(300), silence: LIMIT, ..options() };
    let message = open_timed(&selector, short).unwrap_err().to_string();
    assert!(message.contains("no answer"), "{message}");
    done(server);
}

#[test]
fn lines_and_floats_come_over_a_socket() {
    let (listener, selector) = listen();
    let server = thread::spawn(move || {
        let (mut stream, _) = listener.accept().expect("a host");
        stream.write_all(b"half,a,line\n").expect("the host listens");
        for line in 0..9 {
            stream.write_all(format!("{line},2\n").as_bytes()).expect("the host listens");
        }
        let (mut stream, _) = listener.accept().expect("a host");
        let bytes: Vec<u8> = [0.5f32, 1.5, 2.5, 3.5].iter().flat_map(|value| value.to_le_bytes()).collect();
        stream.write_all(&bytes).expect("the host listens");
        let _ = stream.read(&mut [0; 1]);
    });
    let events = Events::default();
    let mut source = open_by(&selector, Lines::new(None), &events);
    // Three matching lines determine the number of channels.
    assert_eq!(collect(&mut source, 6).first(), Some(&(0, 3.0)));
    close(source, &events);
    let events = Events::default();
    let mut source = open_by(&selector, Floats::new(2), &events);
    assert_eq!(collect(&mut source, 2), [(0, 0.5), (1, 2.5)]);
    close(source, &events);
    done(server);
}
