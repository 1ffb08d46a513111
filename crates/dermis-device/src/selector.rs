//! The text by which a user names a source: `file:run.csv`, `twin:healing-square`, `serial:/dev/ttyUSB0@115200`,
//! `tcp:192.168.1.20:5025`, or simply a path.

use std::fmt;
use std::str::FromStr;

use crate::{DeviceError, FileSpec};

/// A source as the user named it; opening it is the business of whoever has the transport.
///
/// ```
/// use dermis_device::SourceSelector;
///
/// let tcp: SourceSelector = "tcp:192.168.1.20:5025".parse()?;
/// assert_eq!(tcp, SourceSelector::Tcp { host: "192.168.1.20".into(), port: 5025 });
///
/// let serial: SourceSelector = "serial:/dev/ttyUSB0@115200".parse()?;
/// assert_eq!(serial, SourceSelector::Serial { port: "/dev/ttyUSB0".into(), baud: Some(115_200) });
///
/// // A bare path is a file; text after '#' chooses frames of it.
/// let file: SourceSelector = "runs/voltages.csv#ref".parse()?;
/// assert_eq!(file, "file:runs/voltages.csv#ref".parse()?);
///
/// let error = "udp:host:1".parse::<SourceSelector>().unwrap_err();
/// assert!(error.to_string().starts_with("'udp:host:1': expected file:PATH, twin[:NAME]"));
/// # Ok::<(), dermis_device::DeviceError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SourceSelector {
    /// A recording, `file:PATH` or a bare path.
    File(FileSpec),
    /// A digital twin, `twin` or `twin:NAME`; without a name, that of the skin at hand.
    Twin {
        /// Name of the skin.
        name: Option<String>,
    },
    /// A serial port, `serial:PORT` or `serial:PORT@BAUD`.
    Serial {
        /// The port's device name.
        port: String,
        /// Bits per second, where the instrument does not fix them.
        baud: Option<u32>,
    },
    /// A TCP server, `tcp:HOST:PORT`; an IPv6 host stands in brackets.
    Tcp {
        /// Host name or address, without brackets.
        host: String,
        /// Port number.
        port: u16,
    },
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

/// A word of several letters before the first colon is meant as a scheme; one letter is a Windows drive, and anything
/// with other characters belongs to a path.
fn is_unknown_scheme(scheme: &str) -> bool {
    scheme.is_empty() || (scheme.len() > 1 && scheme.bytes().all(|byte| byte.is_ascii_alphanumeric()))
}

fn parse_serial(text: &str, rest: &str) -> Result<SourceSelector, DeviceError> {
    let expected = "serial:PORT or serial:PORT@BAUD, as in serial:/dev/ttyUSB0@115200";
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
    Ok(SourceSelector::Serial { port: port.to_owned(), baud })
}

fn parse_tcp(text: &str, rest: &str) -> Result<SourceSelector, DeviceError> {
    let error = || DeviceError::selector(text, "tcp:HOST:PORT, as in tcp:192.168.1.20:5025 or tcp:[::1]:5025");
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
    Ok(SourceSelector::Tcp { host: host.to_owned(), port })
}

impl fmt::Display for SourceSelector {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(spec) => write!(out, "file:{spec}"),
            Self::Twin { name: None } => write!(out, "twin"),
            Self::Twin { name: Some(name) } => write!(out, "twin:{name}"),
            Self::Serial { port, baud: None } => write!(out, "serial:{port}"),
            Self::Serial { port, baud: Some(baud) } => write!(out, "serial:{port}@{baud}"),
            Self::Tcp { host, port } if host.contains(':') => write!(out, "tcp:[{host}]:{port}"),
            Self::Tcp { host, port } => write!(out, "tcp:{host}:{port}"),
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
            "tcp:skin.local:5025",
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
    fn malformed_text_says_what_was_expected() {
        for (text, expected) in [
            ("", "a file path"),
            ("file:", "a file path"),
            ("usb:1", "file:PATH, twin[:NAME]"),
            ("serial:", "serial:PORT"),
            ("serial:COM3@fast", "serial:PORT@BAUD"),
            ("tcp:host", "tcp:HOST:PORT"),
            ("tcp:host:0", "tcp:HOST:PORT"),
            ("tcp:host:99999", "tcp:HOST:PORT"),
            ("tcp:::1:80", "tcp:[::1]:5025"),
        ] {
            let message = text.parse::<SourceSelector>().unwrap_err().to_string();
            assert!(message.contains(expected) && message.contains(text), "{text}: {message}");
        }
    }
}
