//! Separators between the cells of a line.

/// Separator between cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Separator {
    /// A single character: comma, semicolon, tab or bar.
    Mark(u8),
    /// One or more blanks.
    Spaces,
}

impl Separator {
    /// All separators, in the order in which they are tried.
    pub(super) const ALL: [Self; 5] =
        [Self::Mark(b'\t'), Self::Mark(b';'), Self::Mark(b','), Self::Mark(b'|'), Self::Spaces];

    /// The cells of a line, without surrounding blanks and double quotes. Separators inside quotes don't count.
    pub(super) fn cells(self, line: &str) -> Cells<'_> {
        Cells { line, at: Some(0), separator: self }
    }

    /// The cell that begins at `start`, trimmed and unquoted, and the position of its end.
    pub(super) fn cell_at(self, line: &str, start: usize) -> (&str, usize) {
        let bytes = line.as_bytes();
        let mut is_quoted = false;
        let is_end = |byte: u8| match self {
            Self::Mark(mark) => byte == mark,
            Self::Spaces => byte.is_ascii_whitespace(),
        };
        let length = bytes[start..].iter().position(|byte| {
            is_quoted ^= *byte == b'"';
            !is_quoted && is_end(*byte)
        });
        let end = length.map_or(bytes.len(), |length| start + length);
        (unquote(&line[start..end]), end)
    }
}

/// The cells of one line.
pub(super) struct Cells<'a> {
    line: &'a str,
    /// Start of the next cell; `None` after the last.
    at: Option<usize>,
    separator: Separator,
}

impl<'a> Iterator for Cells<'a> {
    type Item = &'a str;

    fn next(&mut self) -> Option<&'a str> {
        let mut start = self.at?;
        if self.separator == Separator::Spaces {
            let rest = &self.line[start..];
            start += rest.len() - rest.trim_start().len();
            if start == self.line.len() {
                self.at = None;
                return None;
            }
        }
        let (cell, end) = self.separator.cell_at(self.line, start);
        self.at = (end < self.line.len()).then_some(end + 1);
        Some(cell)
    }
}

fn unquote(cell: &str) -> &str {
    let cell = cell.trim();
    cell.strip_prefix('"').and_then(|cell| cell.strip_suffix('"')).map_or(cell, str::trim)
}
