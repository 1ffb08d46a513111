//! The last verdict on every patch, and the readers to send it to.

use dermis_device::HostStamp;
use dermis_touch::guard::{GuardReport, GuardVerdict};
use serde::Serialize;

use super::reader::{Reader, Stream};
use crate::sink::json_lines::Verdict;

/// Maximum number of readers at once.
const MOST_READERS: usize = 8;
/// Heartbeats in the time after which a verdict is stale.
const HEARTBEATS: u64 = 5;
/// Shortest and longest time between heartbeats, nanoseconds.
const HEARTBEAT_NS: [u64; 2] = [2_000_000, 50_000_000];

/// One patch.
#[derive(Debug)]
struct Row {
    name: String,
    report: GuardReport,
    sequence: Option<u64>,
    /// Time and verdict of the last line about it.
    told: (u64, GuardVerdict),
}

/// Verdicts and readers. Times are on the host's monotonic clock, nanoseconds.
#[derive(Debug)]
pub(super) struct Board {
    rows: Vec<Row>,
    readers: Vec<Reader>,
    heartbeat_ns: u64,
    line: Vec<u8>,
}

impl Board {
    /// A board for these patches, with their reports before the first frame.
    pub fn new(patches: &[(String, GuardReport)], now_ns: u64) -> Self {
        let row = |(name, report): &(String, GuardReport)| Row {
            name: name.clone(),
            report: *report,
            sequence: None,
            told: (now_ns, report.verdict),
        };
        let shortest_ns = patches.iter().map(|(_, report)| report.stale_after_ns).min().unwrap_or(u64::MAX);
        let [least_ns, most_ns] = HEARTBEAT_NS;
        Self {
            rows: patches.iter().map(row).collect(),
            readers: Vec::new(),
            heartbeat_ns: (shortest_ns / HEARTBEATS).clamp(least_ns, most_ns),
            line: Vec::with_capacity(512),
        }
    }

    /// Tells the readers a patch's verdict on a frame.
    pub fn publish(&mut self, patch: usize, sequence: u64, report: GuardReport, now_ns: u64) {
        let Some(row) = self.rows.get_mut(patch) else { return };
        (row.report, row.sequence) = (report, Some(sequence));
        self.tell(patch, now_ns);
    }

    /// Tells the readers that a patch will have no more frames.
    pub fn end(&mut self, patch: usize, now_ns: u64) {
        let Some(row) = self.rows.get_mut(patch) else { return };
        row.report = row.report.ended();
        self.tell(patch, now_ns);
    }

    /// Ends all patches and disconnects the readers.
    pub fn close(&mut self, now_ns: u64) {
        (0..self.rows.len()).for_each(|patch| self.end(patch, now_ns));
        self.readers.clear();
    }

    /// Sends the heartbeats that are due, and every verdict that has become stale. Returns the time until the next of
    /// them, nanoseconds.
    pub fn tick(&mut self, now_ns: u64) -> u64 {
        for patch in 0..self.rows.len() {
            let Row { report, told: (told_ns, verdict), .. } = &self.rows[patch];
            if now_ns.saturating_sub(*told_ns) >= self.heartbeat_ns || report.at(now_ns).verdict != *verdict {
                self.tell(patch, now_ns);
            }
        }
        let until = |row: &Row| {
            let (told_ns, _) = row.told;
            let stale_ns = row.report.frame_ns.saturating_add(row.report.stale_after_ns).saturating_add(1);
            let next_ns = told_ns.saturating_add(self.heartbeat_ns);
            if stale_ns > now_ns { next_ns.min(stale_ns) } else { next_ns }
        };
        self.rows.iter().map(until).min().unwrap_or(u64::MAX).saturating_sub(now_ns).min(self.heartbeat_ns)
    }

    /// Greets a new reader, or turns it away if there are too many.
    pub fn add(&mut self, stream: Stream, now_ns: u64) {
        let mut reader = Reader::new(stream);
        if self.readers.len() >= MOST_READERS {
            let line = format!("{{\"refused\":\"{MOST_READERS} readers are connected\",\"safety_rated\":false}}\n");
            reader.send(line.as_bytes(), now_ns);
            return;
        }
        self.greet();
        let mut is_there = reader.send(&self.line, now_ns);
        for patch in 0..self.rows.len() {
            self.write_line(patch, now_ns);
            is_there = is_there && reader.send(&self.line, now_ns);
        }
        if is_there {
            self.readers.push(reader);
        }
    }

    /// Writes the greeting.
    fn greet(&mut self) {
        let greeting = Greeting {
            dermis_guard: 1,
            safety_rated: false,
            rule: "stop unless the last line says ok and is younger than its valid_ms",
            heartbeat_ms: milliseconds(self.heartbeat_ns),
            patches: self.rows.iter().map(|row| row.name.as_str()).collect(),
        };
        put(&mut self.line, &greeting);
    }

