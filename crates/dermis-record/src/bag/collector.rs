//! The messages of a bag, by topic.

use std::collections::BTreeMap;

use dermis_device::instruments::MOST_BYTES;

use super::array::ArrayKind;

/// A topic of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Topic {
    pub kind: String,
    pub messages: u64,
}

/// Collects the messages of all files.
pub(super) struct Collector {
    pub wanted: Option<String>,
    pub topics: BTreeMap<String, Topic>,
    /// Time and readings of the frames in each suitable topic.
    pub frames: BTreeMap<String, Vec<(i64, Vec<f64>)>>,
    pub held: u64,
    pub bad: Vec<String>,
}

impl Collector {
    /// Adds a topic as announced by its file.
    pub fn topic(&mut self, name: &str, kind: &str) {
        self.topics.entry(name.to_owned()).or_insert_with(|| Topic { kind: kind.to_owned(), messages: 0 });
    }

    /// Adds a message; returns false if there is no room for more.
    pub fn message(&mut self, topic: &str, at_ns: i64, data: &[u8]) -> bool {
        let Some(known) = self.topics.get_mut(topic) else { return true };
        known.messages += 1;
        if self.wanted.as_deref().is_some_and(|wanted| wanted != topic) {
            return true;
        }
        let Some(kind) = ArrayKind::of(&known.kind) else { return true };
        let number = known.messages;
        match kind.read(data) {
            Some(values) => {
                self.held += 8 * values.len() as u64;
                self.frames.entry(topic.to_owned()).or_default().push((at_ns, values));
            }
            None => self.bad.push(format!("message {number} of {topic} is malformed")),
        }
        self.held <= MOST_BYTES
    }
}
