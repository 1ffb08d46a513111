//! The server's own thread: a handful of embedded files, one WebSocket per page, and access control for both.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, UdpSocket};
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, OnceLock};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::{Request as HttpRequest, State, WebSocketUpgrade};
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use crossbeam_channel::Sender;
use dermis_page::protocol::{self, Encoded};
use dermis_page::{Scene, Update};
use tokio::runtime::{Builder, Runtime};
use tokio::sync::{Semaphore, watch};
use tokio::time::{Instant, sleep_until};

use super::PageError;
use super::access::{Access, Token, bracketed};
use super::client;
use super::connections::Bounded;
use super::hub::Hub;
use super::request::Request;
use super::shared::{PageOptions, Shared};

/// A running server. Dropping it stops it.
#[derive(Debug)]
pub struct ServerHandle {
    address: SocketAddr,
    token: Option<Token>,
    stop: watch::Sender<bool>,
    farewell: Arc<OnceLock<&'static str>>,
    thread: Option<JoinHandle<()>>,
}

/// Time for pages to be closed properly.
const CLOSING_TIME: Duration = Duration::from_millis(500);

struct Asset {
    path: &'static str,
    kind: &'static str,
    bytes: &'static [u8],
}

const ASSETS: [Asset; 4] = [
    Asset { path: "/", kind: "text/html; charset=utf-8", bytes: include_bytes!("../../assets/index.html") },
    Asset { path: "/page.js", kind: "text/javascript; charset=utf-8", bytes: include_bytes!("../../assets/page.js") },
    Asset { path: "/page.css", kind: "text/css; charset=utf-8", bytes: include_bytes!("../../assets/page.css") },
    Asset { path: "/icon.svg", kind: "image/svg+xml", bytes: include_bytes!("../../assets/icon.svg") },
];

