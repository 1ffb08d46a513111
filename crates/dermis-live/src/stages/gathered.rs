//! Gathers frames that arrive faster than they can be fitted. Their mean is fitted instead.

use dermis_touch::Contact;

/// Least time between two fits, nanoseconds. In that time, presses by hand or robot move less than the uncertainty of
/// their position.
const INTERVAL_NS: u64 = 5_000_000;

/// The frames since the last fit, and its contacts.
#[derive(Debug, Default)]
pub(super) struct Gathered {
    sum: Vec<f64>,
    count: u32,
    fitted_ns: Option<u64>,
    /// No fit before this time: the last one took as long.
    until_ns: u64,
    contacts: Vec<Contact>,
}

impl Gathered {
    /// Adds a frame with these contacts in its image. The mean to fit, once it is time. Until then `contacts` becomes
    /// those of the last fit.
    pub fn add(&mut self, time_ns: u64, frame: &[f64], contacts: &mut Vec<Contact>) -> Option<Vec<f64>> {
        if self.contacts.is_empty() || contacts.is_empty() || self.count > 0 && self.sum.len() != frame.len() {
            self.drop_frames();
        }
        if self.count == 0 {
            self.sum.clear();
            self.sum.resize(frame.len(), 0.0);
        }
        self.sum.iter_mut().zip(frame).for_each(|(sum, value)| *sum += value);
        self.count += 1;
        let since_ns = self.fitted_ns.map_or(u64::MAX, |fitted_ns| time_ns.saturating_sub(fitted_ns));
        if time_ns < self.until_ns || since_ns < INTERVAL_NS {
            contacts.clone_from(&self.contacts);
            return None;
        }
        let mean = self.sum.iter().map(|sum| sum / f64::from(self.count)).collect();
        self.count = 0;
        Some(mean)
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
        self.until_ns = 0;
        self.drop_frames();
    }

    fn drop_frames(&mut self) {
        (self.count, self.fitted_ns) = (0, None);
        self.contacts.clear();
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
    fn frames_that_follow_a_fit_closely_become_one() {
        let mut gathered = Gathered::default();
        let mut add = |ms: u64, value: f64| {
            let mean = gathered.add(ms * MS, &[value], &mut vec![contact()]);
            if mean.is_some() {
                gathered.keep(ms * MS, 20 * MS, &[contact()]);
            }
            mean
        };
        assert_eq!(add(0, 1.0), Some(vec![1.0]));
        // After a fit of 20 ms, the next one waits at least as long.
        assert_eq!((1..20).find_map(|ms| add(ms, 2.0)), None);
        assert_eq!(add(20, 2.0), Some(vec![2.0]));
    }

    #[test]
    fn a_release_is_seen_at_once() {
        let mut gathered = Gathered::default();
        gathered.keep(0, 50 * MS, &[contact()]);
        let mut contacts = Vec::new();
        assert_eq!(gathered.add(MS, &[0.0], &mut contacts), None);
        assert!(contacts.is_empty());
    }
}
