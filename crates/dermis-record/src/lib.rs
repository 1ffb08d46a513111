//! Recordings: raw frames before any processing, together with the skin, calibrations, baselines, touches and events,
//! in one MCAP file (<https://mcap.dev/spec>, profile `ros2`) that general viewers can open. The same frames are
//! available again as a [`dermis_device::Source`].
//!
//! ```
//! use dermis_device::{Frame, HostStamp, Layout};
//! use dermis_record::{Recorder, Recording, RecordingHead, read_frames};
//!
//! let folder = tempfile::tempdir()?;
//! let file = folder.path().join("press.mcap");
//! let head = RecordingHead::new("name = \"mine\"", Layout::Channels { count: 2 }, "my board");
//! let mut recorder = Recorder::create(&file, &head)?;
//! let mut frame = Frame::default();
//! for n in 0..3 {
//!     frame.refill(n, HostStamp::now(), &[1.0, n as f64], &[]);
//!     recorder.write_frame(&frame)?;
//! }
//! recorder.finish(0)?; // No frame was dropped on the way.
//!
//! let mut recording = Recording::open(&file)?;
//! assert_eq!(recording.frames().count(), 3);
//! // Or as a table, like any other file of frames.
//! let table = read_frames(&format!("{}#1..3", file.display()).parse()?, None)?;
//! assert_eq!(table.row(1), Some(&[1.0, 2.0][..]));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | | |
//! |---|---|
//! | [`Recorder`], [`LiveRecording`], [`LiveFeed`] | writing, by hand or from a running pipeline |
//! | [`Recording`], [`read_frames`], [`read_frames_of`], [`Replay`], [`rerun`] | reading: directly, as a table, as a source, through a pipeline again |
//! | [`export`](fn@export), [`sink`] | tables for other programs; JSON lines, images, touches |
//! | [`recover`](fn@recover) | a complete recording from a broken one |
//! | [`guard_socket`] | a guard's verdicts as lines on a socket |
//! | `foxglove` | a live server for Foxglove, with the feature of this name |
//! | [`Publisher`], `ros2` | a running patch for other programs, live |
//!
//! # Channels
//! All messages are CDR, and the file contains their definitions (`ros2msg`).
//!
//! | topic | type | content |
//! |---|---|---|
//! | `/dermis/frames` | `dermis_msgs/msg/Frame` | every raw frame, queued before it is processed |
//! | `/dermis/baselines` | `dermis_msgs/msg/Baseline` | every baseline with its values, noise and reason |
//! | `/dermis/touches` | `dermis_msgs/msg/Touches` | touches of frames that have any, or in which one ended |
//! | `/dermis/events` | `dermis_msgs/msg/Event` | commands, gaps, faults, verdicts of the guard |
//! | `/dermis/image` | `sensor_msgs/msg/Image` | the image (32FC1), at a limited rate |
//! | `/dermis/points` | `sensor_msgs/msg/PointCloud2` | the image on the skin's surface, with its value in the field `pressure` |
//! | `/dermis/touch_points` | `sensor_msgs/msg/PointCloud2` | touches in space |
//!
//! A recording of a body ([`BodyRecording`]) has each patch's topics below the patch's name, `/dermis/PATCH/frames`,
//! its metadata as `dermis.skin/PATCH`, and `/joint_states`. It opens like a folder: `arm.mcap/PATCH` is a
//! recording of that patch alone, and can be used anywhere a recording is read.
//!
//! The last three topics exist if a [`SkinView`] was given. Log times are the host's wall clock. Readings take 8
//! bytes each and are exact, including the payload of a NaN.
//!
//! Metadata records: `dermis.recording` (format version, channel layout and labels as JSON, source, software),
//! `dermis.skin` (the skin file, key `toml`), `dermis.calibration` (the calibrations, keys `image` and `forces`), all
//! attached as files too, and at the end `dermis.finished` (frames written and dropped).
//!
//! # Interrupted recordings
//! While in progress, a recording `press.mcap` is called `press.partial.mcap`; it gets its name when it is complete
//! and on disk. Twice a second everything is handed to the operating system as a complete chunk with a checksum, so
//! if the writer is killed, the partial recording lacks about the last second at most. It opens like any other, and
//! [`Recording::damage`] reports what is missing. Neither name is ever overwritten. A device at the path (a pipe, a
//! terminal) is written to directly.

mod bag;
mod body;
mod cdr;
mod error;
mod events;
mod export;
mod file;
#[cfg(feature = "foxglove")]
pub mod foxglove;
mod frames;
pub mod guard_socket;
mod head;
mod live;
mod live_feed;
mod live_request;
mod live_writer;
mod messages;
mod publisher;
mod queue;
mod reader;
mod recover;
mod replay;
mod rerun;
#[cfg(feature = "ros2")]
pub mod ros2;
mod scan;
mod schema;
mod shared_file;
pub mod sink;
mod sync;
mod view;
mod writer;

pub use body::{BodyHead, BodyRecording};
pub use error::Error;
pub use export::{Exported, Table, TableFormat, export, export_frames};
pub use frames::{UNDERSTOOD, check_skin, is_recording, read_frames, read_frames_of};
pub use head::RecordingHead;
pub use live::{LiveRecording, RecordingEnd};
pub use live_feed::LiveFeed;
pub use live_request::{LiveCommand, LiveRequest};
pub use messages::{BaselineEntry, EventEntry, OtherPlaceEntry, TouchEntry, TouchesEntry};
pub use publisher::{ForceAndTorque, Publisher};
pub use queue::{RecorderHandle, RecorderStatus, RecordingStop};
pub use reader::{Damage, Entry, LostFrames, Recording};
pub use recover::{Recovered, recover};
pub use replay::Replay;
pub use rerun::{RerunOptions, RerunReport, rerun};
pub use view::SkinView;
pub use writer::{Recorder, RecordingSummary};
