//! Finds reference values and measured data for the tests of dermis, and reports data that are missing.
//!
//! Reference values are part of the repository (`tests/data/oracle`): a test that cannot read them fails. Measurements
//! by others are not part of it. [`set`] looks for them in the folder that `DERMIS_DATA` names, or else in
//! `tests/data/measured` and `../shared/data`. A test without its data calls [`skip`] (as [`set`] does) and returns;
//! `scripts/test` counts it as skipped:
//!
//! ```ignore
//! let Some(folder) = dermis_testdata::set("hydrogel") else { return };
//! ```

use std::fs::OpenOptions;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

/// The files of each set of measured data: set, file, bytes, SHA-256, address.
const MEASURED: &str = include_str!("../data/measured.tsv");

/// The folder of this crate, `tests/` of the repository.
fn here() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A file or folder of reference values, e.g. `"mit/spirals.json"`.
///
/// # Panics
/// If it doesn't exist: the repository contains them all.
pub fn oracle(path: &str) -> PathBuf {
    let path = here().join("data/oracle").join(path);
    assert!(path.exists(), "{} is missing; the repository holds it", path.display());
    path
}

/// The text of a file of reference values, e.g. `"mit/spirals.json"`.
///
/// # Panics
/// If it cannot be read.
pub fn oracle_text(path: &str) -> String {
    let path = oracle(path);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Compares a committed file that is generated from code with its current text, or writes it if `DERMIS_BLESS` is set.
/// `path` is relative to the repository; `expected` makes the current text from the one found.
///
/// # Panics
/// If the file differs, with the first line that does, or can't be written.
pub fn blessed(path: &str, expected: impl FnOnce(&str) -> String) {
    let file = here().join("..").join(path);
    let found = std::fs::read_to_string(&file).unwrap_or_default();
    let expected = expected(&found);
    if std::env::var_os("DERMIS_BLESS").is_some() {
        return std::fs::write(&file, &expected).unwrap_or_else(|error| panic!("{path}: {error}"));
    }
    let (old, new): (Vec<&str>, Vec<&str>) = (found.lines().collect(), expected.lines().collect());
    let line = (0..old.len().max(new.len())).find(|&line| old.get(line) != new.get(line));
    if let Some(line) = line {
        let (old, new) = (old.get(line).unwrap_or(&""), new.get(line).unwrap_or(&""));
        panic!("{path}, line {}: {old:?} should be {new:?}; run this test with DERMIS_BLESS=1", line + 1);
    }
}

/// Decompresses Zstandard data.
fn unpacked(compressed: &[u8]) -> Result<Vec<u8>, String> {
    let mut decoder = ruzstd::decoding::StreamingDecoder::new(compressed).map_err(|error| error.to_string())?;
    let mut bytes = Vec::new();
    decoder.read_to_end(&mut bytes).map_err(|error| error.to_string())?;
    Ok(bytes)
}

/// The folders of all EIDORS cases, sorted by name.
///
/// # Panics
/// If there are no cases.
pub fn eit_cases() -> Vec<PathBuf> {
    let root = oracle("eit");
    let entries = std::fs::read_dir(&root).unwrap_or_else(|error| panic!("{}: {error}", root.display()));
    let mut cases: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).filter(|path| path.is_dir()).collect();
    cases.sort();
    assert!(!cases.is_empty(), "{} holds no case", root.display());
    cases
}

