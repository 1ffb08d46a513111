//! Output of an experiment: a table on the terminal and as a file, and figures with their data.

use std::fmt::Write as _;
use std::io::Write;
use std::path::Path;

use anyhow::Context;
use dermis_device::instruments::npy;
use dermis_device::write_atomic;
use dermis_lab::experiments::{Figure, Report};

use super::figures::{cells, drawing};
use crate::draw;

/// Prints the table on the terminal.
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

/// Writes table, figures and data of one experiment to its own folder.
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
        put(&folder.join(format!("{name}.pdf")), &draw::pdf(&picture))?;
        data(&folder, figure)?;
    }
    Ok(())
}

pub(super) fn put(path: &Path, content: &[u8]) -> anyhow::Result<()> {
    Ok(write_atomic(path, |file| file.write_all(content))?)
}

/// Writes the data of a figure for other programs: CSV for curves, NPY for images.
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
