//! Connections whose timeouts depend on the device's actions and not on the machine's speed. A device counts as silent
//! only after the test stalls it, and no time passes for a dialogue.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use dermis_device::stream::{Connect, Dialogue, Inbox, Link};
use dermis_device::{HostStamp, Layout};

/// Signals between a test and a connection.
#[derive(Debug, Clone, Default)]
pub struct Events {
    connections: Arc<AtomicU64>,
    /// The stalled connection, counted from 1.
    stalled: Arc<AtomicU64>,
    processed: Arc<AtomicU64>,
}

impl Events {
    /// Makes the device count as silent on its current connection from now on. Earlier bytes still arrive.
    pub fn stall(&self) {
        self.stalled.store(self.connections.load(Ordering::SeqCst), Ordering::SeqCst);
    }

    /// Number of bytes that the host has read and processed, over all connections.
    #[allow(dead_code, reason = "not every test waits for them")]
    pub fn processed(&self) -> u64 {
        self.processed.load(Ordering::SeqCst)
    }
}

/// Wraps another kind of connection and reports these events.
pub struct EventConnect<C> {
    pub inner: C,
    pub events: Events,
}

impl<C: Connect> Connect for EventConnect<C> {
    fn connect(&mut self) -> io::Result<Box<dyn Link>> {
        let inner = self.inner.connect()?;
        let number = self.events.connections.fetch_add(1, Ordering::SeqCst) + 1;
        Ok(Box::new(EventLink { inner, events: self.events.clone(), number, read: 0 }))
    }

    fn name(&self) -> &str {
        self.inner.name()
    }
}

struct EventLink {
    inner: Box<dyn Link>,
    events: Events,
    number: u64,
    /// Number of bytes in the last read. The dialogue has processed them when the next read begins.
    read: u64,
}

impl Link for EventLink {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.events.processed.fetch_add(std::mem::take(&mut self.read), Ordering::SeqCst);
        loop {
            // Check before reading, so that bytes from before the stall are read first.
            let is_stalled = self.events.stalled.load(Ordering::SeqCst) == self.number;
            let count = self.inner.read(buffer)?;
            if count > 0 || is_stalled {
                self.read = count as u64;
                return Ok(count);
            }
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.inner.write(bytes)
    }
}

/// A dialogue for which no time passes: it neither repeats requests nor gives up.
pub struct Timeless<D>(pub D);

impl<D: Dialogue> Dialogue for Timeless<D> {
    fn open(&mut self, send: &mut Vec<u8>) {
        self.0.open(send);
    }

    fn receive(&mut self, bytes: &[u8], at: HostStamp, inbox: &mut Inbox, send: &mut Vec<u8>) -> Result<(), String> {
        self.0.receive(bytes, at, inbox, send)
    }

    fn tick(&mut self, _: Duration, send: &mut Vec<u8>) -> Result<(), String> {
        self.0.tick(Duration::ZERO, send)
    }

    fn close(&mut self, send: &mut Vec<u8>) {
        self.0.close(send);
    }

    fn layout(&self) -> Option<Layout> {
        self.0.layout()
    }

    fn identity(&self) -> Option<String> {
        self.0.identity()
    }
}
