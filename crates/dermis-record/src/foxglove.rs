//! A live server for Foxglove and other viewers that speak its WebSocket protocol (`foxglove.sdk.v1`).
//!
//! Topics that recordings also have use the same names, schemas and messages here. In addition there are:
//!
//! | topic | type | content |
//! |---|---|---|
//! | `/dermis/scene` | `foxglove.SceneUpdate` | touches as discs with one-sigma ellipses, force arrows and labels |
//! | `/dermis/transforms` | `foxglove.FrameTransforms` | link to patch; on a body all links |
//! | `/dermis/log` | `foxglove.Log` | events and baselines in words |
//!
//! On a body each patch has its own topics, `/dermis/PATCH/scene`, except for the last two. Log times are the wall
//! clock at the frame's first byte.
//!
//! # Losses
//! Every patch has a queue and a thread in front of the server, so nothing here delays the pipeline. Frames that don't
//! fit are counted ([`LiveFeed::status`](crate::LiveFeed::status)). Behind that, each client has a queue of
//! [`CLIENT_QUEUE`] messages. A client that doesn't keep up loses the oldest, and sees gaps in the frame numbers.

mod address;
mod channels;
mod parameters;
mod publisher;
mod scene;
mod server;
mod tare;
mod transforms;

pub use address::{FoxgloveAddress, FoxgloveAddressError};
pub use server::{CLIENT_QUEUE, FoxglovePatch, FoxgloveServer};
pub use transforms::FramePose;

/// The layout for Foxglove that shows a single skin: its file, JSON.
pub const LAYOUT: &str = include_str!("../foxglove/layout.json");

#[cfg(test)]
mod tests;