/// Headers of every response: load nothing from elsewhere, forbid framing, cache nothing.
const HEADERS: [(header::HeaderName, &str); 7] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::X_FRAME_OPTIONS, "DENY"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::CACHE_CONTROL, "no-store"),
    (header::HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    (header::HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
];

/// Serves the page at `address` (port 0 for any free one) until the handle is dropped. Returns once it listens.
///
/// # Errors
/// [`PageError::PortInUse`] or [`PageError::Bind`] if the address is not available, [`PageError::TokenMissing`]
/// beyond loopback without a token, [`PageError::HostUnfit`] for a malformed host, [`PageError::Start`] if no thread
/// could start.
pub fn serve(
    address: SocketAddr,
    options: PageOptions,
    hub: Hub,
    scene: Scene,
    commands: Sender<Request>,
) -> Result<ServerHandle, PageError> {
    // Checked before the port is opened, and again below with the actual port.
    Access::new(address, options.token.clone(), &options.allowed_hosts)?;
    let listener = bind(address)?;
    let start = |source| PageError::Start { source };
    let address = listener.local_addr().map_err(start)?;
    let (stop, stopped) = watch::channel(false);
    let farewell = Arc::new(OnceLock::new());
    let shared = Shared {
        access: Access::new(address, options.token.clone(), &options.allowed_hosts)?,
        hub,
        scene_json: protocol::scene(&scene),
        scene,
        commands,
        updates: watch::channel(None).0,
        stop: stopped,
        farewell: farewell.clone(),
        places: Semaphore::new(options.most_clients),
        next_client: AtomicU64::new(1),
        options,
    };
    let token = shared.options.token.clone();
    let runtime = Builder::new_multi_thread()
        .worker_threads(1)
        .thread_name("page-worker")
        .enable_io()
        .enable_time()
        .build()
        .map_err(start)?;
    let thread = thread::Builder::new()
        .name("page".into())
        .spawn(move || run(&runtime, listener, Arc::new(shared)))
        .map_err(start)?;
    Ok(ServerHandle { address, token, stop, farewell, thread: Some(thread) })
}

impl ServerHandle {
    /// The address it listens on, with the actual port.
    pub fn local_addr(&self) -> SocketAddr {
        self.address
    }

    /// Address to open in a browser, including the token. A server on all addresses gives its network address, which
    /// works on this machine and from a phone.
    pub fn url(&self) -> String {
        let ip = self.address.ip();
        let host = if ip.is_unspecified() { bracketed(network_address()) } else { bracketed(ip) };
        let query = self.token.as_ref().map(|token| format!("?token={}", token.as_str())).unwrap_or_default();
        format!("http://{host}:{}/{query}", self.address.port())
    }

    /// Closes every page and the port, and waits until that is done.
    pub fn shutdown(mut self) {
        self.stop_and_join();
    }

    /// Like `shutdown`, and tells pages the reason.
    pub fn shutdown_because(self, reason: &'static str) {
        // This is the only place that sets a reason, and it consumes the handle, so it cannot be set already.
        let _ = self.farewell.set(reason);
        self.shutdown();
    }

    fn stop_and_join(&mut self) {
        self.stop.send_replace(true);
        if let Some(thread) = self.thread.take() {
            // If the thread panicked, that has been printed, and there is nothing left to stop.
            let _ = thread.join();
        }
    }
}

/// This machine's address on its network: the source address of outgoing packets. Nothing is sent. Without a network
/// it is the loopback address.
fn network_address() -> IpAddr {
    // An address reserved for documentation (RFC 5737) is routed like any remote one.
    let far_away = SocketAddr::from(([192, 0, 2, 1], 9));
    let own = || {
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        socket.connect(far_away)?;
        socket.local_addr()
    };
    own().map_or(Ipv4Addr::LOCALHOST.into(), |address| address.ip())
}

impl Drop for ServerHandle {
    fn drop(&mut self) {
        self.stop_and_join();
    }
}

fn bind(address: SocketAddr) -> Result<TcpListener, PageError> {
    let bind_error = |source: io::Error| match source.kind() {
        io::ErrorKind::AddrInUse => PageError::PortInUse { address },
        _ => PageError::Bind { address, source },
    };
    let listener = TcpListener::bind(address).map_err(bind_error)?;
    listener.set_nonblocking(true).map_err(bind_error)?;
    Ok(listener)
}

fn run(runtime: &Runtime, listener: TcpListener, shared: Arc<Shared>) {
    let served = runtime.block_on(async {
        tokio::spawn(encode(shared.clone()));
        let (mut stop, mut stop_again) = (shared.stop.clone(), shared.stop.clone());
        // Without Nagle's delay: otherwise an update's second message would wait up to 40 ms for the first to be
        // acknowledged.
        let listener = tokio::net::TcpListener::from_std(listener)?;
        let PageOptions { most_connections, head_patience, .. } = shared.options;
        let listener = Bounded::new(listener, most_connections, head_patience);
        // Idle connections must not keep the process alive: cut what is still open shortly after the stop.
        let deadline = async move {
            client::stopped(&mut stop_again).await;
            tokio::time::sleep(CLOSING_TIME).await;
        };
        let stopped = async move { client::stopped(&mut stop).await };
        let served = tokio::select! {
            served = axum::serve(listener, router(shared.clone())).with_graceful_shutdown(stopped) => served,
            () = deadline => Ok(()),
        };
        // Pages are separate tasks, no longer connections of the server. Each frees its place once it has been told.
        let places = u32::try_from(shared.options.most_clients).unwrap_or(u32::MAX);
        let _ = tokio::time::timeout(CLOSING_TIME, shared.places.acquire_many(places)).await;
        served
    });
    if let Err(error) = served {
        tracing::error!("the page's server stopped: {error}");
    }
}

/// Takes the latest update, encodes it once for all pages, and paces them.
async fn encode(shared: Arc<Shared>) {
    let pause = Duration::from_secs(1) / shared.options.most_updates_per_s.max(1);
    let mut front = Update::default();
    let mut sequence = 0;
    loop {
        shared.hub.inner.published.notified().await;
        let next = Instant::now() + pause;
        if shared.updates.receiver_count() > 0 && shared.hub.take(&mut front) {
            sequence += 1;
            shared.updates.send_replace(Some(Arc::new(Encoded::new(sequence, &front))));
        }
        sleep_until(next).await;
    }
}

fn router(shared: Arc<Shared>) -> Router {
    let mut router = Router::new().route("/ws", get(upgrade));
    for asset in &ASSETS {
        router =
            router.route(asset.path, get(move || async move { ([(header::CONTENT_TYPE, asset.kind)], asset.bytes) }));
    }
    router
        .fallback(|| async { (StatusCode::NOT_FOUND, "Not found.\n") })
        .layer(middleware::from_fn_with_state(shared.clone(), guard))
        .with_state(shared)
}

/// Rejects unauthorised requests, and adds the headers to every response.
async fn guard(State(shared): State<Arc<Shared>>, request: HttpRequest<Body>, next: Next) -> Response {
    let origin_required = request.uri().path() == "/ws";
    let cookie = shared.access.cookie(request.uri());
    let mut response = match shared.access.check(request.headers(), request.uri(), origin_required) {
        Err(denial) => (denial.status(), denial.explanation()).into_response(),
        Ok(()) => {
            let mut response = next.run(request).await;
            if let Some(Ok(cookie)) = cookie.map(|cookie| HeaderValue::from_str(&cookie)) {
                response.headers_mut().insert(header::SET_COOKIE, cookie);
            }
            response
        }
    };
    for (name, value) in HEADERS {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

async fn upgrade(State(shared): State<Arc<Shared>>, socket: WebSocketUpgrade) -> Response {
    let bytes = shared.options.most_message_bytes;
    socket
        .max_message_size(bytes)
        .max_frame_size(bytes)
        .on_upgrade(move |socket| async move { client::serve(socket, &shared).await })
}
