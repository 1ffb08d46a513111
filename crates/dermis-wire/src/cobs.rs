//! Consistent overhead byte stuffing (Cheshire and Baker, IEEE/ACM Transactions on Networking 7, 1999): zeros are
//! replaced with the distance to the next zero, so a zero on the line always marks the end of a packet.

/// Code of a group with 254 bytes and no zero after them.
const FULL: u8 = 0xff;

/// Stuffs incoming bytes into a buffer, between two delimiters.
pub(crate) struct Stuffer<'b> {
    out: &'b mut [u8],
    at: usize,
    code_at: usize,
    code: u8,
}

/// Error: the buffer is full.
pub(crate) struct Full;

impl<'b> Stuffer<'b> {
    pub(crate) fn new(out: &'b mut [u8]) -> Result<Self, Full> {
        *out.first_mut().ok_or(Full)? = 0;
        let mut stuffer = Self { out, at: 1, code_at: 1, code: 1 };
        stuffer.open()?;
        Ok(stuffer)
    }

    pub(crate) fn push(&mut self, byte: u8) -> Result<(), Full> {
        if self.code == FULL {
            self.close();
            self.open()?;
        }
        if byte == 0 {
            self.close();
            return self.open();
        }
        self.put(byte)?;
        self.code += 1;
        Ok(())
    }

    /// Closes the packet; returns its bytes with both delimiters.
    pub(crate) fn finish(mut self) -> Result<&'b mut [u8], Full> {
        self.close();
        self.put(0)?;
        Ok(&mut self.out[..self.at])
    }

    /// Reserves a byte for the next group's code.
    fn open(&mut self) -> Result<(), Full> {
        self.code_at = self.at;
        self.code = 1;
        self.put(0)
    }

    fn close(&mut self) {
        self.out[self.code_at] = self.code;
    }

    fn put(&mut self, byte: u8) -> Result<(), Full> {
        *self.out.get_mut(self.at).ok_or(Full)? = byte;
        self.at += 1;
        Ok(())
    }
}

/// Removes the stuffing in place. Returns the number of bytes left, or `None` if the bytes are not valid stuffing.
pub(crate) fn unstuff(bytes: &mut [u8]) -> Option<usize> {
    let (mut read, mut written) = (0, 0);
    while read < bytes.len() {
        let code = bytes[read];
        let end = read + usize::from(code);
        if code == 0 || end > bytes.len() {
            return None;
        }
        bytes.copy_within(read + 1..end, written);
        written += usize::from(code) - 1;
        read = end;
        if code != FULL && read < bytes.len() {
            bytes[written] = 0;
            written += 1;
        }
    }
    Some(written)
}
