//! Rate limit for repeated log messages: the 1st, 2nd, 4th, 8th ... occurrence is logged.

/// Counts repetitions of a message. Messages that differ only in their digits count as the same.
#[derive(Debug, Default)]
pub(super) struct LogLimit {
    said: String,
    times: u64,
}

impl LogLimit {
    /// Number of occurrences, or `None` if this one shouldn't be logged.
    pub fn count(&mut self, text: &str) -> Option<u64> {
        let words: String = text.chars().filter(|c| !c.is_ascii_digit()).collect();
        if words != self.said {
            (self.said, self.times) = (words, 0);
        }
        self.times += 1;
        self.times.is_power_of_two().then_some(self.times)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_messages_become_rarer_and_new_ones_are_logged_at_once() {
        let mut limit = LogLimit::default();
        let told = (0..1000).filter(|k| limit.count(&format!("silent for {k} s")).is_some()).count();
        assert_eq!(told, 10);
        assert_eq!(limit.count("connection refused"), Some(1));
        assert_eq!(limit.count("silent for 2.0 s"), Some(1));
    }
}
