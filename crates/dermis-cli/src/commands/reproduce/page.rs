//! One page for all replayed experiments: contents, methods, tables, figures with captions, downloads. Pictures and
//! styles are embedded, so the page can be sent as a single file; downloads are in the folders next to it.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use dermis_lab::experiments::{Figure, METHODS, Method, PAPERS, Report};
use dermis_skin::Skin;
use dermis_twin::from_skin::seed_of;

use super::figures::{caption, cells, comparison, drawing, skins};
use super::report::put;
use crate::commands::escaped;
use crate::draw::{self, Picture};

const STYLE: &str = include_str!("report.css");
/// Explains twins, kinds of figures and measures.
const METHODS_TEXT: &str = include_str!("methods.html");
/// Wider pictures, in pixels, scroll sideways on a small screen.
const WIDE_PX: u32 = 640;

/// The page and its count of figures.
struct Page {
    text: String,
    figures: usize,
}

/// A paper and its replayed experiments.
struct Chapter<'a> {
    letter: &'static str,
    title: &'static str,
    reports: Vec<&'a Report>,
}

/// Writes one page for all experiments to `report.html` in the folder.
pub fn write_page(folder: &Path, reports: &[Report]) -> anyhow::Result<PathBuf> {
    let chapters = chapters(reports);
    let mut page = Page { text: String::new(), figures: 0 };
    page.head(&chapters);
    page.contents(&chapters);
    page.methods(&chapters)?;
    for chapter in &chapters {
        page.chapter(chapter)?;
    }
    page.text.push_str("</main>\n</body>\n</html>\n");
    let path = folder.join("report.html");
    put(&path, page.text.as_bytes())?;
    Ok(path)
}

/// Reports grouped by paper, papers in their fixed order.
fn chapters(reports: &[Report]) -> Vec<Chapter<'_>> {
    let chapter = |(letter, title, experiments): &(&'static str, &'static str, &[_])| Chapter {
        letter,
        title,
        reports: reports
            .iter()
            .filter(|report| experiments.iter().any(|e: &dermis_lab::experiments::Experiment| e.id == report.id))
            .collect(),
    };
    PAPERS.iter().map(chapter).filter(|chapter| !chapter.reports.is_empty()).collect()
}

fn method(letter: &str) -> Option<&'static Method> {
    METHODS.iter().find(|method| method.letter == letter)
}

impl Page {
    fn push(&mut self, text: &str) {
        self.text.push_str(text);
        self.text.push('\n');
    }

