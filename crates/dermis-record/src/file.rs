//! Where a recording's bytes go: a file that has another name until it is whole, or a device that stands under the name.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::sync::Syncer;
use crate::Error;
use crate::sink::staged::StagedFile;

/// What the operating system has been given is on the disk itself after this, and the time that the disk takes for it.
const SYNC_INTERVAL: Duration = Duration::from_secs(2);

/// Where the bytes go.
pub(super) trait Destination: Write + Send {
    /// Makes everything durable and gives it its final name.
    fn complete(self: Box<Self>) -> io::Result<()>;
}

/// A file under its partial name, or the device that stands at `path`.
pub(super) fn destination(path: &Path) -> Result<Box<dyn Destination>, Error> {
    if fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir()) {
        let file = OpenOptions::new().write(true).open(path).map_err(Error::io(path))?;
        return Ok(Box::new(Device(BufWriter::new(file))));
    }
    Ok(Box::new(PartialFile::create(path)?))
}

/// What a recording is recovered into: a file that appears under its name when it is whole and otherwise not at all, for
/// the partial name may be that of the broken recording.
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
    target: PathBuf,
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
        Ok(Self { out: BufWriter::new(file), syncer, partial, target: path.to_owned() })
    }
}

/// `a/press.mcap` becomes `a/press.partial.mcap`.
fn partial_name(path: &Path) -> Option<PathBuf> {
    let mut name = OsString::from(path.file_stem()?);
    name.push(".partial");
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    Some(path.with_file_name(name))
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
        self.out.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()?;
        self.syncer.written()
    }
}

impl Destination for PartialFile {
    fn complete(mut self: Box<Self>) -> io::Result<()> {
        self.out.flush()?;
        self.out.get_ref().sync_all()?;
        fs::rename(&self.partial, &self.target)?;
        crate::sink::sync_directory(&self.target);
        Ok(())
    }
}
