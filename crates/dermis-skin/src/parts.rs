//! `frontend` and `backend` of a skin file may be paths to separate files, so that skins can share them: one
//! instrument reads many frontends. A path is relative to the skin file; the parts of built-in skins are embedded.

use std::fmt;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde::de::value::MapAccessDeserializer;
use serde::de::{DeserializeOwned, Deserializer, MapAccess, Visitor};

use crate::builtin::builtin_part;
use crate::check::Checker;
use crate::error::{Error, FileError};

/// A table in place, or the path of a file that contains it.
pub(crate) enum Part<T> {
    Here(T),
    File(String),
}

impl<'de, T: DeserializeOwned> Deserialize<'de> for Part<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(PartVisitor(PhantomData))
    }
}

struct PartVisitor<T>(PhantomData<T>);

impl<'de, T: DeserializeOwned> Visitor<'de> for PartVisitor<T> {
    type Value = Part<T>;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a table, or the path of a file that holds it")
    }

    fn visit_str<E: serde::de::Error>(self, path: &str) -> Result<Self::Value, E> {
        if path.is_empty() {
            return Err(E::custom("an empty path; expected that of a TOML file"));
        }
        Ok(Part::File(path.to_string()))
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
        T::deserialize(MapAccessDeserializer::new(map)).map(Part::Here)
    }
}

impl<T: DeserializeOwned> Part<T> {
    /// The folder for files named in this part: the part's own folder, or the skin file's.
    pub(crate) fn folder(&self, folder: Option<&Path>) -> Option<PathBuf> {
        match self {
            Part::Here(_) => folder.map(Path::to_path_buf),
            Part::File(path) => folder.and_then(|folder| folder.join(path).parent().map(Path::to_path_buf)),
        }
    }

    pub(crate) fn read(self, field: &'static str, file: &str, folder: Option<&Path>) -> Result<T, Error> {
        let path = match self {
            Part::Here(value) => return Ok(value),
            Part::File(path) => path,
        };
        let checker = Checker { file };
        check_path(field, &path, &checker)?;
        let parse = |text: &str, name: String| {
            toml::from_str(text)
                .map_err(|error| Error::SkinFile { file: name, message: error.to_string().trim_end().to_string() })
        };
        if let Some(folder) = folder {
            let place = folder.join(&path);
            match read_skin_text(&place) {
                Ok(text) => return parse(&text, place.display().to_string()),
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
                Err(source) => return Err(Error::Io(FileError { file: place, source })),
            }
        }
        match builtin_part(&path) {
            Some(text) => parse(text, format!("built-in {field} {path}")),
            None => {
                let expected = "a table, or a TOML file of its own next to the skin file";
                Err(checker.refused(field, format!("{path:?}, which does not exist"), expected))
            }
        }
    }
}

/// Checks that a path stays within the skin file's folder: skin files may come from untrusted sources.
fn check_path(field: &str, path: &str, checker: &Checker<'_>) -> Result<(), Error> {
    if path.is_empty() || Path::new(path).is_absolute() || path.split(['/', '\\']).any(|part| part == "..") {
        let expected = "a path within the skin file's folder";
        return Err(checker.refused(field, format!("{path:?}"), expected));
    }
    Ok(())
}

/// Text of a file named in a skin file, and the file's name for errors.
pub(crate) fn read_beside(
    field: &str,
    path: &str,
    file: &str,
    folder: Option<&Path>,
    expected: &str,
) -> Result<(String, String), Error> {
    let (bytes, name) = read_bytes_beside(field, path, file, folder, expected)?;
    let text = String::from_utf8(bytes);
    text.map(|text| (text, name.clone()))
        .map_err(|_| Error::SkinFile { file: name, message: "not text (UTF-8)".into() })
}

/// Bytes of a file named in a skin file, and the file's name for errors.
pub(crate) fn read_bytes_beside(
    field: &str,
    path: &str,
    file: &str,
    folder: Option<&Path>,
    expected: &str,
) -> Result<(Vec<u8>, String), Error> {
    let checker = Checker { file };
    check_path(field, path, &checker)?;
    let Some(folder) = folder else {
        let expected = format!("{expected}; text has no folder");
        return Err(checker.refused(field, format!("{path:?}"), expected));
    };
    let place = folder.join(path);
    match read_bounded(&place, MOST_BESIDE_BYTES, "a file of a skin") {
        Ok(bytes) => Ok((bytes, place.display().to_string())),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            Err(checker.refused(field, format!("{path:?}, which does not exist"), expected))
        }
        Err(source) => Err(Error::Io(FileError { file: place, source })),
    }
}

