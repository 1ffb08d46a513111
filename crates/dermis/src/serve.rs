//! A twin behind the real wire: on a socket it answers and streams as an instrument with firmware does, so that everything
//! between port and picture is tried without hardware. One host at a time; frames that a slow host does not take are
//! skipped and show in the sequence numbers.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use dermis_device::instruments::wire::{DeviceInfo, WireDevice};
use dermis_device::{Frame, HostStamp, Source, SourceEvent};
use dermis_wire::Status;

use crate::Error;
use crate::skin::{Reads, Skin};
use crate::twin_source::TwinSource;

/// Time between two looks at the port.
const NAP: Duration = Duration::from_millis(2);
/// Bytes that may wait for a host before frames are skipped.
const MOST_WAITING: usize = 256 * 1024;
/// A host that takes nothing for so long has gone.
const PATIENCE: Duration = Duration::from_secs(5);
/// Rate of a twin whose skin file gives none.
const FRAMES_PER_S: f64 = 50.0;

/// What became of a served twin's frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Served {
    /// Frames taken, sent or not.
    pub frames: u64,
    /// Frames skipped because the host was too slow.
    pub skipped: u64,
    /// Hosts that connected.
    pub hosts: u64,
}

/// What a twin says of itself on the wire. Every call gives another boot number.
///
/// # Errors
/// A skin whose electrodes or protocol cannot be made, or with more channels than a frame can hold.
pub fn device_info(skin: &Skin) -> Result<DeviceInfo, Error> {
    let protocol = skin.protocol()?;
    let count = |what: &str, count: usize| {
        u16::try_from(count).map_err(|_| Error::Frames {
            what: what.to_string(),
            expected: "at most 65535".to_string(),
            got: count.to_string(),
        })
    };
    let short = |text: &str| text.chars().take(60).collect::<String>();
    let wall_ns = HostStamp::now().wall_ns;
    Ok(DeviceInfo {
        device: format!("dermis twin of {}", short(&skin.name)),
        serial: "twin".to_string(),
        firmware: env!("CARGO_PKG_VERSION").to_string(),
        protocol: "as the skin file's".to_string(),
        boot: ((wall_ns ^ (wall_ns >> 32)) as u32).max(1),
        electrodes: count("electrodes", protocol.electrode_count())?,
        channels: count("channels", protocol.channel_count())?,
        frames_per_s: skin.backend.frames_per_s.unwrap_or(FRAMES_PER_S) as f32,
        amplitude_a: (skin.backend.current_ma * 1e-3) as f32,
        frequency_hz: skin.backend.frequency_khz.map_or(0.0, |khz| (khz * 1e3) as f32),
        magnitude: skin.backend.reads == Reads::Magnitude,
    })
}

/// Serves a twin until `stop` is set or, if given, `most` frames have been taken. The twin begins to measure when a host
/// first asks for frames (at once where `most` is given), so that this host sees it untouched; from then on it goes on,
/// host or not, as an instrument does.
///
/// # Errors
/// When the twin cannot go on, or the listener fails.
pub fn serve(
    listener: &TcpListener,
    mut twin: TwinSource,
    info: DeviceInfo,
    most: Option<u64>,
    stop: &AtomicBool,
) -> Result<Served, Error> {
    let failed = |source| Error::Io { file: "listening socket".into(), source };
    listener.set_nonblocking(true).map_err(failed)?;
    let mut device = WireDevice::new(info);
    let mut host: Option<Host> = None;
    let mut frame = Frame::default();
    let mut served = Served::default();
    let mut measuring = most.is_some();
    let mut overrun = false;
    while !stop.load(Ordering::Relaxed) && most.is_none_or(|most| served.frames < most) {
        accept(listener, &mut host, &mut device, &mut served).map_err(failed)?;
        if let Some(talking) = &mut host
            && !talking.serve(&mut device)
        {
            host = None;
            device.reset_link();
        }
        measuring |= device.is_running();
        if !measuring {
            std::thread::sleep(NAP);
            continue;
        }
        match twin.next_frame(&mut frame, NAP)? {
            SourceEvent::Idle => {}
            SourceEvent::End => break,
            SourceEvent::Frame => {
                served.frames += 1;
                let Some(host) = &mut host else { continue };
                if host.waiting.len() > MOST_WAITING {
                    served.skipped += 1;
                    overrun = true;
                    continue;
                }
                let status = if std::mem::take(&mut overrun) { Status::OVERRUN } else { Status::default() };
                device.frame(&frame, status, &mut host.waiting);
                host.flush();
            }
        }
    }
    Ok(served)
}

/// Takes a host that knocks; another one at the same time is sent away.
fn accept(
    listener: &TcpListener,
    host: &mut Option<Host>,
    device: &mut WireDevice,
    served: &mut Served,
) -> std::io::Result<()> {
    match listener.accept() {
        Ok((_, from)) if host.is_some() => {
            tracing::warn!("{from} was sent away: another host is connected");
            Ok(())
        }
        Ok((stream, _)) => {
            stream.set_nonblocking(true)?;
            stream.set_nodelay(true)?;
            device.reset_link();
            served.hosts += 1;
            *host = Some(Host { stream, waiting: Vec::new(), took: Instant::now(), gone: false });
            Ok(())
        }
        // Whoever knocked has gone again, or nobody did.
        Err(error) if is_passing(error.kind()) || error.kind() == ErrorKind::ConnectionAborted => Ok(()),
        Err(error) => Err(error),
    }
}

fn is_passing(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::WouldBlock | ErrorKind::Interrupted | ErrorKind::TimedOut)
}

/// The connected host.
struct Host {
    stream: TcpStream,
    /// Bytes not sent yet.
    waiting: Vec<u8>,
    /// When it last took any.
    took: Instant,
    gone: bool,
}

impl Host {
    /// Hears and answers; false when the host has gone.
    fn serve(&mut self, device: &mut WireDevice) -> bool {
        let mut buffer = [0; 4096];
        match self.stream.read(&mut buffer) {
            Ok(0) => self.gone = true,
            Ok(count) => device.receive(&buffer[..count], &mut self.waiting),
            Err(error) if is_passing(error.kind()) => {}
            Err(_) => self.gone = true,
        }
        self.flush();
        !self.gone
    }

    fn flush(&mut self) {
        if self.waiting.is_empty() {
            self.took = Instant::now();
            return;
        }
        match self.stream.write(&self.waiting) {
            Ok(count) => {
                self.waiting.drain(..count);
                self.took = Instant::now();
            }
            Err(error) if is_passing(error.kind()) => self.gone |= self.took.elapsed() > PATIENCE,
            Err(_) => self.gone = true,
        }
    }
}
