//! What an experiment leaves behind: a table, figures with their data, and a page that shows all of them.

use std::fmt::Write as _;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use dermis::lab::experiments::{Figure, Look, Report, Row};
use dermis_device::instruments::npy;
use dermis_device::write_atomic;

use crate::draw::{self, Chart, Heatmap, Mark, Panel, Picture, Series};

/// The table on the terminal.
pub fn print(out: &mut dyn Write, report: &Report) -> std::io::Result<()> {
    writeln!(out, "{}  {}", report.id, report.title)?;
    writeln!(out, "  {:<52} {:>10} {:>10} {:>7}  {:<16} kind", "", "paper", "here", "ratio", "unit")?;
    for row in &report.rows {
        let [paper, here, ratio] = cells(row);
        writeln!(
            out,
            "  {:<52} {paper:>10} {here:>10} {ratio:>7}  {:<16} {}",
            row.quantity,
            row.unit,
            row.kind.word()
        )?;
    }
    report.notes.iter().try_for_each(|note| writeln!(out, "  {note}"))
}

/// Paper, here, ratio, as text.
fn cells(row: &Row) -> [String; 3] {
    let ratio = row.paper.filter(|paper| *paper != 0.0).map(|paper| format!("{:.2}", row.here / paper));
    [row.paper.map(number).unwrap_or_default(), number(row.here), ratio.unwrap_or_default()]
}

/// Four significant digits.
fn number(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let digits = 3 - value.abs().log10().floor() as i32;
    if !(-3..=7).contains(&digits) {
        return format!("{value:.3e}");
    }
    let text = format!("{value:.*}", digits.max(0) as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_string() } else { text }
}

/// Table, figures and data of one experiment, in a folder of its own.
pub fn write(folder: &Path, report: &Report) -> anyhow::Result<()> {
    let folder = folder.join(report.id);
    std::fs::create_dir_all(&folder).with_context(|| format!("creating {}", folder.display()))?;
    let mut table = String::from("quantity,unit,paper,here,ratio,kind\n");
    for row in &report.rows {
        let paper = row.paper.map(|v| v.to_string()).unwrap_or_default();
        let ratio = row.paper.map(|v| (row.here / v).to_string()).unwrap_or_default();
        let quantity = row.quantity.replace('"', "'");
        let _ = writeln!(table, "\"{quantity}\",{},{paper},{},{ratio},{}", row.unit, row.here, row.kind.word());
    }
    put(&folder.join("table.csv"), table.as_bytes())?;
    for figure in &report.figures {
        let (name, picture) = drawing(figure);
        put(&folder.join(format!("{name}.svg")), draw::svg(&picture).as_bytes())?;
        put(&folder.join(format!("{name}.png")), &draw::png(&picture, 2)?)?;
        data(&folder, figure)?;
    }
    Ok(())
}

fn put(path: &Path, content: &[u8]) -> anyhow::Result<()> {
    Ok(write_atomic(path, |file| file.write_all(content))?)
}

fn drawing(figure: &Figure) -> (&'static str, Picture) {
    match figure {
        Figure::Curves { name, title, x_label, y_label, curves, .. } => {
            let series = curves.iter().map(|curve| Series {
                name: curve.name.clone(),
                points: curve.points.clone(),
                mark: match curve.look {
                    Look::Line if (3..=40).contains(&curve.points.len()) => Mark::LinePoints,
                    Look::Line => Mark::Line,
                    Look::Points => Mark::Points,
                    Look::Repeats => Mark::Repeats,
                    Look::PaperPoints => Mark::PaperPoints,
                    Look::PaperLine => Mark::PaperLine,
                },
            });
            let (x_label, y_label) = (x_label.to_string(), y_label.to_string());
            (*name, Chart { title: title.clone(), x_label, y_label, series: series.collect() }.picture())
        }
        Figure::Images { name, title, columns, panels, .. } => {
            let panel = |panel: &dermis::lab::experiments::ImagePanel| Panel {
                name: panel.name.clone(),
                quantity: panel.quantity.into(),
                columns: *columns,
                values: panel.values.clone(),
                marks: panel.marks.clone(),
                bend: panel.bend,
                width_mm: panel.width_mm,
            };
            let panels = panels.iter().map(panel).collect();
            (*name, Heatmap { title: title.clone(), panels }.picture())
        }
    }
}

/// What a figure shows, for other programs: CSV of curves, NPY of images.
fn data(folder: &Path, figure: &Figure) -> anyhow::Result<()> {
    match figure {
        Figure::Curves { name, curves, .. } => {
            let mut text = String::from("curve,x,y\n");
            for curve in curves {
                for [x, y] in curve.points.iter().filter(|p| p.iter().all(|v| v.is_finite())) {
                    let _ = writeln!(text, "{},{x},{y}", curve.name);
                }
            }
            put(&folder.join(format!("{name}.csv")), text.as_bytes())
        }
        Figure::Images { name, columns, panels, .. } => {
            let rows = panels.first().map_or(0, |panel| panel.values.len() / columns);
            let values: Vec<f32> = panels.iter().flat_map(|panel| panel.values.iter().copied()).collect();
            let shape = [panels.len(), rows, *columns];
            let path = folder.join(format!("{name}.npy"));
            Ok(npy::write_f32(&path, &shape, &values)?)
        }
    }
}

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#222}\
table{border-collapse:collapse;margin:1rem 0}td,th{padding:.2rem .8rem;border-bottom:1px solid #ddd;text-align:right}\
td:first-child,th:first-child{text-align:left}.predicted{color:#00664a}.fitted{color:#a04000}img{max-width:100%}";

/// One page for all experiments in the folder's `report.html`; figures are linked, not embedded.
pub fn write_page(folder: &Path, reports: &[Report]) -> anyhow::Result<PathBuf> {
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\"><title>dermis reproduce</title><style>{STYLE}</style>\n\
         <h1>Published experiments on their twins</h1>\n<p>Fitted figures prove nothing; predicted ones follow from the \
         twin's physics, algorithm ones from how images and touches are made of its readings.</p>\n"
    );
    for report in reports {
        let _ = writeln!(
            page,
            "<h2>{} &mdash; {}</h2>\n<table><tr><th>quantity<th>paper<th>here<th>ratio<th>unit<th>kind",
            report.id,
            escaped(report.title)
        );
        for row in &report.rows {
            let [paper, here, ratio] = cells(row);
            let (quantity, kind) = (escaped(&row.quantity), row.kind.word());
            let _ = writeln!(
                page,
                "<tr class=\"{kind}\"><td>{quantity}<td>{paper}<td>{here}<td>{ratio}<td>{}<td>{kind}",
                escaped(row.unit)
            );
        }
        page.push_str("</table>\n");
        for note in &report.notes {
            let _ = writeln!(page, "<p>{}</p>", escaped(note));
        }
        for figure in &report.figures {
            let (name, picture) = drawing(figure);
            let _ = writeln!(page, "<p><img src=\"{}/{name}.svg\" alt=\"{}\"></p>", report.id, escaped(&picture.title));
        }
    }
    let path = folder.join("report.html");
    put(&path, page.as_bytes())?;
    Ok(path)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_four_digits() {
        let texts = [0.0, 6.0, 0.123456, 2.51, 16.92, 1.19e-4, 56789.0, f64::NAN].map(number);
        assert_eq!(texts, ["0", "6", "0.1235", "2.51", "16.92", "0.000119", "56789", "NaN"].map(String::from));
    }
}
