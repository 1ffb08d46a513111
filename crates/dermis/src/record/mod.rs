//! Recordings: raw frames before any processing, together with the skin, baselines, touches and events, in one MCAP file
//! (<https://mcap.dev/spec>) that general viewers open, and the same frames back as a [`dermis_device::Source`].
//!
//! # Channels
//! | topic | schema, encoding | what |
//! |---|---|---|
//! | `/dermis/frames` | `dermis.Frame`, Protocol Buffers | every raw frame |
//! | `/dermis/baselines` | `dermis.Baseline`, Protocol Buffers | every baseline at start-up, tare or by hand, with its reason |
//! | `/dermis/touches` | `dermis.Touches`, JSON | touches by frame, as [`crate::sink::JsonLines`] writes them |
//! | `/dermis/events` | `dermis.Event`, JSON | anything else worth keeping: a tare refused, a channel lost |
//!
//! Log times are the host's wall clock. Frames are Protocol Buffers because the schema then travels with the file and
//! viewers plot any channel without a plug-in, while packed doubles are the readings' own bits: 8 bytes a reading, exact
//! to the payload of a NaN. In `dermis.Frame` (proto2): `fixed64 sequence = 1`, `fixed64 device_time_ns = 2` (absent
//! where the device has no clock), `fixed64 host_monotonic_ns = 3`, `fixed64 host_wall_ns = 4`, packed `double values =
//! 5`, packed `double imaginary = 6`. In `dermis.Baseline`: `fixed64 time_ns = 1`, `fixed64 frames = 2`, `string origin =
//! 3`, `string reason = 4`, packed `double values = 5`.
//!
//! Metadata records: `dermis.recording` (format version, channel layout and labels as JSON, source, software),
//! `dermis.skin` (the skin file, key `toml`; also attached as `skin.toml`), and at the end `dermis.finished` (frames
//! written and dropped).
//!
//! # What survives
//! While it is being made, a recording `press.mcap` is called `press.partial.mcap`; it gets its name when it is whole and
//! on disk. Twice a second everything is handed to the operating system as a complete chunk with a checksum, so a partial
//! recording whose writer was killed lacks at most about the last second; it opens like any other, and
//! [`Recording::damage`] says what is missing. Neither name is ever overwritten.

mod head;
mod queue;
mod reader;
mod replay;
mod scan;
mod schema;
mod wire;
mod writer;

pub use head::RecordingHead;
pub use queue::{RecorderHandle, RecorderStatus};
pub use reader::{Damage, Entry, LostFrames, Recording};
pub use replay::Replay;
pub use wire::BaselineEntry;
pub use writer::{Recorder, RecordingSummary};
