//! The reading thread: connects, talks until the connection ends, waits and repeats, until told to stop.

use std::thread;
use std::time::{Duration, Instant};

use super::{Connect, Dialogue, Inbox, Link};
use crate::HostStamp;

/// Time limits and queue size of a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamOptions {
    /// Longest wait for the device's first answer.
    pub patience: Duration,
    /// Time without any byte before reconnecting.
    pub silence: Duration,
    /// Time without a complete frame before reconnecting, although bytes or damaged frames arrive.
    pub frame: Duration,
    /// Wait before the second attempt to connect. Doubles with each further attempt.
    pub first_wait: Duration,
    /// Longest wait between attempts.
    pub longest_wait: Duration,
    /// Queue size in frames.
    pub queue: usize,
}

impl Default for StreamOptions {
    /// 5 s, 2 s, 3 s, 0.1 s, 2 s, 256 frames.
    fn default() -> Self {
        Self {
            patience: Duration::from_secs(5),
            silence: Duration::from_secs(2),
            frame: Duration::from_secs(3),
            first_wait: Duration::from_millis(100),
            longest_wait: Duration::from_secs(2),
            queue: 256,
        }
    }
}

/// Longest sleep between checks of the stop flag.
const NAP: Duration = Duration::from_millis(20);
/// Maximum number of bytes per read from the port.
const CHUNK: usize = 64 * 1024;

pub(super) fn run(
    mut connect: Box<dyn Connect>,
    mut dialogue: Box<dyn Dialogue>,
    mut inbox: Inbox,
    options: StreamOptions,
) {
    let shared = inbox.shared();
    let mut wait = options.first_wait;
    let mut ended = LogLimit::default();
    let mut watchdog = Watchdog::new(connect.name());
    let mut buffer = vec![0; CHUNK];
    while !shared.is_stopped() {
        let before = inbox.taken();
        let reason = match connect.connect() {
            Ok(mut link) => {
                shared.connected();
                let ended = talk(link.as_mut(), dialogue.as_mut(), &mut inbox, &mut buffer, options, &mut watchdog);
                match ended {
                    Ok(()) => return,
                    Err(reason) => reason,
                }
            }
            Err(error) => format!("cannot connect: {error}"),
        };
        if inbox.taken() > before {
            wait = options.first_wait;
        }
        if let Some(times) = ended.count(&reason) {
            let times = if times > 1 { format!(" ({times} times)") } else { String::new() };
            tracing::warn!("{}: {reason}{times}; next attempt in {} ms", connect.name(), wait.as_millis());
        }
        shared.troubled(reason);
        let until = Instant::now() + wait;
        while !shared.is_stopped() && Instant::now() < until {
            thread::sleep(NAP.min(wait));
        }
        wait = (wait * 2).min(options.longest_wait);
    }
}

/// Runs one connection. Returns `Ok` when told to stop, or the reason why the connection is no longer usable.
fn talk(
    link: &mut dyn Link,
    dialogue: &mut dyn Dialogue,
    inbox: &mut Inbox,
    buffer: &mut [u8],
    options: StreamOptions,
    watchdog: &mut Watchdog,
) -> Result<(), String> {
    let shared = inbox.shared();
    let opened = Instant::now();
    let (silence, mut heard) = (options.silence, opened);
    watchdog.begin(inbox);
    let mut introduced = false;
    let mut send = Vec::new();
    dialogue.open(&mut send);
    while !shared.is_stopped() {
        if !send.is_empty() {
            link.write(&send).map_err(|error| format!("cannot send: {error}"))?;
            send.clear();
        }
        let count = link.read(buffer).map_err(|error| format!("connection ended: {error}"))?;
        if count > 0 {
            heard = Instant::now();
            dialogue.receive(&buffer[..count], HostStamp::now(), inbox, &mut send)?;
            watchdog.heard(count, inbox, dialogue.is_frames_only(), options.frame)?;
        } else if heard.elapsed() > silence {
            return Err(format!("silent for {:.1} s", silence.as_secs_f64()));
        }
        dialogue.tick(opened.elapsed(), &mut send)?;
        if !introduced && let Some(layout) = dialogue.layout() {
            introduced = true;
            shared.introduced(layout, dialogue.identity());
        }
    }
    send.clear();
    dialogue.close(&mut send);
    // The device may be gone; this message is only a courtesy.
    let _ = link.write(&send);
    Ok(())
}

/// Number of bytes without a complete frame that no instrument would send.
const MOST_BYTES: u64 = 256 * 1024;
/// Number of damaged frames in a row that a disturbance can't explain.
const MOST_DAMAGED: u64 = 8;
/// Longest time between frames expected of any instrument, in multiples of the deadline.
const SLOWEST: u32 = 10;

/// Watches for a device that sends bytes but no complete frames.
struct Watchdog {
    name: String,
    damaged: LogLimit,
    /// Time of the last complete frame, followed by the numbers of frames and of damaged ones at that time, and the
    /// number of bytes since.
    since: Instant,
    taken: u64,
    bad: u64,
    bytes: u64,
    /// Number of damaged frames that have been logged.
    seen: u64,
    troubled: bool,
}

impl Watchdog {
    fn new(name: &str) -> Self {
        let (name, damaged, since) = (name.to_owned(), LogLimit::default(), Instant::now());
        Self { name, damaged, since, taken: 0, bad: 0, bytes: 0, seen: 0, troubled: false }
    }

