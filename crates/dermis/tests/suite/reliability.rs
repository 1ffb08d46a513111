//! A device is unplugged and plugged in again a hundred times, stalls, and is replaced by another: the stream
//! resumes, every gap is counted, and touches end and begin as they should.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

use dermis_device::instruments::wire::{DeviceInfo, WireDevice, WireHost};
use dermis_device::stream::{StreamOptions, StreamSource, TcpConnect};
use dermis_device::{Frame, HostStamp, Layout, Source, SourceEvent, Status};
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_skin::Skin;
use dermis_tomo::mesh::distance;
use dermis_touch::TouchPhase;
use dermis_twin::TwinKit;

use crate::own_clock::{EventConnect, Events, Timeless};

/// No wait takes this long, however busy the machine is.
const LIMIT: Duration = Duration::from_secs(480);
const CONNECTIONS: u64 = 100;
/// Frames per connection.
const BROUGHT: u64 = 12;
/// Additional frames of the first connection, for the baseline.
const BASELINE: u64 = 40;
/// Frames taken by the device while it is unplugged: 0.42 s.
const MISSED: u64 = 21;
const PERIOD_NS: u64 = 20_000_000;
const PLACES_M: [[f64; 2]; 2] = [[-0.02, 0.015], [0.022, -0.018]];

fn info(channels: u16) -> DeviceInfo {
    DeviceInfo {
        device: "made".into(),
        serial: "1".into(),
        firmware: "0".into(),
        protocol: "pseudo-polar".into(),
        boot: 5,
        electrodes: 16,
        channels,
        frames_per_s: 50.0,
        amplitude_a: 0.0,
        frequency_hz: 0.0,
        magnitude: false,
    }
}

/// Frames of the twin: untouched, and pressed at each of the places.
fn readings(skin: &Skin) -> [Vec<Vec<f64>>; 3] {
    let mut twin = TwinKit::of(skin).expect("it has a twin").twin;
    let (mut values, mut time_s) = (Vec::new(), 0.0);
    [None, Some(PLACES_M[0]), Some(PLACES_M[1])].map(|place| {
        twin.scene_mut().release_all();
        if let Some([x_m, y_m]) = place {
            twin.scene_mut().press(0, x_m, y_m, 0.01, 80e3).expect("on the skin");
        }
        let mut frames = Vec::new();
        for _ in 0..30 + BASELINE {
            twin.step(time_s, &mut values).expect("it goes on");
            time_s += 0.02;
            frames.push(values.clone());
        }
        // Skip the frames in which a press fades in or out.
        frames.split_off(30)
    })
}

/// Answers until the host has started the device (true) or has disconnected (false).
fn shake_hands(stream: &mut TcpStream, device: &mut WireDevice) -> bool {
    device.reset_link();
    stream.set_read_timeout(Some(LIMIT)).expect("a timeout");
    let mut buffer = [0; 1024];
    while !device.is_running() {
        let count = stream.read(&mut buffer).expect("the host speaks");
        if count == 0 {
            return false;
        }
        let mut answer = Vec::new();
        device.receive(&buffer[..count], &mut answer);
        stream.write_all(&answer).expect("the host listens");
    }
    true
}

/// Waits until the host has closed the connection.
fn wait_until_left(stream: &mut TcpStream) {
    while stream.read(&mut [0; 64]).is_ok_and(|count| count > 0) {}
}

/// State of the skin during a connection: untouched, or pressed at one of the places. Every fourth connection repeats
/// the place of the one before.
fn state(connection: u64) -> usize {
    [0, 1, 2, 2][(connection % 4) as usize]
}

/// Plays the device on a socket. Frames flow once the host has asked for the first, because a stream keeps only a
/// few of those that arrive before.
fn device(listener: &TcpListener, readings: &[Vec<Vec<f64>>; 3], events: &Events, asked: &Receiver<()>) {
    let mut device = WireDevice::new(info(208));
    let mut sequence = 0;
    for connection in 0..CONNECTIONS {
        if connection % 25 == 10 {
            // Another device on the port: the host disconnects, and only time is lost.
            let (mut stream, _) = listener.accept().expect("a host");
            assert!(!shake_hands(&mut stream, &mut WireDevice::new(info(4))), "the host leaves");
        }
        let (mut stream, _) = listener.accept().expect("a host");
        assert!(shake_hands(&mut stream, &mut device), "the host stays");
        if connection == 0 {
            asked.recv_timeout(LIMIT).expect("the host asks");
        }
        let brought = if connection == 0 { BASELINE } else { BROUGHT };
        let mut bytes = Vec::new();
        for n in 0..=brought {
            let mut frame = Frame::default();
            let values = &readings[state(connection)][((sequence + n) % BASELINE) as usize];
            frame.refill(sequence + n, HostStamp { monotonic_ns: 0, wall_ns: 0 }, values, &[]);
            frame.device_time_ns = Some((sequence + n) * PERIOD_NS);
            bytes.clear();
            device.frame(&frame, Status::default(), &mut bytes);
            // Unplugging cuts the last frame in two.
            let length = if n == brought { bytes.len() / 2 } else { bytes.len() };
            stream.write_all(&bytes[..length]).expect("the host listens");
        }
        sequence += brought + MISSED;
        if connection % 25 == 20 {
            // Stays connected but silent until the host gives up.
            events.stall();
        } else {
            stream.shutdown(Shutdown::Write).expect("the host listens");
        }
        wait_until_left(&mut stream);
    }
}

