//! What can go wrong between asking for the page and having it.

use std::io;
use std::net::SocketAddr;

use dermis_page::UpdateError;

/// Why the page could not be served, or an update not shown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PageError {
    /// Another program listens on the port.
    #[error(
        "port {} on {} is in use; expected a free port: stop the other program, pass another --port, or --port 0 for any free one",
        address.port(),
        address.ip()
    )]
    PortInUse {
        /// The address asked for.
        address: SocketAddr,
    },
    /// The address could not be listened on for another reason.
    #[error("cannot listen on {address}: {source}; expected an address of this machine and a port this user may open")]
    Bind {
        /// The address asked for.
        address: SocketAddr,
        /// What the system said.
        source: io::Error,
    },
    /// Beyond loopback the page needs a token.
    #[error(
        "address {address} can be reached from other machines and no token was given; expected a token, or a loopback address"
    )]
    TokenMissing {
        /// The address asked for.
        address: SocketAddr,
    },
    /// The token could be guessed or does not fit into an address.
    #[error("token of {length} characters; expected at least {least}, of letters, digits, '-' and '_'")]
    TokenUnfit {
        /// Characters given.
        length: usize,
        /// Fewest characters accepted.
        least: usize,
    },
    /// The system gave no random bytes for a token.
    #[error("the system gave no random bytes for a token: {reason}")]
    Random {
        /// What the system said.
        reason: String,
    },
    /// An allowed host is not a host name.
    #[error("allowed host {host:?}; expected a name or address without scheme, port or path, such as lab-pc.local")]
    HostUnfit {
        /// The text given.
        host: String,
    },
    /// The server's thread or its runtime could not be started.
    #[error("cannot start the page's server: {source}")]
    Start {
        /// What the system said.
        source: io::Error,
    },
    /// An update that contradicts itself.
    #[error(transparent)]
    Update(#[from] UpdateError),
}
