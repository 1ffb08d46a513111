//! Serial ports, found by path or by USB identity. The latter works whichever socket a board is plugged into.

use std::io::{self, ErrorKind, Read, Write};
use std::path::Path;
use std::time::Duration;

use serialport::{SerialPort, SerialPortType};

use super::tcp::nothing_yet;
use super::{Connect, Link};
use crate::selector::SerialName;

const READ: Duration = Duration::from_millis(20);
/// Default baud rate, if neither user nor instrument sets one. Boards on USB ignore it.
const BAUD: u32 = 115_200;

/// A serial port of this machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Port {
    /// Path or name for opening the port.
    pub path: String,
    /// USB vendor and product numbers, if it is on USB.
    pub usb: Option<(u16, u16)>,
    /// Serial number of the USB device.
    pub serial: Option<String>,
    /// Product name of the USB device.
    pub product: Option<String>,
}

/// Serial ports of this machine, by path.
///
/// # Errors
/// The operating system's errors.
pub fn ports() -> io::Result<Vec<Port>> {
    // Without this directory (in a container, for instance) the listing would panic, and there are no ports.
    if cfg!(target_os = "linux") && !Path::new("/sys/class/tty").is_dir() {
        return Ok(Vec::new());
    }
    let mut ports: Vec<Port> = serialport::available_ports()?.into_iter().map(Port::from).collect();
    ports.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(ports)
}

impl From<serialport::SerialPortInfo> for Port {
    fn from(info: serialport::SerialPortInfo) -> Self {
        match info.port_type {
            SerialPortType::UsbPort(usb) => Self {
                path: info.port_name,
                usb: Some((usb.vid, usb.pid)),
                serial: usb.serial_number,
                product: usb.product,
            },
            _ => Self { path: info.port_name, usb: None, serial: None, product: None },
        }
    }
}

/// Opens a serial port.
#[derive(Debug, Clone)]
pub struct SerialConnect {
    name: String,
    port: SerialName,
    baud: u32,
}

impl SerialConnect {
    /// A port by path or USB identity; the default for `baud` is 115,200 bits/s.
    pub fn new(name: impl Into<String>, port: SerialName, baud: Option<u32>) -> Self {
        Self { name: name.into(), port, baud: baud.unwrap_or(BAUD) }
    }

    /// Looks up the path again for every connection: it may change when a board is plugged in again.
    fn path(&self) -> io::Result<String> {
        match &self.port {
            SerialName::Path(path) => Ok(path.clone()),
            SerialName::Usb { vendor, product, serial } => ports()?
                .into_iter()
                .find(|port| port.usb == Some((*vendor, *product)) && (serial.is_none() || *serial == port.serial))
                .map(|port| port.path)
                .ok_or_else(|| io::Error::new(ErrorKind::NotFound, format!("no USB device {} found", self.port))),
        }
    }
}

impl Connect for SerialConnect {
    fn connect(&mut self) -> io::Result<Box<dyn Link>> {
        let path = self.path()?;
        let port = serialport::new(&path, self.baud).timeout(READ).open().map_err(|error| {
            let error = io::Error::from(error);
            let advice = match error.kind() {
                ErrorKind::PermissionDenied => " (is this user in the group of the port, often dialout?)",
                _ => "",
            };
            io::Error::new(error.kind(), format!("{path}: {error}{advice}"))
        })?;
        Ok(Box::new(SerialLink(port)))
    }

    fn name(&self) -> &str {
        &self.name
    }
}

struct SerialLink(Box<dyn SerialPort>);

impl Link for SerialLink {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        nothing_yet(self.0.read(buffer))
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut rest = bytes;
        // A port that accepts nothing for a second has no device behind it.
        for _ in 0..50 {
            if rest.is_empty() {
                return Ok(());
            }
            rest = &rest[nothing_yet(self.0.write(rest))?..];
        }
        Err(io::Error::new(ErrorKind::TimedOut, "the port accepts no bytes"))
    }
}
