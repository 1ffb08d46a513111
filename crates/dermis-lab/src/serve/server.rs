//! Serves a twin to its hosts.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use dermis_device::instruments::wire::{DeviceInfo, WireDevice};
use dermis_device::{Frame, HostStamp, Source, SourceEvent};
use dermis_twin::instrument::Fault;
use dermis_wire::Status;

use super::listener::{Door, Host};
use crate::Error;
use crate::twin_source::TwinSource;
use dermis_skin::{FileError, Reads, Skin};

/// Time between polls of the port.
const NAP: Duration = Duration::from_millis(2);
/// Bytes queued for a host above which frames are skipped.
const MOST_WAITING: usize = 256 * 1024;

/// Frame counts of a served twin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Served {
    /// Frames taken, sent or not.
    pub frames: u64,
    /// Frames skipped because a host was too slow.
    pub skipped: u64,
    /// Hosts that connected.
    pub hosts: u64,
}

/// The device information that a twin sends over the wire. Every call gives a new boot number.
///
/// # Errors
/// The skin's electrodes or protocol are invalid, or it has more channels than a frame can hold.
pub fn device_info(skin: &Skin) -> Result<DeviceInfo, Error> {
    let protocol = skin.protocol()?;
    let count = |what: &str, count: usize| {
        u16::try_from(count).map_err(|_| {
            Error::Live(dermis_live::Error::Frames {
                what: what.to_string(),
                expected: "at most 65535".to_string(),
                got: count.to_string(),
            })
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
        frames_per_s: skin.backend.frame_rate_hz() as f32,
        amplitude_a: (skin.backend.current_ma * 1e-3) as f32,
        frequency_hz: skin.backend.frequency_khz.map_or(0.0, |khz| (khz * 1e3) as f32),
        magnitude: skin.backend.reads == Reads::Magnitude,
    })
}

/// A connected host, with its own device state machine. All guests get the same frames.
struct Guest {
    host: Host,
    device: WireDevice,
    /// Frames were skipped since the last one sent.
    overrun: bool,
}

/// Serves a twin until `stop` is set or, if `most` is given, that many frames have been taken.
///
/// The twin starts measuring when a host first asks for frames (at once if `most` is given), so this host sees it
/// untouched. From then on it keeps measuring with or without hosts, as an instrument does. It answers a self-test
/// with the number of faults in its instrument, and an impedance check with the contact impedances of its electrodes,
/// NaN for an open one.
///
/// # Errors
/// The twin or the port fails.
pub fn serve(
    door: &mut Door,
    mut twin: TwinSource,
    info: DeviceInfo,
    most: Option<u64>,
    stop: &AtomicBool,
) -> Result<Served, Error> {
    let failed =
        |source| Error::Live(dermis_live::Error::Io(FileError { file: "port of the served twin".into(), source }));
    let mut faults: Option<Vec<Fault>> = None;
    let mut measured = (Vec::new(), Vec::new());
    let mut guests: Vec<Guest> = Vec::new();
    let mut frame = Frame::default();
    let mut served = Served::default();
    let mut measuring = most.is_some();
    while !stop.load(Ordering::Relaxed) && most.is_none_or(|most| served.frames < most) {
        if faults.as_deref() != Some(twin.acting_faults()) {
            let acting = twin.acting_faults().to_vec();
            measured = (vec![acting.len() as f32], twin.contacts_ohm());
            guests.iter_mut().for_each(|guest| guest.device.set_measured(&measured.0, &measured.1));
            faults = Some(acting);
        }
        if let Some(host) = door.knock(guests.len()).map_err(failed)? {
            let mut device = WireDevice::new(info.clone());
            device.set_measured(&measured.0, &measured.1);
            // Hosts already connected keep seeing the demonstration; the first host needs a skin at rest.
            if guests.is_empty() {
                twin.calm()?;
            }
            served.hosts += 1;
            guests.push(Guest { host, device, overrun: false });
        }
        guests.retain_mut(|Guest { host, device, .. }| host.serve(door, device) && !host.is_mute(device));
        measuring |= guests.iter().any(|guest| guest.device.wants_frames());
        if !measuring {
            std::thread::sleep(NAP);
            continue;
        }
        match twin.next_frame(&mut frame, NAP)? {
            SourceEvent::Idle => {}
            SourceEvent::End => break,
            SourceEvent::Frame => {
                served.frames += 1;
                for Guest { host, device, overrun } in &mut guests {
                    if host.waiting() > MOST_WAITING {
                        served.skipped += 1;
                        *overrun = true;
                        continue;
                    }
                    let status = if std::mem::take(overrun) { Status::OVERRUN } else { Status::default() };
                    host.send(door, |waiting| device.frame(&frame, status, waiting));
                }
            }
        }
    }
    Ok(served)
}
