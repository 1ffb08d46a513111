//! Verdicts of guards on a local socket, one line of JSON per frame, for a machine that must stop.
//!
//! A reader gets a greeting and then lines. Without frames, the last verdict is repeated as a heartbeat, and becomes
//! `stale` when its frame is too old. A reader must stop unless its last line says `ok` and is younger than that line's
//! `valid_ms`, so the machine also stops if this process ends, hangs or is suspended. No part of this is safety-rated,
//! and every line says so.
//!
//! Nothing here waits for a reader: a line that does not fit into a reader's buffer is skipped for it, and a reader
//! that stays behind for a second is disconnected.

mod address;
mod board;
mod reader;
mod server;

pub use address::{GuardAddress, GuardAddressError};
pub use server::{GuardPublisher, GuardSocket};
