//! Connections before they become pages. A client that doesn't send a whole request head in time is disconnected; if
//! all places are taken, the one that has been silent longest has to make room.

use std::collections::VecDeque;
use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::serve::Listener;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::oneshot;
use tokio::time::{Instant, Sleep, sleep};

/// End of a request head.
const HEAD_END: &[u8] = b"\r\n\r\n";
/// Start of the response after which a connection is a page's WebSocket.
const SWITCHED: &[u8] = b"HTTP/1.1 101";

/// A listener that limits the number and the idle time of its connections.
pub(super) struct Bounded {
    inner: TcpListener,
    most: usize,
    patience: Duration,
    open: Arc<AtomicUsize>,
    /// Connections in order of arrival.
    waiting: VecDeque<Waiting>,
}

/// A connection that may still owe a request head.
struct Waiting {
    /// True once a whole request has arrived.
    is_known: Arc<AtomicBool>,
    give_up: oneshot::Sender<()>,
}

impl Bounded {
    /// At most `most` connections, each with `patience` to send the head of a request.
    pub fn new(inner: TcpListener, most: usize, patience: Duration) -> Self {
        Self { inner, most: most.max(1), patience, open: Arc::default(), waiting: VecDeque::new() }
    }

    /// Makes room if all places are taken; returns false if no connection can be dropped.
    fn make_room(&mut self) -> bool {
        self.waiting.retain(|waiting| !waiting.give_up.is_closed());
        if self.open.load(Ordering::Relaxed) < self.most {
            return true;
        }
        let silent = self.waiting.iter().position(|waiting| !waiting.is_known.load(Ordering::Relaxed));
        let silent = silent.and_then(|index| self.waiting.remove(index));
        silent.is_some_and(|waiting| waiting.give_up.send(()).is_ok())
    }
}

impl Listener for Bounded {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Connection, SocketAddr) {
        loop {
            match self.inner.accept().await {
                // All places are held by pages, so drop the new connection.
                Ok(_) if !self.make_room() => {}
                Ok((stream, from)) => {
                    if let Err(error) = stream.set_nodelay(true) {
                        tracing::debug!("cannot set TCP_NODELAY on a connection: {error}");
                    }
                    let is_known = Arc::new(AtomicBool::new(false));
                    let (give_up, asked_to_go) = oneshot::channel();
                    self.waiting.push_back(Waiting { is_known: is_known.clone(), give_up });
                    self.open.fetch_add(1, Ordering::Relaxed);
                    let connection = Connection {
                        stream,
                        state: State::Head { seen: 0 },
                        until: Box::pin(sleep(self.patience)),
                        patience: self.patience,
                        asked_to_go: Some(asked_to_go),
                        is_known,
                        open: self.open.clone(),
                    };
                    return (connection, from);
                }
                // Out of descriptors, or the connection has gone already. Neither ends the server.
                Err(error) => {
                    tracing::debug!("a connection failed: {error}");
                    sleep(Duration::from_millis(50)).await;
                }
            }
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.inner.local_addr()
    }
}

/// State of a connection.
#[derive(Clone, Copy, PartialEq)]
enum State {
    /// Waiting for a request head; `seen` bytes of its end marker have arrived.
    Head { seen: usize },
    /// A head has arrived and is being answered.
    Answering,
    /// A page's WebSocket, which has its own rules.
    Socket,
}

/// A connection with a deadline for the head of every request.
pub(super) struct Connection {
    stream: TcpStream,
    state: State,
    until: Pin<Box<Sleep>>,
    patience: Duration,
    asked_to_go: Option<oneshot::Receiver<()>>,
    is_known: Arc<AtomicBool>,
    open: Arc<AtomicUsize>,
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.open.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Connection {
    fn expects_head(&mut self) {
        self.state = State::Head { seen: 0 };
        self.until.as_mut().reset(Instant::now() + self.patience);
    }

    /// True if the deadline has passed, or another connection needs the place.
    fn is_over(&mut self, context: &mut Context<'_>) -> bool {
        if !matches!(self.state, State::Head { .. }) {
            return false;
        }
        // After the listener has been dropped, the place is never asked for.
        if let Some(asked) = &mut self.asked_to_go
            && let Poll::Ready(asked) = Pin::new(asked).poll(context)
        {
            self.asked_to_go = None;
            if asked.is_ok() {
                return true;
            }
        }
        self.until.as_mut().poll(context).is_ready()
    }

    fn read(&mut self, bytes: &[u8]) {
        let State::Head { mut seen } = self.state else { return };
        for byte in bytes {
            seen = match (*byte == HEAD_END[seen], *byte) {
                (true, _) => seen + 1,
                (false, b'\r') => 1,
                _ => 0,
            };
            if seen == HEAD_END.len() {
                self.state = State::Answering;
                self.is_known.store(true, Ordering::Relaxed);
                return;
            }
        }
        self.state = State::Head { seen };
    }

    fn written(&mut self, bytes: &[u8]) {
        match self.state {
            State::Answering if bytes.starts_with(SWITCHED) => self.state = State::Socket,
            State::Answering | State::Head { .. } => self.expects_head(),
            State::Socket => {}
        }
    }
}

impl AsyncRead for Connection {
    fn poll_read(self: Pin<&mut Self>, context: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        if this.is_over(context) {
            return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
        }
        let before = buffer.filled().len();
        let outcome = Pin::new(&mut this.stream).poll_read(context, buffer);
        let bytes = buffer.filled()[before..].to_vec();
        this.read(&bytes);
        outcome
    }
}

impl AsyncWrite for Connection {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let this = self.get_mut();
        let outcome = Pin::new(&mut this.stream).poll_write(context, bytes);
        if let Poll::Ready(Ok(_)) = outcome {
            this.written(bytes);
        }
        outcome
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().stream).poll_flush(context)
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    use super::*;

