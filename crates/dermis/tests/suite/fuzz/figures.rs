//! Totals over all sequences of a run.

use std::collections::BTreeSet;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// Totals over all sequences of this process.
pub struct Figures {
    pub sequences: AtomicU64,
    pub commands: AtomicU64,
    pub messages: AtomicU64,
    pub frames: AtomicU64,
    pub replays: AtomicU64,
    pub states: Mutex<BTreeSet<State>>,
}

/// A coarse state of the running system, as a test would name it.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct State {
    pub skin: &'static str,
    pub image: &'static str,
    pub is_recording: bool,
    pub is_touched: bool,
    pub is_anomalous: bool,
    pub follows_silence: bool,
    pub damages: &'static str,
    pub faults: &'static str,
    pub is_sound: bool,
}

pub static FIGURES: Figures = Figures {
    sequences: AtomicU64::new(0),
    commands: AtomicU64::new(0),
    messages: AtomicU64::new(0),
    frames: AtomicU64::new(0),
    replays: AtomicU64::new(0),
    states: Mutex::new(BTreeSet::new()),
};

impl Figures {
    pub fn tell(&self) {
        let states = self.states.lock().unwrap();
        let one = |count: &AtomicU64| count.load(Ordering::Relaxed);
        println!(
            "{} sequences, {} commands, {} messages of pages, {} frames, {} states, {} replays to the bit, {:.0} MB at most",
            one(&self.sequences),
            one(&self.commands),
            one(&self.messages),
            one(&self.frames),
            states.len(),
            one(&self.replays),
            super::peak_bytes().map_or(f64::NAN, |bytes| bytes * 1e-6)
        );
    }
}

/// The count in a word: few, some, many.
pub fn some(count: usize) -> &'static str {
    match count {
        0 => "none",
        1 => "one",
        _ => "several",
    }
}
