//! Names of sources as users write them: `file:run.csv`, `twin:healing-square`, `serial:/dev/ttyUSB0@115200`,
//! `serial:2341:0043`, `tcp:192.168.1.20:5025#lines`, or simply a path.

use std::fmt;
use std::str::FromStr;

use crate::{DeviceError, FileSpec};

/// A source as the user named it. Opening it is up to the code that owns the transport.
///
/// ```
/// use dermis_device::{Instrument, SerialName, SourceSelector};
///
/// let tcp: SourceSelector = "tcp:192.168.1.20:5025".parse()?;
/// assert_eq!(tcp, SourceSelector::Tcp { host: "192.168.1.20".into(), port: 5025, instrument: Instrument::Wire });
///
/// let serial: SourceSelector = "serial:/dev/ttyUSB0@115200#lines".parse()?;
/// let port = SerialName::Path("/dev/ttyUSB0".into());
/// let instrument = Instrument::Lines { channels: None };
/// assert_eq!(serial, SourceSelector::Serial { port, baud: Some(115_200), instrument });
///
/// // A board by its USB numbers, and by its serial number where there are several.
/// let board: SourceSelector = "serial:2341:0043:A1B2".parse()?;
/// let port = SerialName::Usb { vendor: 0x2341, product: 0x0043, serial: Some("A1B2".into()) };
/// assert_eq!(board, SourceSelector::Serial { port, baud: None, instrument: Instrument::Wire });
///
/// // A bare path is a file; text after '#' chooses frames of it.
/// let file: SourceSelector = "runs/voltages.csv#ref".parse()?;
/// assert_eq!(file, "file:runs/voltages.csv#ref".parse()?);
///
/// // Whatever `read` reads, by content: CSV and NumPy tables, Sciospec files and the folders that hold them.
/// for (text, path, frames) in [
///     ("file:press.npy#0..60", "press.npy", "0..60"),
///     ("file:tank/setup_00001.eit", "tank/setup_00001.eit", ""),
///     ("file:tank/20240131 12.30.00/setup#..10", "tank/20240131 12.30.00/setup", "0..10"),
///     ("run.mcap", "run.mcap", ""),
/// ] {
///     let SourceSelector::File(spec) = text.parse()? else { panic!("{text} is a file") };
///     assert_eq!((spec.path.to_str(), spec.select.to_string()), (Some(path), frames.to_string()));
/// }
/// assert_eq!("twin:ionic-disc".parse::<SourceSelector>()?, SourceSelector::Twin { name: Some("ionic-disc".into()) });
///
/// let error = "udp:host:1".parse::<SourceSelector>().unwrap_err();
/// assert!(error.to_string().starts_with("'udp:host:1': expected file:PATH, twin[:NAME]"));
/// # Ok::<(), dermis_device::DeviceError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SourceSelector {
    /// A recording, `file:PATH` or a bare path.
    File(FileSpec),
    /// A digital twin, `twin` or `twin:NAME`. The default is the twin of the current skin.
    Twin {
        /// Name of the skin.
        name: Option<String>,
    },
    /// A serial port, `serial:PORT`, optionally followed by `@BAUD` and `#INSTRUMENT`.
    Serial {
        /// The port.
        port: SerialName,
        /// Bits per second, unless the instrument has a fixed rate.
        baud: Option<u32>,
        /// The instrument on this port.
        instrument: Instrument,
    },
    /// A TCP server, `tcp:HOST:PORT`, optionally followed by `#INSTRUMENT`. An IPv6 host is in brackets.
    Tcp {
        /// Host name or address, without brackets.
        host: String,
        /// Port number.
        port: u16,
        /// The instrument on this socket.
        instrument: Instrument,
    },
}

/// A serial port, by path or by USB identity.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SerialName {
    /// Path or name, `/dev/ttyACM0` or `COM3`.
    Path(String),
    /// `VID:PID` or `VID:PID:SERIAL`, with four hexadecimal digits for each number. The first match if there are
    /// several.
    Usb {
        /// USB vendor number.
        vendor: u16,
        /// USB product number.
        product: u16,
        /// Serial number.
        serial: Option<String>,
    },
}

