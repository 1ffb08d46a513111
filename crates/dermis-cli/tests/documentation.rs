//! The documentation matches the code: its links resolve, its skin file is valid, and it covers every key of a skin
//! file.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use dermis_skin::{BUILTIN_NAMES, Skin, json_schema};
use serde_json::Value;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Every Markdown file that newcomers read, and every chapter.
fn pages() -> Vec<PathBuf> {
    let root = root();
    let mut pages: Vec<PathBuf> = [
        "README.md",
        "ARCHITECTURE.md",
        "CONTRIBUTING.md",
        "CODE_OF_CONDUCT.md",
        "SECURITY.md",
        "CHANGELOG.md",
        "benches/peers/README.md",
        "tests/data/README.md",
        "tests/data/oracle/README.md",
    ]
    .map(|name| root.join(name))
    .to_vec();
    let chapters = std::fs::read_dir(root.join("docs/src")).expect("the chapters").flatten().map(|entry| entry.path());
    pages.extend(chapters.filter(|path| path.extension().is_some_and(|extension| extension == "md")));
    pages
}

/// Targets of the links `[text](target)` on a page.
fn links(page: &str) -> Vec<&str> {
    page.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(target, _)| target).collect()
}

/// Anchors of a page's headings, as mdBook makes them.
fn anchors(page: &str) -> Vec<String> {
    let headings = page.lines().filter(|line| line.starts_with('#')).map(|line| line.trim_start_matches('#').trim());
    let anchor = |heading: &str| {
        let kept =
            heading.to_lowercase().chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c)).collect::<String>();
        kept.replace(' ', "-")
    };
    headings.map(anchor).collect()
}

#[test]
fn links_lead_to_files_and_headings() {
    for page in pages() {
        let content = text(&page);
        for link in links(&content) {
            if link.contains("://") {
                continue;
            }
            let (file, heading) = link.split_once('#').map_or((link, None), |(file, heading)| (file, Some(heading)));
            let target = if file.is_empty() { page.clone() } else { page.with_file_name(file) };
            assert!(target.exists(), "{}: {link} leads nowhere", page.display());
            if let Some(heading) = heading {
                let known = anchors(&text(&target));
                assert!(known.iter().any(|anchor| anchor == heading), "{}: {link}: headings {known:?}", page.display());
            }
        }
    }
}

#[test]
fn every_chapter_is_in_the_summary() {
    let summary = text(&root().join("docs/src/SUMMARY.md"));
    let listed = links(&summary);
    for page in pages().iter().filter(|page| page.parent().is_some_and(|folder| folder.ends_with("docs/src"))) {
        let name = page.file_name().expect("a file").to_string_lossy().into_owned();
        assert!(name == "SUMMARY.md" || listed.contains(&name.as_str()), "{name} is not in SUMMARY.md");
    }
}

/// TOML blocks of a page that are complete skin files.
fn skins_of(page: &str) -> Vec<&str> {
    let blocks = page.split("```toml\n").skip(1).filter_map(|rest| rest.split("\n```").next());
    blocks.filter(|block| block.starts_with("name = ") && block.contains("[backend]")).collect()
}

#[test]
fn skin_files_of_the_book_are_some() {
    let mut channels = Vec::new();
    for page in pages() {
        let content = text(&page);
        for example in skins_of(&content) {
            let skin = Skin::parse(example, &page.display().to_string()).unwrap_or_else(|error| panic!("{error}"));
            let electrodes = skin.body().expect("it can be meshed").mesh.electrodes.len();
            channels.push((electrodes, skin.protocol().expect("it has a protocol").channel_count()));
        }
    }
    // The tutorial's skin, for which the Arduino sketch sends 40 numbers, and the one in the chapter on skin files.
    assert!(channels.contains(&(8, 40)) && channels.contains(&(16, 208)), "{channels:?}");
}

