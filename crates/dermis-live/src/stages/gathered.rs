//! Gathers frames that arrive faster than a fit takes: their mean is fitted instead.

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
    contacts: Vec<Contact>,
}

impl Gathered {
    /// Adds a frame. The mean to fit, once it is time; until then `contacts` becomes those of the last fit.
    pub fn add(&mut self, time_ns: u64, frame: &[f64], contacts: &mut Vec<Contact>) -> Option<Vec<f64>> {
        if self.contacts.is_empty() || contacts.is_empty() || self.count > 0 && self.sum.len() != frame.len() {
            self.forget();
        }
        if self.count == 0 {
            self.sum.clear();
            self.sum.resize(frame.len(), 0.0);
        }
        self.sum.iter_mut().zip(frame).for_each(|(sum, value)| *sum += value);
        self.count += 1;
        let since_ns = self.fitted_ns.map_or(u64::MAX, |fitted_ns| time_ns.saturating_sub(fitted_ns));
        if since_ns < INTERVAL_NS {
            contacts.clone_from(&self.contacts);
            return None;
        }
        let mean = self.sum.iter().map(|sum| sum / f64::from(self.count)).collect();
        self.count = 0;
        Some(mean)
    }

    /// Keeps the contacts of a fit for the frames that follow.
    pub fn keep(&mut self, time_ns: u64, contacts: &[Contact]) {
        self.fitted_ns = Some(time_ns);
        self.contacts.clear();
        self.contacts.extend_from_slice(contacts);
    }

    /// Forgets all frames: the next is unrelated to them.
    pub fn forget(&mut self) {
        (self.count, self.fitted_ns) = (0, None);
        self.contacts.clear();
    }
}