/// Maximum size of a file named in a skin file, bytes: enough for a mesh of half a million elements.
const MOST_BESIDE_BYTES: u64 = 1 << 26;

/// Maximum size of a skin file, bytes.
const MOST_BYTES: u64 = 1 << 20;

/// Reads a skin file or a part of one: a regular file of limited size, as UTF-8.
pub(crate) fn read_skin_text(path: &Path) -> std::io::Result<String> {
    use std::io::{Error, ErrorKind::InvalidData};
    let text = String::from_utf8(read_bounded(path, MOST_BYTES, "a skin file (TOML)")?);
    text.map_err(|_| Error::new(InvalidData, "not text; expected a skin file (TOML, UTF-8)"))
}

fn read_bounded(path: &Path, most: u64, what: &str) -> std::io::Result<Vec<u8>> {
    use std::io::{Error, ErrorKind::InvalidData};
    let found = std::fs::metadata(path)?;
    if !found.is_file() {
        return Err(Error::new(InvalidData, format!("not a regular file; expected {what}")));
    }
    if found.len() > most {
        return Err(Error::new(InvalidData, format!("{} bytes; expected {what} of at most {most}", found.len())));
    }
    std::fs::read(path)
}

#[cfg(test)]
mod tests {
    use crate::{Skin, builtin_text};

    #[test]
    fn parts_next_to_a_skin_file_and_built_in_parts_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let text = builtin_text("healing-square").unwrap();
        let (head, rest) = text.split_once("[backend]").unwrap();
        let (backend, imaging) = rest.split_once("[imaging]").unwrap();
        std::fs::create_dir(folder.path().join("parts")).unwrap();
        std::fs::write(folder.path().join("parts/own.toml"), backend).unwrap();
        let (top, frontend) = head.split_once("[frontend]").unwrap();
        let skin = format!("{top}\nbackend = \"parts/own.toml\"\n[frontend]{frontend}[imaging]{imaging}");
        let file = folder.path().join("skin.toml");
        std::fs::write(&file, &skin).unwrap();
        let read = Skin::open(file.to_str().unwrap()).unwrap();
        assert_eq!(read, Skin::open("healing-square").unwrap());
        // Text alone has no folder, so only built-in parts are found.
        let error = Skin::parse(&skin, "a page").unwrap_err().to_string();
        assert!(error.starts_with("a page: backend = \"parts/own.toml\", which does not exist: expected"), "{error}");
        let shared = skin.replace("parts/own.toml", "backends/mux-64.toml");
        assert_eq!(Skin::parse(&shared, "a page").unwrap().backend, Skin::open("piezo-disc").unwrap().backend);
    }

    #[test]
    fn mistakes_in_a_part_name_the_part() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("own.toml"), "current_ma = 1.0\nvoltage = 3\n").unwrap();
        let text = builtin_text("piezo-square").unwrap().replace("backends/mux-64.toml", "own.toml");
        let file = folder.path().join("skin.toml");
        std::fs::write(&file, &text).unwrap();
        let error = Skin::open(file.to_str().unwrap()).unwrap_err().to_string();
        assert!(error.contains("own.toml") && error.contains("voltage") && error.contains("line 2"), "{error}");
        // An error in a table in place shows its line.
        let text = builtin_text("healing-square").unwrap().replace("per_side = 4", "per_side = 4, sides = 4");
        let error = Skin::parse(&text, "a page").unwrap_err().to_string();
        assert!(error.contains("sides") && error.contains("line"), "{error}");
        let text = builtin_text("piezo-square").unwrap().replace("\"backends/mux-64.toml\"", "3");
        let error = Skin::parse(&text, "a page").unwrap_err().to_string();
        assert!(error.contains("a table, or the path of a file"), "{error}");
    }
}
