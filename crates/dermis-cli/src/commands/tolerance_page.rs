//! Presents a tolerance study: a table on the terminal, CSV files, a picture of the map, and one self-contained HTML
//! page with all of it.

use std::fmt::Write as _;
use std::io::Write;
use std::path::Path;

use anyhow::Context;
use dermis_device::write_atomic;
use dermis_lab::tolerances::{ToleranceReport, ToleranceRow, Tolerances};
use dermis_tomo::mesh::Point;

use crate::commands::escaped;
use crate::draw::{self, Heatmap, Panel, Picture};

const STYLE: &str = "body{font:16px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#282c34}\
table{border-collapse:collapse}td,th{padding:.2em .8em;border-bottom:1px solid #ddd;text-align:right}\
td:first-child,th:first-child{text-align:left;white-space:nowrap}pre{background:#f6f6f6;padding:1em}";
/// Columns of the table.
const COLUMNS: [&str; 8] = [
    "errors",
    "samples",
    "position error, mm: median",
    "90 % below",
    "amplitude error, %: median",
    "90 % below",
    "missed, %",
    "false per press",
];

/// Prints the table and the verdict as text.
pub(super) fn write_table(out: &mut dyn Write, report: &ToleranceReport) -> std::io::Result<()> {
    let extent = &report.extent;
    let (samples, presses, seed) = (extent.samples, extent.presses, extent.seed);
    writeln!(out, "{}: {samples} samples of every kind, {presses} presses each, seed {seed}", report.skin)?;
    let head = ["", "samples", "position, mm", "90 %", "amplitude, %", "90 %", "missed, %", "false/press"];
    write_line(out, &head.map(String::from))?;
    report.rows().try_for_each(|row| write_line(out, &cells(row)))?;
    writeln!(out, "{}", report.verdict())
}

fn write_line(out: &mut dyn Write, cells: &[String; 8]) -> std::io::Result<()> {
    write!(out, "{:<30}", cells[0])?;
    cells[1..].iter().try_for_each(|cell| write!(out, " {cell:>12}"))?;
    writeln!(out)
}

fn cells(row: &ToleranceRow) -> [String; 8] {
    let number = |value: f64, digits: usize| if value.is_finite() { format!("{value:.digits$}") } else { "-".into() };
    [
        row.name.clone(),
        row.samples.to_string(),
        number(row.position_mm[0], 2),
        number(row.position_mm[1], 2),
        number(row.amplitude_percent[0], 1),
        number(row.amplitude_percent[1], 1),
        number(row.misses_percent, 1),
        number(row.false_per_press, 2),
    ]
}

/// Writes NAME-tolerances.csv, NAME-tolerances-map.csv, NAME-tolerances-map.png and NAME-tolerances.html.
pub(super) fn write_files(folder: &Path, report: &ToleranceReport, tolerances: &Tolerances) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("creating {}", folder.display()))?;
    let picture = picture(report);
    let files = [
        (".csv", table_csv(report).into_bytes()),
        ("-map.csv", map_csv(report).into_bytes()),
        ("-map.png", draw::png(&picture, 2)?),
        (".html", page(report, tolerances, &picture).into_bytes()),
    ];
    for (end, content) in files {
        let path = folder.join(format!("{}-tolerances{end}", report.skin));
        write_atomic(&path, |file| file.write_all(&content))?;
    }
    Ok(())
}

fn table_csv(report: &ToleranceReport) -> String {
    let mut text = String::from(
        "what,samples,presses,position_median_mm,position_p90_mm,amplitude_median_percent,amplitude_p90_percent,\
         misses_percent,false_per_press,mean_with_misses_mm\n",
    );
    for row in report.rows() {
        let [median, p90] = row.position_mm;
        let [amplitude, amplitude_p90] = row.amplitude_percent;
        let (samples, presses, name) = (row.samples, row.presses, row.name.replace(',', ";"));
        let (misses, false_touches, mean) = (row.misses_percent, row.false_per_press, row.mean_mm);
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "{name},{samples},{presses},{median},{p90},{amplitude},{amplitude_p90},{misses},{false_touches},{mean}"
        );
    }
    text
}

fn map_csv(report: &ToleranceReport) -> String {
    let mut text = String::from("x_mm,y_mm,presses,median_mm,misses\n");
    for place in &report.places {
        let [x, y] = place.place_m.map(|m| 1e3 * m);
        let _ = writeln!(text, "{x},{y},{},{},{}", place.presses, place.median_mm, place.misses);
    }
    text
}

fn picture(report: &ToleranceReport) -> Picture {
    let (grid, values) = (&report.grid, &report.map_mm);
    let (width, height) = (grid.columns as f64 * grid.pixel_m, grid.rows as f64 * grid.pixel_m);
    let pressed = report.places.iter().filter(|place| place.presses > 0);
    let mark = |p: Point| [(p[0] - grid.left_m) / width, (grid.top_m - p[1]) / height];
    let panel = Panel {
        name: "all errors together".into(),
        quantity: "median position error (mm)".into(),
        columns: grid.columns,
        values: values.clone(),
        marks: pressed.map(|place| mark(place.place_m)).collect(),
        bend: None,
        width_mm: Some(1e3 * width),
    };
    Heatmap { title: format!("{}: median position error", report.skin), panels: vec![panel] }.picture()
}

fn page(report: &ToleranceReport, tolerances: &Tolerances, picture: &Picture) -> String {
    let name = escaped(&report.skin);
    let head: String = COLUMNS.iter().map(|column| format!("<th>{column}</th>")).collect();
    let line = |row: &ToleranceRow| {
        let cells: String = cells(row).iter().map(|cell| format!("<td>{}</td>", escaped(cell))).collect();
        format!("<tr>{cells}</tr>\n")
    };
    let rows: String = report.rows().map(line).collect();
    let verdict = escaped(&report.verdict());
    let extent = &report.extent;
    let (samples, presses, seed) = (extent.samples, extent.presses, extent.seed);
    let varied = escaped(&applied(tolerances, report));
    let map = draw::svg(picture);
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{name}: tolerances</title>\n\
         <style>{STYLE}</style></head><body>\n<h1>{name}: the cost of manufacturing errors</h1>\n<p><b>{verdict}</b></p>\n\
         <table><tr>{head}</tr>\n{rows}</table>\n\
         <p>{samples} samples of every kind, {presses} presses each, seed {seed}. Every sample is a twin with the errors of its \
         row; the model that reads it has none. Rows with fewer samples say so. A press is missed if no touch is \
         within a quarter of the shorter side; every other touch is false. Amplitudes are compared with those of the same \
         presses on the skin as drawn.</p>\n\
         <h2>Errors over the skin</h2>\n<p>All errors together; crosses mark the pressed places. A missed press \
         counts as a quarter of the shorter side.</p>\n{map}\n<h2>What was varied</h2>\n<pre>{varied}</pre>\n</body></html>\n"
    )
}

/// The tolerances that apply to this skin, as a file. Listing others would suggest that they had been tried.
fn applied(tolerances: &Tolerances, report: &ToleranceReport) -> String {
    let has = |name: &str| report.causes.iter().any(|row| row.name == name);
    let is_applied = |line: &&str| match line.split(' ').next().unwrap_or_default() {
        "coil_place_mm" | "element_height_mm" | "stiffness_percent" => has("coil positions"),
        "gain_percent" | "noise_percent" | "bad_electrode" => true,
        _ => !has("coil positions"),
    };
    tolerances.to_toml().lines().filter(is_applied).map(|line| format!("{line}\n")).collect()
}
