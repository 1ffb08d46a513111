//! Wavefront OBJ.

use super::numbers::{fan, three_numbers};

/// Corners of the triangles in an OBJ file.
///
/// # Errors
/// A malformed line; the message names it.
pub(super) fn read(bytes: &[u8]) -> Result<Vec<[f32; 3]>, String> {
    let text = String::from_utf8_lossy(bytes);
    let (mut vertices, mut corners) = (Vec::new(), Vec::new());
    for (index, line) in text.lines().enumerate() {
        let fault = |expected: &str| format!("line {}: expected {expected}", index + 1);
        let (kind, words) = line.trim_start().split_once(char::is_whitespace).unwrap_or_default();
        if kind == "v" {
            vertices.push(three_numbers(words).ok_or_else(|| fault("v X Y Z"))?);
        } else if kind == "f" {
            // Vertices count from 1; negative numbers count back from the newest.
            let vertex = |word: &str| -> Option<[f32; 3]> {
                let number: i64 = word.split('/').next()?.parse().ok()?;
                let place = if number < 0 { vertices.len() as i64 + number } else { number - 1 };
                vertices.get(usize::try_from(place).ok()?).copied()
            };
            let face: Option<Vec<[f32; 3]>> = words.split_whitespace().map(vertex).collect();
            let face =
                face.filter(|face| face.len() >= 3).ok_or_else(|| fault("f with three known vertices or more"))?;
            corners.extend(fan(&face));
        }
    }
    Ok(corners)
}