#[test]
fn a_hundred_replugs_are_counted_exactly_and_touches_end_and_begin() {
    let skin = Skin::open("healing-square").expect("a built-in skin");
    let readings = readings(&skin);
    let mut pipeline =
        Pipeline::new(Prepared::new(skin).expect("it can be prepared"), &Layout::Channels { count: 208 }, None)
            .expect("a pipeline");
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let port = listener.local_addr().expect("an address").port();
    let (events, (ask, asked)) = (Events::default(), channel());
    let told = events.clone();
    let server = thread::spawn(move || device(&listener, &readings, &told, &asked));
    let options = StreamOptions {
        patience: LIMIT,
        silence: Duration::from_millis(1),
        frame: LIMIT,
        first_wait: Duration::from_millis(2),
        longest_wait: Duration::from_millis(10),
        queue: 4096,
    };
    let connect = EventConnect { inner: TcpConnect::new(format!("tcp:127.0.0.1:{port}"), "127.0.0.1", port), events };
    let mut source =
        StreamSource::open(Box::new(connect), Box::new(Timeless(WireHost::new())), options).expect("it answers");
    let (began, mut frame) = (Instant::now(), Frame::default());
    let nothing = source.next_frame(&mut frame, Duration::ZERO).expect("a stream never ends");
    assert_ne!(nothing, SourceEvent::Frame, "nothing has been asked for yet");
    ask.send(()).expect("the device is there");
    let total = BASELINE + (CONNECTIONS - 1) * BROUGHT;
    let (mut seen, mut open, mut begun) = (0, BTreeMap::new(), Vec::new());
    while seen < total {
        assert!(began.elapsed() < LIMIT, "{seen} of {total} frames; {:?}", source.problem());
        if source.next_frame(&mut frame, Duration::from_millis(50)).expect("a stream never ends") != SourceEvent::Frame
        {
            continue;
        }
        seen += 1;
        let output = pipeline.process(&frame, frame.host_monotonic_ns).expect("a frame of this skin");
        let connection = frame.sequence.saturating_sub(BASELINE - BROUGHT) / (BROUGHT + MISSED);
        for touch in output.ended.iter().chain(output.touches.iter()) {
            match touch.phase {
                TouchPhase::Begin => {
                    assert!(begun.last().is_none_or(|(_, last)| touch.id > *last), "identities count up");
                    assert!(open.insert(touch.id, connection).is_none(), "touch {} begins twice", touch.id);
                    begun.push((connection, touch.id));
                    let place = PLACES_M[state(connection) - 1];
                    let error_m = distance(touch.position_m, place);
                    assert!(error_m < 5e-3, "touch {} is {:.1} mm off", touch.id, error_m * 1e3);
                }
                TouchPhase::Move => assert_eq!(open.get(&touch.id), Some(&connection), "of this connection"),
                TouchPhase::End => {
                    let began = open.remove(&touch.id).expect("it has begun");
                    assert_eq!(connection, began + 1, "it ends with the first frame after the gap");
                }
            }
        }
    }
    // One touch for every connection under a press, even if the previous place was the same.
    let pressed: Vec<u64> = (0..CONNECTIONS).filter(|connection| state(*connection) > 0).collect();
    assert_eq!(begun.iter().map(|(connection, _)| *connection).collect::<Vec<_>>(), pressed);
    let counters = source.counters();
    assert_eq!((counters.frames, counters.lost, counters.bad), (total, MISSED * (CONNECTIONS - 1), 0));
    assert!(source.connections() >= CONNECTIONS);
    println!("{CONNECTIONS} connections in {:.1} s", began.elapsed().as_secs_f64());
    drop(source);
    server.join().expect("the device did its part");
}
