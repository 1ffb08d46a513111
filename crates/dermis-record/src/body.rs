//! One recording of a whole body: the channels of every patch, and the joint values.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Arc, Mutex};

use super::file::destination;
use super::head::{RecordingHead, record};
use super::shared_file::{SharedFile, lock, mcap_error, new_writer};
use super::writer::{Recorder, add_channel};
use super::{messages, schema};
use crate::Error;

/// Names of the metadata records at a body's beginning and end.
const BODY: &str = "dermis.body";
const BODY_FINISHED: &str = "dermis.body_finished";

/// Description of a body at the start of its recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BodyHead {
    /// Name of the body.
    pub name: String,
    /// The body file's text.
    pub toml: String,
    /// The URDF file's text, if there is one.
    pub urdf: Option<String>,
}

/// A recording of a body being written. The file is complete once it and the recorders of all patches have finished.
pub struct BodyRecording {
    file: Arc<Mutex<SharedFile>>,
    joints: u16,
    patches: BTreeSet<String>,
    bytes: Vec<u8>,
}

impl std::fmt::Debug for BodyRecording {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("BodyRecording").field("patches", &self.patches).finish_non_exhaustive()
    }
}

impl BodyRecording {
    /// Starts a recording, like [`Recorder::create`].
    ///
    /// # Errors
    /// As for [`Recorder::create`].
    pub fn create(path: &Path, head: &BodyHead) -> Result<Self, Error> {
        let failed = |error| mcap_error(path, error);
        let mut writer = new_writer(destination(path)?).map_err(failed)?;
        let entries =
            [("name", head.name.clone()), ("toml", head.toml.clone()), ("urdf", head.urdf.clone().unwrap_or_default())];
        writer.write_metadata(&record(BODY, entries)).map_err(failed)?;
        let joints = add_channel(&mut writer, &schema::JOINTS, None).map_err(failed)?;
        let file = Arc::new(Mutex::new(SharedFile::new(path.to_owned(), writer)));
        Ok(Self { file, joints, patches: BTreeSet::new(), bytes: Vec::new() })
    }

    /// Makes a recorder for one patch.
    ///
    /// # Errors
    /// A name that is taken or contains a slash; otherwise as for [`Recorder::create`].
    pub fn patch(&mut self, name: &str, head: &RecordingHead) -> Result<Recorder, Error> {
        if name.is_empty() || name.contains('/') || !self.patches.insert(name.to_owned()) {
            return Err(Error::Live(dermis_live::Error::Frames {
                what: "patch to record".to_owned(),
                expected: "a name without a slash that no other patch has".to_owned(),
                got: format!("{name:?}"),
            }));
        }
        Recorder::of_patch(self.file.clone(), name, head)
    }

    /// Writes joint values, radians or metres, as a `sensor_msgs/JointState`.
    ///
    /// # Errors
    /// An I/O error.
    pub fn write_joints<'a>(
        &mut self,
        wall_ns: u64,
        joints: impl ExactSizeIterator<Item = (&'a str, f64)>,
    ) -> Result<(), Error> {
        messages::write_joints(&mut self.bytes, wall_ns, joints);
        lock(&self.file).write(self.joints, wall_ns, &self.bytes).map(|_| ())
    }

    /// Ends the recording of the body itself.
    ///
    /// # Errors
    /// An I/O error.
    pub fn finish(self) -> Result<(), Error> {
        let mut file = lock(&self.file);
        let finished = file.finish(&record(BODY_FINISHED, [("patches", self.patches.len().to_string())]))?;
        finished.map_or(Ok(()), |out| out.complete().map_err(Error::io(file.name())))
    }
}

#[cfg(test)]
mod tests {
    use dermis_device::{Frame, HostStamp, Layout};

    use super::*;
    use crate::Recording;

    fn frame(sequence: u64, values: &[f64]) -> Frame {
        let mut frame = Frame::default();
        frame.refill(sequence, HostStamp { monotonic_ns: sequence, wall_ns: 1_000 + sequence }, values, &[]);
        frame
    }

    #[test]
    fn every_patch_of_a_body_opens_as_a_recording_of_its_own() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("arm.mcap");
        let head = BodyHead { name: "arm".into(), toml: "urdf = \"arm.urdf\"\n".into(), urdf: Some("<robot/>".into()) };
        let mut body = BodyRecording::create(&path, &head).unwrap();
        let of = |count| RecordingHead::new(format!("name = \"skin-{count}\""), Layout::Channels { count }, "twin");
        let mut palm = body.patch("palm", &of(2)).unwrap();
        let mut back = body.patch("back", &of(3)).unwrap();
        assert!(body.patch("palm", &of(2)).unwrap_err().to_string().contains("no other patch"));
        for n in 0..5 {
            palm.write_frame(&frame(n, &[1.0, n as f64])).unwrap();
            if n < 3 {
                back.write_frame(&frame(10 + n, &[2.0, 3.0, n as f64])).unwrap();
            }
            body.write_joints(1_000 + n, [("elbow", 0.1 * n as f64), ("wrist", 0.0)].into_iter()).unwrap();
        }
        palm.write_event(2_000, "fell", "on the palm", &[1.0]).unwrap();
        // The file is complete only after the last writer has finished.
        back.finish(1).unwrap();
        body.finish().unwrap();
        assert!(!path.exists());
        palm.finish(0).unwrap();

        let read = |patch: &str| {
            let mut recording = Recording::open(&path.join(patch)).unwrap();
            let frames: Vec<Frame> = recording.frames().collect::<Result<_, _>>().unwrap();
            assert!(recording.damage().is_none(), "{patch}: {}", recording.damage());
            (recording, frames)
        };
        let (palm, frames) = read("palm");
        assert_eq!((palm.skin_toml(), frames.len(), palm.frames_dropped()), ("name = \"skin-2\"", 5, Some(0)));
        assert_eq!(frames[4].values, [1.0, 4.0]);
        let counts = palm.counts();
        assert_eq!((counts["/dermis/events"], counts["/dermis/back/frames"], counts["/joint_states"]), (1, 3, 5));
        let (back, frames) = read("back");
        assert_eq!((frames[2].sequence, back.frames_written(), back.frames_dropped()), (12, Some(3), Some(1)));

        let table =
            crate::read_frames(&format!("{}#1..3", path.join("palm").display()).parse().unwrap(), None).unwrap();
        assert_eq!(table.row(1), Some(&[1.0, 2.0][..]));
        let error = Recording::open(&path).unwrap_err().to_string();
        assert!(error.contains("expected a patch of it, FILE/PATCH: back, palm"), "{error}");
        let error = Recording::open(&path.join("knee")).unwrap_err().to_string();
        assert!(error.contains("patch \"knee\": expected a patch of the recording: back, palm"), "{error}");
    }

    #[test]
    fn a_patch_that_is_dropped_leaves_the_file_partial_and_readable() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("arm.mcap");
        let head = BodyHead { name: "arm".into(), toml: String::new(), urdf: None };
        let mut body = BodyRecording::create(&path, &head).unwrap();
        let of = RecordingHead::new("name = \"a\"", Layout::Channels { count: 1 }, "twin");
        let (mut one, other) = (body.patch("one", &of).unwrap(), body.patch("other", &of).unwrap());
        one.write_frame(&frame(1, &[0.5])).unwrap();
        drop(other);
        one.finish(0).unwrap();
        body.finish().unwrap();
        assert!(!path.exists());
        let mut found = Recording::open(&folder.path().join("arm.partial.mcap/one")).unwrap();
        assert_eq!((found.frames().count(), found.frames_dropped()), (1, Some(0)));
    }
}
