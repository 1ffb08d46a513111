//! Frames from instruments and files.
//!
//! A [`Source`] hands out [`Frame`]s one at a time, whatever is behind it; a [`FrameTable`] is a finite recording read
//! from a file by one of the [`instruments`]. The crate knows how instruments write numbers down and in which order
//! ([`Layout`]); it knows no forward model and no images.
//!
//! Live instruments are behind a [`stream::StreamSource`], opened by [`open_stream`].
//!
//! Decoders take bytes and return values, so they can be tested without a file system; [`read`] is the one place where
//! bytes come from disk, and [`stream`] the one where they come from ports and sockets.

pub mod acquire;
mod atomic;
mod error;
mod frame;
pub mod instruments;
mod open;
mod playback;
mod select;
mod selector;
mod source;
pub mod stream;
mod table;

pub use atomic::write_atomic;
pub use dermis_wire::Status;
pub use error::DeviceError;
pub use frame::{Frame, HostStamp};
pub use instruments::{Format, decode, read};
pub use open::{open_stream, open_wire};
pub use playback::{Pacing, Playback, Repeat};
pub use select::{FileSpec, FrameItem, FrameSelect};
pub use selector::{Instrument, SerialName, SourceSelector};
pub use source::{Counters, Source, SourceEvent};
pub use table::{FrameTable, Layout};
