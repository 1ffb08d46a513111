//! State shared by all requests to the server.

use std::sync::atomic::AtomicU64;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use tokio::sync::{Semaphore, watch};

use super::access::{Access, Token};

/// Options for serving the page.
#[derive(Debug, Clone)]
pub struct PageOptions {
    /// Secret that pages must present; required beyond loopback.
    pub token: Option<Token>,
    /// Additional host names by which the server is reached, without port.
    pub allowed_hosts: Vec<String>,
    /// Maximum number of pages connected at once; any further page is refused with a message.
    pub most_clients: usize,
    /// Maximum number of open connections, including pages. Above that, connections that have sent nothing yet are cut
    /// off.
    pub most_connections: usize,
    /// Time allowed for the head of a request.
    pub head_patience: Duration,
    /// Longest message accepted from a page.
    pub most_message_bytes: usize,
    /// Messages per second accepted from a page, on average and in a burst.
    pub most_messages_per_s: u32,
    /// Maximum number of updates per second sent to a page; updates in between are merged.
    pub most_updates_per_s: u32,
}

impl Default for PageOptions {
    fn default() -> Self {
        Self {
            token: None,
            allowed_hosts: Vec::new(),
            most_clients: 8,
            most_connections: 64,
            head_patience: Duration::from_secs(10),
            most_message_bytes: 16 * 1024,
            most_messages_per_s: 1000,
            most_updates_per_s: 100,
        }
    }
}

/// State seen by every request.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) access: Access,
    pub(super) options: PageOptions,
    pub(super) stop: watch::Receiver<bool>,
    /// Reason for stopping, as told to pages.
    pub(super) farewell: Arc<OnceLock<&'static str>>,
    pub(super) places: Semaphore,
    pub(super) next_client: AtomicU64,
}
