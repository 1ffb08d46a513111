//! A twin served over the real wire protocol on a loopback socket: the stream delivers the twin's readings, and a
//! twin that is killed and restarted is found again with its gap counted.

use std::io::Write;
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use dermis_device::instruments::wire::WireHost;
use dermis_device::stream::{StreamOptions, StreamSource, TcpConnect};
use dermis_device::{Frame, Source, SourceEvent, open_stream};
use dermis_lab::serve::{Door, Served, device_info, serve};
use dermis_lab::twin_source::TwinSource;
use dermis_skin::Skin;
use dermis_twin::TwinKit;

use crate::own_clock::Timeless;

/// Only reached if a test hangs.
const LIMIT: Duration = Duration::from_secs(540);

/// A twin that is being served.
struct Instrument {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Served>,
}

impl Instrument {
    fn start(listener: TcpListener) -> Self {
        let skin = Skin::open("healing-square").expect("a built-in skin");
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let thread = thread::spawn(move || {
            let (twin, _commands) = TwinSource::new(&skin).expect("it has a twin");
            let mut door = Door::tcp(listener).expect("a socket");
            serve(&mut door, twin, device_info(&skin).expect("a protocol"), None, &stopped).expect("it goes on")
        });
        Self { stop, thread }
    }

    fn kill(self) -> Served {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().expect("it ends in order")
    }
}

fn collect(source: &mut StreamSource, count: usize) -> Vec<Frame> {
    let mut seen = Vec::new();
    let began = Instant::now();
    while seen.len() < count {
        assert!(began.elapsed() < LIMIT, "{} of {count} frames; {:?}", seen.len(), source.problem());
        let mut frame = Frame::default();
        if source.next_frame(&mut frame, Duration::from_millis(50)).expect("a stream never ends") == SourceEvent::Frame
        {
            seen.push(frame);
        }
    }
    seen
}

/// Collects what was still in flight when the instrument went away; the host has read everything once it reports the
/// end of the connection.
fn drain(source: &mut StreamSource, seen: &mut Vec<Frame>) {
    let began = Instant::now();
    while source.problem().is_none() {
        assert!(began.elapsed() < LIMIT, "the connection does not end");
        thread::sleep(Duration::from_millis(2));
    }
    let mut frame = Frame::default();
    while source.next_frame(&mut frame, Duration::ZERO).expect("a stream never ends") == SourceEvent::Frame {
        seen.push(std::mem::take(&mut frame));
    }
}

/// Waits for the first frame that meets the condition. Panics if none of many frames does.
fn until(source: &mut StreamSource, what: &str, is_expected: impl Fn(&Frame) -> bool) -> Frame {
    for _ in 0..10_000 {
        let frame = collect(source, 1).pop().expect("a frame");
        if is_expected(&frame) {
            return frame;
        }
    }
    panic!("{what} in none of 10,000 frames");
}

/// Options of a patient host, since a twin's thread may have to wait for a core.
fn options() -> StreamOptions {
    StreamOptions { patience: LIMIT, silence: LIMIT, longest_wait: Duration::from_millis(50), ..Default::default() }
}

#[test]
fn frames_are_the_twins_and_a_restart_is_survived() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = listener.local_addr().expect("an address");
    let instrument = Instrument::start(listener);
    let connect = Box::new(TcpConnect::new(format!("tcp:{address}"), "127.0.0.1", address.port()));
    let mut source = StreamSource::open(connect, Box::new(Timeless(WireHost::new())), options()).expect("it answers");
    assert!(source.identity().expect("it said").starts_with("dermis twin of healing-square twin"));

    let mut first = collect(&mut source, 30);
    assert_eq!(instrument.kill().hosts, 1);
    drain(&mut source, &mut first);
    let skin = Skin::open("healing-square").expect("a built-in skin");
    let rate = skin.backend.frames_per_s.expect("a rate");
    let mut twin = TwinKit::of(&skin).expect("it has a twin").twin;
    let mut values = Vec::new();
    for frame in &first {
        let time_s = frame.device_time_ns.expect("a twin has a clock") as f64 * 1e-9;
        assert!((time_s - frame.sequence as f64 / rate).abs() < 2e-9, "frame {} at {time_s} s", frame.sequence);
        twin.step(frame.sequence as f64 * (1.0 / rate), &mut values).expect("it goes on");
        let sent: Vec<f64> = values.iter().map(|value| f64::from(*value as f32)).collect();
        assert_eq!(frame.values, sent, "frame {}", frame.sequence);
    }

    let instrument = Instrument::start(TcpListener::bind(address).expect("the same port"));
    let mut again = collect(&mut source, 10);
    assert_eq!(instrument.kill().skipped, 0);
    drain(&mut source, &mut again);
    let (last, next) = (first.last().expect("frames"), &again[0]);
    // The numbering continues across the gap, whose length follows from clock and rate after a restart.
    let periods = (next.host_monotonic_ns - last.host_monotonic_ns) as f64 * 1e-9 * rate;
    assert_eq!(next.sequence - last.sequence - 1, (periods.round() as u64).saturating_sub(1));
    assert_eq!(next.device_time_ns, Some(0), "the twin restarted");
    let all: Vec<u64> = first.iter().chain(&again).map(|frame| frame.sequence).collect();
    let gaps: u64 = all.windows(2).map(|pair| pair[1] - pair[0] - 1).sum();
    assert_eq!(source.counters().lost, gaps);
}

