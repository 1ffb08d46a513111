//! One reader of a guard's socket. Nothing waits for it.

use std::io::{self, Write};
use std::net::TcpStream;
#[cfg(unix)]
use std::os::unix::net::UnixStream;

/// A reader that has taken nothing for this long is disconnected, nanoseconds: its buffer holds old verdicts.
const LONGEST_STALL_NS: u64 = 1_000_000_000;

/// A connection that never blocks.
#[derive(Debug)]
pub(super) enum Stream {
    Tcp(TcpStream),
    #[cfg(unix)]
    Unix(UnixStream),
}

/// A reader and the rest of a line that it has received in part.
#[derive(Debug)]
pub(super) struct Reader<S = Stream> {
    stream: S,
    rest: Vec<u8>,
    stalled_since_ns: Option<u64>,
}

/// A place to write to without waiting.
pub(super) trait Sending {
    /// Writes what fits; an error of kind `WouldBlock` if nothing does.
    fn send(&mut self, bytes: &[u8]) -> io::Result<usize>;
}

impl Sending for Stream {
    fn send(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Tcp(stream) => stream.write(bytes),
            #[cfg(unix)]
            Self::Unix(stream) => stream.write(bytes),
        }
    }
}

impl<S: Sending> Reader<S> {
    pub fn new(stream: S) -> Self {
        Self { stream, rest: Vec::new(), stalled_since_ns: None }
    }

    /// Sends a whole line, or skips it if the reader is behind. False if the reader is gone, or was disconnected for
    /// staying behind.
    pub fn send(&mut self, line: &[u8], now_ns: u64) -> bool {
        match self.try_send(line) {
            Ok(true) => {
                self.stalled_since_ns = None;
                true
            }
            Ok(false) => {
                let since_ns = *self.stalled_since_ns.get_or_insert(now_ns);
                now_ns.saturating_sub(since_ns) < LONGEST_STALL_NS
            }
            Err(_) => false,
        }
    }

    /// Sends the rest of an earlier line and then this one. False if there was no room for all of it.
    fn try_send(&mut self, line: &[u8]) -> io::Result<bool> {
        let sent = write_what_fits(&mut self.stream, &self.rest)?;
        self.rest.drain(..sent);
        if !self.rest.is_empty() {
            return Ok(false);
        }
        let sent = write_what_fits(&mut self.stream, line)?;
        if sent > 0 {
            // Lines are never truncated: the rest of a partly sent one follows later.
            self.rest.extend_from_slice(&line[sent..]);
        }
        Ok(sent == line.len())
    }
}

/// Returns the number of bytes written.
fn write_what_fits(stream: &mut impl Sending, bytes: &[u8]) -> io::Result<usize> {
    let mut sent = 0;
    while sent < bytes.len() {
        match stream.send(&bytes[sent..]) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(count) => sent += count,
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(sent)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A buffer with little room.
    #[derive(Default)]
    struct Narrow {
        room: usize,
        got: Vec<u8>,
    }

    impl Sending for Narrow {
        fn send(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let count = bytes.len().min(self.room);
            if count == 0 {
                return Err(io::ErrorKind::WouldBlock.into());
            }
            self.room -= count;
            self.got.extend_from_slice(&bytes[..count]);
            Ok(count)
        }
    }

    #[test]
    fn lines_are_skipped_whole_while_a_reader_is_behind() {
        let mut reader = Reader::new(Narrow { room: 10, ..Narrow::default() });
        let lines = ["first\n", "second\n", "third\n", "fourth\n", "fifth\n"];
        for (number, line) in lines.iter().enumerate() {
            if number == 3 {
                reader.stream.room = 100;
            }
            assert!(reader.send(line.as_bytes(), number as u64));
        }
        assert_eq!(String::from_utf8_lossy(&reader.stream.got), "first\nsecond\nfourth\nfifth\n");
    }

    #[test]
    fn a_reader_that_stays_behind_is_disconnected_and_needs_no_more_memory() {
        let mut reader = Reader::new(Narrow { room: 3, ..Narrow::default() });
        let sent = |reader: &mut Reader<Narrow>, now_ns| reader.send(b"a line\n", now_ns);
        assert!((0..10).all(|k| sent(&mut reader, k * LONGEST_STALL_NS / 10)));
        assert_eq!(reader.rest.len(), 4);
        assert!(!sent(&mut reader, LONGEST_STALL_NS));
    }
}
