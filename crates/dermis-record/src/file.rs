//! Where a recording's bytes go: a file that has another name until it is whole, or a device that stands under the
//! name.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use dermis_device::{Place, partial_name};

use super::sync::Syncer;
use crate::Error;
use crate::sink::staged::StagedFile;

/// What the operating system has been given is on the disk itself after this, and the time that the disk takes for it.
const SYNC_INTERVAL: Duration = Duration::from_secs(2);

/// Where the bytes go.
pub(super) trait Destination: Write + Send {
    /// Makes everything durable and gives it its final name, unless another file has it; then the partial one stays.
    fn complete(self: Box<Self>) -> io::Result<()>;

    /// Ends after an error: what was handed out whole stays, with a note of what happened behind it where there is
    /// room.
    fn abandon(self: Box<Self>, _note: &[u8]) {}
}

/// A file under its partial name, or the device that stands at `path`.
pub(super) fn destination(path: &Path) -> Result<Box<dyn Destination>, Error> {
    if fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir()) {
        let file = OpenOptions::new().write(true).open(path).map_err(Error::io(path))?;
        return Ok(Box::new(Device(BufWriter::new(file))));
    }
    Ok(Box::new(PartialFile::create(path)?))
}

/// What a recording is recovered into: a file that appears under its name when it is whole and otherwise not at all,
/// for the partial name may be that of the broken recording.
pub(super) fn whole_file(path: &Path) -> Result<Box<dyn Destination>, Error> {
    refuse_existing(path)?;
    Ok(Box::new(StagedFile::create(path)?))
}

fn refuse_existing(path: &Path) -> Result<(), Error> {
    if !path.exists() {
        return Ok(());
    }
    let reason = io::Error::new(io::ErrorKind::AlreadyExists, "exists, and recordings are never overwritten");
    Err(Error::io(path)(reason))
}

impl Destination for StagedFile {
    fn complete(mut self: Box<Self>) -> io::Result<()> {
        self.settle()
    }
}

/// A file under its partial name.
struct PartialFile {
    out: BufWriter<File>,
    syncer: Syncer,
    partial: PathBuf,
    place: Place,
    /// Bytes given out, and those of them that came to the system whole.
    given: u64,
    whole: u64,
}

impl PartialFile {
    fn create(path: &Path) -> Result<Self, Error> {
        let partial = partial_name(path).ok_or_else(|| Error::io(path)(io::ErrorKind::IsADirectory.into()))?;
        refuse_existing(path)?;
        let file = OpenOptions::new().write(true).create_new(true).open(&partial).map_err(Error::io(&partial))?;
        let handle = file.try_clone().map_err(Error::io(&partial))?;
        let syncer = Syncer::spawn(SYNC_INTERVAL, move || handle.sync_data()).map_err(Error::io(&partial))?;
        // The name, too, shall be there after a loss of power.
        crate::sink::sync_directory(&partial);
        Ok(Self { out: BufWriter::new(file), syncer, partial, place: Place::at(path), given: 0, whole: 0 })
    }
}

/// What is no regular file and has no other name meanwhile.
struct Device(BufWriter<File>);

impl Write for Device {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl Destination for Device {
    fn complete(mut self: Box<Self>) -> io::Result<()> {
        self.0.flush()
    }
}

impl Write for PartialFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.out.write(bytes)?;
        self.given += count as u64;
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()?;
        self.whole = self.given;
        self.syncer.written()
    }
}

impl Destination for PartialFile {
    fn abandon(self: Box<Self>, note: &[u8]) {
        // Half a chunk is of no use to anyone, and on a full disk it makes room for the note.
        let (mut file, _) = self.out.into_parts();
        let noted = file
            .set_len(self.whole)
            .and_then(|()| file.seek(SeekFrom::Start(self.whole)))
            .and_then(|_| file.write_all(note))
            .and_then(|()| file.sync_data());
        if let Err(error) = noted {
            tracing::debug!("{}: no note of the failure: {error}", self.partial.display());
        }
    }

    fn complete(mut self: Box<Self>) -> io::Result<()> {
        self.out.flush()?;
        self.out.get_ref().sync_all()?;
        self.place.put(&self.partial)?;
        crate::sink::sync_directory(self.place.path());
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_abandoned_file_keeps_what_was_whole_and_says_why() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("press.mcap");
        let mut file = Box::new(PartialFile::create(&path).unwrap());
        file.write_all(b"whole").unwrap();
        file.flush().unwrap();
        file.write_all(b"torn").unwrap();
        file.abandon(b"+note");
        assert_eq!(fs::read(folder.path().join("press.partial.mcap")).unwrap(), b"whole+note");
        assert!(!path.exists());
    }

    #[test]
    fn a_recording_that_finds_its_name_taken_stays_under_the_partial_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("press.mcap");
        let mut file = Box::new(PartialFile::create(&path).unwrap());
        file.write_all(b"ours").unwrap();
        fs::write(&path, "another's").unwrap();
        let error = Destination::complete(file).unwrap_err();
        assert!(error.to_string().contains("press.partial.mcap"), "{error}");
        assert_eq!(fs::read(&path).unwrap(), b"another's");
        assert_eq!(fs::read(folder.path().join("press.partial.mcap")).unwrap(), b"ours");
    }
}
