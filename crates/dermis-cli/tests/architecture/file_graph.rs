//! The graph of a crate's files: an edge means that one file names an item defined in another. Names re-exported by a
//! module file count as those of the defining file. Test modules, comments and strings are ignored.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Path of a module from the crate's root; empty for the root itself.
type Module = Vec<String>;

/// Facts about a file.
struct SourceFile {
    name: String,
    code: String,
    /// Re-exported name, or `*`, and the path behind it.
    reexports: Vec<(String, Vec<String>)>,
}

/// Edges between files, by name, without self-loops.
pub(crate) fn file_graph(source_folder: &Path) -> BTreeMap<String, BTreeSet<String>> {
    let mut paths = Vec::new();
    super::sources(source_folder, &mut paths);
    let files: BTreeMap<Module, SourceFile> = paths.iter().filter_map(|path| read(source_folder, path)).collect();
    files.iter().map(|(module, file)| (file.name.clone(), edges(&files, module, file))).collect()
}

/// A cycle in a graph, with its first file repeated at the end.
pub(crate) fn cycle(graph: &BTreeMap<String, BTreeSet<String>>) -> Option<Vec<String>> {
    let mut done = BTreeSet::new();
    graph.keys().find_map(|file| visit(graph, file, &mut Vec::new(), &mut done))
}

fn visit(
    graph: &BTreeMap<String, BTreeSet<String>>,
    file: &str,
    path: &mut Vec<String>,
    done: &mut BTreeSet<String>,
) -> Option<Vec<String>> {
    if let Some(start) = path.iter().position(|before| before == file) {
        return Some(path[start..].iter().cloned().chain([file.to_string()]).collect());
    }
    if done.contains(file) {
        return None;
    }
    path.push(file.to_string());
    let found = graph.get(file).into_iter().flatten().find_map(|next| visit(graph, next, path, done));
    path.pop();
    done.insert(file.to_string());
    found
}

fn read(source_folder: &Path, path: &PathBuf) -> Option<(Module, SourceFile)> {
    let name = path.strip_prefix(source_folder).ok()?.to_string_lossy().into_owned();
    let mut module: Module = name.strip_suffix(".rs")?.split('/').map(String::from).collect();
    match module.last().map(String::as_str) {
        // The tests of a module see all of it.
        Some("tests") => return None,
        Some("mod") => drop(module.pop()),
        Some("lib" | "main") if module.len() == 1 => module.clear(),
        _ => {}
    }
    let text = std::fs::read_to_string(path).expect("a source file");
    let code = without_tests(&without_comments_and_strings(&text));
    let reexports = uses(&code).into_iter().filter(|import| import.is_public).map(|import| (import.name, import.path));
    let reexports = reexports.collect();
    Some((module, SourceFile { name, code, reexports }))
}

/// One name imported by a `use`.
struct Import {
    is_public: bool,
    name: String,
    path: Vec<String>,
}

fn edges(files: &BTreeMap<Module, SourceFile>, module: &Module, file: &SourceFile) -> BTreeSet<String> {
    let imports = uses(&file.code);
    let mut found = BTreeSet::new();
    let mut add = |path: &[String]| {
        if let Some(target) = resolve(files, module, path, 0).filter(|target| *target != file.name) {
            found.insert(target);
        }
    };
    imports.iter().for_each(|import| add(&import.path));
    for path in paths_in(&without_uses(&file.code)) {
        // A module imported by name.
        let imported = imports.iter().find(|import| import.name == path[0]);
        match imported {
            Some(import) => add(&[&import.path[..], &path[1..]].concat()),
            None => add(&path),
        }
    }
    found
}

