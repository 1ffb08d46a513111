//! The wire over a real serial line of this machine: a pseudo-terminal whose other end the host opens by its path.
#![cfg(all(unix, feature = "serial"))]

use std::io::{ErrorKind, Read, Write};
use std::thread;
use std::time::{Duration, Instant};

use dermis_device::instruments::wire::{DeviceInfo, WireDevice};
use dermis_device::stream::{StreamOptions, ports};
use dermis_device::{Frame, HostStamp, Source, SourceEvent, open_stream};
use dermis_wire::Status;
use serialport::{SerialPort, TTYPort};

/// Time limit that only a hanging test reaches.
const LIMIT: Duration = Duration::from_secs(540);

#[test]
fn frames_come_through_a_serial_line() {
    let Ok((mut master, slave)) = TTYPort::pair() else {
        dermis_testdata::skip("this machine gives no pseudo-terminal");
        return;
    };
    let path = slave.name().expect("a path");
    // Only one side may have it open.
    drop(slave);
    let (read, wait) = std::sync::mpsc::channel();
    let server = thread::spawn(move || {
        let mut device = WireDevice::new(DeviceInfo {
            device: "made".into(),
            serial: "1".into(),
            firmware: "0".into(),
            protocol: "adjacent".into(),
            boot: 5,
            electrodes: 16,
            channels: 208,
            frames_per_s: 100.0,
            amplitude_a: 0.0,
            frequency_hz: 0.0,
            magnitude: false,
        });
        master.set_timeout(Duration::from_millis(20)).expect("a timeout");
        let (began, mut sent, mut buffer) = (Instant::now(), 0u64, [0; 1024]);
        let mut booted = false;
        while sent < 50 && began.elapsed() < LIMIT {
            let mut bytes = Vec::new();
            match master.read(&mut buffer) {
                Ok(count) => {
                    if !booted {
                        // Many boards print this when the port is opened.
                        bytes.extend_from_slice(b"booting...\r\n");
                        booted = true;
                    }
                    device.receive(&buffer[..count], &mut bytes);
                }
                Err(error) if error.kind() == ErrorKind::TimedOut => {}
                // The other end isn't open yet.
                Err(_) => thread::sleep(Duration::from_millis(2)),
            }
            if device.is_running() {
                let mut frame = Frame::default();
                let values: Vec<f64> = (0..208).map(|channel| (sent * 1000 + channel) as f64).collect();
                frame.refill(sent, HostStamp { monotonic_ns: 0, wall_ns: 0 }, &values, &[]);
                device.frame(&frame, Status::default(), &mut bytes);
                sent += 1;
            }
            master.write_all(&bytes).expect("the line takes bytes");
        }
        // The other end must finish reading before this one closes.
        let _ = wait.recv_timeout(LIMIT);
        sent
    });
    let options = StreamOptions { patience: LIMIT, silence: LIMIT, ..StreamOptions::default() };
    let mut source = open_stream(&format!("serial:{path}").parse().expect("a selector"), options).expect("it answers");
    let (mut frame, began, mut seen) = (Frame::default(), Instant::now(), 0u64);
    while seen < 50 && began.elapsed() < LIMIT {
        if source.next_frame(&mut frame, Duration::from_millis(50)).expect("a stream never ends") == SourceEvent::Frame
        {
            assert_eq!((frame.sequence, frame.values[207]), (seen, (seen * 1000 + 207) as f64));
            seen += 1;
        }
    }
    assert_eq!((seen, source.counters().lost, source.counters().bad), (50, 0, 0));
    read.send(()).expect("the device waits");
    drop(source);
    assert_eq!(server.join().expect("the device did its part"), 50);
}

#[test]
fn ports_are_listed_in_order() {
    let ports = ports().expect("a list, if an empty one");
    assert!(ports.windows(2).all(|pair| pair[0].path <= pair[1].path));
}
