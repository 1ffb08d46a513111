//! Reads the triangles of mesh files: STL, binary and text, and OBJ. Other formats are refused, and everything except
//! corners is ignored: colours, textures, normals.

use std::path::Path;

/// Largest mesh file, bytes.
const MOST_BYTES: u64 = 128 << 20;
/// Bytes of an STL file before its triangles, and of each triangle.
const STL_HEAD: usize = 84;
const STL_TRIANGLE: usize = 50;

/// Corners of the triangles in a mesh file, three each, in the file's own unit.
///
/// # Errors
/// The file cannot be read or is too large, its format is another, or a line or number is malformed. The message says
/// what was expected.
pub fn read_triangles(file: &Path) -> Result<Vec<[f32; 3]>, String> {
    let ending = file.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default();
    if !["stl", "obj"].contains(&ending.as_str()) {
        return Err(format!("format {:?}: expected STL or OBJ", ending.to_uppercase()));
    }
    let length = std::fs::metadata(file).map_err(|error| error.to_string())?.len();
    if length > MOST_BYTES {
        return Err(format!("{length} bytes: expected at most {MOST_BYTES}"));
    }
    let bytes = std::fs::read(file).map_err(|error| error.to_string())?;
    let corners = match ending.as_str() {
        "obj" => obj(&String::from_utf8_lossy(&bytes))?,
        _ => binary_stl(&bytes).map_or_else(|| text_stl(&String::from_utf8_lossy(&bytes)), Ok)?,
    };
    if corners.is_empty() || corners.iter().flatten().any(|number| !number.is_finite()) {
        return Err("no triangles, or corners that are not finite: expected a mesh".to_owned());
    }
    Ok(corners)
}

/// `None` if the length doesn't fit the number of triangles, as in a text file.
fn binary_stl(bytes: &[u8]) -> Option<Vec<[f32; 3]>> {
    let count = u32::from_le_bytes(bytes.get(80..STL_HEAD)?.try_into().ok()?) as usize;
    let triangles = bytes.get(STL_HEAD..)?;
    if triangles.len() != count.checked_mul(STL_TRIANGLE)? {
        return None;
    }
    let number = |four: &[u8]| four.try_into().map_or(f32::NAN, f32::from_le_bytes);
    // The normal comes first and two bytes of attributes last.
    let corners = |triangle: &[u8]| -> Vec<[f32; 3]> {
        let corner = |bytes: &[u8]| [number(&bytes[..4]), number(&bytes[4..8]), number(&bytes[8..])];
        triangle[12..48].chunks_exact(12).map(corner).collect()
    };
    Some(triangles.chunks_exact(STL_TRIANGLE).flat_map(corners).collect())
}

fn text_stl(text: &str) -> Result<Vec<[f32; 3]>, String> {
    let vertices = text.lines().enumerate().filter_map(|(index, line)| {
        let numbers = line.trim_start().strip_prefix("vertex")?;
        Some(three_numbers(numbers).ok_or_else(|| format!("line {}: expected vertex X Y Z", index + 1)))
    });
    let corners: Vec<[f32; 3]> = vertices.collect::<Result<_, _>>()?;
    if corners.len().is_multiple_of(3) { Ok(corners) } else { Err("expected three vertices per facet".to_owned()) }
}

fn obj(text: &str) -> Result<Vec<[f32; 3]>, String> {
    let (mut vertices, mut corners) = (Vec::new(), Vec::new());
    for (index, line) in text.lines().enumerate() {
        let fault = |expected: &str| format!("line {}: expected {expected}", index + 1);
        if let Some(numbers) = line.strip_prefix("v ") {
            vertices.push(three_numbers(numbers).ok_or_else(|| fault("v X Y Z"))?);
        } else if let Some(words) = line.strip_prefix("f ") {
            // Vertices count from 1; negative numbers count back from the newest.
            let vertex = |word: &str| -> Option<[f32; 3]> {
                let number: i64 = word.split('/').next()?.parse().ok()?;
                let place = if number < 0 { vertices.len() as i64 + number } else { number - 1 };
                vertices.get(usize::try_from(place).ok()?).copied()
            };
            let face: Option<Vec<[f32; 3]>> = words.split_whitespace().map(vertex).collect();
            let face =
                face.filter(|face| face.len() >= 3).ok_or_else(|| fault("f with three known vertices or more"))?;
            corners.extend(face[1..].windows(2).flat_map(|pair| [face[0], pair[0], pair[1]]));
        }
    }
    Ok(corners)
}

fn three_numbers(text: &str) -> Option<[f32; 3]> {
    let mut numbers = text.split_whitespace().map(|word| word.parse().ok());
    Some([numbers.next()??, numbers.next()??, numbers.next()??])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(name: &str, content: &[u8]) -> Result<Vec<[f32; 3]>, String> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join(name);
        std::fs::write(&file, content).unwrap();
        read_triangles(&file)
    }

    const CORNERS: [[f32; 3]; 3] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.5]];

    #[test]
    fn three_formats_give_the_same_triangle() {
        let mut binary = vec![b'x'; 80];
        binary.extend(1u32.to_le_bytes());
        let numbers = [[0.0, 0.0, 1.0]].into_iter().chain(CORNERS).flatten();
        binary.extend(numbers.flat_map(f32::to_le_bytes));
        binary.extend([0, 0]);
        assert_eq!(read("a.STL", &binary).unwrap(), CORNERS);
        let text =
            "solid a\nfacet normal 0 0 1\n outer loop\n  vertex 0 0 0\n  vertex 1 0 0\n  vertex 0 2 5e-1\n endloop\n";
        assert_eq!(read("a.stl", text.as_bytes()).unwrap(), CORNERS);
        let obj = "# one\nv 0 0 0\nv 1 0 0\nvn 0 0 1\nv 0 2 0.5\nf 1/1/1 2//1 -1\n";
        assert_eq!(read("a.obj", obj.as_bytes()).unwrap(), CORNERS);
    }

    #[test]
    fn a_face_of_four_corners_is_two_triangles() {
        let obj = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n";
        assert_eq!(read("a.obj", obj.as_bytes()).unwrap()[3..], [[0.0; 3], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]);
    }

    #[test]
    fn malformed_files_say_what_was_expected() {
        for (name, text, expected) in [
            ("a.dae", "<COLLADA/>", "expected STL or OBJ"),
            ("a.obj", "v 0 0\n", "line 1: expected v X Y Z"),
            ("a.obj", "v 0 0 0\nf 1 2 3\n", "line 2: expected f"),
            ("a.stl", "solid a\nvertex 0 0 0\n", "three vertices per facet"),
            ("a.stl", "solid a\n", "no triangles"),
        ] {
            let refusal = read(name, text.as_bytes()).unwrap_err();
            assert!(refusal.contains(expected), "{name}: {refusal}");
        }
    }
}