/// The file that defines the item at a path; `None` for other crates and for modules themselves.
fn resolve(files: &BTreeMap<Module, SourceFile>, from: &Module, path: &[String], depth: usize) -> Option<String> {
    let mut module = from.clone();
    let mut rest = path;
    match path.first()?.as_str() {
        "crate" => {
            module.clear();
            rest = &rest[1..];
        }
        "self" => rest = &rest[1..],
        "super" => {
            while rest.first().is_some_and(|segment| segment == "super") {
                module.pop()?;
                rest = &rest[1..];
            }
        }
        first => {
            let child: Module = module.iter().cloned().chain([first.to_string()]).collect();
            files.get(&child)?;
        }
    }
    loop {
        let segment = rest.first()?;
        let child: Module = module.iter().cloned().chain([segment.clone()]).collect();
        if files.contains_key(&child) {
            (module, rest) = (child, &rest[1..]);
            continue;
        }
        let file = files.get(&module)?;
        // Circular re-exports would not compile.
        assert!(depth < 16, "{}: {path:?} leads nowhere", file.name);
        let own = file.reexports.iter().find(|(name, _)| name == segment);
        let target = match own {
            Some((_, path)) => resolve(files, &module, &[&path[..], &rest[1..]].concat(), depth + 1),
            None => None,
        };
        return target.or_else(|| Some(file.name.clone()));
    }
}

/// All names imported by the `use` declarations of a file.
fn uses(code: &str) -> Vec<Import> {
    let mut found = Vec::new();
    for statement in use_statements(code) {
        let text = &code[statement];
        let (visibility, tree) = text.split_once("use ").unwrap_or(("", text));
        let mut paths = Vec::new();
        expand(tree.trim_end_matches(';'), &[], &mut paths);
        let is_public = visibility.trim_start().starts_with("pub");
        found.extend(paths.into_iter().map(|(name, path)| Import { is_public, name, path }));
    }
    found
}

/// Positions of the `use` declarations, at any indentation.
fn use_statements(code: &str) -> Vec<std::ops::Range<usize>> {
    let mut found = Vec::new();
    let mut at = 0;
    for line in code.split_inclusive('\n') {
        let start = at;
        at += line.len();
        if without_visibility(line).starts_with("use ")
            && let Some(length) = code[start..].find(';')
        {
            found.push(start..start + length + 1);
        }
    }
    found
}

/// A line without indentation and `pub` or `pub(...)`.
fn without_visibility(line: &str) -> &str {
    let text = line.trim_start();
    let rest = match text.strip_prefix("pub") {
        Some(rest) if rest.starts_with('(') => rest.split_once(')').map_or(rest, |(_, rest)| rest),
        Some(rest) => rest,
        None => text,
    };
    rest.trim_start()
}

fn without_uses(code: &str) -> String {
    let mut left = code.to_string();
    use_statements(code).into_iter().rev().for_each(|range| left.replace_range(range, ""));
    left
}

/// Expands a use tree below `prefix` into names and paths.
fn expand(tree: &str, prefix: &[String], found: &mut Vec<(String, Vec<String>)>) {
    let tree = tree.trim();
    let join = |path: &str| -> Vec<String> {
        let segments = path.split("::").map(str::trim).filter(|segment| !segment.is_empty()).map(String::from);
        prefix.iter().cloned().chain(segments).collect()
    };
    if let Some((head, group)) = tree.split_once('{') {
        let inner = group.strip_suffix('}').unwrap_or(group);
        let prefix = join(head);
        let (mut depth, mut start) = (0, 0);
        for (index, letter) in inner.char_indices().chain([(inner.len(), ',')]) {
            match letter {
                '{' => depth += 1,
                '}' => depth -= 1,
                ',' if depth == 0 => {
                    expand(&inner[start..index], &prefix, found);
                    start = index + 1;
                }
                _ => {}
            }
        }
    } else if !tree.is_empty() {
        let (path, name) = tree.split_once(" as ").map_or((tree, None), |(path, name)| (path, Some(name.trim())));
        let mut path = join(path);
        if path.last().is_some_and(|segment| segment == "self") {
            path.pop();
        }
        let name = name.map(String::from).or_else(|| path.last().cloned()).unwrap_or_default();
        found.push((name, path));
    }
}

