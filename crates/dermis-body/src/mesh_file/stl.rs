//! STL, binary and text.

use super::numbers::three_numbers;

/// Bytes before the triangles, and of each triangle.
const HEAD: usize = 84;
const TRIANGLE: usize = 50;

/// Corners of the triangles in an STL file.
///
/// # Errors
/// A malformed line, or facets without three vertices.
pub(super) fn read(bytes: &[u8]) -> Result<Vec<[f32; 3]>, String> {
    binary(bytes).map_or_else(|| text(&String::from_utf8_lossy(bytes)), Ok)
}

/// `None` if the length doesn't fit the number of triangles, as in a text file.
fn binary(bytes: &[u8]) -> Option<Vec<[f32; 3]>> {
    let count = u32::from_le_bytes(bytes.get(80..HEAD)?.try_into().ok()?) as usize;
    let triangles = bytes.get(HEAD..)?;
    if triangles.len() != count.checked_mul(TRIANGLE)? {
        return None;
    }
    let number = |four: &[u8]| four.try_into().map_or(f32::NAN, f32::from_le_bytes);
    // The normal comes first and two bytes of attributes last.
    let corners = |triangle: &[u8]| -> Vec<[f32; 3]> {
        let corner = |bytes: &[u8]| [number(&bytes[..4]), number(&bytes[4..8]), number(&bytes[8..])];
        triangle[12..48].chunks_exact(12).map(corner).collect()
    };
    Some(triangles.chunks_exact(TRIANGLE).flat_map(corners).collect())
}

fn text(text: &str) -> Result<Vec<[f32; 3]>, String> {
    let vertices = text.lines().enumerate().filter_map(|(index, line)| {
        let numbers = line.trim_start().strip_prefix("vertex")?;
        Some(three_numbers(numbers).ok_or_else(|| format!("line {}: expected vertex X Y Z", index + 1)))
    });
    let corners: Vec<[f32; 3]> = vertices.collect::<Result<_, _>>()?;
    if corners.len().is_multiple_of(3) { Ok(corners) } else { Err("expected three vertices per facet".to_owned()) }
}
