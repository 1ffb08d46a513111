//! Fits to frames that arrive faster than they can be fitted: some are passed over, and keep the contacts of the last
//! fit.

use dermis_touch::Contact;

/// Least time between two fits, nanoseconds. In that time, presses by hand or robot move less than the uncertainty of
/// their position.
const INTERVAL_NS: u64 = 5_000_000;

/// When the next frame is due to be fitted, and the contacts of the last fit.
#[derive(Debug, Default)]
pub(super) struct Pace {
    fitted_ns: Option<u64>,
    /// No fit before this time: the last one took as long.
    until_ns: u64,
    contacts: Vec<Contact>,
}

impl Pace {
    /// True if a frame with these contacts in its image is due to be fitted. Otherwise `contacts` becomes those of the
    /// last fit. The first frame with contacts, and one without, are due as soon as the last fit's time has passed.
    pub fn is_due(&mut self, time_ns: u64, contacts: &mut Vec<Contact>) -> bool {
        if self.contacts.is_empty() || contacts.is_empty() {
            self.fitted_ns = None;
            self.contacts.clear();
        }
        let since_ns = self.fitted_ns.map_or(u64::MAX, |fitted_ns| time_ns.saturating_sub(fitted_ns));
        let is_due = time_ns >= self.until_ns && since_ns >= INTERVAL_NS;
        if !is_due {
            contacts.clone_from(&self.contacts);
        }
        is_due
    }

    /// Keeps the contacts of a fit for the frames that follow. The fit took `spent_ns`, and the next one waits at least
    /// as long, so that fits take half of a core at most.
    pub fn keep(&mut self, time_ns: u64, spent_ns: u64, contacts: &[Contact]) {
        (self.fitted_ns, self.until_ns) = (Some(time_ns), time_ns.saturating_add(spent_ns));
        self.contacts.clear();
        self.contacts.extend_from_slice(contacts);
    }

    /// Replaces contacts by those of the last fit.
    pub fn repeat(&self, contacts: &mut Vec<Contact>) {
        contacts.clone_from(&self.contacts);
    }

    /// Forgets all frames: the next is unrelated to them.
    pub fn forget(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn contact() -> Contact {
        Contact::even([0.0; 2], 1.0, 1e-4)
    }

    #[test]
    fn frames_that_follow_a_fit_closely_keep_its_contacts() {
        let mut pace = Pace::default();
        let mut is_due = |ms: u64| {
            let is_due = pace.is_due(ms * MS, &mut vec![contact()]);
            if is_due {
                pace.keep(ms * MS, 20 * MS, &[contact()]);
            }
            is_due
        };
        assert!(is_due(0));
        // After a fit of 20 ms, the next one waits at least as long.
        assert!(!(1..20).any(&mut is_due));
        assert!(is_due(20));
    }

    #[test]
    fn a_release_is_seen_at_once() {
        let mut pace = Pace::default();
        pace.keep(0, 50 * MS, &[contact()]);
        let mut contacts = Vec::new();
        assert!(!pace.is_due(MS, &mut contacts));
        assert!(contacts.is_empty());
    }
}
