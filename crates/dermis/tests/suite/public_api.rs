//! The public API: its names and members are those in `public-api.txt`, there are few names, no two are equal, and each
//! is shown in an example or says why not. `DERMIS_BLESS=1 cargo test -p dermis --test suite public_api` writes the
//! file.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Maximum number of names that the crate may export.
const MOST_NAMES: usize = 300;
/// Start of the line of documentation that says why there is no example.
const NO_EXAMPLE: &str = "No example";
/// Start of the line of documentation that names the item whose example shows this one too.
const SHOWN_WITH: &str = "Shown with";

/// A declaration of a source file, with the documentation before it.
struct Declaration {
    text: String,
    docs: String,
}

/// The declarations of a file that begin in its first column with `pub`, apart from tests, each up to its body or end.
fn declarations(file: &Path) -> Vec<Declaration> {
    let source = std::fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    let (mut found, mut docs) = (Vec::new(), String::new());
    let mut lines = source.lines();
    while let Some(line) = lines.next() {
        if let Some(doc) = line.strip_prefix("///") {
            docs = docs + doc.trim() + "\n";
        } else if line.starts_with("pub ") {
            let mut text = line.to_owned();
            let is_import = line.starts_with("pub use");
            while !text.contains(';') && (is_import || !text.contains('{')) {
                text = text + " " + lines.next().expect("a declaration ends").trim();
            }
            found.push(Declaration { text, docs: std::mem::take(&mut docs) });
        } else if !line.starts_with("#[") {
            docs.clear();
        }
    }
    found
}

/// The path and the names of an import: `a::{b::{C, D as E}, F}` exports C, E and F.
fn imported(tree: &str) -> Vec<String> {
    let tree = tree.trim();
    if let Some((_, inner)) = tree.split_once('{') {
        let inner = inner.strip_suffix('}').expect("braces match");
        let (mut depth, mut start, mut names) = (0, 0, Vec::new());
        for (at, letter) in inner.char_indices() {
            match letter {
                '{' => depth += 1,
                '}' => depth -= 1,
                ',' if depth == 0 => {
                    names.extend(imported(&inner[start..at]));
                    start = at + 1;
                }
                _ => {}
            }
        }
        names.extend(imported(&inner[start..]));
        return names;
    }
    let name = tree.rsplit_once(" as ").map_or_else(|| tree.rsplit("::").next().unwrap_or(tree), |(_, name)| name);
    if name.is_empty() { Vec::new() } else { vec![name.to_owned()] }
}

/// The name that a struct, enum, trait, function, constant or module declares.
fn declared(text: &str) -> String {
    let name = text.split_whitespace().nth(2).expect("a name");
    name.chars().take_while(|letter| letter.is_alphanumeric() || *letter == '_').collect()
}

fn sources() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// The names that a declaration exports.
fn exports(declaration: &Declaration) -> Vec<String> {
    match declaration.text.strip_prefix("pub use ") {
        Some(tree) => imported(tree.trim_end_matches(';')),
        None => vec![declared(&declaration.text)],
    }
}

/// Names that a declaration says are shown in another's example, and are not.
fn not_shown(declaration: &Declaration, all: &[Declaration]) -> Vec<String> {
    let shown_in = declaration.docs.split_once(SHOWN_WITH).and_then(|(_, rest)| rest.split('`').nth(1));
    let other = shown_in.and_then(|name| all.iter().find(|other| exports(other).iter().any(|own| own == name)));
    let example = other.map_or("", |other| &other.docs);
    let words: BTreeSet<&str> = example.split(|letter: char| !letter.is_alphanumeric() && letter != '_').collect();
    exports(declaration).into_iter().filter(|name| !words.contains(name.as_str())).collect()
}

/// The exported names of a file with their paths, its public modules, and what is wrong with the documentation.
fn examine(module: &str, file: &Path) -> (Vec<String>, Vec<String>, Vec<String>) {
    let (mut names, mut modules, mut wrong) = (Vec::new(), Vec::new(), Vec::new());
    let all = declarations(file);
    for declaration in &all {
        let Declaration { text, docs } = declaration;
        let has_reason = docs.contains("```") || docs.contains(NO_EXAMPLE);
        // Modules have a page of their own, and names of this crate's own files are documented there.
        let is_exempt =
            text.starts_with("pub mod ") || text.starts_with("pub use ") && !text.starts_with("pub use dermis_");
        if docs.contains(SHOWN_WITH) {
            wrong
                .extend(not_shown(declaration, &all).iter().map(|name| format!("{module}::{name} is not shown there")));
        } else if !has_reason && !is_exempt {
            wrong.push(format!("{module}: {text}: neither an example nor a reason"));
        }
        if text.starts_with("pub mod ") {
            modules.push(declared(text));
        }
        names.extend(exports(declaration).into_iter().map(|name| format!("{module}::{name}")));
    }
    (names, modules, wrong)
}

