//! Presses that are part of the baseline but have ended: when to look for them, whether they explain a frame, and when
//! the baseline is corrected.

use dermis_estimate::{Estimate, Press};

use crate::stages::touch_search::is_clearly_explained;

/// Presses that have ended are accepted as the explanation of a frame if they leave less than this share of its
/// energy (with real gels and wrong geometries, a press leaves up to a third), and less than this share of the
/// residual of present presses. The second condition becomes "less than the residual" if the explanation needs fewer
/// presses.
const UNEXPLAINED: f64 = 0.3;
const BETTER: f64 = 0.5;
/// Number of frames in a row that must show that presses have ended before the baseline is corrected, and the maximum
/// number of frames between searches that fail.
const FRAMES: u32 = 3;
const MOST_WAIT: u32 = 64;

/// Presses that have ended, and the number of frames in a row that showed them.
#[derive(Debug, Default)]
pub(super) struct EndedPresses {
    pub presses: Vec<Press>,
    /// No other press is present.
    are_alone: bool,
    frames: u32,
    /// Frames until the next search for them.
    wait: u32,
    waited: u32,
    /// The last search failed, and the frames since have not been clearly explained.
    pub has_failed: bool,
    /// Presses may change the skin in either direction, so a change of the opposite sign does not mean that one has
    /// ended.
    both_signs: bool,
    /// A search takes the time of several frames.
    is_slow: bool,
    is_unhurried: bool,
}

impl EndedPresses {
    pub fn new(both_signs: bool, is_slow: bool) -> Self {
        Self { both_signs, is_slow, ..Self::default() }
    }

    /// From now on, every frame that nothing explains is searched.
    pub fn take_time(&mut self) {
        self.is_unhurried = true;
    }

    /// Forgets the last frame: the next is unrelated to it.
    pub fn forget(&mut self) {
        self.presses.clear();
        (self.frames, self.wait) = (0, 0);
    }

    /// True if it is time for a search.
    pub fn is_due(&self) -> bool {
        self.wait == 0 && !self.both_signs
    }

    /// True if there are presses that have ended, and the next search is later.
    pub fn is_between_searches(&self) -> bool {
        !self.presses.is_empty() && self.wait > 0
    }

    /// Takes the explanation of a frame less these presses, which leaves this share of the frame. True if they still
    /// explain it.
    pub fn explain(&mut self, unexplained: f64, rest: &Estimate) -> bool {
        if unexplained >= UNEXPLAINED {
            return false;
        }
        self.wait -= 1;
        self.frames += 1;
        self.are_alone = rest.presses.is_empty();
        true
    }

    /// Drops presses that no longer explain a frame. If they were not certain, the next search is due.
    pub fn drop_presses(&mut self) {
        self.presses.clear();
        if self.frames < FRAMES {
            (self.frames, self.wait) = (0, 0);
        }
    }

    /// True if present presses do not explain the frame, so that it is searched for presses of negative load, which
    /// are part of the baseline but have ended.
    pub fn looks_for(&mut self, estimate: &Estimate) -> bool {
        self.presses.clear();
        if is_clearly_explained(estimate) || self.both_signs {
            (self.frames, self.wait, self.waited, self.has_failed) = (0, 0, 0, false);
            return false;
        }
        let looks = self.wait == 0;
        self.wait = self.wait.saturating_sub(1);
        looks
    }

    /// Removes the presses that have ended from an explanation, if it is better than one by present presses alone.
    pub fn judge(&mut self, estimate: &Estimate, with_ended: Option<Estimate>) -> Option<Estimate> {
        let found = with_ended.filter(|found| {
            let has_ended = found.presses.iter().any(|press| press.load < 0.0);
            let is_simpler = found.presses.len() < estimate.presses.len();
            let most = if is_simpler { estimate.unexplained } else { BETTER * estimate.unexplained };
            has_ended && found.unexplained < most.min(UNEXPLAINED)
        });
        self.has_failed = found.is_none();
        let Some(mut found) = found else {
            self.frames = 0;
            self.wait_longer();
            return None;
        };
        self.presses.extend(found.presses.iter().filter(|press| press.load < 0.0));
        self.are_alone = self.presses.len() == found.presses.len();
        self.frames += 1;
        if self.frames >= FRAMES {
            self.wait_longer();
        } else if self.is_slow && !self.is_unhurried {
            // These presses alone must explain the frames that are still needed.
            self.wait = FRAMES - self.frames;
        }
        let pairs = found.presses.into_iter().zip(found.evidence);
        (found.presses, found.evidence) = pairs.filter(|(press, _)| press.load > 0.0).unzip();
        Some(found)
    }

    /// Searches less and less often while nothing explains the frames, or while the baseline is not corrected by what
    /// explains them.
    fn wait_longer(&mut self) {
        self.wait = if self.is_unhurried { 0 } else { self.waited };
        self.waited = (2 * self.waited).clamp(1, MOST_WAIT);
    }

    /// The presses that have certainly ended, once; none of them if no other press is present. `None` until they have
    /// been missing for several frames.
    pub fn take_certain(&mut self) -> Option<&[Press]> {
        if self.frames < FRAMES {
            return None;
        }
        self.frames = 0;
        Some(if self.are_alone { &[] } else { &self.presses })
    }
}

/// Presses that are part of the baseline but have ended.
#[derive(Debug)]
pub(crate) enum Gone<'a> {
    /// Nothing else touches the skin: the next frames are its new baseline.
    Alone,
    /// Other presses touch the skin. The ended ones account for this change of the channels, model volts.
    BesideOthers(&'a [f64]),
}
