//! A stand-in for a Sciospec instrument behind a socket. It executes commands and measures as configured.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use dermis_device::instruments::sciospec::live::LiveSetup;
use dermis_device::stream::StreamOptions;
use dermis_device::{Frame, Layout, Source, SourceEvent, open_sciospec, open_stream};

const FRAMES: usize = 20;

/// Settings at the instrument's start, and whether it was stopped.
#[derive(Debug, Default, PartialEq)]
struct Told {
    injections: Vec<(u8, u8)>,
    amplitude_a: f64,
    frequency_hz: f32,
    stopped: bool,
}

fn potential_v(frame: usize, (source, sink): (u8, u8), electrode: usize) -> f32 {
    1e-3 * f32::from(source) - 1e-4 * f32::from(sink) + 1e-5 * electrode as f32 + 1e-6 * frame as f32
}

fn serve(listener: TcpListener) -> JoinHandle<Told> {
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().expect("a host");
        let mut told = Told::default();
        let mut has_started = false;
        loop {
            let command = command(&mut stream);
            let data = &command[2..command.len() - 1];
            match (command[0], data) {
                (0xb4, [0]) if has_started => {
                    told.stopped = true;
                    return told;
                }
                (0xb0, [1]) => told = Told::default(),
                (0xb0, [5, rest @ ..]) => told.amplitude_a = f64::from_be_bytes(rest.try_into().expect("a double")),
                (0xb0, [4, rest @ ..]) => {
                    told.frequency_hz = f32::from_be_bytes(rest[..4].try_into().expect("a float"))
                }
                (0xb0, [6, source, sink]) => told.injections.push((*source, *sink)),
                _ => {}
            }
            stream.write_all(&[0x18, 1, 0x83, 0x18]).expect("the host listens");
            if (command[0], data) == (0xb4, &[1][..]) {
                has_started = true;
                (0..FRAMES).for_each(|frame| stream.write_all(&measured(frame, &told.injections)).expect("it listens"));
            }
        }
    })
}

fn command(stream: &mut TcpStream) -> Vec<u8> {
    let mut bytes = vec![0; 2];
    stream.read_exact(&mut bytes).expect("a command");
    bytes.resize(usize::from(bytes[1]) + 3, 0);
    stream.read_exact(&mut bytes[2..]).expect("its data");
    assert_eq!(bytes[0], bytes[bytes.len() - 1], "{bytes:x?}");
    bytes
}

/// A frame of sixteen electrodes; channels 17 to 32 are sent too.
fn measured(frame: usize, injections: &[(u8, u8)]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for injection in injections {
        for group in 0..2 {
            bytes.extend([0xb4, 137, group as u8 + 1, injection.0, injection.1, 0, 1, 0, 0, 0, frame as u8]);
            for channel in 0..16 {
                bytes.extend(potential_v(frame, *injection, 16 * group + channel).to_be_bytes());
                bytes.extend(0_f32.to_be_bytes());
            }
            bytes.push(0xb4);
        }
    }
    bytes
}

fn setup() -> LiveSetup {
    LiveSetup {
        electrodes: 16,
        injections: (0..16).map(|first| (first, (first + 4) % 16)).collect(),
        amplitude_a: 2e-3,
        frequency_hz: Some(5e3),
        frames_per_s: None,
    }
}

#[test]
fn the_instrument_gets_its_setup_and_every_frame_arrives() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let selector = format!("tcp:{}#sciospec", listener.local_addr().expect("an address")).parse().expect("a selector");
    let instrument = serve(listener);
    let mut source = open_sciospec(&selector, StreamOptions::default(), setup()).expect("it answers");
    let stimulations = setup().injections;
    assert_eq!(source.layout(), &Layout::SingleEnded { electrodes: 16, stimulations });
    let mut frame = Frame::default();
    for index in 0..FRAMES {
        while source.next_frame(&mut frame, Duration::from_millis(100)).expect("it goes on") != SourceEvent::Frame {}
        assert_eq!((frame.sequence, frame.values.len()), (index as u64, 256));
        for (channel, value) in frame.values.iter().enumerate() {
            let source = channel as u8 / 16;
            let expected = potential_v(index, (source + 1, (source + 4) % 16 + 1), channel % 16);
            assert_eq!(*value, f64::from(expected), "{index} {channel}");
        }
    }
    drop(source);
    let told = instrument.join().expect("it ran");
    assert_eq!((told.amplitude_a, told.frequency_hz, told.stopped), (2e-3, 5e3, true));
    assert_eq!((told.injections.len(), told.injections[15]), (16, (16, 4)));
    let without_skin = open_stream(&selector, StreamOptions::default()).expect_err("a skin is needed").to_string();
    assert!(without_skin.contains("#sciospec") && without_skin.contains("a skin"), "{without_skin}");
}
