//! Serves a twin over the real wire protocol, on a socket or a pseudo-terminal. It answers and streams like an
//! instrument with firmware, so that the whole path from port to picture can be tried without hardware. It takes up
//! to eight hosts at a time and disconnects silent ones. Frames that a slow host doesn't accept are skipped, which
//! shows in its sequence numbers.

mod background;
mod commands;
mod listener;
mod server;

pub use background::Background;
pub use commands::{WORDS, command_of};
pub use listener::Door;
pub use server::{Served, device_info, serve};