/// Every path with two or more segments.
fn paths_in(code: &str) -> Vec<Vec<String>> {
    let is_part = |letter: char| letter.is_alphanumeric() || letter == '_' || letter == ':';
    code.split(|letter: char| !is_part(letter))
        .filter(|word| word.contains("::") && !word.starts_with("::"))
        .map(|word| word.split("::").filter(|segment| !segment.is_empty()).map(String::from).collect::<Vec<_>>())
        .filter(|path| path.len() > 1)
        .collect()
}

/// The code without its test modules, whose closing braces start a line.
fn without_tests(code: &str) -> String {
    let mut kept = String::with_capacity(code.len());
    let mut lines = code.lines().peekable();
    while let Some(line) = lines.next() {
        let module = lines.next_if(|next| line == "#[cfg(test)]" && without_visibility(next).starts_with("mod "));
        match module {
            Some(declared) if declared.ends_with(';') => {}
            Some(_) => drop(lines.find(|line| *line == "}")),
            None => kept.extend([line, "\n"]),
        }
    }
    kept
}

fn without_comments_and_strings(text: &str) -> String {
    let mut code = String::with_capacity(text.len());
    for line in text.lines() {
        let mut in_string = false;
        let mut letters = line.chars().peekable();
        while let Some(letter) = letters.next() {
            match letter {
                '\\' if in_string => drop(letters.next()),
                '"' => in_string = !in_string,
                '/' if !in_string && letters.peek() == Some(&'/') => break,
                // A quote as a character literal doesn't open a string.
                '\'' if !in_string && letters.peek() == Some(&'"') => drop(letters.next()),
                _ if in_string => {}
                _ => code.push(letter),
            }
        }
        code.push('\n');
    }
    code
}

#[cfg(test)]
mod tests {
    use super::*;

    fn graph_of(name: &str, files: &[(&str, &str)]) -> BTreeMap<String, BTreeSet<String>> {
        let folder = std::env::temp_dir().join(format!("dermis-file-graph-{}-{name}", std::process::id()));
        for (file, text) in files {
            let path = folder.join(file);
            std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
            std::fs::write(path, text).expect("a file");
        }
        let graph = file_graph(&folder);
        std::fs::remove_dir_all(&folder).expect("the folder");
        graph
    }

    #[test]
    fn names_lead_to_the_file_that_defines_them() {
        let graph = graph_of(
            "names",
            &[
                ("lib.rs", "mod error;\npub mod a;\npub use error::Error;\n"),
                ("error.rs", "pub struct Error;\n"),
                ("a.rs", "mod b;\nmod c;\npub use b::{B, Other as Renamed};\n"),
                ("a/b.rs", "use crate::Error;\npub struct B;\npub struct Other;\n"),
                (
                    "a/c.rs",
                    "//! crate::nowhere\nuse super::Renamed;\nfn f() { let _ = (\"super::x\", crate::a::B); }\n\
                     #[cfg(test)]\npub(super) mod tests {\n    use crate::Other;\n}\n",
                ),
            ],
        );
        let edges = |file: &str| graph[file].iter().map(String::as_str).collect::<Vec<_>>();
        assert_eq!(edges("a/b.rs"), ["error.rs"]);
        assert_eq!(edges("a/c.rs"), ["a/b.rs"]);
        assert_eq!(edges("a.rs"), ["a/b.rs"]);
        assert_eq!(cycle(&graph), None);
    }

    #[test]
    fn a_parent_and_a_child_that_use_each_other_are_a_cycle() {
        let files = [
            ("lib.rs", "mod a;\n"),
            (
                "a.rs",
                "mod b;\n#[cfg(test)]\nmod c;\n#[cfg(test)]\nmod tests {\n}\npub const SIZE: usize = 3;\nfn f() { b::g() }\n",
            ),
            ("a/b.rs", "pub fn g() { super::SIZE; }\n"),
        ];
        let found = cycle(&graph_of("cycle", &files)).expect("a cycle");
        assert_eq!(found, ["a.rs", "a/b.rs", "a.rs"]);
    }
}