/// Kind of instrument on a port or socket.
///
/// ```
/// use dermis_device::Instrument;
///
/// assert_eq!("wire".parse::<Instrument>()?, Instrument::Wire);
/// assert_eq!("lines:208".parse::<Instrument>()?, Instrument::Lines { channels: Some(208) });
/// assert_eq!("floats:208".parse::<Instrument>()?.to_string(), "floats:208");
/// assert!("floats".parse::<Instrument>().is_err());
/// # Ok::<(), dermis_device::DeviceError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Instrument {
    /// dermis's own wire protocol, `wire`. The default.
    #[default]
    Wire,
    /// Lines of numbers, `lines` or `lines:CHANNELS`.
    Lines {
        /// Numbers per line. If absent, determined from consecutive lines with the same count.
        channels: Option<usize>,
    },
    /// Raw single-precision frames, `floats:CHANNELS`.
    Floats {
        /// Readings per frame.
        channels: usize,
    },
    /// A Sciospec EIT instrument, `sciospec`.
    Sciospec,
}

/// Maximum number of channels that a user can specify.
const MOST_CHANNELS: usize = 65_535;

impl FromStr for Instrument {
    type Err = DeviceError;

    fn from_str(text: &str) -> Result<Self, DeviceError> {
        let error = || DeviceError::selector(text, "wire, lines, lines:CHANNELS, floats:CHANNELS or sciospec");
        let (name, channels) = text.split_once(':').map_or((text, None), |(name, rest)| (name, Some(rest)));
        let channels: Option<usize> = channels.map(|text| text.parse().map_err(|_| error())).transpose()?;
        if channels.is_some_and(|count| count == 0 || count > MOST_CHANNELS) {
            return Err(error());
        }
        match (name, channels) {
            ("wire", None) => Ok(Self::Wire),
            ("lines", channels) => Ok(Self::Lines { channels }),
            ("floats", Some(channels)) => Ok(Self::Floats { channels }),
            ("sciospec", None) => Ok(Self::Sciospec),
            _ => Err(error()),
        }
    }
}

impl fmt::Display for Instrument {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Wire => write!(out, "wire"),
            Self::Lines { channels: None } => write!(out, "lines"),
            Self::Lines { channels: Some(channels) } => write!(out, "lines:{channels}"),
            Self::Floats { channels } => write!(out, "floats:{channels}"),
            Self::Sciospec => write!(out, "sciospec"),
        }
    }
}

impl fmt::Display for SerialName {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Path(path) => write!(out, "{path}"),
            Self::Usb { vendor, product, serial: None } => write!(out, "{vendor:04x}:{product:04x}"),
            Self::Usb { vendor, product, serial: Some(serial) } => write!(out, "{vendor:04x}:{product:04x}:{serial}"),
        }
    }
}

const FORMS: &str = "file:PATH, twin[:NAME], serial:PORT[@BAUD], tcp:HOST:PORT or a path";

impl FromStr for SourceSelector {
    type Err = DeviceError;

    fn from_str(text: &str) -> Result<Self, DeviceError> {
        if text == "twin" {
            return Ok(Self::Twin { name: None });
        }
        let Some((scheme, rest)) = text.split_once(':') else { return text.parse().map(Self::File) };
        match scheme {
            "file" if rest.is_empty() => Err(DeviceError::selector(text, "a file path, as in file:run.csv")),
            "file" => rest.parse().map(Self::File),
            "twin" if rest.is_empty() => Ok(Self::Twin { name: None }),
            "twin" => Ok(Self::Twin { name: Some(rest.to_owned()) }),
            "serial" => parse_serial(text, rest),
            "tcp" => parse_tcp(text, rest),
            _ if is_unknown_scheme(scheme) => Err(DeviceError::selector(text, FORMS)),
            _ => text.parse().map(Self::File),
        }
    }
}

/// A word of several letters before the first colon is treated as a scheme. A single letter is a Windows drive, and
/// anything with other characters is part of a path.
fn is_unknown_scheme(scheme: &str) -> bool {
    scheme.is_empty() || (scheme.len() > 1 && scheme.bytes().all(|byte| byte.is_ascii_alphanumeric()))
}

fn parse_serial(text: &str, rest: &str) -> Result<SourceSelector, DeviceError> {
    let expected = "serial:PORT or serial:PORT@BAUD, as in serial:/dev/ttyUSB0@115200, or serial:VID:PID[:SERIAL]";
    let (rest, instrument) = split_instrument(rest)?;
    let (port, baud) = match rest.rsplit_once('@') {
        Some((port, baud)) => {
            let baud = baud.parse().ok().filter(|&baud: &u32| baud > 0);
            (port, Some(baud.ok_or_else(|| DeviceError::selector(text, expected))?))
        }
        None => (rest, None),
    };
    if port.is_empty() {
        return Err(DeviceError::selector(text, expected));
    }
    let port = usb_name(port).unwrap_or_else(|| SerialName::Path(port.to_owned()));
    Ok(SourceSelector::Serial { port, baud, instrument })
}

