//! The documentation says what is: its links lead somewhere, its skin file is one, and every key of a skin file is in it.

use std::path::{Path, PathBuf};

use dermis::skin::{BUILTIN_NAMES, Skin};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Every Markdown file that people read first, and every chapter.
fn pages() -> Vec<PathBuf> {
    let root = root();
    let mut pages: Vec<PathBuf> =
        ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md", "benches/peers/README.md"]
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

#[test]
fn the_skin_file_of_the_book_is_one() {
    let chapter = text(&root().join("docs/src/skin-file.md"));
    let example = chapter.split("```toml\n").nth(1).and_then(|rest| rest.split("```").next()).expect("an example");
    let skin = Skin::parse(example, "docs/src/skin-file.md").expect("the example is a skin file");
    assert_eq!(skin.body().expect("it can be meshed").mesh.electrodes.len(), 16);
    assert_eq!(skin.protocol().expect("it has a protocol").channel_count(), 208);
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
