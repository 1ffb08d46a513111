//! A twin behind the real wire: on a socket or a pseudo-terminal it answers and streams as an instrument with firmware
//! does, so that everything between port and picture is tried without hardware. Up to eight hosts at a time, one that
//! says nothing is sent away; frames that a slow host does not take are skipped and show in its sequence numbers.

mod background;
mod commands;
mod listener;
mod server;

pub use background::Background;
pub use commands::{WORDS, command_of};
pub use listener::Door;
pub use server::{Served, device_info, serve};
