//! The rules of ARCHITECTURE.md: which crates use which, which crates stay free of files, sockets and clocks, and
//! that files have no circular dependencies.

#[path = "architecture/file_graph.rs"]
mod file_graph;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The crate whose macros expand to unsafe code.
const EXPANDS_TO_UNSAFE: &str = "dermis-py";

/// The crate whose functions JavaScript calls by name, which counts as unsafe, and the file that contains them.
const EXPORTS_NAMES: (&str, &str) = ("dermis-wasm", "exports.rs");

/// Names that a pure crate must not use.
const OUTSIDE_WORLD: [&str; 6] = ["std::fs", "std::net", "std::process", "std::env", "Instant::now", "SystemTime"];

fn crates() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Our crates among a manifest's dependencies, in any of its dependency tables.
fn our_dependencies(manifest: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut in_dependencies = false;
    for line in manifest.lines().map(str::trim) {
        if let Some(table) = line.strip_prefix('[').and_then(|line| line.strip_suffix(']')) {
            in_dependencies = table.ends_with("dependencies");
            // A separate table for one dependency: [dependencies.dermis-tomo].
            let own = table.rsplit_once("dependencies.").map(|(_, name)| name.trim_matches('"'));
            found.extend(own.filter(|name| name.starts_with("dermis")).map(String::from));
        } else if in_dependencies && line.starts_with("dermis") {
            let name: String = line.chars().take_while(|c| c.is_alphanumeric() || *c == '-').collect();
            found.insert(name);
        }
    }
    // Finds data for tests; not part of any published crate.
    found.remove("dermis-testdata");
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

/// A row of the table of crates.
struct Row {
    floor: u32,
    name: String,
    /// `None` if it may use all others.
    uses: Option<BTreeSet<String>>,
    is_pure: bool,
}

fn architecture() -> String {
    std::fs::read_to_string(crates().join("../ARCHITECTURE.md")).expect("ARCHITECTURE.md")
}

/// The table of crates in ARCHITECTURE.md: floor, crate, reason, uses, files and the like.
fn table() -> Vec<Row> {
    let text = architecture();
    let rows = text.lines().filter_map(|line| {
        let cells: Vec<&str> = line.strip_prefix('|')?.strip_suffix('|')?.split('|').map(str::trim).collect();
        let [floor, name, _reason, uses, outside] = cells[..] else { return None };
        let name = name.strip_prefix('`')?.strip_suffix('`')?.to_string();
        let listed = uses.split(',').map(str::trim).filter(|name| *name != "-");
        let listed = listed.map(|name| format!("dermis-{name}")).collect();
        let uses = (uses != "all").then_some(listed);
        Some(Row { floor: floor.parse().ok()?, name, uses, is_pure: outside.starts_with("none") })
    });
    rows.collect()
}

#[test]
fn the_table_of_crates_lists_their_dependencies() {
    let (manifests, table) = (manifests(), table());
    let floors: BTreeMap<&str, u32> = table.iter().map(|row| (row.name.as_str(), row.floor)).collect();
    let present: BTreeSet<&str> = manifests.keys().map(String::as_str).collect();
    assert_eq!(present, floors.keys().copied().collect(), "the crates on disk and those in ARCHITECTURE.md differ");
    let mut wrong = Vec::new();
    for Row { floor, name, uses, .. } in &table {
        let used = our_dependencies(&manifests[name]);
        let above = used.iter().filter(|other| floors.get(other.as_str()).is_none_or(|other| other > floor));
        wrong.extend(above.map(|other| format!("{name} uses {other}, which is above it")));
        if let Some(listed) = uses {
            wrong.extend(used.difference(listed).map(|other| format!("{name} uses {other}, which the table lacks")));
            wrong.extend(listed.difference(&used).map(|other| format!("{name} does not use {other}, which is listed")));
        }
    }
    assert!(wrong.is_empty(), "ARCHITECTURE.md and the manifests differ:\n{}", wrong.join("\n"));
}

#[test]
fn the_diagram_shows_only_what_the_table_allows() {
    let (text, table) = (architecture(), table());
    let full = |short: &str| if short == "dermis" { short.to_string() } else { format!("dermis-{short}") };
    let mut arrows = 0;
    for line in text.lines() {
        let Some((user, used)) = line.trim().split_once(" --> ") else { continue };
        let node = |text: &str| full(text.split('[').next().unwrap_or(text).trim());
        let (user, used) = (node(user), node(used));
        if user == "dermis-firmware" {
            continue;
        }
        let row = table.iter().find(|row| row.name == user).unwrap_or_else(|| panic!("{user} is not in the table"));
        let is_listed = row.uses.as_ref().is_none_or(|uses| uses.contains(&used));
        assert!(is_listed, "{user} uses {used} in the diagram but not in the table");
        arrows += 1;
    }
    assert!(arrows >= table.len(), "only {arrows} arrows in the diagram");
}

#[test]
fn files_of_a_crate_have_no_cyclic_dependencies() {
    for name in manifests().keys() {
        let graph = file_graph::file_graph(&crates().join(name).join("src"));
        assert!(graph.values().any(|uses| !uses.is_empty()), "{name}: no file names another");
        if let Some(cycle) = file_graph::cycle(&graph) {
            panic!("{name}: {}", cycle.join(" -> "));
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
    for Row { name, .. } in table().iter().filter(|row| row.is_pure) {
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
        let takes = manifest.contains("[lints]\nworkspace = true");
        let is_excepted = name == EXPANDS_TO_UNSAFE || name == EXPORTS_NAMES.0;
        assert!(takes || is_excepted, "{name} does not take the workspace's lints");
    }
}

#[test]
fn the_crate_of_macros_that_are_unsafe_has_no_unsafe_code_of_its_own() {
    let mut files = Vec::new();
    sources(&crates().join(EXPANDS_TO_UNSAFE).join("src"), &mut files);
    assert!(!files.is_empty());
    for file in files {
        let text = std::fs::read_to_string(&file).expect("a source file");
        assert!(!text.contains("unsafe"), "{} has the word unsafe", file.display());
    }
}

#[test]
fn the_crate_of_exported_names_has_unsafe_attributes_and_no_unsafe_code() {
    let (name, exports) = EXPORTS_NAMES;
    assert!(manifests()[name].contains("unsafe_code = \"deny\""));
    let mut files = Vec::new();
    sources(&crates().join(name).join("src"), &mut files);
    let mut exported = 0;
    for file in files {
        let text = std::fs::read_to_string(&file).expect("a source file");
        let code = text.lines().filter(|line| !line.trim_start().starts_with("//") && line.contains("unsafe"));
        for line in code {
            assert!(file.ends_with(exports), "{} has the word unsafe", file.display());
            let known = ["#![allow(unsafe_code)]", "#[unsafe(no_mangle)]", "unsafe extern \"C\" {"];
            assert!(known.contains(&line), "{}: {line}", file.display());
            exported += 1;
        }
    }
    assert!(exported > 2, "nothing is exported any more");
}

#[test]
fn dependency_tables_of_every_form_are_read() {
    let manifest = "[dependencies]\ndermis-tomo.workspace = true\nserde = \"1\"\n[dependencies.dermis-touch]\npath = \
                    \"x\"\n[target.'cfg(unix)'.dev-dependencies]\ndermis = { path = \"y\" }\n[lib]\ndermis-device = 1";
    let found: Vec<String> = our_dependencies(manifest).into_iter().collect();
    assert_eq!(found, ["dermis", "dermis-tomo", "dermis-touch"]);
}
