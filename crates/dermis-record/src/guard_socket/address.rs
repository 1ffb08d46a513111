//! Addresses of a guard's socket.

use std::fmt;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::str::FromStr;

/// Address of a guard's socket: `tcp://127.0.0.1:PORT`, `tcp://[::1]:PORT`, `tcp://localhost:PORT` or
/// `unix://PATH`. Lines carry times of this machine's monotonic clock and are not encrypted, so other machines are
/// refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum GuardAddress {
    /// A port on loopback; 0 takes a free one.
    Tcp(SocketAddr),
    /// A Unix socket at this path.
    Unix(PathBuf),
}

/// An address that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("\"{}\": expected tcp://127.0.0.1:PORT, tcp://[::1]:PORT, tcp://localhost:PORT or unix://PATH", .0.escape_debug())]
pub struct GuardAddressError(String);

impl FromStr for GuardAddress {
    type Err = GuardAddressError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let refused = || GuardAddressError(text.to_owned());
        if let Some(path) = text.strip_prefix("unix://").filter(|path| cfg!(unix) && !path.is_empty()) {
            return Ok(Self::Unix(PathBuf::from(path)));
        }
        let place = text.strip_prefix("tcp://").ok_or_else(refused)?;
        let address = match place.strip_prefix("localhost:") {
            Some(port) => port.parse().ok().map(|port| SocketAddr::from((Ipv4Addr::LOCALHOST, port))),
            None => place.parse().ok(),
        };
        address.filter(|address| address.ip().is_loopback()).map(Self::Tcp).ok_or_else(refused)
    }
}

impl fmt::Display for GuardAddress {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(address) => write!(out, "tcp://{address}"),
            Self::Unix(path) => write!(out, "unix://{}", path.display()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn local_addresses_are_accepted_and_others_refused() {
        for text in ["tcp://127.0.0.1:7879", "tcp://[::1]:0"] {
            assert_eq!(text.parse::<GuardAddress>().unwrap().to_string(), text);
        }
        assert_eq!("tcp://localhost:80".parse::<GuardAddress>().unwrap().to_string(), "tcp://127.0.0.1:80");
        #[cfg(unix)]
        assert_eq!("unix:///run/a".parse(), Ok(GuardAddress::Unix(PathBuf::from("/run/a"))));
        for text in
            ["", "7879", "tcp://0.0.0.0:1", "tcp://10.0.0.5:1", "tcp://127.0.0.1", "tcp://127.0.0.1:x", "unix://"]
        {
            let message = text.parse::<GuardAddress>().unwrap_err().to_string();
            assert!(message.starts_with(&format!("\"{text}\": expected tcp://127.0.0.1:PORT")), "{message}");
        }
    }
}