    fn head(&mut self, chapters: &[Chapter]) {
        let font = BASE64_STANDARD.encode(draw::FONT_FILE);
        let letters: Vec<&str> = chapters.iter().map(|chapter| chapter.letter).collect();
        let ids: Vec<&str> = chapters.iter().flat_map(|chapter| &chapter.reports).map(|report| report.id).collect();
        let (papers, version) = (letters.join(", "), env!("CARGO_PKG_VERSION"));
        let _ = writeln!(
            self.text,
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <title>Published skins, replayed on their twins: {papers}</title>\n<style>\n\
             @font-face{{font-family:\"DejaVu Sans\";src:url(data:font/ttf;base64,{font}) format(\"truetype\")}}\n\
             {STYLE}</style>\n</head>\n<body>\n<main>\n<header>\n<h1>Published skins, replayed on their twins</h1>\n\
             <p class=\"lead\">{} experiments of {}, simulated and imaged by dermis {version}, each next to the \
             numbers in its paper.</p>\n<p class=\"command\"><code>dermis reproduce {}</code></p>\n</header>",
            ids.len(),
            if letters.len() == 1 { format!("paper {papers}") } else { format!("papers {papers}") },
            ids.join(" ")
        );
    }

    fn contents(&mut self, chapters: &[Chapter]) {
        self.push("<nav aria-label=\"Contents\">\n<h2>Contents</h2>\n<ol>\n<li><a href=\"#methods\">Methods</a>");
        for chapter in chapters {
            let (letter, title) = (chapter.letter, escaped(chapter.title));
            let _ = writeln!(self.text, "<li><a href=\"#{letter}\">Paper {letter}: {title}</a>\n<ol>");
            for report in &chapter.reports {
                let _ = writeln!(self.text, "<li><a href=\"#{0}\">{0}: {1}</a>", report.id, escaped(report.title));
            }
            self.push("</ol>");
        }
        self.push("</ol>\n</nav>");
    }

    fn methods(&mut self, chapters: &[Chapter]) -> anyhow::Result<()> {
        self.push("<section id=\"methods\">\n<h2>Methods</h2>");
        self.text.push_str(METHODS_TEXT);
        self.push("<h3>What was given, fitted and assumed</h3>");
        for method in chapters.iter().filter_map(|chapter| method(chapter.letter)) {
            let _ = writeln!(
                self.text,
                "<h4>Paper {}</h4>\n<dl>\n<dt>given<dd>{}\n<dt>fitted<dd>{}\n<dt>assumed<dd>{}\n</dl>",
                method.letter,
                escaped(method.given),
                escaped(method.fitted),
                escaped(method.assumed)
            );
        }
        self.push("<h3>Versions and seeds</h3>");
        let version = env!("CARGO_PKG_VERSION");
        let _ = writeln!(
            self.text,
            "<p>dermis {version}. Noise and tolerances of a twin come from a seeded generator, so that a replay gives \
             the same numbers on the same machine. Every experiment starts with a new twin.</p>\n<div \
             class=\"scroll\"><table>\n\
             <thead><tr><th>skin<th>paper<th>seed<th>frames/s<th>channels</thead>\n<tbody>"
        );
        for method in chapters.iter().filter_map(|chapter| method(chapter.letter)) {
            for name in method.skins {
                let skin = Skin::open(name)?;
                let rate = skin.backend.frames_per_s.map_or("\u{2013}".to_string(), |rate| rate.to_string());
                let channels = skin.protocol().map_or("\u{2013}".to_string(), |p| p.channel_count().to_string());
                let (letter, seed) = (method.letter, seed_of(&skin));
                let _ = writeln!(self.text, "<tr><td>{name}<td>{letter}<td>{seed}<td>{rate}<td>{channels}");
            }
        }
        self.push("</tbody></table></div>\n</section>");
        Ok(())
    }

    fn chapter(&mut self, chapter: &Chapter) -> anyhow::Result<()> {
        let letter = chapter.letter;
        let _ = writeln!(
            self.text,
            "<section class=\"paper\" id=\"{letter}\">\n<h2>Paper {letter}: {}</h2>",
            escaped(chapter.title)
        );
        if let Some(method) = method(letter) {
            let link = |doi: &str| format!(", <a href=\"https://doi.org/{doi}\">{doi}</a>");
            let doi = method.doi.map(link).unwrap_or_default();
            let _ = writeln!(self.text, "<p class=\"source\">{}{doi}</p>", escaped(method.source));
        }
        if let Some(picture) = comparison(letter, &chapter.reports) {
            let words = "The twins' value of every number in the paper other than 0, as a ratio to the paper's on a \
                         logarithmic axis, and at the right the twin's number with the paper's in brackets. The dashed \
                         line is the paper. For errors, left of it is better.";
            self.figure(&picture, words, "");
        }
        for (name, title, picture) in skins(letter)? {
            let words = format!(
                "The skin {name} ({}) to scale, seen from the side that is touched: its outline and its electrodes or \
                 coils with their numbers.",
                escaped(&title)
            );
            self.figure(&picture, &words, "");
        }
        for report in &chapter.reports {
            self.experiment(report);
        }
        self.push("</section>");
        Ok(())
    }

    fn experiment(&mut self, report: &Report) {
        let (id, title) = (report.id, escaped(report.title));
        let _ = writeln!(
            self.text,
            "<article id=\"{id}\">\n<h3>{id}: {title}</h3>\n<div \
            class=\"scroll\"><table>\n<thead><tr><th>quantity<th>paper\
             <th>here<th>ratio<th>unit<th>kind</thead>\n<tbody>"
        );
        for row in &report.rows {
            let [paper, here, ratio] = cells(row);
            let (quantity, kind) = (escaped(&row.quantity), row.kind.word());
            let _ = writeln!(
                self.text,
                "<tr class=\"{kind}\"><td>{quantity}<td>{paper}<td>{here}<td>{ratio}<td>{}<td>{kind}",
                escaped(row.unit)
            );
        }
        self.push("</tbody></table></div>");
        for note in &report.notes {
            let _ = writeln!(self.text, "<p>{}</p>", escaped(note));
        }
        let _ = writeln!(self.text, "<p class=\"downloads\"><a href=\"{id}/table.csv\" download>table (CSV)</a></p>");
        for figure in &report.figures {
            let (name, picture) = drawing(figure);
            let data = if matches!(figure, Figure::Curves { .. }) { "csv" } else { "npy" };
            let links: Vec<String> = ["svg", "pdf", "png", data]
                .iter()
                .map(|end| format!("<a href=\"{id}/{name}.{end}\" download>{}</a>", end.to_uppercase()))
                .collect();
            self.figure(&picture, &escaped(&caption(figure)), &links.join(" "));
        }
        self.push("</article>");
    }

    /// A picture with its number and caption; `links` are downloads.
    fn figure(&mut self, picture: &Picture, caption: &str, links: &str) {
        self.figures += 1;
        let wide = if picture.width_px > WIDE_PX { " wide" } else { "" };
        let downloads =
            if links.is_empty() { String::new() } else { format!(" <span class=\"downloads\">{links}</span>") };
        let _ = writeln!(
            self.text,
            "<figure>\n<div class=\"scroll{wide}\">{}</div>\n<figcaption><b>Figure {}.</b> \
            {caption}{downloads}</figcaption>\n\
             </figure>",
            draw::svg(picture).trim_end(),
            self.figures
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_lab::experiments::{Curve, Kind, Look, Row};

    fn report(id: &'static str) -> Report {
        let (unit, paper, here, kind) = ("mm", Some(2.0), 0.123_456, Kind::Predicted);
        let rows = vec![Row { quantity: "error < 1".into(), unit, paper, here, kind }];
        let curves = vec![Curve { name: "c".into(), points: vec![[0.0, 1.0], [0.0, 2.0]], look: Look::Repeats }];
        let (title, caption) = ("its title".into(), "What is shown.".into());
        let figures =
            vec![Figure::Curves { name: "chart", title, caption, x_label: "x (s)", y_label: "y (m)", curves }];
        Report { id, title: "a < b", rows, figures, notes: vec!["a note".into()] }
    }

    fn page(reports: &[Report]) -> String {
        let folder = tempfile::tempdir().unwrap();
        std::fs::read_to_string(write_page(folder.path(), reports).unwrap()).unwrap()
    }

    #[test]
    fn one_page_has_all_papers_with_contents_methods_tables_and_figures() {
        // In the order of replay; the page has the papers in their fixed order.
        let page = page(&[report("P1"), report("I3")]);
        let targets: Vec<&str> = page.split("href=\"#").skip(1).filter_map(|rest| rest.split('"').next()).collect();
        assert_eq!(targets, ["methods", "I", "I3", "P", "P1"]);
        for target in targets {
            assert!(page.contains(&format!("id=\"{target}\"")), "{target}");
        }
        assert!(page.contains("dermis reproduce I3 P1"));
        // Only values fitted in these papers appear; the measures; the seeds.
        assert!(page.contains("0.888 kPa") && page.contains("60 N/m") && !page.contains("56.8 dB"));
        assert!(page.contains("<dt>ICC") && page.contains("<dt>RIE") && page.contains("<dt>SSIM"));
        assert!(page.contains("<tr><td>piezo-disc<td>P<td>1<td>30<td>4096"));
        assert!(page.contains("<td>error &lt; 1<td>2<td>0.1235<td>0.06<td>mm<td>predicted"));
        assert!(page.contains("What is shown. Symbols are means over the repeats"));
        for file in ["I3/table.csv", "I3/chart.svg", "P1/chart.pdf", "P1/chart.csv"] {
            assert!(page.contains(&format!("href=\"{file}\" download")), "{file}");
        }
        // A comparison for each paper, two and three skins, and a chart for each experiment, numbered throughout.
        assert_eq!(page.matches("<figure>").count(), 9);
        assert!(page.contains("<b>Figure 9.</b>") && !page.contains("Figure 10."));
    }

    #[test]
    fn the_page_is_self_contained_and_fits_small_screens_and_paper() {
        let page = page(&[report("H2")]);
        for outside in ["src=\"", "url(http", "<link", "<script", "@import"] {
            assert!(!page.contains(outside), "{outside}");
        }
        assert!(page.contains("url(data:font/ttf;base64,AAEAAA"));
        assert!(
            page.contains("name=\"viewport\"") && page.contains("@media print") && page.contains("<html lang=\"en\">")
        );
    }
}