    const LONG: Duration = Duration::from_secs(3600);
    const HEAD: &[u8] = b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n";

    fn run(test: impl Future<Output = ()>) {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        runtime.block_on(test);
    }

    async fn bounded(most: usize, patience: Duration) -> (Bounded, SocketAddr) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        (Bounded::new(listener, most, patience), address)
    }

    async fn pair(listener: &mut Bounded, address: SocketAddr) -> (TcpStream, Connection) {
        let (client, (server, _)) = tokio::join!(TcpStream::connect(address), listener.accept());
        (client.unwrap(), server)
    }

    async fn take_head(server: &mut Connection) {
        let mut buffer = vec![0; HEAD.len()];
        server.read_exact(&mut buffer).await.unwrap();
        assert_eq!(buffer, HEAD);
    }

    #[test]
    fn a_client_without_a_complete_header_in_time_is_disconnected() {
        run(async {
            for sent in [&b""[..], &HEAD[..1], &HEAD[..HEAD.len() - 1], b"\r\n\r\r\n\n"] {
                let (mut listener, address) = bounded(4, Duration::from_millis(20)).await;
                let (mut client, mut server) = pair(&mut listener, address).await;
                client.write_all(sent).await.unwrap();
                let mut buffer = Vec::new();
                let error = server.read_to_end(&mut buffer).await.unwrap_err();
                assert_eq!(error.kind(), io::ErrorKind::TimedOut, "after {sent:?}");
            }
        });
    }

    #[test]
    fn a_header_in_pieces_is_accepted_and_an_answer_restarts_the_deadline() {
        run(async {
            let (mut listener, address) = bounded(4, Duration::from_millis(300)).await;
            let (mut client, mut server) = pair(&mut listener, address).await;
            for byte in HEAD {
                client.write_all(&[*byte]).await.unwrap();
                client.flush().await.unwrap();
                assert_eq!(server.read_u8().await.unwrap(), *byte);
            }
            assert!(server.state == State::Answering && server.is_known.load(Ordering::Relaxed));
            server.write_all(b"HTTP/1.1 200 OK\r\n\r\n").await.unwrap();
            assert!(server.state == State::Head { seen: 0 });
            // The same connection, left open without a second request.
            assert_eq!(server.read_u8().await.unwrap_err().kind(), io::ErrorKind::TimedOut);
        });
    }

    #[test]
    fn a_pages_socket_has_no_deadline_here() {
        run(async {
            // Anything with a deadline would end at once.
            let (mut listener, address) = bounded(4, LONG).await;
            let (mut client, mut server) = pair(&mut listener, address).await;
            client.write_all(HEAD).await.unwrap();
            take_head(&mut server).await;
            server.write_all(b"HTTP/1.1 101 Switching Protocols\r\n\r\n").await.unwrap();
            assert!(server.state == State::Socket);
            server.until.as_mut().reset(Instant::now());
            client.write_all(b"x").await.unwrap();
            assert_eq!(server.read_u8().await.unwrap(), b'x');
        });
    }

    #[test]
    fn the_longest_silent_connection_is_dropped_if_all_slots_are_taken() {
        run(async {
            let (mut listener, address) = bounded(3, LONG).await;
            let (mut known, mut first) = pair(&mut listener, address).await;
            known.write_all(HEAD).await.unwrap();
            take_head(&mut first).await;
            let (_silent, mut second) = pair(&mut listener, address).await;
            let (_other, third) = pair(&mut listener, address).await;
            let (_new, fourth) = pair(&mut listener, address).await;
            assert_eq!(second.read_u8().await.unwrap_err().kind(), io::ErrorKind::TimedOut);
            assert!(first.state == State::Answering, "a page was asked to go");
            drop((third, fourth));
        });
    }

    #[test]
    fn a_new_page_is_refused_while_all_slots_are_taken_and_admitted_later() {
        run(async {
            let (mut listener, address) = bounded(2, LONG).await;
            let mut held = Vec::new();
            for _ in 0..2 {
                let (mut client, mut server) = pair(&mut listener, address).await;
                client.write_all(HEAD).await.unwrap();
                take_head(&mut server).await;
                held.push((client, server));
            }
            let accepting = tokio::spawn(async move {
                let accepted = listener.accept().await.0;
                (listener, accepted)
            });
            let mut refused = TcpStream::connect(address).await.unwrap();
            // Closed without an answer: end of stream, or a connection reset.
            assert!(!matches!(refused.read(&mut [0; 1]).await, Ok(count) if count > 0));
            held.pop();
            let _let_in = TcpStream::connect(address).await.unwrap();
            let (listener, _server) = accepting.await.unwrap();
            assert_eq!(listener.open.load(Ordering::Relaxed), 2);
        });
    }
}