    /// Restarts the watch, for a new connection or after a complete frame.
    fn begin(&mut self, inbox: &Inbox) {
        (self.since, self.taken, self.bad, self.bytes) = (Instant::now(), inbox.taken(), inbox.losses().1, 0);
    }

    /// Checks the deadline after `count` bytes have been processed.
    fn heard(&mut self, count: usize, inbox: &mut Inbox, frames_only: bool, patience: Duration) -> Result<(), String> {
        let bad = inbox.losses().1;
        if bad > self.seen {
            self.seen = bad;
            let reason = inbox.reason().unwrap_or("it fails its checks");
            if self.damaged.count(reason).is_some() {
                tracing::warn!("{}: a frame is damaged, {bad} so far: {reason}", self.name);
            }
        }
        if inbox.taken() > self.taken {
            if std::mem::take(&mut self.troubled) {
                inbox.shared().recovered();
            }
            self.begin(inbox);
            return Ok(());
        }
        self.bytes += count as u64;
        let (damaged, late) = (bad - self.bad, self.since.elapsed());
        let is_stuck = self.bytes >= MOST_BYTES || damaged >= MOST_DAMAGED;
        if !(late > patience && (is_stuck || (frames_only && late > SLOWEST * patience))) {
            return Ok(());
        }
        self.troubled = true;
        let why = match (damaged, inbox.reason()) {
            (0, _) => {
                // Bytes that make up no frame count as damage.
                inbox.bad(1);
                self.seen += 1;
                format!("{} bytes came", self.bytes)
            }
            (_, None) => format!("{damaged} damaged frames arrived"),
            (_, Some(reason)) => format!("{damaged} damaged frames arrived: {reason}"),
        };
        Err(format!("no whole frame for {:.1} s, although {why}", late.as_secs_f64()))
    }
}

/// Rate limit for repeated log messages: the 1st, 2nd, 4th, 8th ... occurrence is logged. Counts repetitions of a
/// message. Messages that differ only in their digits count as the same.
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

    /// A deadline that is never reached within a test, and one that has always passed.
    const NEVER: Duration = Duration::from_secs(3600);
    const OVER: Duration = Duration::ZERO;

    fn watchdog() -> (Watchdog, Inbox, std::sync::mpsc::Receiver<crate::Frame>) {
        let (inbox, frames, _) = Inbox::new(8);
        let mut watchdog = Watchdog::new("tcp:skin:1");
        watchdog.begin(&inbox);
        (watchdog, inbox, frames)
    }

    #[test]
    fn many_bytes_without_a_frame_end_a_connection_and_few_do_not() {
        let (mut watchdog, mut inbox, _frames) = watchdog();
        let most = MOST_BYTES as usize;
        assert_eq!(watchdog.heard(most - 1, &mut inbox, false, OVER), Ok(()));
        let error = watchdog.heard(1, &mut inbox, false, OVER).unwrap_err();
        assert!(error.starts_with("no whole frame for 0.0 s, although 262144 bytes came"), "{error}");
        assert_eq!(inbox.losses(), (0, 1), "the bytes count as a damaged frame");
    }

    #[test]
    fn nothing_is_due_before_the_deadline() {
        let (mut watchdog, mut inbox, _frames) = watchdog();
        for _ in 0..100 {
            inbox.bad(1);
            assert_eq!(watchdog.heard(1 << 20, &mut inbox, true, NEVER), Ok(()));
        }
    }

    #[test]
    fn damaged_frames_in_a_row_end_a_connection_with_the_reason() {
        let (mut watchdog, mut inbox, _frames) = watchdog();
        for damaged in 1..=MOST_DAMAGED {
            inbox.bad_because("a line of 100 numbers, expected 208".to_owned());
            let heard = watchdog.heard(100, &mut inbox, false, OVER);
            assert_eq!(heard.is_err(), damaged == MOST_DAMAGED, "after {damaged}");
            if let Err(reason) = heard {
                assert!(reason.ends_with("8 damaged frames arrived: a line of 100 numbers, expected 208"), "{reason}");
            }
        }
        assert_eq!(inbox.losses(), (0, MOST_DAMAGED));
    }

    #[test]
    fn any_byte_of_a_stream_of_frames_must_lead_to_a_frame() {
        let (mut watchdog, mut inbox, _frames) = watchdog();
        assert!(watchdog.heard(1, &mut inbox, true, OVER).is_err());
    }

    #[test]
    fn a_complete_frame_resets_the_watchdog() {
        let (mut watchdog, mut inbox, _frames) = watchdog();
        let reason = watchdog.heard(MOST_BYTES as usize, &mut inbox, false, OVER).unwrap_err();
        inbox.shared().troubled(reason);
        watchdog.begin(&inbox);
        inbox.take(|frame| frame.values.push(1.0));
        assert_eq!(watchdog.heard(4, &mut inbox, false, OVER), Ok(()));
        assert_eq!(inbox.shared().problem(), None);
        // Earlier bytes no longer count.
        assert_eq!(watchdog.heard(MOST_BYTES as usize - 1, &mut inbox, false, OVER), Ok(()));
    }

    #[test]
    fn repeated_messages_become_rarer_and_new_ones_are_logged_at_once() {
        let mut limit = LogLimit::default();
        let told = (0..1000).filter(|k| limit.count(&format!("silent for {k} s")).is_some()).count();
        assert_eq!(told, 10);
        assert_eq!(limit.count("connection refused"), Some(1));
        assert_eq!(limit.count("silent for 2.0 s"), Some(1));
    }
}
