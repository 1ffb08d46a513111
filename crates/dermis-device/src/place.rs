//! The last step of writing a file: it takes its name, and what appeared or changed under that name meanwhile is not
//! replaced.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

/// Where a file will stand, and what stood there when its writing began.
#[derive(Debug, Clone)]
pub struct Place {
    target: PathBuf,
    before: Option<Identity>,
}

/// What tells whether a file is still the same.
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

/// What stood under names when the command began that will write there.
static BEFORE: Mutex<BTreeMap<PathBuf, Option<Identity>>> = Mutex::new(BTreeMap::new());

/// Notes what stands under these names now: a file that appears or changes there from now on is not replaced by what is
/// written there first, however long the work before it takes. Names noted earlier are forgotten. Names that are no
/// paths do no harm.
pub fn remember(names: impl IntoIterator<Item = PathBuf>) {
    let found = |name: PathBuf| {
        let target = followed(&name);
        std::path::absolute(name).ok().map(|name| (name, Identity::of(&target)))
    };
    *BEFORE.lock().unwrap_or_else(PoisonError::into_inner) = names.into_iter().filter_map(found).collect();
}

/// Where a link leads, or the path itself.
pub(crate) fn followed(path: &Path) -> PathBuf {
    fs::canonicalize(path).unwrap_or_else(|_| path.to_owned())
}

impl Place {
    /// A place for what was asked for under a name: links are followed, and what counts as standing there is what did
    /// when [`remember`] was told of the name, or what does now.
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

    /// A place for a new file, or for one that replaces what stands there now.
    pub fn at(target: impl Into<PathBuf>) -> Self {
        let target = target.into();
        let before = Identity::of(&target);
        Self { target, before }
    }

    /// The path.
    pub fn path(&self) -> &Path {
        &self.target
    }

    /// Gives the finished file at `from` its name. What stood there when the writing began is replaced; what appeared
    /// or changed since is not.
    ///
    /// # Errors
    /// What the system says; [`ErrorKind::AlreadyExists`] with a message that names `from`, which stays, where another
    /// file has the name.
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
            // Nothing stands there now, or it is not what did.
            _ => match rename_new(from, &self.target) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists => Err(taken()),
                other => other,
            },
        }
    }
}

/// Renames a file unless another one has the new name.
///
/// # Errors
/// [`ErrorKind::AlreadyExists`], and what the system says.
pub fn rename_new(from: &Path, to: &Path) -> io::Result<()> {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{CWD, RenameFlags, renameat_with};
        use rustix::io::Errno;
        match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
            Ok(()) => return Ok(()),
            // File systems that do not know of it.
            Err(Errno::INVAL | Errno::NOSYS | Errno::NOTSUP) => {}
            Err(error) => return Err(error.into()),
        }
    }
    link_new(from, to)
}

/// The same by a second name and the removal of the first: slower, and two names stand for a moment.
fn link_new(from: &Path, to: &Path) -> io::Result<()> {
    match fs::hard_link(from, to) {
        Ok(()) => fs::remove_file(from),
        Err(error) if error.kind() == ErrorKind::AlreadyExists => Err(error),
        // A file system without second names: between look and rename a file could appear, there is no way round that.
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
    fn what_appears_after_the_command_began_is_kept_even_if_its_writing_begins_later() {
        let folder = tempfile::tempdir().unwrap();
        let (new, old) = (folder.path().join("new.csv"), folder.path().join("old.csv"));
        fs::write(&old, "before").unwrap();
        remember([new.clone(), old.clone(), PathBuf::from("--out")]);
        fs::write(&new, "another's").unwrap();
        let error = crate::write_atomic(&new, |out| out.write_all(b"ours")).unwrap_err().to_string();
        assert!(error.contains("not replaced"), "{error}");
        assert_eq!(fs::read_to_string(&new).unwrap(), "another's");
        // What stood there from the beginning is replaced, and so is what was written since.
        for _ in 0..2 {
            crate::write_atomic(&old, |out| out.write_all(b"ours")).unwrap();
            assert_eq!(fs::read_to_string(&old).unwrap(), "ours");
        }
    }

    #[test]
    fn a_file_that_appeared_meanwhile_is_kept_and_so_is_the_finished_one() {
        let folder = tempfile::tempdir().unwrap();
        let (part, target) = (folder.path().join("x.part"), folder.path().join("x"));
        fs::write(&part, "new").unwrap();
        let place = Place::at(&target);
        fs::write(&target, "another").unwrap();
        let error = place.put(&part).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::AlreadyExists);
        assert!(error.to_string().contains("x.part"), "{error}");
        assert_eq!((fs::read(&target).unwrap(), fs::read(&part).unwrap()), (b"another".to_vec(), b"new".to_vec()));
        // What stood there from the beginning is replaced, as long as nobody changed it.
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
