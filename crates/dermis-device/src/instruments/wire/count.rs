//! Counts lost frames. The device's sequence numbers wrap and restart; the host's don't.

use crate::HostStamp;
use crate::stream::Inbox;

/// Number of consecutive frames with old numbers after which the device is assumed to have restarted its count.
const STUBBORN: u32 = 16;

/// Tracks the sequence numbers of device and host.
#[derive(Debug, Default)]
pub(super) struct Count {
    /// The device's next expected number.
    expected: Option<u32>,
    /// The host's next number.
    next: u64,
    /// Set after a reset, or a possible one, of the device's count.
    reset: Option<Reset>,
    /// Number of consecutive frames with old numbers.
    repeats: u32,
    /// Arrival of the last frame on the monotonic clock, in nanoseconds.
    last_ns: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Reset {
    /// The boot number changed.
    Certain,
    /// The device has no boot number. Assume a reset only if its sequence numbers go back.
    IfBack,
}

impl Count {
    /// Records that the device was reset.
    pub(super) fn was_reset(&mut self) {
        self.reset = Some(Reset::Certain);
    }

    /// Records that the device may have been reset.
    pub(super) fn may_be_reset(&mut self) {
        self.reset = Some(Reset::IfBack);
    }

    /// The host's number for a frame, or `None` for a duplicate or late frame. Counts the frames lost before it.
    pub(super) fn number(&mut self, sequence: u32, frames_per_s: f32, at: HostStamp, inbox: &Inbox) -> Option<u64> {
        let ahead = sequence.wrapping_sub(self.expected.unwrap_or(sequence));
        let back = ahead >= 1 << 31;
        let reset = match self.reset.take() {
            Some(Reset::Certain) => true,
            Some(Reset::IfBack) => back,
            None => back && self.repeats >= STUBBORN,
        };
        if back && !reset {
            self.repeats += 1;
            inbox.bad(1);
            return None;
        }
        let missed = if reset {
            // After a reset the sequence numbers don't tell how many frames are missing. Estimate that from the frame
            // rate and the time since the last frame, and don't count this frame.
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
