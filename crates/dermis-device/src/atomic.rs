//! Files that are either complete or absent: written to a temporary name, flushed to disk, then renamed.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::DeviceError;
use crate::place::{Place, followed};

/// Writes a file through `fill` so that `path` never holds an incomplete one.
///
/// The bytes go to a temporary file in the same directory, which is synchronised to disk and renamed to `path`. This
/// replaces the file that was there at the start, but not one that has appeared or changed in the meantime; the error
/// then names the finished file. If `fill` fails, the temporary file is removed and any file at `path` stays. Links
/// are followed. If `path` exists but isn't a regular file (a pipe, a terminal), it is written directly.
///
/// # Errors
/// [`DeviceError::Io`] naming `path` and the step that failed, `fill` included.
///
/// ```
/// use std::io::Write;
///
/// let path = std::env::temp_dir().join(format!("dermis-doc-{}.csv", std::process::id()));
/// dermis_device::write_atomic(&path, |out| writeln!(out, "frame,x_mm"))?;
/// assert_eq!(std::fs::read_to_string(&path)?, "frame,x_mm\n");
/// std::fs::remove_file(&path)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_atomic<T>(path: &Path, fill: impl FnOnce(&mut dyn Write) -> io::Result<T>) -> Result<T, DeviceError> {
    let failed = |action| move |error| DeviceError::io(path, action, error);
    let target = followed(path);
    if fs::metadata(&target).is_ok_and(|found| !found.is_file() && !found.is_dir()) {
        let mut out = OpenOptions::new().write(true).open(&target).map_err(failed("open"))?;
        return fill(&mut out).map_err(failed("write"));
    }
    let place = Place::named(path);
    let (mut temporary, file) = Temporary::create_beside(&target).map_err(failed("create a file next to"))?;
    let mut out = BufWriter::new(file);
    let value = fill(&mut out).map_err(failed("write"))?;
    let file = out.into_inner().map_err(|error| failed("write")(error.into_error()))?;
    file.sync_all().map_err(failed("flush"))?;
    drop(file);
    // Keep a finished file even if another file has taken its name.
    temporary.finished = true;
    place.put(&temporary.path).map_err(failed("put the finished file at"))?;
    sync_directory(&target);
    Ok(value)
}

/// A file that is deleted on drop unless it was finished.
struct Temporary {
    path: PathBuf,
    finished: bool,
}

impl Temporary {
    fn create_beside(target: &Path) -> io::Result<(Self, File)> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let name = target.file_name().ok_or_else(|| io::Error::from(io::ErrorKind::IsADirectory))?;
        loop {
            let count = COUNT.fetch_add(1, Ordering::Relaxed);
            let mut hidden = std::ffi::OsString::from(".");
            hidden.push(name);
            hidden.push(format!(".{}-{count}.part", std::process::id()));
            let path = target.with_file_name(hidden);
            match OpenOptions::new().write(true).create_new(true).open(&path) {
                Ok(file) => return Ok((Self { path, finished: false }, file)),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        if !self.finished {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// Makes the rename itself durable, on systems where directories can be synchronised.
fn sync_directory(target: &Path) {
    if let Some(Ok(directory)) = target.parent().map(File::open) {
        let _ = directory.sync_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names_in(directory: &Path) -> Vec<String> {
        fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    }

    #[test]
    fn a_failed_write_leaves_what_was_there() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("out.csv");
        write_atomic(&path, |out| out.write_all(b"old")).unwrap();
        let error = write_atomic(&path, |out| {
            out.write_all(&[b'x'; 100_000])?;
            Err::<(), _>(io::Error::other("disk on fire"))
        });
        let message = error.unwrap_err().to_string();
        assert!(message.contains("out.csv") && message.contains("disk on fire"), "{message}");
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names_in(directory.path()), ["out.csv"]);
    }

    #[test]
    fn a_failed_first_write_leaves_nothing() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("out.csv");
        assert!(write_atomic(&path, |_| Err::<(), _>(io::Error::other("no"))).is_err());
        assert!(names_in(directory.path()).is_empty());
    }

    #[test]
    fn a_file_that_appears_in_the_meantime_is_not_replaced() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("out.csv");
        let error = write_atomic(&path, |out| {
            fs::write(&path, "another program's")?;
            out.write_all(b"ours")
        });
        let message = error.unwrap_err().to_string();
        assert!(message.contains("not replaced") && message.contains(".out.csv."), "{message}");
        assert_eq!(fs::read(&path).unwrap(), b"another program's");
        assert_eq!(names_in(directory.path()).len(), 2);
    }

    #[test]
    fn the_final_name_does_not_exist_while_writing() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("out.csv");
        let seen = write_atomic(&path, |out| {
            out.write_all(b"half")?;
            out.flush()?;
            Ok(path.exists())
        });
        assert!(!seen.unwrap());
        assert_eq!(fs::read(&path).unwrap(), b"half");
    }

    #[test]
    fn directories_and_missing_directories_are_refused() {
        let directory = tempfile::tempdir().unwrap();
        assert!(write_atomic(directory.path(), |_| Ok(())).is_err());
        assert!(write_atomic(&directory.path().join("none/out.csv"), |_| Ok(())).is_err());
        assert!(names_in(directory.path()).is_empty());
    }
}
