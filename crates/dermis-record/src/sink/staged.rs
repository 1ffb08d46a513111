//! A file that is filled over time and takes its final name only when complete. For writers that cannot produce their
//! content in one go, as [`dermis_device::write_atomic`] requires.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use dermis_device::Place;

use crate::Error;

/// A temporary file next to its final name. It is deleted if dropped before [`StagedFile::finish`].
///
/// Links are followed. A target that exists and isn't a regular file (a pipe, a terminal) is written directly.
#[derive(Debug)]
pub(crate) struct StagedFile {
    out: BufWriter<File>,
    /// `None` if the target is written directly.
    temporary: Option<PathBuf>,
    place: Place,
}

impl StagedFile {
    pub(crate) fn create(path: &Path) -> Result<Self, Error> {
        let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let place = Place::at(&target);
        let special = fs::metadata(&target).is_ok_and(|found| !found.is_file() && !found.is_dir());
        let (temporary, file) = if special {
            (None, OpenOptions::new().write(true).open(&target).map_err(Error::io(path))?)
        } else {
            let (temporary, file) = create_beside(&target).map_err(Error::io(path))?;
            (Some(temporary), file)
        };
        Ok(Self { out: BufWriter::new(file), temporary, place })
    }

    /// Syncs the content to disk and gives it its name.
    pub(crate) fn finish(mut self) -> Result<(), Error> {
        self.settle().map_err(Error::io(self.place.path().to_owned()))
    }

    /// Like `finish`, without consuming the file.
    pub(crate) fn settle(&mut self) -> io::Result<()> {
        self.out.flush()?;
        if self.temporary.is_none() {
            return Ok(());
        }
        self.out.get_ref().sync_all()?;
        // A finished file is kept even if its name was taken meanwhile.
        let Some(temporary) = self.temporary.take() else { return Ok(()) };
        self.place.put(&temporary)?;
        sync_directory(self.place.path());
        Ok(())
    }
}

impl Write for StagedFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.out.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

impl Seek for StagedFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.out.seek(to)
    }
}

impl Drop for StagedFile {
    fn drop(&mut self) {
        if let Some(temporary) = &self.temporary {
            let _ = fs::remove_file(temporary);
        }
    }
}

fn create_beside(target: &Path) -> io::Result<(PathBuf, File)> {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    if target.is_dir() {
        return Err(io::ErrorKind::IsADirectory.into());
    }
    let name = target.file_name().ok_or(io::ErrorKind::IsADirectory)?;
    loop {
        let mut hidden = OsString::from(".");
        hidden.push(name);
        hidden.push(format!(".{}-s{}.part", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed)));
        let path = target.with_file_name(hidden);
        match OpenOptions::new().write(true).create_new(true).open(&path) {
            Ok(file) => return Ok((path, file)),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
}

/// Makes a rename durable on systems where directories can be synced; elsewhere it does nothing.
pub(crate) fn sync_directory(path: &Path) {
    if let Some(Ok(directory)) = path.parent().map(File::open) {
        let _ = directory.sync_all();
    }
}
