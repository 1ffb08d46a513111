//! Which channels share a drive, a measuring pair or an electrode, and which are reciprocal.

use crate::error::{TouchError, require, require_length};

/// Assignment of a skin's channels to its electrodes (or coils).
#[derive(Debug, Clone, PartialEq)]
pub struct Wiring {
    /// Electrodes of each drive and of each measuring pattern.
    pub(super) drives: Vec<Vec<u32>>,
    pub(super) patterns: Vec<Vec<u32>>,
    /// Drive and pattern of each channel.
    pub(super) channels: Vec<[u32; 2]>,
    /// The reciprocal channel and the factor that makes the two voltages equal.
    pub(super) partners: Vec<Option<(u32, f64)>>,
    /// Channels of each drive, then of each pattern, then of each electrode.
    pub(super) groups: Vec<Vec<u32>>,
}

impl Wiring {
    /// Builds the wiring from the electrodes of each drive and of each measuring pattern (indices from 0), the drive
    /// and pattern of each channel, and its reciprocal channel, if any, with the factor that makes the two equal.
    ///
    /// # Errors
    /// [`TouchError::Length`], and [`TouchError::Parameter`] for an index that does not exist.
    pub fn new(
        electrodes: usize,
        drives: Vec<Vec<u32>>,
        patterns: Vec<Vec<u32>>,
        channels: Vec<[u32; 2]>,
        partners: Vec<Option<(u32, f64)>>,
    ) -> Result<Self, TouchError> {
        require_length("reciprocal partners", channels.len(), partners.len())?;
        let exists = |index: u32, count: usize, what: &'static str| {
            require((index as usize) < count, what, f64::from(index), "an index that exists")
        };
        for electrode in drives.iter().chain(&patterns).flatten() {
            exists(*electrode, electrodes, "electrode")?;
        }
        for [drive, pattern] in &channels {
            exists(*drive, drives.len(), "drive of a channel")?;
            exists(*pattern, patterns.len(), "pattern of a channel")?;
        }
        for (partner, _) in partners.iter().flatten() {
            exists(*partner, channels.len(), "reciprocal channel")?;
        }
        let mut groups = vec![Vec::new(); drives.len() + patterns.len() + electrodes];
        for (channel, &[drive, pattern]) in (0..).zip(&channels) {
            groups[drive as usize].push(channel);
            groups[drives.len() + pattern as usize].push(channel);
            for electrode in 0..electrodes as u32 {
                let uses = |list: &[Vec<u32>], index: u32| list[index as usize].contains(&electrode);
                if uses(&drives, drive) || uses(&patterns, pattern) {
                    groups[drives.len() + patterns.len() + electrode as usize].push(channel);
                }
            }
        }
        Ok(Self { drives, patterns, channels, partners, groups })
    }

    /// Number of channels.
    #[must_use]
    pub fn channel_count(&self) -> usize {
        self.channels.len()
    }

    /// Number of electrodes.
    #[must_use]
    pub fn electrode_count(&self) -> usize {
        self.groups.len() - self.drives.len() - self.patterns.len()
    }

    /// Channels that drive or read an electrode.
    #[must_use]
    pub fn channels_of(&self, electrode: u32) -> &[u32] {
        &self.groups[self.drives.len() + self.patterns.len() + electrode as usize]
    }

    pub(super) fn channels_of_drive(&self, drive: usize) -> &[u32] {
        &self.groups[drive]
    }

    pub(super) fn channels_of_pattern(&self, pattern: usize) -> &[u32] {
        &self.groups[self.drives.len() + pattern]
    }
}
