//! The live page: a small web server that shows one skin in a browser and passes the user's actions to the pipeline.
//!
//! It knows nothing about pipelines. The pipeline fills an [`Update`] per frame and hands it to [`Hub::publish`],
//! which copies it and returns: a slow browser loses updates (which are counted), but the pipeline never waits.
//! Clicks come back as [`Request`]s on a bounded channel, each with a [`Reply`] that the page shows. The wire format
//! is described in `docs/src/page-protocol.md`.
//!
//! The server listens on loopback by default. Every request must name an allowed host, and a WebSocket must come from
//! the page's own origin, so that a site opened in the same browser can neither watch nor press. Any address beyond
//! loopback needs a [`Token`].
//!
//! ```no_run
//! use dermis_cli::page::{self, Hub, PageOptions, Scene, Update};
//!
//! let hub = Hub::new();
//! let (commands, requests) = crossbeam_channel::bounded(256);
//! let address = "127.0.0.1:0".parse().expect("an address");
//! let server = page::serve(address, PageOptions::default(), hub.clone(), Scene::default(), commands)?;
//! println!("page: {}", server.url());
//! hub.publish(&Update::default())?;
//! for request in requests.try_iter() {
//!     request.reply.refuse("nothing is connected");
//! }
//! # Ok::<(), dermis_cli::page::PageError>(())
//! ```

mod access;
mod assets;
mod client;
mod connections;
mod endpoint;
mod error;
mod hub;
mod request;
mod server;
mod shared;

pub use access::Token;
pub use dermis_page::message::{HubStats, Level};
pub use dermis_page::protocol::PROTOCOL_VERSION;
pub use dermis_page::{
    BaselineRow, ChannelValues, ClassImage, Command, Counter, DamageRow, DamageView, ElectrodeView, FaultView,
    FrameFaultView, GridView, HealthView, Image, OtherPlaceView, PipelineState, Press, PressLimits, ProposalView,
    Scene, SourceState, StageLatency, TareState, TouchPhase, TouchView, Update, UpdateError,
};
pub use endpoint::{BodyFeed, BodyPage, PatchImage, SkinPage};
pub use error::PageError;
pub use hub::Hub;
pub use request::{Reply, Request, coalesced};
pub use server::{Binding, ServerHandle, serve};
pub use shared::PageOptions;
