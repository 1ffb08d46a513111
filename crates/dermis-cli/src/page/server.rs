//! The server's own thread: a handful of embedded files, one WebSocket per page, and access control for both. A body
//! has a page at `/`, and each of its patches one at `/patch/NAME/`.

use std::collections::BTreeMap;
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, UdpSocket};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::{Path, Request as HttpRequest, State, WebSocketUpgrade};
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use crossbeam_channel::Sender;
use dermis_page::protocol::Encoded;
use dermis_page::{Scene, Update};
use tokio::runtime::{Builder, Runtime};
use tokio::sync::{Semaphore, watch};
use tokio::time::{Instant, MissedTickBehavior, interval, sleep_until};

use super::PageError;
use super::access::{Access, Token, bracketed};
use super::assets::{self, Asset};
use super::client;
use super::connections::Bounded;
use super::endpoint::{BodyFeed, BodyPage, Endpoint, Packet, SkinPage};
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

const BINARY: [(header::HeaderName, &str); 1] = [(header::CONTENT_TYPE, "application/octet-stream")];
/// Interval between updates of a body's page: 30 per second.
const BODY_PERIOD: Duration = Duration::from_millis(33);
/// Time for pages to be closed properly.
const CLOSING_TIME: Duration = Duration::from_millis(500);

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

/// Serves the page of a skin at `address` (port 0 for any free one) until the handle is dropped. Returns once it
/// listens.
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
    let root = Endpoint::of_skin(SkinPage { hub, scene, commands });
    Binding::new(address, options)?.serve(Site { root: Arc::new(root), patches: BTreeMap::new(), meshes: Vec::new() })
}

/// An open port on which nothing is served yet.
#[derive(Debug)]
pub struct Binding {
    address: SocketAddr,
    options: PageOptions,
    access: Access,
    listener: TcpListener,
}

impl Binding {
    /// Listens at `address` (port 0 for any free one).
    ///
    /// # Errors
    /// As [`serve`].
    pub fn new(address: SocketAddr, options: PageOptions) -> Result<Self, PageError> {
        // Checked before the port is opened, and again below with the actual port.
        Access::new(address, options.token.clone(), &options.allowed_hosts)?;
        let listener = bind(address)?;
        let address = listener.local_addr().map_err(|source| PageError::Start { source })?;
        let access = Access::new(address, options.token.clone(), &options.allowed_hosts)?;
        Ok(Self { address, options, access, listener })
    }

    /// Serves the page of a body, and below it the pages of its patches, until the handle is dropped.
    ///
    /// # Errors
    /// [`PageError::Start`] if no thread could start.
    pub fn serve_body(self, page: BodyPage) -> Result<ServerHandle, PageError> {
        let root = Arc::new(Endpoint::of_body(&page));
        let meshes = page.meshes;
        let named = page.scene.patches.into_iter().zip(page.patches);
        let patches = named.filter_map(|(patch, skin)| Some((patch.name, Arc::new(Endpoint::of_skin(skin?)))));
        let patches = patches.collect();
        self.serve(Site { root, patches, meshes })
    }

