//! The last step of writing a file: giving it its name without overwriting anything that has appeared or changed under
//! that name in the meantime.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

/// A file's destination, and the file that was there when writing began.
#[derive(Debug, Clone)]
pub struct Place {
    target: PathBuf,
    before: Option<Identity>,
}

/// Identifies a file and its state.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Identity {
    number: u64,
    bytes: u64,
    modified: Option<SystemTime>,
}

impl Identity {
    fn of(path: &Path) -> Option<Self> {
        let found = fs::symlink_metadata(path).ok()?;
        #[cfg(unix)]
        let number = std::os::unix::fs::MetadataExt::ino(&found);
        #[cfg(not(unix))]
        let number = 0;
        Some(Self { number, bytes: found.len(), modified: found.modified().ok() })
    }
}

/// Files that existed under certain names when the current command began.
static BEFORE: Mutex<BTreeMap<PathBuf, Option<Identity>>> = Mutex::new(BTreeMap::new());

/// Records which files exist under these names. If a file appears or changes there later, the first write under that
/// name won't replace it, however long the work before takes. Forgets all names recorded earlier. Names that aren't
/// paths do no harm.
pub fn remember(names: impl IntoIterator<Item = PathBuf>) {
    let found = |name: PathBuf| {
        let target = followed(&name);
        std::path::absolute(name).ok().map(|name| (name, Identity::of(&target)))
    };
    *BEFORE.lock().unwrap_or_else(PoisonError::into_inner) = names.into_iter().filter_map(found).collect();
}

/// The target of a link, or the path itself.
pub(crate) fn followed(path: &Path) -> PathBuf {
    fs::canonicalize(path).unwrap_or_else(|_| path.to_owned())
}

impl Place {
    /// The destination for a name that the user gave. Follows links. The previous file is the one that [`remember`]
    /// recorded, or else the one that exists now.
    pub fn named(name: &Path) -> Self {
        let noted = std::path::absolute(name)
            .ok()
            .and_then(|name| BEFORE.lock().unwrap_or_else(PoisonError::into_inner).remove(&name));
        let place = Self::at(followed(name));
        match noted {
            Some(before) => Self { before, ..place },
            None => place,
        }
    }

    /// The destination for a new file, or for one that replaces the existing file.
    pub fn at(target: impl Into<PathBuf>) -> Self {
        let target = target.into();
        let before = Identity::of(&target);
        Self { target, before }
    }

    /// Path of the destination.
    pub fn path(&self) -> &Path {
        &self.target
    }

    /// Renames the finished file at `from` to the destination. Replaces the file that was there when writing began,
    /// but not one that has appeared or changed since.
    ///
    /// # Errors
    /// The operating system's errors. [`ErrorKind::AlreadyExists`] if another file has the name; the message names
    /// `from`, which is kept.
    pub fn put(&self, from: &Path) -> io::Result<()> {
        let taken = || {
            let text = format!(
                "another file appeared or changed there meanwhile and was not replaced; the finished one stands at {}",
                from.display()
            );
            io::Error::new(ErrorKind::AlreadyExists, text)
        };
        match &self.before {
            Some(before) if Identity::of(&self.target).as_ref() == Some(before) => fs::rename(from, &self.target),
            // The destination is free, or holds a different file than before.
            _ => match rename_new(from, &self.target) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists => Err(taken()),
                other => other,
            },
        }
    }
}

/// Renames a file unless the new name is taken.
///
/// # Errors
/// [`ErrorKind::AlreadyExists`], and the operating system's errors.
pub fn rename_new(from: &Path, to: &Path) -> io::Result<()> {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{CWD, RenameFlags, renameat_with};
        use rustix::io::Errno;
        match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
            Ok(()) => return Ok(()),
            // The file system doesn't support this flag.
            Err(Errno::INVAL | Errno::NOSYS | Errno::NOTSUP) => {}
            Err(error) => return Err(error.into()),
        }
    }
    link_new(from, to)
}

/// Does the same with a hard link to the new name, then removes the old one. Slower, and both names exist for a
/// moment.
fn link_new(from: &Path, to: &Path) -> io::Result<()> {
    match fs::hard_link(from, to) {
        Ok(()) => fs::remove_file(from),
        Err(error) if error.kind() == ErrorKind::AlreadyExists => Err(error),
        // The file system has no hard links. A file could appear between check and rename; that can't be avoided.
        Err(_) if fs::symlink_metadata(to).is_ok() => Err(ErrorKind::AlreadyExists.into()),
        Err(_) => fs::rename(from, to),
    }
}

/// `a/press.mcap` becomes `a/press.partial.mcap`.
pub fn partial_name(path: &Path) -> Option<PathBuf> {
    let mut name = OsString::from(path.file_stem()?);
    name.push(".partial");
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    Some(path.with_file_name(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_appears_after_the_command_began_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let (new, old) = (folder.path().join("new.csv"), folder.path().join("old.csv"));
        fs::write(&old, "before").unwrap();
        remember([new.clone(), old.clone(), PathBuf::from("--out")]);
        fs::write(&new, "another's").unwrap();
        let error = crate::write_atomic(&new, |out| out.write_all(b"ours")).unwrap_err().to_string();
        assert!(error.contains("not replaced"), "{error}");
        assert_eq!(fs::read_to_string(&new).unwrap(), "another's");
        // The original file is replaced, and so is our own later version.
        for _ in 0..2 {
            crate::write_atomic(&old, |out| out.write_all(b"ours")).unwrap();
            assert_eq!(fs::read_to_string(&old).unwrap(), "ours");
        }
    }

    #[test]
    fn a_file_that_appeared_in_the_meantime_is_kept_next_to_the_finished_one() {
        let folder = tempfile::tempdir().unwrap();
        let (part, target) = (folder.path().join("x.part"), folder.path().join("x"));
        fs::write(&part, "new").unwrap();
        let place = Place::at(&target);
        fs::write(&target, "another").unwrap();
        let error = place.put(&part).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::AlreadyExists);
        assert!(error.to_string().contains("x.part"), "{error}");
        assert_eq!((fs::read(&target).unwrap(), fs::read(&part).unwrap()), (b"another".to_vec(), b"new".to_vec()));
        // The original file is replaced as long as nobody changed it.
        Place::at(&target).put(&part).unwrap();
        assert_eq!(fs::read(&target).unwrap(), b"new");
        fs::write(&part, "newer").unwrap();
        let place = Place::at(&target);
        fs::write(&target, "changed by another").unwrap();
        assert!(place.put(&part).is_err());
        assert_eq!(fs::read(&target).unwrap(), b"changed by another");
    }

    #[test]
    fn without_the_system_call_a_second_name_does_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let (part, target) = (folder.path().join("x.part"), folder.path().join("x"));
        fs::write(&part, "new").unwrap();
        link_new(&part, &target).unwrap();
        assert!(!part.exists());
        fs::write(&part, "newer").unwrap();
        assert_eq!(link_new(&part, &target).unwrap_err().kind(), ErrorKind::AlreadyExists);
        assert_eq!(fs::read(&target).unwrap(), b"new");
        assert!(part.exists());
    }
}
