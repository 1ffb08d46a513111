//! The content behind one address of the server, and the receivers of its commands: a skin, or a body with all its
//! skins.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::body::Bytes;
use crossbeam_channel::Sender;
use dermis_page::protocol::{self, Encoded};
use dermis_page::{BodyScene, BodyState, Scene};
use tokio::sync::watch;

use super::hub::Hub;
use super::request::Request;

/// A running body as its page sees it. Called on the server's thread; nothing here may wait.
pub trait BodyFeed: Send + Sync {
    /// The state now, and the newest image of every patch that has one.
    fn now(&self) -> (BodyState, Vec<PatchImage>);

    /// Sets joints, radians or metres.
    ///
    /// # Errors
    /// A sentence for the page that states what was refused and why.
    fn set_joints(&self, values: &BTreeMap<String, f64>) -> Result<(), String>;
}

/// The newest image of a patch.
#[derive(Debug, Clone)]
pub struct PatchImage {
    /// Number of the patch.
    pub patch: usize,
    /// Counts the patch's images from 1.
    pub version: u64,
    /// The message of [`protocol::patch_image`].
    pub message: Bytes,
}

/// A skin behind a page.
#[derive(Debug, Clone)]
pub struct SkinPage {
    /// The place where its pipeline publishes.
    pub hub: Hub,
    /// Its scene.
    pub scene: Scene,
    /// Its pipeline's queue of commands.
    pub commands: Sender<Request>,
}

/// A body behind a page.
pub struct BodyPage {
    /// For notices.
    pub hub: Hub,
    /// Its scene.
    pub scene: BodyScene,
    /// Its state.
    pub feed: Arc<dyn BodyFeed>,
    /// Its patches by number; `None` for one that doesn't run.
    pub patches: Vec<Option<SkinPage>>,
    /// Meshes of its links, which the scene refers to as `mesh/NUMBER`.
    pub meshes: Vec<Bytes>,
}

/// One address with its WebSocket.
pub(super) struct Endpoint {
    pub(super) hub: Hub,
    pub(super) scene_json: String,
    pub(super) updates: watch::Sender<Option<Arc<Packet>>>,
    /// The skins that commands go to: one, or the body's patches by number.
    pub(super) skins: Vec<Option<SkinPage>>,
    /// The body, if it is one.
    pub(super) body: Option<Arc<dyn BodyFeed>>,
}

/// One update, encoded once for all pages.
#[derive(Debug)]
pub(super) struct Packet {
    /// Counts updates from 1. Pages acknowledge it; gaps show what a page has missed.
    pub(super) sequence: u64,
    /// Binary messages. A page gets those whose version differs from the last one sent to it in the same slot.
    pub(super) parts: Vec<Part>,
    /// The state, JSON; sent last.
    pub(super) state: String,
}

/// A binary message of an update.
#[derive(Debug)]
pub(super) struct Part {
    pub(super) slot: usize,
    pub(super) version: u64,
    pub(super) message: Bytes,
}

impl Endpoint {
    /// The page of a single skin, or of one patch.
    pub(super) fn of_skin(page: SkinPage) -> Self {
        Self {
            hub: page.hub.clone(),
            scene_json: protocol::scene(&page.scene),
            updates: watch::channel(None).0,
            skins: vec![Some(page)],
            body: None,
        }
    }

    /// The page of a body.
    pub(super) fn of_body(page: &BodyPage) -> Self {
        Self {
            hub: page.hub.clone(),
            scene_json: protocol::body_scene(&page.scene),
            updates: watch::channel(None).0,
            skins: page.patches.clone(),
            body: Some(page.feed.clone()),
        }
    }
}

impl Packet {
    pub(super) fn of_skin(encoded: Encoded) -> Self {
        let Encoded { sequence, image, channels, classes, state } = encoded;
        let messages = [image, channels].into_iter().chain(classes).enumerate();
        let parts = messages.map(|(slot, message)| Part { slot, version: sequence, message }).collect();
        Self { sequence, parts, state }
    }

    pub(super) fn of_body(sequence: u64, feed: &dyn BodyFeed) -> Self {
        let (state, images) = feed.now();
        let part = |PatchImage { patch, version, message }| Part { slot: patch, version, message };
        Self { sequence, parts: images.into_iter().map(part).collect(), state: protocol::body_state(sequence, &state) }
    }
}
