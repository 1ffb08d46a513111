//! Reads the triangles of mesh files: STL, OBJ, PLY, COLLADA and glTF. Colours, textures and normals are ignored. Axes
//! are not converted: in a file with y up, y stays up.

mod bounded_read;
mod collada;
mod gltf;
mod numbers;
mod obj;
mod ply;
mod stl;

use std::path::Path;

use bounded_read::read_whole;

/// Corners of the triangles in a mesh file, three each. COLLADA and glTF files give metres, others their own unit.
///
/// # Errors
/// The file, or one that it refers to, cannot be read or is too large, its format is unknown, or its content is
/// malformed. The message says what was expected.
pub fn read_triangles(file: &Path) -> Result<Vec<[f32; 3]>, String> {
    let ending = mesh_ending(file)?;
    let bytes = read_whole(file)?;
    let corners = match ending.as_str() {
        "stl" => stl::read(&bytes)?,
        "obj" => obj::read(&bytes)?,
        "ply" => ply::read(&bytes)?,
        "dae" => collada::read(&bytes)?,
        _ => gltf::read(file, &bytes)?,
    };
    if corners.is_empty() || corners.iter().flatten().any(|number| !number.is_finite()) {
        return Err("no triangles, or corners that are not finite: expected a mesh".to_owned());
    }
    Ok(corners)
}

/// The ending of a mesh file, in lower case.
///
/// # Errors
/// A format that is not read.
pub(crate) fn mesh_ending(file: &Path) -> Result<String, String> {
    let ending = file.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default();
    if ["stl", "obj", "ply", "dae", "gltf", "glb"].contains(&ending.as_str()) {
        return Ok(ending);
    }
    Err(format!("format {:?}: expected STL, OBJ, PLY, COLLADA (DAE), glTF or GLB", ending.to_uppercase()))
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
    fn malformed_files_are_refused_with_the_expectation() {
        for (name, text, expected) in [
            ("a.3ds", "MM", "format \"3DS\": expected STL, OBJ, PLY, COLLADA (DAE), glTF or GLB"),
            ("a.glb", "glTF", "the header of a GLB file"),
            ("a.ply", "ply\nformat ascii 1.0\n", "end_header"),
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
