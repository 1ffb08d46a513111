//! Output to a terminal. Text from files, instruments and recordings may contain control characters, which would move
//! the cursor, change titles or worse. They are written as `\\x1b` and the like; line ends and tabs are kept.

use std::fmt::Write as _;
use std::io::{self, Write};

/// A writer that blocks control characters.
#[derive(Debug)]
pub struct Plain<W> {
    inner: W,
    /// The first byte of a character that may turn out to be a two-byte control character.
    held: bool,
}

/// The first byte of U+0080 to U+00BF.
const LEAD: u8 = 0xc2;

impl<W: Write> Plain<W> {
    /// A filter in front of `inner`.
    pub fn new(inner: W) -> Self {
        Self { inner, held: false }
    }
}

impl<W: Write> Write for Plain<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let is_plain = |byte: &u8| !(matches!(*byte, LEAD | 0x7f) || *byte < b' ' && !matches!(*byte, b'\n' | b'\t'));
        if !self.held && bytes.iter().all(is_plain) {
            self.inner.write_all(bytes)?;
            return Ok(bytes.len());
        }
        let mut plain = Vec::with_capacity(bytes.len() + 16);
        for &byte in bytes {
            if std::mem::take(&mut self.held) {
                match byte {
                    0x80..=0x9f => {
                        plain.extend_from_slice(format!("\\x{byte:02x}").as_bytes());
                        continue;
                    }
                    _ => plain.push(LEAD),
                }
            }
            match byte {
                LEAD => self.held = true,
                _ if is_plain(&byte) => plain.push(byte),
                _ => plain.extend_from_slice(format!("\\x{byte:02x}").as_bytes()),
            }
        }
        self.inner.write_all(&plain)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        if std::mem::take(&mut self.held) {
            self.inner.write_all(&[LEAD])?;
        }
        self.inner.flush()
    }
}

/// Text without control characters other than line ends and tabs.
pub fn plain(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for character in text.chars() {
        if character.is_control() && !matches!(character, '\n' | '\t') {
            let _ = write!(out, "\\x{:02x}", u32::from(character));
        } else {
            out.push(character);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_escaped_and_other_text_is_kept() {
        let (bad, good) = ("a\x1b]0;title\x07b\u{9b}31m \u{7f}", "a\\x1b]0;title\\x07b\\x9b31m \\x7f");
        assert_eq!(plain(bad), good);
        let kept = "25 \u{b5}m \u{b0} \u{4e2d}\u{1f600}\tline\n";
        assert_eq!(plain(kept), kept);
        for (text, expected) in [(bad, good), (kept, kept)] {
            // In pieces of every size, so that characters are split.
            for size in 1..=text.len() {
                let mut out = Plain::new(Vec::new());
                text.as_bytes().chunks(size).for_each(|piece| out.write_all(piece).unwrap());
                out.flush().unwrap();
                assert_eq!(String::from_utf8(out.inner).unwrap(), expected, "pieces of {size}");
            }
        }
    }
}
