//! Recordings: writing, reading, playing them as a source or through a pipeline again, tables for other programs.

/// ```
/// use dermis::record::{LiveRecording, RecordingHead, SkinView};
/// use dermis::{Error, Session, Skin};
///
/// let file = std::env::temp_dir().join(format!("dermis-live-{}.mcap", std::process::id()));
/// let mut session = Session::open("twin", Skin::open("healing-square")?)?;
/// let prepared = session.pipeline().prepared();
/// let layout = dermis::source::Layout::Channels { count: prepared.channels() };
/// let head = RecordingHead::of(prepared, layout, "twin");
/// // A thread writes; the session waits for no disk.
/// let recording = LiveRecording::start(&file, &head, session.pipeline(), SkinView::IMAGES_PER_S)?;
/// session.next_borrowed()?;
/// let end = recording.finish();
/// assert_eq!((end.lost, end.error), (0, None));
/// # std::fs::remove_file(&file).map_err(|source| dermis::FileError { file, source })?;
/// # Ok::<(), Error>(())
/// ```
pub use dermis_record::LiveRecording;
/// No example here: [`Recording`](crate::Recording) and [`LiveRecording`] have one.
pub use dermis_record::{Recorder, RecordingEnd, RecordingSummary};
/// Shown with [`LiveRecording`].
pub use dermis_record::{RecordingHead, SkinView};

/// ```
/// use dermis::Recording;
/// use dermis::record::{Entry, Recorder, RecordingHead};
/// use dermis::source::Layout;
///
/// let file = std::env::temp_dir().join(format!("dermis-entries-{}.mcap", std::process::id()));
/// let head = RecordingHead::new("name = \"mine\"", Layout::Channels { count: 2 }, "my board");
/// let mut recorder = Recorder::create(&file, &head)?;
/// recorder.write_event(0, "note", "the cable was moved", &[])?;
/// recorder.finish(0)?;
///
/// let mut recording = Recording::open(&file)?;
/// let Some(Entry::Event { entry, .. }) = recording.next_entry()? else { panic!("an event") };
/// assert_eq!(entry.detail, "the cable was moved");
/// assert!(recording.damage().is_none());
/// # std::fs::remove_file(&file).map_err(|source| dermis::FileError { file, source })?;
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_record::Entry;
/// No example: fields of [`Entry`], and the result of [`Recording::damage`](crate::Recording::damage).
pub use dermis_record::{BaselineEntry, Damage as RecordingDamage, EventEntry, TouchEntry, TouchesEntry};

/// ```
/// use dermis::Recording;
/// use dermis::record::{
///     Recorder, RecordingHead, Replay, Table, TableFormat, export, is_recording, read_frames, recover,
/// };
/// use dermis::source::{Frame, HostStamp, Layout, Pacing, Repeat, Source};
///
/// let folder = std::env::temp_dir().join(format!("dermis-replay-{}", std::process::id()));
/// # let failed = |source| dermis::FileError { file: folder.clone(), source };
/// # std::fs::create_dir_all(&folder).map_err(failed)?;
/// let file = folder.join("press.mcap");
/// let layout = Layout::Channels { count: 2 };
/// let mut recorder = Recorder::create(&file, &RecordingHead::new("name = \"mine\"", layout, "my board"))?;
/// let mut frame = Frame::default();
/// for n in 0..3 {
///     frame.refill(n, HostStamp::now(), &[1.0, n as f64], &[]);
///     recorder.write_frame(&frame)?;
/// }
/// recorder.finish(0)?;
///
/// // As a table, like any other file of frames.
/// assert!(is_recording(&file));
/// let table = read_frames(&format!("{}#1..3", file.display()).parse()?, None)?;
/// assert_eq!(table.row(1), Some(&[1.0, 2.0][..]));
/// // As a source, like an instrument.
/// let replay = Replay::new(Recording::open(&file)?, Pacing::Immediate, Repeat::Once)?;
/// assert_eq!(replay.channels(), 2);
/// // As a file for other programs.
/// let csv = folder.join("press.csv");
/// let exported = export(&mut Recording::open(&file)?, Table::Frames, TableFormat::Csv, &csv)?;
/// assert_eq!(exported.rows, 3);
/// // A recording that was cut off becomes a complete one.
/// assert_eq!(recover(&file, &folder.join("again.mcap"))?.frames, 3);
/// # std::fs::remove_dir_all(&folder).map_err(failed)?;
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_record::Replay;
/// No example: as [`read_frames`], in a skin's order of channels.
pub use dermis_record::read_frames_of;
/// No example: results of [`export`](fn@export) and [`recover`](fn@recover).
pub use dermis_record::{Exported, Recovered};
/// Shown with [`Replay`].
pub use dermis_record::{Table, TableFormat, export, is_recording, read_frames, recover};

/// No example: [`rerun`] needs a recording of a skin; `dermis replay` is a program around it.
pub use dermis_record::{RerunOptions, RerunReport, rerun};
