//! Addresses of the server.

use std::fmt;
use std::net::IpAddr;
use std::str::FromStr;

/// Address that the server listens on: `HOST:PORT`, where the host is a name, an IPv4 address or an IPv6 address in
/// brackets. Port 0 takes a free one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoxgloveAddress {
    host: String,
    port: u16,
}

/// An address that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("\"{}\": expected HOST:PORT, such as 127.0.0.1:8765 or [::1]:0", .0.escape_debug())]
pub struct FoxgloveAddressError(String);

impl FoxgloveAddress {
    /// The address that Foxglove suggests, on this machine only.
    pub const DEFAULT: &str = "127.0.0.1:8765";

    /// The host, with brackets if it is an IPv6 address.
    pub fn host(&self) -> &str {
        &self.host
    }

    /// The port.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// True if only this machine can connect.
    pub fn is_loopback(&self) -> bool {
        let bare = self.host.trim_start_matches('[').trim_end_matches(']');
        self.host == "localhost" || bare.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
    }

    /// The same host with another port.
    pub(super) fn with_port(&self, port: u16) -> Self {
        Self { host: self.host.clone(), port }
    }
}

impl FromStr for FoxgloveAddress {
    type Err = FoxgloveAddressError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let refused = || FoxgloveAddressError(text.to_owned());
        let (host, port) = text.rsplit_once(':').ok_or_else(refused)?;
        let is_v6 = host
            .strip_prefix('[')
            .and_then(|rest| rest.strip_suffix(']'))
            .is_some_and(|bare| bare.parse::<IpAddr>().is_ok_and(|ip| ip.is_ipv6()));
        let is_name = !host.is_empty() && host.chars().all(|c| c.is_ascii_alphanumeric() || ".-_".contains(c));
        let port = port.parse().ok().filter(|_| is_v6 || is_name).ok_or_else(refused)?;
        Ok(Self { host: host.to_owned(), port })
    }
}

impl fmt::Display for FoxgloveAddress {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}:{}", self.host, self.port)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_parsed_and_remote_ones_recognised() {
        let of = |text: &str| text.parse::<FoxgloveAddress>().unwrap();
        for (text, is_loopback) in [
            (FoxgloveAddress::DEFAULT, true),
            ("localhost:0", true),
            ("[::1]:8765", true),
            ("127.9.9.9:1", true),
            ("0.0.0.0:8765", false),
            ("[::]:8765", false),
            ("robot.local:8765", false),
        ] {
            assert_eq!((of(text).to_string().as_str(), of(text).is_loopback()), (text, is_loopback));
        }
        for text in
            ["", "8765", "127.0.0.1", ":8765", "::1:8765", "127.0.0.1:x", "127.0.0.1:65536", "ws://a:1", "a b:1"]
        {
            let message = text.parse::<FoxgloveAddress>().unwrap_err().to_string();
            assert!(message.starts_with(&format!("\"{text}\": expected HOST:PORT")), "{message}");
        }
    }
}
