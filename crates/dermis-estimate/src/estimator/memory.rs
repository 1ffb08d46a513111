//! The state that an estimator carries from frame to frame.

use super::pause::Pause;
use crate::press::Press;

/// State that an estimator carries from frame to frame.
#[derive(Clone, Debug)]
pub struct Memory {
    /// Presses of the last frame.
    pub(super) last: Vec<Press>,
    /// Positions and radii that presses keep until they move.
    pub(super) kept: Vec<Press>,
    /// Residual of the last frame.
    pub(super) left: f64,
    /// Pauses of the searches for first presses, for presses that have ended, and for further ones.
    pub(super) first: Pause,
    pub(super) gone: Pause,
    pub(super) further: Pause,
    /// Presses that explained a frame together.
    pub(super) together: Vec<Press>,
    /// Those of them that it clearly needed, by their places in the list, and how far they may change until that has to
    /// be tested again: in radii, and in the logarithm of the strength.
    pub(super) needed: Vec<(usize, f64)>,
}

impl Memory {
    pub(super) fn nothing() -> Self {
        let (first, gone, further) = (Pause::over(), Pause::over(), Pause::over());
        let (last, kept) = (Vec::new(), Vec::new());
        Self { last, kept, left: 0.0, first, gone, further, together: Vec::new(), needed: Vec::new() }
    }
}
