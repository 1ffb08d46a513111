//! Decodes the text encodings that spreadsheets and loggers write: UTF-8, UTF-16 of either byte order with or without
//! a byte-order mark, and Windows-1252.

use std::borrow::Cow;
use std::path::Path;

use encoding_rs::{Encoding, UTF_16BE, UTF_16LE, WINDOWS_1252};

use super::foreign;
use crate::DeviceError;

/// Number of bytes to inspect for an encoding without a byte-order mark.
const LOOKED_AT: usize = 4096;

/// Text, and its encoding if that isn't UTF-8.
pub(super) struct Text<'a> {
    pub text: Cow<'a, str>,
    pub encoding: Option<&'static str>,
}

impl<'a> Text<'a> {
    /// The content as text without a byte-order mark, with line feeds as line ends.
    ///
    /// # Errors
    /// [`DeviceError::Foreign`] with a description of the content.
    pub fn of(content: &'a [u8], file: &Path, expected: &'static str) -> Result<Self, DeviceError> {
        let (text, encoding) = decoded(content).ok_or_else(|| foreign(file, expected, content))?;
        // Line ends of old Macintosh files.
        let text = if text.contains('\r') && !text.contains('\n') { text.replace('\r', "\n").into() } else { text };
        Ok(Self { text, encoding })
    }
}

fn decoded(content: &[u8]) -> Option<(Cow<'_, str>, Option<&'static str>)> {
    let bare = content.strip_prefix(b"\xef\xbb\xbf").unwrap_or(content);
    let looks_wide =
        content.starts_with(b"\xff\xfe") || content.starts_with(b"\xfe\xff") || wide_order(content).is_some();
    if !looks_wide && let Ok(text) = std::str::from_utf8(bare) {
        return (!text.contains('\0')).then_some((Cow::Borrowed(text), None));
    }
    let encoding: &'static Encoding = match Encoding::for_bom(content) {
        Some((encoding, _)) => encoding,
        None => wide_order(content).unwrap_or(WINDOWS_1252),
    };
    // Text tables contain no control characters.
    let is_text = |text: &str| !text.contains(|c: char| c.is_control() && !matches!(c, '\t' | '\n' | '\r' | '\u{c}'));
    let (text, _, had_errors) = encoding.decode(content);
    (!had_errors && is_text(&text)).then(|| (text, Some(encoding.name())))
}

/// Recognises UTF-16 without a byte-order mark: in ASCII text every second byte is zero.
fn wide_order(content: &[u8]) -> Option<&'static Encoding> {
    let (pairs, _) = content[..content.len().min(LOOKED_AT)].as_chunks::<2>();
    let zeros = |which: usize| pairs.iter().filter(|pair| pair[which] == 0 && pair[1 - which] != 0).count();
    let most = |which: usize| pairs.len() >= 4 && 10 * zeros(which) >= 9 * pairs.len();
    if !content.len().is_multiple_of(2) {
        None
    } else if most(1) {
        Some(UTF_16LE)
    } else if most(0) {
        Some(UTF_16BE)
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_encoding_gives_the_same_text() {
        let text = "Zeit (µs);1,5\n2;3\n";
        let wide = |order: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(order).collect::<Vec<u8>>();
        let marked = |mark: &[u8], rest: Vec<u8>| [mark, &rest].concat();
        for (content, encoding) in [
            (text.as_bytes().to_vec(), None),
            (marked(b"\xef\xbb\xbf", text.into()), None),
            (marked(b"\xff\xfe", wide(u16::to_le_bytes)), Some("UTF-16LE")),
            (marked(b"\xfe\xff", wide(u16::to_be_bytes)), Some("UTF-16BE")),
            (wide(u16::to_le_bytes), Some("UTF-16LE")),
            (wide(u16::to_be_bytes), Some("UTF-16BE")),
            (text.chars().map(|c| c as u8).collect(), Some("windows-1252")),
        ] {
            let read = Text::of(&content, Path::new("a.csv"), "text").unwrap();
            assert_eq!((read.text.as_ref(), read.encoding), (text, encoding));
        }
        assert_eq!(Text::of(b"1\r2\r", Path::new("a.csv"), "text").unwrap().text, "1\n2\n");
        assert!(Text::of(b"\0\x01\x02\xff", Path::new("a.csv"), "text").is_err());
        assert!(Text::of(b"\x01\x02\xff\xee", Path::new("a.csv"), "text").is_err());
    }
}