/// The stored Jacobian of a case of [`eit_cases`] for the conductivity `name` ("hom" or "wave"): row-major, with a
/// row per measurement and a column per element.
///
/// # Panics
/// If the file is missing or broken.
pub fn stored_jacobian(case: &Path, name: &str) -> Vec<f64> {
    let path = case.join(format!("J_{name}.f64.planes.zst"));
    let bytes = std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    from_planes(&bytes).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Reads numbers that are stored as eight planes of bytes, the most significant first, and compressed with Zstandard.
/// Neighbouring numbers have similar signs and exponents, so planes compress better than whole numbers.
fn from_planes(compressed: &[u8]) -> Result<Vec<f64>, String> {
    let planes = unpacked(compressed)?;
    if planes.is_empty() || !planes.len().is_multiple_of(8) {
        return Err(format!("{} bytes, expected a multiple of 8 above 0", planes.len()));
    }
    let count = planes.len() / 8;
    Ok((0..count).map(|k| f64::from_be_bytes(std::array::from_fn(|plane| planes[plane * count + k]))).collect())
}

/// The folder of a set of measured data ("golfball", "hydrogel", "ktc", "pyeidors-tank", "sciospec", "team7"), if
/// every file that `tests/data/measured.tsv` lists for it exists with the listed size. Otherwise calls [`skip`].
///
/// # Panics
/// For a name that is not in `tests/data/measured.tsv`.
pub fn set(name: &str) -> Option<PathBuf> {
    match find(name, &roots(std::env::var_os("DERMIS_DATA").map(PathBuf::from))) {
        Ok(folder) => Some(folder),
        Err(reason) => {
            skip(&reason);
            None
        }
    }
}

/// Folders to search for measured data: the one the user names, or else the two usual ones.
fn roots(named: Option<PathBuf>) -> Vec<PathBuf> {
    match named {
        Some(folder) => vec![folder],
        None => vec![here().join("data/measured"), here().join("../../shared/data")],
    }
}

/// The first of these folders that has the complete set; otherwise the reason why the last one hasn't.
fn find(name: &str, roots: &[PathBuf]) -> Result<PathBuf, String> {
    let rows = MEASURED.lines().filter(|line| !line.starts_with('#')).map(|line| line.split('\t').collect::<Vec<_>>());
    let files: Vec<(&str, u64)> =
        rows.filter(|row| row[0] == name).map(|row| (row[1], row[2].parse().expect("a size"))).collect();
    assert!(!files.is_empty(), "tests/data/measured.tsv has no set {name}");
    let mut reason = String::new();
    for root in roots {
        let lacking = files.iter().find_map(|(file, bytes)| match std::fs::metadata(root.join(file)) {
            Ok(found) if found.len() == *bytes => None,
            Ok(found) => Some(format!("{file} has {} bytes, expected {bytes}", found.len())),
            Err(_) => Some(format!("{file} is not there")),
        });
        match lacking {
            None => return Ok(root.join(name)),
            Some(lack) => reason = lack,
        }
    }
    Err(format!("no measured data {name}: {reason} (scripts/fetch-data {name})"))
}

/// Reports that the running test checks nothing, and why: prints a line `skipped: TEST: REASON` to standard output
/// and, if `DERMIS_SKIPPED` names a file, appends it there. `scripts/test` counts these tests as skipped. After this
/// call, a test must return at once.
///
/// # Panics
/// If the file named by `DERMIS_SKIPPED` cannot be written: the test would count as passed.
pub fn skip(reason: &str) {
    let line = line_of(&test_name(), reason);
    print!("{line}");
    if let Some(path) = std::env::var_os("DERMIS_SKIPPED") {
        // Append in a single write, so that lines of concurrent tests stay whole.
        let file = OpenOptions::new().create(true).append(true).open(&path);
        let written = file.and_then(|mut file| file.write_all(line.as_bytes()));
        written.unwrap_or_else(|error| panic!("DERMIS_SKIPPED={}: {error}", path.display()));
    }
}

fn line_of(test: &str, reason: &str) -> String {
    format!("skipped: {test}: {}\n", reason.replace(['\n', '\r'], " "))
}

/// The test's name in nextest, or else the name of its thread.
fn test_name() -> String {
    match (std::env::var("NEXTEST_BINARY_ID"), std::env::var("NEXTEST_TEST_NAME")) {
        (Ok(binary), Ok(test)) => format!("{binary} {test}"),
        _ => std::thread::current().name().unwrap_or("a test").to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stored_jacobians_have_their_shapes_and_first_value() {
        let sizes = [("tiny_disc8", 40 * 64), ("square16", 208 * 512), ("disc16_si", 208 * 1024)];
        for (name, size) in sizes.into_iter().chain([("square16_internal_lines", 208 * 800), ("tank3d16", 208 * 1152)])
        {
            for sigma in ["hom", "wave"] {
                let values = stored_jacobian(&oracle(&format!("eit/{name}")), sigma);
                assert_eq!(values.len(), size, "{name} {sigma}");
                assert!(values.iter().all(|value| value.is_finite() && value.abs() < 10.0), "{name} {sigma}");
            }
        }
        assert_eq!(eit_cases().len(), 5);
    }

    #[test]
    fn broken_files_of_numbers_are_refused() {
        assert!(from_planes(b"").is_err() && from_planes(b"not compressed").is_err());
    }

    #[test]
    fn an_empty_folder_and_a_short_file_are_missing_data() {
        let folder = tempfile::tempdir().unwrap();
        let roots = [folder.path().to_path_buf()];
        std::fs::create_dir_all(folder.path().join("golfball")).unwrap();
        let empty = find("golfball", &roots).unwrap_err();
        assert!(empty.contains("golfball/phantom_A.csv is not there"), "{empty}");
        std::fs::write(folder.path().join("golfball/phantom_A.csv"), "ref\n1\n").unwrap();
        let short = find("golfball", &roots).unwrap_err();
        assert!(short.contains("has 6 bytes, expected 11612"), "{short}");
        // A file missing from one set doesn't affect another.
        std::fs::write(folder.path().join("golfball/phantom_A.csv"), vec![b'0'; 11612]).unwrap();
        assert_eq!(find("golfball", &roots).unwrap(), folder.path().join("golfball"));
        assert!(find("team7", &roots).is_err());
    }

    #[test]
    fn a_later_folder_is_searched_if_the_first_lacks_the_set() {
        let (first, second) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        std::fs::create_dir_all(second.path().join("golfball")).unwrap();
        std::fs::write(second.path().join("golfball/phantom_A.csv"), vec![b'0'; 11612]).unwrap();
        let roots = [first.path().to_path_buf(), second.path().to_path_buf()];
        assert_eq!(find("golfball", &roots).unwrap(), second.path().join("golfball"));
        assert_eq!(super::roots(Some("mine".into())), [PathBuf::from("mine")], "a named folder is the only one");
    }

    #[test]
    fn a_skip_is_one_line() {
        assert_eq!(line_of("crate::a test", "no data\nat all"), "skipped: crate::a test: no data at all\n");
    }

    /// Tests look for data only through this crate, so that none is skipped silently.
    #[test]
    fn no_test_looks_for_data_by_itself() {
        fn visit(folder: &Path, found: &mut Vec<PathBuf>) {
            for path in std::fs::read_dir(folder).unwrap().flatten().map(|entry| entry.path()) {
                if path.is_dir() {
                    visit(&path, found);
                } else if path.extension().is_some_and(|extension| extension == "rs") {
                    let text = std::fs::read_to_string(&path).unwrap();
                    let code = text.lines().filter(|line| !line.trim_start().starts_with("//"));
                    found.extend(code.filter(|line| line.contains("../shared")).map(|_| path.clone()));
                }
            }
        }
        let mut found = Vec::new();
        visit(&here().join("../crates"), &mut found);
        visit(&here().join("../firmware"), &mut found);
        assert!(found.is_empty(), "use dermis_testdata::set or ::oracle in {found:?}");
    }
}
