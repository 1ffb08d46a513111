//! The workbench of one data set: its folder, the extent of the run, the progress callback and the findings.

use std::path::{Path, PathBuf};
use std::time::Instant;

use super::finding::{Comparison, Figure, Finding};
use crate::Error;

/// Extent of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Extent {
    /// Everything: five or three random draws, all levels, the finer mesh.
    #[default]
    Full,
    /// One draw, the first level, the coarser mesh: seconds instead of minutes.
    Quick,
}

/// Reason for stopping a set early.
pub(super) enum Stop {
    /// A file or folder is missing.
    Missing(PathBuf),
    /// A file has invalid content, or a computation failed.
    Failed(Error),
}

impl<E: Into<Error>> From<E> for Stop {
    fn from(error: E) -> Self {
        Self::Failed(error.into())
    }
}

/// A row of the table, without its time.
pub(super) struct Row<'a> {
    pub(super) measured: &'a str,
    pub(super) known: &'a str,
    pub(super) here: Vec<Figure>,
    pub(super) plain: Comparison,
    pub(super) published: Comparison,
}

/// The workbench of one set.
pub(super) struct Bench<'a> {
    folder: PathBuf,
    extent: Extent,
    tell: &'a mut dyn FnMut(&str),
    pub(super) findings: Vec<Finding>,
    pub(super) missing: Vec<PathBuf>,
    since: Instant,
}

impl<'a> Bench<'a> {
    pub(super) fn new(folder: PathBuf, extent: Extent, tell: &'a mut dyn FnMut(&str)) -> Self {
        Self { folder, extent, tell, findings: Vec::new(), missing: Vec::new(), since: Instant::now() }
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    pub(super) fn is_quick(&self) -> bool {
        self.extent == Extent::Quick
    }

    /// Reports the current step.
    pub(super) fn say(&mut self, step: &str) {
        (self.tell)(step);
    }

    /// Path of a file or folder of the set; an error if it is missing.
    pub(super) fn need(&self, name: &str) -> Result<PathBuf, Stop> {
        let path = self.folder.join(name);
        if path.exists() { Ok(path) } else { Err(Stop::Missing(path)) }
    }

    /// Adds a row; its time is the time since the previous one.
    pub(super) fn add(&mut self, row: Row<'_>) {
        let Row { measured, known, here, plain, published } = row;
        let seconds = self.since.elapsed().as_secs_f64();
        self.findings.push(Finding { measured: measured.into(), known: known.into(), here, plain, published, seconds });
        self.since = Instant::now();
    }
}