    fn serve(self, site: Site) -> Result<ServerHandle, PageError> {
        let start = |source| PageError::Start { source };
        let Self { address, options, access, listener } = self;
        let (stop, stopped) = watch::channel(false);
        let farewell = Arc::new(OnceLock::new());
        let shared = Shared {
            access,
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
            .spawn(move || run(&runtime, listener, Arc::new(shared), site))
            .map_err(start)?;
        Ok(ServerHandle { address, token, stop, farewell, thread: Some(thread) })
    }
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

fn run(runtime: &Runtime, listener: TcpListener, shared: Arc<Shared>, site: Site) {
    let served = runtime.block_on(async {
        for endpoint in site.patches.values().chain([&site.root]) {
            match endpoint.body.clone() {
                Some(feed) => tokio::spawn(encode_body(endpoint.clone(), feed)),
                None => tokio::spawn(encode(shared.clone(), endpoint.clone())),
            };
        }
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
            served = axum::serve(listener, router(shared.clone(), site)).with_graceful_shutdown(stopped) => served,
            () = deadline => Ok(()),
        };
        // Pages are separate tasks, no longer connections of the server. Each frees its place after closing.
        let places = u32::try_from(shared.options.most_clients).unwrap_or(u32::MAX);
        let _ = tokio::time::timeout(CLOSING_TIME, shared.places.acquire_many(places)).await;
        served
    });
    if let Err(error) = served {
        tracing::error!("the page's server stopped: {error}");
    }
}

/// Takes the latest update, encodes it once for all pages, and paces them.
async fn encode(shared: Arc<Shared>, endpoint: Arc<Endpoint>) {
    let pause = Duration::from_secs(1) / shared.options.most_updates_per_s.max(1);
    let mut front = Update::default();
    let mut sequence = 0;
    loop {
        endpoint.hub.inner.published.notified().await;
        let next = Instant::now() + pause;
        if endpoint.updates.receiver_count() > 0 && endpoint.hub.take(&mut front) {
            sequence += 1;
            let packet = Packet::of_skin(Encoded::new(sequence, &front));
            endpoint.updates.send_replace(Some(Arc::new(packet)));
        }
        sleep_until(next).await;
    }
}

/// Reads the body's state once per interval while a page is open, and encodes it once for all pages.
async fn encode_body(endpoint: Arc<Endpoint>, feed: Arc<dyn BodyFeed>) {
    let mut ticks = interval(BODY_PERIOD);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut sequence = 0;
    loop {
        ticks.tick().await;
        if endpoint.updates.receiver_count() > 0 {
            sequence += 1;
            endpoint.hub.inner.counts.published.fetch_add(1, Ordering::Relaxed);
            endpoint.updates.send_replace(Some(Arc::new(Packet::of_body(sequence, feed.as_ref()))));
        }
    }
}

/// The addresses of the server: `/`, and `/patch/NAME/` for each patch of a body.
struct Site {
    root: Arc<Endpoint>,
    patches: BTreeMap<String, Arc<Endpoint>>,
    meshes: Vec<Bytes>,
}

fn router(shared: Arc<Shared>, site: Site) -> Router {
    let Site { root, patches, meshes } = site;
    let own = if root.body.is_some() { &assets::BODY } else { &assets::SKIN };
    let patches = Arc::new(patches);
    let mut router = Router::new();
    for asset in own {
        router = router.route(&format!("/{}", asset.name), get(move || async move { file(asset) }));
    }
    let at_root = shared.clone();
    router = router.route("/ws", get(move |socket| upgrade(at_root, Some(root), socket)));
    for (number, mesh) in meshes.into_iter().enumerate() {
        router = router.route(&format!("/mesh/{number}"), get(move || async move { (BINARY, mesh) }));
    }
    if !patches.is_empty() {
        for asset in &assets::SKIN {
            let known = patches.clone();
            let answer = move |Path(name): Path<String>| async move {
                if known.contains_key(&name) { file(asset).into_response() } else { not_found().into_response() }
            };
            router = router.route(&format!("/patch/{{name}}/{}", asset.name), get(answer));
        }
        let at_patch = shared.clone();
        let answer = move |Path(name): Path<String>, socket| upgrade(at_patch, patches.get(&name).cloned(), socket);
        router = router.route("/patch/{name}/ws", get(answer));
    }
    router
        .fallback(|| async { not_found() })
        .layer(middleware::from_fn_with_state(shared.clone(), guard))
        .with_state(shared)
}

fn file(asset: &'static Asset) -> impl IntoResponse {
    ([(header::CONTENT_TYPE, asset.kind)], asset.bytes)
}

fn not_found() -> impl IntoResponse {
    (StatusCode::NOT_FOUND, "Not found.\n")
}

/// Rejects unauthorised requests, and adds the headers to every response.
async fn guard(State(shared): State<Arc<Shared>>, request: HttpRequest<Body>, next: Next) -> Response {
    let origin_required = request.uri().path().ends_with("/ws");
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

async fn upgrade(shared: Arc<Shared>, endpoint: Option<Arc<Endpoint>>, socket: WebSocketUpgrade) -> Response {
    let Some(endpoint) = endpoint else { return not_found().into_response() };
    let bytes = shared.options.most_message_bytes;
    socket
        .max_message_size(bytes)
        .max_frame_size(bytes)
        .on_upgrade(move |socket| async move { client::serve(socket, &shared, &endpoint).await })
}
