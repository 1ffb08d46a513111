//! Feeds the frames of an acquisition to the frame driver.

use std::time::Duration;

use dermis_device::Frame;
use dermis_device::acquire::{Acquisition, Next as Acquired};
use dermis_live::driver::{Feed, Next};

/// The frames of an acquisition. A frame's memory is returned when the next one is requested.
pub struct AcquiredFrames<'a> {
    acquisition: &'a mut Acquisition,
    /// Longest wait for a frame.
    patience: Duration,
    current: Option<Frame>,
}

impl<'a> AcquiredFrames<'a> {
    /// Waits at most `patience` for each frame.
    pub fn new(acquisition: &'a mut Acquisition, patience: Duration) -> Self {
        Self { acquisition, patience, current: None }
    }

    /// The acquisition behind the frames.
    pub fn acquisition(&self) -> &Acquisition {
        self.acquisition
    }
}

impl Feed for AcquiredFrames<'_> {
    type Error = anyhow::Error;

    fn next(&mut self) -> anyhow::Result<Next<'_>> {
        if let Some(frame) = self.current.take() {
            self.acquisition.recycle(frame);
        }
        Ok(match self.acquisition.next(self.patience).map_err(dermis_lab::Error::from)? {
            Acquired::Frame(frame) => Next::Frame(self.current.insert(frame), None),
            Acquired::Idle => Next::Idle,
            Acquired::End => Next::End,
        })
    }
}
