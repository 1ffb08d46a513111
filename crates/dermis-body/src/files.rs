//! Files referenced by a body: bounded reads, `package://` paths, checks of meshes.

use dermis_skin::FileError;

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::error::Error;
use crate::mesh_file::mesh_ending;

/// Bytes of a mesh to examine: enough for the start of every format, and for the first vertex of a text file.
const LOOKED_AT: u64 = 64 << 10;

/// Reads a text of at most `most` bytes.
pub(crate) fn read_text(file: &Path, most: u64) -> Result<String, Error> {
    let io = |source| Error::Io(FileError { file: file.to_path_buf(), source });
    let metadata = std::fs::metadata(file).map_err(io)?;
    let bad = |message: String| io(std::io::Error::new(std::io::ErrorKind::InvalidData, message));
    if !metadata.is_file() {
        return Err(bad("not a file: expected a text file".to_owned()));
    }
    let mut text = String::new();
    let read = File::open(file).and_then(|opened| opened.take(most + 1).read_to_string(&mut text)).map_err(io)?;
    if read as u64 > most {
        return Err(bad(format!("larger than the limit of {most} bytes")));
    }
    Ok(text)
}

/// Path of the file behind a URDF `filename`: a path relative to the URDF file, `file://PATH`, or
/// `package://NAME/PATH`. A package is one of those given, or else a folder with its name in any folder above the
/// URDF file, in `ROS_PACKAGE_PATH`, or below `share` in `AMENT_PREFIX_PATH`.
///
/// # Errors
/// The reason why the file wasn't found, and the expected content.
pub(crate) fn resolve(filename: &str, urdf: &Path, packages: &[(String, PathBuf)]) -> Result<PathBuf, String> {
    let folder = urdf.parent().unwrap_or(Path::new(""));
    if filename.is_empty() {
        return Err("expected the name of a file".to_owned());
    }
    if let Some(path) = filename.strip_prefix("file://") {
        return Ok(folder.join(path));
    }
    let Some(rest) = filename.strip_prefix("package://") else {
        if filename.contains("://") {
            return Err("expected a path, file:// or package://".to_owned());
        }
        return Ok(folder.join(filename));
    };
    // Some files have a third slash, which loaders of robots ignore.
    let parts = rest.trim_start_matches('/').split_once('/');
    let (package, path) = parts.ok_or("expected package://NAME/PATH")?;
    if let Some((_, place)) = packages.iter().find(|(name, _)| name == package) {
        return Ok(place.join(path));
    }
    let absolute = std::path::absolute(urdf).unwrap_or_else(|_| urdf.to_path_buf());
    let above = absolute.ancestors().skip(1).flat_map(|folder| {
        let is_it = folder.file_name().is_some_and(|name| name == package);
        is_it.then(|| folder.to_path_buf()).into_iter().chain([folder.join(package)])
    });
    let listed = |variable: &str| {
        let text = std::env::var_os(variable).unwrap_or_default();
        std::env::split_paths(&text).collect::<Vec<_>>()
    };
    let ros = listed("ROS_PACKAGE_PATH").into_iter().map(|folder| folder.join(package));
    let ament = listed("AMENT_PREFIX_PATH").into_iter().map(|folder| folder.join("share").join(package));
    let place = above.chain(ros).chain(ament).find(|place| place.is_dir());
    let unknown =
        || format!("package {package} was not found: expected packages.{package} = \"FOLDER\" in the body file");
    Ok(place.ok_or_else(unknown)?.join(path))
}

/// Checks that the content of a file matches its ending: STL, OBJ, PLY, COLLADA or glTF.
///
/// # Errors
/// The fault, and the expected content.
pub(crate) fn check_mesh(file: &Path) -> Result<(), String> {
    let ending = mesh_ending(file)?;
    let mut start = Vec::new();
    let found = std::fs::metadata(file).map_err(|error| error.to_string())?;
    // Opening a pipe waits for its writer.
    if !found.is_file() {
        return Err("not a file: expected a mesh".to_owned());
    }
    let length = found.len();
    let opened = File::open(file).map_err(|error| error.to_string())?;
    opened.take(LOOKED_AT).read_to_end(&mut start).map_err(|error| error.to_string())?;
    if start.is_empty() {
        return Err("empty: expected a mesh".to_owned());
    }
    let text = String::from_utf8_lossy(&start);
    let is_it = match ending.as_str() {
        "stl" => {
            let counted = start.get(80..84).and_then(|bytes| bytes.try_into().ok()).map(u32::from_le_bytes);
            // Text files begin with "solid", but so do some programs' binary files.
            counted.is_some_and(|count| length == 84 + 50 * u64::from(count))
                || (text.trim_start().starts_with("solid") && text.contains("facet"))
        }
        "obj" => text.lines().any(|line| line.split_whitespace().next() == Some("v")),
        "dae" => text.contains("<COLLADA"),
        "ply" => text.starts_with("ply"),
        "glb" => start.starts_with(b"glTF"),
        _ => text.trim_start().starts_with('{'),
    };
    if is_it { Ok(()) } else { Err(format!("no {} file, or cut off: expected one whole", ending.to_uppercase())) }
}
