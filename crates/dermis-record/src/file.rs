//! Destination of a recording's bytes: a file with a temporary name until it is complete, or a device under the given
//! name.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use dermis_device::{Place, partial_name};

use super::sync::Syncer;
use crate::Error;
use crate::sink::staged::StagedFile;

/// Interval for syncing written data to the disk, in addition to the time that the disk takes.
const SYNC_INTERVAL: Duration = Duration::from_secs(2);

/// A destination for bytes.
pub(super) trait Destination: Write + Send {
    /// Syncs everything to disk and gives the file its final name, unless that name is taken; then the partial name
    /// stays.
    fn complete(self: Box<Self>) -> io::Result<()>;

    /// Ends after an error: keeps complete data, followed by a note of the failure if there is room.
    fn abandon(self: Box<Self>, _note: &[u8]) {}
}

/// A file under its partial name, or the device at `path`.
pub(super) fn destination(path: &Path) -> Result<Box<dyn Destination>, Error> {
    if fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir()) {
        let file = OpenOptions::new().write(true).open(path).map_err(Error::io(path))?;
        return Ok(Box::new(Device(BufWriter::new(file))));
    }
    Ok(Box::new(PartialFile::create(path)?))
}

/// The destination of a recovered recording: a file that appears under its name only when complete. It doesn't use
/// the partial name, which the broken recording may still have.
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
    /// Bytes written, and the number of them that form complete chunks handed to the operating system.
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
        // The name, too, should survive a loss of power.
        crate::sink::sync_directory(&partial);
        Ok(Self { out: BufWriter::new(file), syncer, partial, place: Place::at(path), given: 0, whole: 0 })
    }
}

/// A destination that isn't a regular file, and so has no partial name.
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
        // Half a chunk is useless, and on a full disk removing it makes room for the note.
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
    fn an_abandoned_file_keeps_its_complete_part_and_the_reason() {
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