/// Parses `VID:PID[:SERIAL]`.
fn usb_name(port: &str) -> Option<SerialName> {
    let number = |text: &str| {
        let digits = text.len() == 4 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
        digits.then(|| u16::from_str_radix(text, 16).ok()).flatten()
    };
    let (vendor, rest) = port.split_once(':')?;
    let (product, serial) = rest.split_once(':').map_or((rest, None), |(product, serial)| (product, Some(serial)));
    let serial = serial.filter(|serial| !serial.is_empty()).map(str::to_owned);
    Some(SerialName::Usb { vendor: number(vendor)?, product: number(product)?, serial })
}

/// Cuts `#INSTRUMENT` off the end.
fn split_instrument(text: &str) -> Result<(&str, Instrument), DeviceError> {
    match text.rsplit_once('#') {
        Some((rest, instrument)) => Ok((rest, instrument.parse()?)),
        None => Ok((text, Instrument::Wire)),
    }
}

fn parse_tcp(text: &str, rest: &str) -> Result<SourceSelector, DeviceError> {
    let error = || DeviceError::selector(text, "tcp:HOST:PORT, as in tcp:192.168.1.20:5025 or tcp:[::1]:5025");
    let (rest, instrument) = split_instrument(rest)?;
    let (host, port) = rest.rsplit_once(':').ok_or_else(error)?;
    let bare = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
    let host = match bare {
        Some(bare) => bare,
        None if host.contains([':', '[', ']']) => return Err(error()),
        None => host,
    };
    let port = port.parse().ok().filter(|&port: &u16| port > 0).ok_or_else(error)?;
    if host.is_empty() {
        return Err(error());
    }
    Ok(SourceSelector::Tcp { host: host.to_owned(), port, instrument })
}

impl fmt::Display for SourceSelector {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(spec) => return write!(out, "file:{spec}"),
            Self::Twin { name: None } => return write!(out, "twin"),
            Self::Twin { name: Some(name) } => return write!(out, "twin:{name}"),
            Self::Serial { port, baud: None, .. } => write!(out, "serial:{port}")?,
            Self::Serial { port, baud: Some(baud), .. } => write!(out, "serial:{port}@{baud}")?,
            Self::Tcp { host, port, .. } if host.contains(':') => write!(out, "tcp:[{host}]:{port}")?,
            Self::Tcp { host, port, .. } => write!(out, "tcp:{host}:{port}")?,
        }
        match self {
            Self::Serial { instrument, .. } | Self::Tcp { instrument, .. } if *instrument != Instrument::Wire => {
                write!(out, "#{instrument}")
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_form_survives_printing_and_parsing() {
        for text in [
            "file:a/b.csv",
            "file:voltages.csv#train1,train2",
            "file:a#b.csv#",
            "twin",
            "twin:healing-square",
            "serial:COM3",
            "serial:/dev/ttyACM0@921600",
            "serial:2341:0043",
            "serial:2341:0043:A1B2@9600#lines",
            "tcp:skin.local:5025",
            "tcp:10.0.0.2:80#floats:208",
            "serial:COM3#lines:16",
            "serial:/dev/ttyACM0#sciospec",
            "tcp:[fe80::1]:80",
        ] {
            let selector: SourceSelector = text.parse().unwrap();
            assert_eq!(selector.to_string(), text);
        }
    }

    #[test]
    fn paths_with_colons_are_paths() {
        for text in ["C:\\run\\a.csv", "./12:30.csv", "runs/12:30.csv"] {
            assert!(matches!(text.parse(), Ok(SourceSelector::File(_))), "{text}");
        }
    }

    #[test]
    fn malformed_text_is_refused_with_the_expectation() {
        for (text, expected) in [
            ("", "a file path"),
            ("file:", "a file path"),
            ("usb:1", "file:PATH, twin[:NAME]"),
            ("serial:", "serial:PORT"),
            ("serial:COM3@fast", "serial:PORT@BAUD"),
            ("tcp:host:1#floats", "floats:CHANNELS"),
            ("serial:COM3#morse", "wire, lines"),
            ("tcp:host", "tcp:HOST:PORT"),
            ("tcp:host:0", "tcp:HOST:PORT"),
            ("tcp:host:99999", "tcp:HOST:PORT"),
            ("tcp:::1:80", "tcp:[::1]:5025"),
        ] {
            let message = text.parse::<SourceSelector>().unwrap_err().to_string();
            let named = text.rsplit('#').next().is_some_and(|part| message.contains(part));
            assert!(message.contains(expected) && named, "{text}: {message}");
        }
    }
}
