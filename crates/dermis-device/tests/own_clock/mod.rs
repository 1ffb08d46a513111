//! Connections whose time limits hang on what the device does and not on the speed of the machine: a device counts as
//! silent only after the test has said that it stalls, and for a dialogue no time passes.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use dermis_device::stream::{Connect, Dialogue, Inbox, Link};
use dermis_device::{HostStamp, Layout};

/// What a test tells a connection, and learns of it.
#[derive(Debug, Clone, Default)]
pub struct Events {
    connections: Arc<AtomicU64>,
    /// The connection that stalls, counted from 1.
    stalled: Arc<AtomicU64>,
    processed: Arc<AtomicU64>,
}

impl Events {
    /// From now on the device counts as silent on the connection that it has now. What it wrote before still arrives.
    pub fn stall(&self) {
        self.stalled.store(self.connections.load(Ordering::SeqCst), Ordering::SeqCst);
    }

    /// Bytes that the host has read and made frames of, over all connections.
    #[allow(dead_code, reason = "not every test waits for them")]
    pub fn processed(&self) -> u64 {
        self.processed.load(Ordering::SeqCst)
    }
}

/// Connections by another, with these events.
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
    /// Bytes of the last read, which the dialogue has taken when the next one is asked for.
    read: u64,
}

impl Link for EventLink {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.events.processed.fetch_add(std::mem::take(&mut self.read), Ordering::SeqCst);
        loop {
            // Looked at before reading: what was written before the stall is read first.
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

/// A dialogue for which no time passes: it neither asks again nor gives up.
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
