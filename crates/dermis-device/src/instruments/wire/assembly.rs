//! Assembly of frames that arrive in parts.

use dermis_wire::{Frame as WireFrame, Part};

use crate::{Frame, HostStamp};

/// A partially received frame.
#[derive(Debug, Default)]
pub(super) struct Assembly {
    sequence: u32,
    /// Number of readings received; 0 before the first part.
    next: u16,
    begun: Option<HostStamp>,
    frame: Frame,
}

impl Assembly {
    /// Adds a part whose first byte arrived at `at`. Returns true when the frame is complete. A part that doesn't
    /// continue the frame in progress discards it; the next complete frame's number shows the gap.
    pub(super) fn take(&mut self, part: &Part<'_>, at: HostStamp) -> bool {
        if part.first == 0 {
            self.frame.clear();
            (self.sequence, self.next, self.begun) = (part.readings.sequence, 0, Some(at));
        } else if self.next != part.first || self.sequence != part.readings.sequence {
            self.forget();
            return false;
        }
        fill(&mut self.frame, &part.readings);
        self.next += part.readings.values.len() as u16;
        self.next == part.total
    }

    /// The device's frame number, and the arrival of the frame's first byte.
    pub(super) fn of(&self) -> (u32, Option<HostStamp>) {
        (self.sequence, self.begun)
    }

    /// Moves the completed frame into `out`, without its number and host times.
    pub(super) fn move_into(&mut self, out: &mut Frame) {
        std::mem::swap(&mut self.frame, out);
        self.forget();
    }

    pub(super) fn forget(&mut self) {
        (self.next, self.begun) = (0, None);
    }
}

/// Appends readings to a frame. Values that exist once per frame are taken from the first part.
pub(super) fn fill(out: &mut Frame, readings: &WireFrame<'_>) {
    let began_ns = *out.device_time_ns.get_or_insert(readings.device_time_ns);
    out.gain.get_or_insert(readings.gain);
    out.status = out.status.with(readings.status);
    out.values.extend(readings.values.volts(readings.scale));
    if let Some(imaginary) = &readings.imaginary {
        out.imaginary.extend(imaginary.volts(readings.scale));
    }
    if let Some(times_ns) = &readings.channel_times_ns {
        let after_ns = readings.device_time_ns.saturating_sub(began_ns);
        out.channel_times_ns.extend(times_ns.iter().map(|time_ns| after_ns + u64::from(time_ns)));
    }
}
