//! Which frames did not come: the device's sequence numbers, which wrap and start anew, against the host's, which do
//! not.

use crate::HostStamp;
use crate::stream::Inbox;

/// Frames in a row with numbers of the past after which the device is taken to count anew.
const STUBBORN: u32 = 16;

/// Sequence numbers: the device's, which wrap, and the host's, which do not.
#[derive(Debug, Default)]
pub(super) struct Count {
    /// What the device's next number should be.
    expected: Option<u32>,
    /// The host's next number.
    next: u64,
    /// The device was reset, or may have been: its numbers start anew.
    anew: Option<Anew>,
    /// Numbers of the past in a row.
    repeats: u32,
    /// Arrival of the last frame.
    last_ns: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Anew {
    /// Known by another boot number.
    Certain,
    /// The device has none; believed where its numbers go back.
    IfBack,
}

impl Count {
    /// The device was reset.
    pub(super) fn is_anew(&mut self) {
        self.anew = Some(Anew::Certain);
    }

    /// The device may have been reset.
    pub(super) fn may_be_anew(&mut self) {
        self.anew = Some(Anew::IfBack);
    }

    /// The host's number of a frame, after counting those before it that did not come; none if it has come before.
    pub(super) fn number(&mut self, sequence: u32, frames_per_s: f32, at: HostStamp, inbox: &Inbox) -> Option<u64> {
        let ahead = sequence.wrapping_sub(self.expected.unwrap_or(sequence));
        let back = ahead >= 1 << 31;
        let anew = match self.anew.take() {
            Some(Anew::Certain) => true,
            Some(Anew::IfBack) => back,
            None => back && self.repeats >= STUBBORN,
        };
        if back && !anew {
            self.repeats += 1;
            inbox.bad(1);
            return None;
        }
        let missed = if anew {
            // What the device would have sent since the last frame, of which this frame is one; its numbers say nothing
            // of that.
            let elapsed_s = at.monotonic_ns.saturating_sub(self.last_ns) as f64 * 1e-9;
            ((elapsed_s * f64::from(frames_per_s)).round() as u64).saturating_sub(1)
        } else {
            u64::from(ahead)
        };
        inbox.lost(missed);
        let number = self.next + missed;
        self.next = number + 1;
        self.expected = Some(sequence.wrapping_add(1));
        self.repeats = 0;
        self.last_ns = at.monotonic_ns;
        Some(number)
    }
}