#[test]
fn every_key_of_a_skin_file_is_in_the_book() {
    let chapter = text(&root().join("docs/src/skin-file.md"));
    for name in BUILTIN_NAMES {
        let toml = Skin::open(name).expect("a built-in skin").to_toml();
        for key in toml.lines().filter_map(|line| line.split_once(" = ")).map(|(key, _)| key.trim()) {
            assert!(chapter.contains(key), "{key} (as in {name}) is not in docs/src/skin-file.md");
        }
    }
}

/// Collects the defaults that a JSON Schema states, by key.
fn defaults_of(node: &Value, found: &mut BTreeMap<String, Vec<Value>>) {
    let stated = node.get("properties").and_then(Value::as_object).into_iter().flatten();
    for (key, property) in stated {
        found.entry(key.clone()).or_default().extend(property.get("default").cloned());
    }
    match node {
        Value::Object(members) => members.values().for_each(|member| defaults_of(member, found)),
        Value::Array(items) => items.iter().for_each(|item| defaults_of(item, found)),
        _ => {}
    }
}

/// The book rounds numbers. The same key may be in several tables, with different defaults.
#[test]
fn defaults_in_the_book_are_those_of_the_schema() {
    let mut known = BTreeMap::new();
    defaults_of(&json_schema(), &mut known);
    let chapter = text(&root().join("docs/src/skin-file.md"));
    let mut compared = 0;
    for row in chapter.lines().filter(|line| line.starts_with("| `")) {
        let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
        let keys: Vec<&str> = cells[0].split('`').skip(1).step_by(2).collect();
        let stated: Vec<&str> = if keys.len() > 1 { cells[1].split(", ").collect() } else { vec![cells[1]] };
        for (key, stated) in keys.iter().zip(stated) {
            // Numbers, words in quotes, true and false; most others are explained in words.
            let Ok(stated) = serde_json::from_str::<Value>(stated.trim_matches('`')) else { continue };
            if stated.is_array() {
                continue;
            }
            let defaults: Vec<&Value> =
                known.get(*key).into_iter().flatten().filter(|value| !value.is_null()).collect();
            let agrees = |value: &&Value| match (value.as_f64(), stated.as_f64()) {
                (Some(value), Some(stated)) => (value - stated).abs() <= 1e-3 * value.abs(),
                _ => **value == stated,
            };
            assert!(
                defaults.is_empty() || defaults.iter().any(agrees),
                "{key}: the book says {stated}, not {defaults:?}"
            );
            compared += usize::from(!defaults.is_empty());
        }
    }
    assert!(compared > 40, "only {compared} defaults were compared");
}

/// The help text of a command.
fn help(words: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_dermis")).args(words).arg("--help").output();
    String::from_utf8_lossy(&output.expect("the command starts").stdout).into_owned()
}

#[test]
fn commands_and_flags_in_the_book_exist() {
    let mut known: BTreeMap<Vec<String>, String> = BTreeMap::new();
    let mut seen = 0;
    for page in pages() {
        let content = text(&page);
        let blocks = content.split("```sh\n").skip(1).filter_map(|rest| rest.split("```").next());
        for line in blocks.flat_map(str::lines).filter_map(|line| line.trim().strip_prefix("dermis ")) {
            // A comment is a number sign after a space; a selection of frames has no space before it.
            let words: Vec<&str> = line.split(" #").next().unwrap_or(line).split_whitespace().collect();
            let depth = if matches!(words[0], "skins" | "twin") { 2 } else { 1 };
            let command: Vec<String> = words.iter().take(depth).map(ToString::to_string).collect();
            let said = known.entry(command).or_insert_with(|| help(&words[..depth.min(words.len())]));
            assert!(!said.is_empty(), "{}: there is no such command: dermis {line}", page.display());
            for flag in words.iter().filter(|word| word.starts_with("--")) {
                assert!(said.contains(flag), "{}: no {flag} in: dermis {line}", page.display());
            }
            seen += 1;
        }
    }
    assert!(seen > 40, "only {seen} commands were found in the book");
}
