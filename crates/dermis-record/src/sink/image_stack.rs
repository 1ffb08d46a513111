//! Images as one NumPy array, frames x rows x columns in single precision, streamed to disk so that memory doesn't
//! grow with the run. The header, whose length doesn't depend on the number of frames, is rewritten at the end.

use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use dermis_device::instruments::npy;

use super::interface::{Sink, Summary};
use super::staged::StagedFile;
use super::touch_table::finished;
use crate::Error;
use dermis_live::skin_frame::SkinFrame;

/// Writes an `.npy` file of shape (frames, rows, columns), little-endian `f4`, NaN outside the skin.
///
/// The target must be seekable: a file, not a pipe.
#[derive(Debug)]
pub struct ImageStack {
    path: PathBuf,
    file: Option<StagedFile>,
    rows: usize,
    columns: usize,
    header_bytes: u64,
    /// The bytes of one image; reused.
    bytes: Vec<u8>,
    summary: Summary,
}

impl ImageStack {
    /// Starts a stack of images of `rows` x `columns`, which appears at `path` once finished.
    ///
    /// # Errors
    /// An I/O error if no file can be created next to `path`, or if it isn't seekable.
    pub fn create(path: &Path, rows: usize, columns: usize) -> Result<Self, Error> {
        let mut file = StagedFile::create(path)?;
        npy::write_header::<f32>(&mut file, &[0, rows, columns]).map_err(Error::io(path))?;
        let header_bytes = file.stream_position().map_err(Error::io(path))?;
        let bytes = Vec::with_capacity(rows.saturating_mul(columns).saturating_mul(size_of::<f32>()));
        let summary = Summary::default();
        Ok(Self { path: path.to_owned(), file: Some(file), rows, columns, header_bytes, bytes, summary })
    }
}

impl Sink for ImageStack {
    fn accept(&mut self, output: &SkinFrame<'_>) -> Result<(), Error> {
        let file = self.file.as_mut().ok_or_else(|| finished(&self.path))?;
        let count = self.rows.saturating_mul(self.columns);
        if (output.rows, output.columns, output.image.len()) != (self.rows, self.columns, count) {
            return Err(Error::Live(dermis_live::Error::Frames {
                what: format!("image of frame {}", output.sequence),
                expected: format!("{} x {} = {count} pixels", self.rows, self.columns),
                got: format!("{} x {}, {} pixels", output.rows, output.columns, output.image.len()),
            }));
        }
        self.bytes.clear();
        self.bytes.extend(output.image.iter().flat_map(|value| value.to_le_bytes()));
        file.write_all(&self.bytes).map_err(Error::io(&self.path))?;
        self.summary.frames += 1;
        self.summary.written += 1;
        Ok(())
    }

    fn finish(&mut self) -> Result<Summary, Error> {
        let Some(mut file) = self.file.take() else { return Ok(self.summary) };
        let frames = usize::try_from(self.summary.frames).unwrap_or(usize::MAX);
        let mut header = Vec::new();
        npy::write_header::<f32>(&mut header, &[frames, self.rows, self.columns]).map_err(Error::io(&self.path))?;
        if header.len() as u64 != self.header_bytes {
            return Err(Error::Live(dermis_live::Error::Content {
                file: self.path.clone(),
                field: "header".to_owned(),
                reason: format!("{frames} frames need {} bytes, {} are reserved", header.len(), self.header_bytes),
            }));
        }
        file.seek(SeekFrom::Start(0)).and_then(|_| file.write_all(&header)).map_err(Error::io(&self.path))?;
        file.finish()?;
        Ok(self.summary)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::output;
    use super::*;

    #[test]
    fn a_stack_reads_back_bit_for_bit() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("i.npy");
        let mut stack = ImageStack::create(&path, 2, 3).unwrap();
        let images: Vec<[f32; 6]> = (0..1234).map(|n| [f32::NAN, 0.1, -0.0, n as f32, 1e-30, f32::MAX]).collect();
        for (sequence, image) in images.iter().enumerate() {
            stack.accept(&output(sequence as u64, image, &[], &[])).unwrap();
        }
        assert!(!path.exists(), "nothing may stand under the final name before the end");
        assert_eq!(stack.finish().unwrap(), Summary { frames: 1234, written: 1234 });
        let array = npy::read(&path).unwrap();
        assert_eq!(array.shape, [1234, 2, 3]);
        let bits: Vec<u32> = array.values.iter().map(|&value| (value as f32).to_bits()).collect();
        let expected: Vec<u32> = images.iter().flatten().map(|value| value.to_bits()).collect();
        assert_eq!(bits, expected);
    }

    #[test]
    fn other_shapes_are_refused_and_an_empty_stack_is_valid() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("i.npy");
        let mut stack = ImageStack::create(&path, 3, 2).unwrap();
        let message = stack.accept(&output(9, &[0.0; 6], &[], &[])).unwrap_err().to_string();
        assert_eq!(message, "image of frame 9: expected 3 x 2 = 6 pixels, got 2 x 3, 6 pixels");
        stack.finish().unwrap();
        assert_eq!(npy::read(&path).unwrap().shape, [0, 3, 2]);
    }
}
