//! The rules of ARCHITECTURE.md: who may use whom, and which crates stay free of files, sockets and clocks.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Our crates, and those of ours that each may use.
const MAY_USE: [(&str, &[&str]); 8] = [
    ("dermis-tomo", &[]),
    ("dermis-touch", &[]),
    ("dermis-wire", &[]),
    ("dermis-learn", &[]),
    ("dermis-device", &["dermis-wire"]),
    ("dermis-twin", &["dermis-tomo"]),
    ("dermis", &["dermis-device", "dermis-learn", "dermis-tomo", "dermis-touch", "dermis-twin", "dermis-wire"]),
    ("dermis-cli", &["dermis", "dermis-device", "dermis-learn", "dermis-tomo", "dermis-touch", "dermis-twin"]),
];

/// Crates that compute and do nothing else.
const PURE: [&str; 4] = ["dermis-tomo", "dermis-touch", "dermis-twin", "dermis-wire"];

/// What a pure crate has no business with.
const OUTSIDE_WORLD: [&str; 6] = ["std::fs", "std::net", "std::process", "std::env", "Instant::now", "SystemTime"];

fn crates() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Names of our crates that a manifest depends on, in any of its dependency tables.
fn our_dependencies(manifest: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut in_dependencies = false;
    for line in manifest.lines().map(str::trim) {
        if let Some(table) = line.strip_prefix('[').and_then(|line| line.strip_suffix(']')) {
            in_dependencies = table.ends_with("dependencies");
            // A table of its own for one dependency: [dependencies.dermis-tomo].
            let own = table.rsplit_once("dependencies.").map(|(_, name)| name.trim_matches('"'));
            found.extend(own.filter(|name| name.starts_with("dermis")).map(String::from));
        } else if in_dependencies && line.starts_with("dermis") {
            let name: String = line.chars().take_while(|c| c.is_alphanumeric() || *c == '-').collect();
            found.insert(name);
        }
    }
    found
}

fn manifests() -> BTreeMap<String, String> {
    let folders = std::fs::read_dir(crates()).expect("the crates folder");
    folders
        .flatten()
        .filter_map(|folder| {
            let manifest = std::fs::read_to_string(folder.path().join("Cargo.toml")).ok()?;
            Some((folder.file_name().to_string_lossy().into_owned(), manifest))
        })
        .collect()
}

fn sources(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a source folder").flatten() {
        let path = entry.path();
        if path.is_dir() {
            sources(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
}

#[test]
fn crates_use_only_whom_they_may() {
    let manifests = manifests();
    let known: BTreeSet<&str> = MAY_USE.iter().map(|(name, _)| *name).collect();
    let present: BTreeSet<&str> = manifests.keys().map(String::as_str).collect();
    assert_eq!(present, known, "the crates on disk and the rules in ARCHITECTURE.md differ");
    for (name, allowed) in MAY_USE {
        for used in our_dependencies(&manifests[name]) {
            assert!(allowed.contains(&used.as_str()), "{name} depends on {used}, which ARCHITECTURE.md does not allow");
        }
    }
}

#[test]
fn the_firmware_uses_the_wire_alone_and_no_standard_library() {
    let folder = crates().join("../firmware");
    let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).expect("the firmware's manifest");
    let (shipped, _for_tests) = manifest.split_once("[dev-dependencies]").expect("tests");
    assert_eq!(our_dependencies(shipped).into_iter().collect::<Vec<_>>(), ["dermis-wire"]);
    assert!(manifest.contains("[lints]\nworkspace = true"));
    let mut files = Vec::new();
    sources(&folder.join("src"), &mut files);
    let text = |file: &PathBuf| std::fs::read_to_string(file).expect("a source file");
    assert!(text(&folder.join("src/lib.rs")).contains("\n#![no_std]\n"));
    for file in files {
        let found = ["std::", "alloc::"].into_iter().find(|name| text(&file).contains(name));
        assert_eq!(found, None, "{} uses more than core", file.display());
    }
}

#[test]
fn pure_crates_touch_no_files_sockets_or_clocks() {
    for name in PURE {
        let mut files = Vec::new();
        sources(&crates().join(name).join("src"), &mut files);
        assert!(!files.is_empty(), "{name} has no sources");
        for file in files {
            let text = std::fs::read_to_string(&file).expect("a source file");
            for forbidden in OUTSIDE_WORLD {
                assert!(!text.contains(forbidden), "{} uses {forbidden}", file.display());
            }
        }
    }
}

#[test]
fn every_crate_forbids_unsafe_code_by_the_workspace_lints() {
    let root = std::fs::read_to_string(crates().join("../Cargo.toml")).expect("the workspace's Cargo.toml");
    assert!(root.contains("unsafe_code = \"forbid\""));
    for (name, manifest) in manifests() {
        assert!(manifest.contains("[lints]\nworkspace = true"), "{name} does not take the workspace's lints");
    }
}

#[test]
fn dependency_tables_of_every_form_are_read() {
    let manifest = "[dependencies]\ndermis-tomo.workspace = true\nserde = \"1\"\n[dependencies.dermis-touch]\npath = \
                    \"x\"\n[target.'cfg(unix)'.dev-dependencies]\ndermis = { path = \"y\" }\n[lib]\ndermis-device = 1";
    let found: Vec<String> = our_dependencies(manifest).into_iter().collect();
    assert_eq!(found, ["dermis", "dermis-tomo", "dermis-touch"]);
}