/// Every exported name with its path, and what is wrong with its documentation.
fn exported() -> (Vec<String>, Vec<String>) {
    let (mut names, modules, mut wrong) = examine("dermis", &sources().join("lib.rs"));
    for module in modules {
        let file = sources().join(format!("{module}.rs"));
        let (inner, further, faults) = examine(&format!("dermis::{module}"), &file);
        assert!(further.is_empty(), "{module} has modules of its own");
        names.extend(inner);
        wrong.extend(faults);
    }
    names.sort();
    (names, wrong)
}

/// The crate's own files that are not modules of the API.
fn own_files() -> Vec<PathBuf> {
    let body_run = std::fs::read_dir(sources().join("body_run")).expect("the folder of running bodies");
    let mut files: Vec<PathBuf> = body_run.flatten().map(|entry| entry.path()).collect();
    files.extend(["error.rs", "session.rs", "source.rs"].map(|name| sources().join(name)));
    files.sort();
    files
}

/// Fields, variants and functions of the types that are defined here and exported, as `Type: declaration`.
fn members(names: &BTreeSet<String>) -> Vec<String> {
    let mut found = Vec::new();
    for file in own_files() {
        let source = std::fs::read_to_string(&file).expect("a source file");
        let (mut owner, mut lines) = (None, source.lines());
        while let Some(line) = lines.next() {
            let of = |start: &str| line.strip_prefix(start).map(|rest| declared(&format!("pub item {rest}")));
            if let Some(name) = of("pub struct ").or_else(|| of("pub enum ")).or_else(|| of("impl ")) {
                owner =
                    Some(name).filter(|name| names.contains(name) && line.ends_with('{') && !line.contains(" for "));
            } else if line == "}" {
                owner = None;
            }
            let (Some(owner), Some(member)) = (&owner, line.strip_prefix("    ")) else { continue };
            let is_variant = member.starts_with(|letter: char| letter.is_ascii_uppercase());
            if !member.starts_with("pub ") && !is_variant {
                continue;
            }
            let mut text = member.to_owned();
            while text.starts_with("pub fn") && !text.ends_with('{') {
                text = text + " " + lines.next().expect("a function has a body").trim();
            }
            found.push(format!("{owner}: {}", text.trim_end_matches([' ', '{', ','])));
        }
    }
    found.sort();
    found
}

#[test]
fn the_exported_names_match_the_list() {
    let (names, _) = exported();
    let last = |name: &String| name.rsplit("::").next().unwrap_or_default().to_owned();
    let members = members(&names.iter().map(last).collect());
    let mut text = String::from(
        "# Names exported by `dermis`, then the members of types defined in it. tests/suite/public_api.rs says how to write this.\n",
    );
    names.iter().chain(&members).for_each(|name| writeln!(text, "{name}").expect("text grows"));
    dermis_testdata::blessed("crates/dermis/public-api.txt", |_| text);
}

#[test]
fn names_are_few_and_unique() {
    let (names, _) = exported();
    println!("{} names", names.len());
    assert!(names.len() <= MOST_NAMES, "{} names, at most {MOST_NAMES}", names.len());
    let mut seen = BTreeSet::new();
    let last = |name: &String| name.rsplit("::").next().unwrap_or_default().to_owned();
    let twice: Vec<String> = names.iter().map(last).filter(|name| !seen.insert(name.clone())).collect();
    assert!(twice.is_empty(), "exported twice: {twice:?}");
}

#[test]
fn every_name_has_an_example_or_a_reason() {
    let (names, mut wrong) = exported();
    let names: BTreeSet<&str> = names.iter().filter_map(|name| name.rsplit("::").next()).collect();
    for file in own_files() {
        for Declaration { text, docs } in declarations(&file) {
            let is_import = text.starts_with("pub use ");
            if !is_import
                && names.contains(declared(&text).as_str())
                && !docs.contains("```")
                && !docs.contains(NO_EXAMPLE)
            {
                wrong.push(format!("{}: {text}: neither an example nor a reason", file.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
