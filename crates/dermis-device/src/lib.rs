//! Frames from instruments and files.
//!
//! A [`Source`] delivers [`Frame`]s one at a time, whatever its origin. A [`FrameTable`] is a finite recording that
//! one of the [`instruments`] has read from a file. The crate knows how instruments write numbers and in which order
//! ([`Layout`]); it knows no forward model and no images.
//!
//! [`open_stream`] opens a live instrument as a [`stream::StreamSource`].
//!
//! ```
//! use dermis_device::{Format, Frame, Pacing, Playback, Repeat, Source, SourceEvent, SourceSelector, decode};
//! use std::time::Duration;
//!
//! // Three frames of two channels, as any spreadsheet writes them.
//! let text = b"time_s,left,right\n0.00,1.0,2.0\n0.02,1.1,2.0\n0.04,,2.1\n";
//! let table = decode(Format::Csv, text, "frames.csv".as_ref())?;
//! assert_eq!((table.frames(), table.channels()), (3, 2));
//! assert!(table.row(2).is_some_and(|row| row[0].is_nan()), "an empty cell is a missing reading");
//!
//! // The same as a source, as an instrument would be.
//! let (mut source, mut frame) = (Playback::new(table, Pacing::Immediate, Repeat::Once)?, Frame::default());
//! assert_eq!(source.next_frame(&mut frame, Duration::ZERO)?, SourceEvent::Frame);
//! assert_eq!(frame.values, [1.0, 2.0]);
//!
//! // How users name one.
//! assert!("serial:/dev/ttyACM0@115200#lines".parse::<SourceSelector>().is_ok());
//! # Ok::<(), dermis_device::DeviceError>(())
//! ```
//!
//! | | |
//! |---|---|
//! | [`Source`], [`Frame`], [`acquire`] | frames one after the other; a thread that reads them into a queue |
//! | [`FrameTable`], [`read`], [`ReadOptions`], [`FileSpec`] | finite recordings; reading files; `frames.csv#0..60` |
//! | [`instruments`] | formats of files and streams, one module each |
//! | [`SourceSelector`], [`open_stream`], [`open_wire`], [`stream`] | live instruments by name, ports, sockets |
//! | [`RealTime`] | priority of the threads between an instrument and its touches |
//! | [`Playback`], [`write_atomic`] | tables played as sources; files written atomically |
//!
//! Decoders take bytes and return values, so they can be tested without a file system. Only [`read`] takes bytes from
//! disk, and only [`stream`] takes them from ports and sockets.

// Readers of tables share helpers that only some formats need.
#![cfg_attr(not(all(feature = "excel", feature = "parquet")), allow(dead_code, unused_imports))]

pub mod acquire;
mod atomic;
mod error;
mod format;
mod frame;
pub mod instruments;
mod open;
mod place;
mod playback;
mod read_options;
mod real_time;
mod select;
mod selector;
mod source;
pub mod stream;
mod table;

pub use atomic::write_atomic;
pub use dermis_wire::Status;
pub use error::DeviceError;
pub use format::Format;
pub use frame::{Frame, HostStamp};
pub use instruments::mend_times;
pub use instruments::{decode, decode_with, open_regular, read};
pub use open::{open_sciospec, open_stream, open_stream_greeted, open_wire};
pub use place::{Place, partial_name, remember, rename_new};
pub use playback::{Pacing, Playback, Repeat};
pub use read_options::{Frequencies, ReadOptions};
pub use real_time::{RealTime, leave_real_time};
pub use select::{FileSpec, FrameItem, FrameSelect};
pub use selector::{Instrument, SerialName, SourceSelector};
pub use source::{Counters, Source, SourceEvent};
pub use table::{FrameTable, Layout};