    fn tell(&mut self, patch: usize, now_ns: u64) {
        let verdict = self.write_line(patch, now_ns);
        self.rows[patch].told = (now_ns, verdict);
        let line = &self.line;
        self.readers.retain_mut(|reader| reader.send(line, now_ns));
    }

    /// Writes the line about a patch, and returns its verdict.
    fn write_line(&mut self, patch: usize, now_ns: u64) -> GuardVerdict {
        let all = self.rows.iter().map(|row| row.report.at(now_ns).verdict).max().unwrap_or(GuardVerdict::Stop);
        let Row { name, report, sequence, .. } = &self.rows[patch];
        let report = report.at(now_ns);
        let line = VerdictLine {
            patch: name,
            verdict: Verdict::of(&report),
            all: all.name(),
            sequence: *sequence,
            frame_ns: HostStamp::on_system_clock(report.frame_ns),
            monotonic_ns: HostStamp::on_system_clock(now_ns),
            valid_ms: milliseconds(report.stale_after_ns),
        };
        put(&mut self.line, &line);
        report.verdict
    }
}

/// The first line that a reader gets.
#[derive(Serialize)]
struct Greeting<'a> {
    dermis_guard: u32,
    safety_rated: bool,
    rule: &'static str,
    heartbeat_ms: f64,
    patches: Vec<&'a str>,
}

/// The verdict on a patch.
#[derive(Serialize)]
struct VerdictLine<'a> {
    patch: &'a str,
    #[serde(flatten)]
    verdict: Verdict,
    /// The worst verdict of all patches.
    all: &'static str,
    sequence: Option<u64>,
    frame_ns: u64,
    monotonic_ns: u64,
    valid_ms: f64,
}

/// Replaces a line by this object.
fn put(line: &mut Vec<u8>, object: &impl Serialize) {
    line.clear();
    // Writing to memory cannot fail, and all keys are texts.
    let _ = serde_json::to_writer(&mut *line, object);
    line.push(b'\n');
}

fn milliseconds(nanoseconds: u64) -> f64 {
    nanoseconds as f64 / 1e6
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_touch::guard::GuardReasons;
    use serde_json::{Value, json};

    const MS: u64 = 1_000_000;

    fn ok(frame_ns: u64) -> GuardReport {
        let (verdict, reasons) = (GuardVerdict::Ok, GuardReasons::default());
        GuardReport { verdict, reasons, frame_ns, stale_after_ns: 100 * MS }
    }

    fn line(board: &mut Board, patch: usize, now_ns: u64) -> Value {
        board.write_line(patch, now_ns);
        serde_json::from_slice(&board.line)
            .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&board.line)))
    }

    #[test]
    fn a_line_gives_the_verdict_on_a_patch_and_on_all() {
        let before = GuardReport::before_frames(0, 100 * MS);
        let mut board = Board::new(&[("outer".into(), before), ("a \"quoted\" one".into(), before)], 0);
        board.publish(0, 7, ok(MS), 2 * MS);
        let found = line(&mut board, 0, 2 * MS);
        let expected = json!({"patch": "outer", "verdict": "ok", "reasons": [], "safety_rated": false, "all": "stale"});
        for (key, value) in expected.as_object().unwrap() {
            assert_eq!(&found[key], value, "{found}");
        }
        assert_eq!((found["sequence"].as_u64(), found["valid_ms"].as_f64()), (Some(7), Some(100.0)));
        assert_eq!(found["monotonic_ns"].as_u64().unwrap() - found["frame_ns"].as_u64().unwrap(), MS);
        let other = line(&mut board, 1, 2 * MS);
        assert_eq!((&other["patch"], &other["reasons"]), (&json!("a \"quoted\" one"), &json!(["no-baseline"])));
        board.greet();
        let greeting: Value = serde_json::from_slice(&board.line).unwrap();
        assert_eq!((&greeting["safety_rated"], greeting["heartbeat_ms"].as_f64()), (&json!(false), Some(20.0)));
    }

    #[test]
    fn a_verdict_turns_stale_at_its_limit_without_a_frame_and_ends_as_stop() {
        let mut board = Board::new(&[("a".into(), GuardReport::before_frames(0, 100 * MS))], 0);
        board.publish(0, 1, ok(0), 0);
        let (mut now_ns, mut heartbeats) = (0, 0);
        while board.rows[0].told.1 == GuardVerdict::Ok {
            let wait_ns = board.tick(now_ns);
            assert!(wait_ns > 0 && wait_ns <= board.heartbeat_ns, "{wait_ns}");
            now_ns += wait_ns;
            heartbeats += 1;
        }
        assert!(heartbeats >= 5, "{heartbeats}");
        assert_eq!(board.rows[0].told, (100 * MS + 1, GuardVerdict::Stale));
        board.close(now_ns);
        assert_eq!(board.rows[0].told.1, GuardVerdict::Stop);
    }
}