#[test]
fn several_hosts_get_the_same_frames_despite_silent_or_leaving_ones() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = listener.local_addr().expect("an address");
    let instrument = Instrument::start(listener);
    // One host that says nothing, and one that sends only noise.
    let mute = TcpStream::connect(address).expect("it listens");
    let mut noisy = TcpStream::connect(address).expect("it listens");
    noisy.write_all(&[0x55; 20_000]).expect("it takes bytes");
    let open = || open_stream(&format!("tcp:{address}").parse().expect("a selector"), options()).expect("it answers");
    let (mut one, mut other) = (open(), open());
    let (mut of_one, mut of_other) = (collect(&mut one, 20), collect(&mut other, 20));
    // Each host counts from its own first frame; the twin's clock is common to both.
    let time = |frame: &Frame| frame.device_time_ns.expect("a twin has a clock");
    while of_one.last().map(time) < of_other.last().map(time) {
        of_one.extend(collect(&mut one, 1));
    }
    for frame in of_other.iter().filter(|frame| time(frame) >= time(&of_one[0])) {
        let same = of_one.iter().find(|same| time(same) == time(frame)).expect("it came to both");
        assert!(same.values == frame.values, "frame {} is not the same", frame.sequence);
    }
    drop(one);
    let last = of_other.last().expect("frames").sequence;
    of_other = collect(&mut other, 20);
    assert!(of_other[0].sequence == last + 1 && of_other.windows(2).all(|w| w[1].sequence == w[0].sequence + 1));
    drop((mute, noisy));
    let served = instrument.kill();
    assert_eq!((served.hosts, served.skipped), (4, 0));
}

/// The twin on a pseudo-terminal acts like a board on a serial port; one host leaves and another one comes.
#[cfg(unix)]
#[test]
fn a_twin_at_a_pseudo_terminal_is_a_board_at_a_serial_port() {
    use dermis_device::stream::Pty;
    use dermis_lab::serve::command_of;

    let Ok(pty) = Pty::open() else {
        dermis_testdata::skip("this machine gives no pseudo-terminal");
        return;
    };
    let selector = format!("serial:{}", pty.path());
    let skin = Skin::open("healing-square").expect("a built-in skin");
    let (twin, commands) = TwinSource::new(&skin).expect("it has a twin");
    let (twin, press) = (twin.undemonstrated(), twin_range(&skin));
    let say = |line: &str| {
        let command = command_of(line, &press).expect("it means something").expect("a command");
        commands.send(command).expect("the twin listens");
    };
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = stop.clone();
    let info = device_info(&skin).expect("a protocol");
    let thread = thread::spawn(move || serve(&mut Door::Pty(pty), twin, info, None, &stopped).expect("it goes on"));
    let open = || open_stream(&selector.parse().expect("a selector"), options()).expect("it answers");

    let mut source = open();
    let rest = collect(&mut source, 10).pop().expect("frames");
    say("press 10 -5 20");
    let changed = |frame: &Frame| {
        let difference = frame.values.iter().zip(&rest.values).map(|(now, before)| (now - before).powi(2)).sum::<f64>();
        (difference / rest.values.iter().map(|value| value.powi(2)).sum::<f64>()).sqrt()
    };
    until(&mut source, "a press", |frame| changed(frame) > 0.01);
    say("release");
    say("fault channel 7 stuck 2.5");
    until(&mut source, "channel 7 stuck", |frame| (frame.values[6] - 2.5e-3).abs() < 1e-9);
    say("repair");
    let sound = until(&mut source, "a sound frame at rest", |frame| changed(frame) < 0.01);

    // This host leaves. The twin keeps measuring, and the next host gets its own numbering.
    let last_ns = sound.device_time_ns.expect("a clock");
    drop(source);
    thread::sleep(Duration::from_millis(300));
    let mut source = open();
    let next = collect(&mut source, 5);
    assert!(next[0].device_time_ns.expect("a clock") > last_ns + 200_000_000, "it went on");
    assert!(next.windows(2).all(|pair| pair[1].sequence == pair[0].sequence + 1));
    drop(source);
    stop.store(true, Ordering::Relaxed);
    let served = thread.join().expect("it ends in order");
    assert_eq!((served.hosts, served.skipped), (2, 0));
}

#[cfg(unix)]
fn twin_range(skin: &Skin) -> dermis_twin::PressRange {
    TwinKit::of(skin).expect("it has a twin").press
}
