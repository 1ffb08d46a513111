//! The reading thread: connect, talk until the connection ends, wait, and again, until told to stop.

use std::thread;
use std::time::{Duration, Instant};

use super::{Connect, Dialogue, Inbox, Link, StreamOptions};
use crate::HostStamp;

/// Longest sleep before looking whether to stop.
const NAP: Duration = Duration::from_millis(20);
/// Bytes taken from a port at once.
const CHUNK: usize = 64 * 1024;

pub(super) fn run(
    mut connect: Box<dyn Connect>,
    mut dialogue: Box<dyn Dialogue>,
    mut inbox: Inbox,
    options: StreamOptions,
) {
    let shared = inbox.shared();
    let mut wait = options.first_wait;
    let mut buffer = vec![0; CHUNK];
    while !shared.is_stopped() {
        let before = inbox.taken();
        let reason = match connect.connect() {
            Ok(mut link) => {
                shared.connected();
                let ended = talk(link.as_mut(), dialogue.as_mut(), &mut inbox, &mut buffer, options.silence);
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
        tracing::warn!("{}: {reason}; next attempt in {} ms", connect.name(), wait.as_millis());
        shared.disconnected(reason);
        let until = Instant::now() + wait;
        while !shared.is_stopped() && Instant::now() < until {
            thread::sleep(NAP.min(wait));
        }
        wait = (wait * 2).min(options.longest_wait);
    }
}

/// Talks until told to stop (`Ok`) or the connection is of no further use (why).
fn talk(
    link: &mut dyn Link,
    dialogue: &mut dyn Dialogue,
    inbox: &mut Inbox,
    buffer: &mut [u8],
    silence: Duration,
) -> Result<(), String> {
    let shared = inbox.shared();
    let opened = Instant::now();
    let mut heard = opened;
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
    // The device may have gone; this is a courtesy.
    let _ = link.write(&send);
    Ok(())
}
