//! Errors of serving the page.

use std::io;
use std::net::SocketAddr;

use dermis_page::UpdateError;

/// An error while serving the page or showing an update.
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
        /// The requested address.
        address: SocketAddr,
    },
    /// The address could not be bound for another reason.
    #[error("cannot listen on {address}: {source}; expected an address of this machine and a port this user may open")]
    Bind {
        /// The requested address.
        address: SocketAddr,
        /// Error from the operating system.
        source: io::Error,
    },
    /// The page needs a token beyond loopback.
    #[error(
        "address {address} can be reached from other machines and no token was given; expected a token, or a loopback address"
    )]
    TokenMissing {
        /// The requested address.
        address: SocketAddr,
    },
    /// The token is too easy to guess, or doesn't fit into an address.
    #[error("token of {length} characters; expected at least {least}, of letters, digits, '-' and '_'")]
    TokenUnfit {
        /// Its length in characters.
        length: usize,
        /// Minimum length in characters.
        least: usize,
    },
    /// The operating system gave no random bytes for a token.
    #[error("the system gave no random bytes for a token: {reason}")]
    Random {
        /// Error from the operating system.
        reason: String,
    },
    /// An allowed host is not a host name.
    #[error("allowed host {host:?}; expected a name or address without scheme, port or path, such as lab-pc.local")]
    HostUnfit {
        /// The given text.
        host: String,
    },
    /// The server's thread or runtime could not start.
    #[error("cannot start the page's server: {source}")]
    Start {
        /// Error from the operating system.
        source: io::Error,
    },
    /// The update contradicts itself.
    #[error(transparent)]
    Update(#[from] UpdateError),
}
