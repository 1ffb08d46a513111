//! Draws the figures of experiments, with captions that explain symbols and colours.

use dermis_lab::experiments::Row;
use dermis_lab::experiments::{Figure, Look, METHODS, Report};
use dermis_skin::Skin;

use crate::draw::{Chart, Dot, DotPlot, Heatmap, Mark, Panel, Picture, Series, SkinDrawing};

/// File name and picture of a figure.
pub(super) fn drawing(figure: &Figure) -> (&'static str, Picture) {
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
            let panel = |panel: &dermis_lab::experiments::ImagePanel| Panel {
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

/// The caption: what is shown, then how to read symbols and colours.
pub(super) fn caption(figure: &Figure) -> String {
    match figure {
        Figure::Curves { caption, curves, .. } => {
            let has = |looks: &[Look]| curves.iter().any(|curve| looks.contains(&curve.look));
            let mut text = caption.clone();
            if has(&[Look::Repeats]) {
                text.push_str(
                    " Symbols are means over the repeats, bars one standard deviation to both sides, pale dots the \
                     single repeats.",
                );
            }
            if has(&[Look::PaperPoints]) {
                text.push_str(" Hollow squares are the paper's.");
            }
            if has(&[Look::PaperLine]) {
                text.push_str(" The dashed line is the paper's.");
            }
            text
        }
        Figure::Images { caption, panels, .. } => {
            let mut text = caption.clone();
            let first = panels.first();
            let is_one = panels.iter().all(|panel| first.is_some_and(|first| panel.quantity == first.quantity));
            text.push_str(match is_one {
                true => " All images share one colour scale",
                false => " Images of one quantity share a colour scale",
            });
            if panels.iter().any(|panel| !panel.marks.is_empty()) {
                text.push_str("; crosses are true places");
            }
            if panels.iter().any(|panel| panel.width_mm.is_some() && panel.bend.is_none()) {
                text.push_str("; x runs to the right, y up");
            }
            text.push('.');
            text
        }
    }
}

/// Every number printed in the papers compared with the value here, as ratios; `None` if there are no numbers.
pub(super) fn comparison(letter: &str, reports: &[&Report]) -> Option<Picture> {
    let kinds = ["fitted", "predicted", "algorithm"];
    let mut dots = Vec::new();
    for (report, row) in reports.iter().flat_map(|report| report.rows.iter().map(move |row| (report, row))) {
        let Some(paper) = row.paper.filter(|paper| *paper != 0.0 && row.here / paper > 0.0) else { continue };
        let [given, here, _] = cells(row);
        dots.push(Dot {
            name: format!("{} {}", report.id, row.quantity),
            numbers: format!("{here} ({given}) {}", row.unit).trim_end().to_string(),
            ratio: row.here / paper,
            kind: kinds.iter().position(|kind| *kind == row.kind.word()).unwrap_or_default(),
        });
    }
    let title = format!("Paper {letter}: its numbers and those of the twins");
    let (label, kinds) = ("twin / paper".into(), kinds.map(String::from).to_vec());
    (!dots.is_empty()).then(|| DotPlot { title, label, kinds, dots }.picture())
}

/// The skins of a paper to scale with numbered electrodes or coils: name, title and picture.
pub(super) fn skins(letter: &str) -> anyhow::Result<Vec<(&'static str, String, Picture)>> {
    let names = METHODS.iter().filter(|method| method.letter == letter).flat_map(|method| method.skins);
    let drawn = names.map(|name| {
        let skin = Skin::open(name)?;
        let picture =
            SkinDrawing { body: &skin.body()?.mesh, title: &skin.title, width_px: 520, mesh: false }.picture();
        Ok((*name, skin.title, picture))
    });
    drawn.collect()
}

/// The paper's value, the value here and their ratio, as text.
pub(super) fn cells(row: &Row) -> [String; 3] {
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

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_lab::experiments::{Kind, Row};

    #[test]
    fn only_numbers_that_a_paper_prints_are_compared() {
        let row = |quantity: &str, paper, here, kind| Row { quantity: quantity.into(), unit: "mm", paper, here, kind };
        let rows = vec![
            row("printed", Some(4.0), 2.0, Kind::Predicted),
            row("not printed", None, 2.0, Kind::Predicted),
            row("of no ratio", Some(0.0), 2.0, Kind::Fitted),
        ];
        let report = Report { id: "X1", title: "t", rows, figures: Vec::new(), notes: Vec::new() };
        let picture = comparison("X", &[&report]).unwrap();
        let words: Vec<&str> = picture.texts().map(|text| text.words.as_str()).collect();
        assert!(
            words.contains(&"X1 printed") && words.contains(&"2 (4) mm") && words.contains(&"predicted"),
            "{words:?}"
        );
        assert!(!words.iter().any(|words| words.contains("not printed") || words.contains("of no")), "{words:?}");
        assert_eq!(comparison("X", &[&Report { rows: Vec::new(), ..report }]), None);
    }

    #[test]
    fn captions_explain_bars_squares_and_crosses() {
        let curve = |look| dermis_lab::experiments::Curve { name: "a".into(), points: vec![[0.0, 1.0]], look };
        let (title, text) = (String::new(), "Something.".to_string());
        let curves = vec![curve(Look::Repeats), curve(Look::PaperLine)];
        let figure = Figure::Curves { name: "f", title, caption: text, x_label: "x", y_label: "y", curves };
        let words = caption(&figure);
        assert!(words.starts_with("Something. ") && words.contains("one standard deviation"), "{words}");
        assert!(words.contains("dashed line") && !words.contains("Hollow"), "{words}");
    }

    #[test]
    fn numbers_keep_four_digits() {
        let texts = [0.0, 6.0, 0.123456, 2.51, 16.92, 1.19e-4, 56789.0, f64::NAN].map(number);
        assert_eq!(texts, ["0", "6", "0.1235", "2.51", "16.92", "0.000119", "56789", "NaN"].map(String::from));
    }
}
