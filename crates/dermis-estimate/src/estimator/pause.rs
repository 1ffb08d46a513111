//! Pauses of searches that were in vain.

/// Frames of the first pause, and of the longest: each is twice as long as the one before.
const FRAMES: [u32; 2] = [8, 32];
/// A residual has clearly grown if it is larger by this factor. That ends a pause.
pub(super) const GROWN: f64 = 1.5;

/// A pause, if there is one.
#[derive(Clone, Debug)]
pub(super) struct Pause {
    /// Frames left, and length of the next pause.
    frames: u32,
    next: u32,
    /// Residual of the frame searched in vain.
    in_vain_at: f64,
}

impl Pause {
    /// No pause, and the next one is short.
    pub fn over() -> Self {
        Self { frames: 0, next: 0, in_vain_at: f64::INFINITY }
    }

    /// Counts a frame with this residual. True if the search skips it.
    pub fn is_on(&mut self, residual: f64) -> bool {
        if residual >= GROWN * self.in_vain_at {
            self.next = 0;
            return false;
        }
        let is_on = self.frames > 0;
        self.frames = self.frames.saturating_sub(1);
        is_on
    }

    /// After a search that found something: the next pause is as short as the first, but this one goes on.
    pub fn shorten(&mut self) {
        self.next = 0;
    }

    /// Begins after a search in vain of a frame with this residual.
    pub fn begin(&mut self, residual: f64) {
        self.next = (2 * self.next).clamp(FRAMES[0], FRAMES[1]);
        (self.frames, self.in_vain_at) = (self.next, residual);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_double_and_end_with_a_larger_residual() {
        let mut pause = Pause::over();
        let lengths = [8, 16, 32, 32].map(|_| {
            pause.begin(100.0);
            (0..100).take_while(|_| pause.is_on(140.0)).count()
        });
        assert_eq!(lengths, [8, 16, 32, 32]);
        pause.begin(100.0);
        assert!(!pause.is_on(150.0));
        pause.begin(100.0);
        assert_eq!((0..100).take_while(|_| pause.is_on(140.0)).count(), 8);
    }
}
