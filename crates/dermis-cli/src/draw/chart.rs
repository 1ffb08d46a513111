//! Charts of lines and points with axes, for reports: what was measured against what was varied.

use super::picture::{Colour, Picture, Point, Polyline, Shape, Stroke};
use super::text::Lettering;

const INK: Colour = Colour(40, 44, 52);
const GRID: Colour = Colour(225, 228, 232);
/// Colours of series, distinguishable for most eyes (Okabe and Ito 2008).
const PALETTE: [Colour; 7] = [
    Colour(0, 114, 178),
    Colour(213, 94, 0),
    Colour(0, 158, 115),
    Colour(204, 121, 167),
    Colour(86, 180, 233),
    Colour(230, 159, 0),
    Colour(90, 90, 90),
];
const WIDTH: f64 = 860.0;
const HEIGHT: f64 = 520.0;
/// Left, right, top, bottom.
const MARGIN: [f64; 4] = [96.0, 24.0, 56.0, 72.0];

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// A line from point to point.
    Line,
    /// Separate points.
    Points,
    /// A line with its points.
    LinePoints,
}

/// One curve.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// What it is, in the legend; empty: none. Series of one name have one colour and one entry.
    pub name: String,
    /// (x, y); points that are not finite are left out, and break a line.
    pub points: Vec<[f64; 2]>,
    /// Its look.
    pub mark: Mark,
}

/// A chart; axes cover what the series do.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    /// Above it.
    pub title: String,
    /// Below the x axis, with its unit.
    pub x_label: String,
    /// Beside the y axis, with its unit.
    pub y_label: String,
    /// The curves.
    pub series: Vec<Series>,
}

/// One axis: data from `low` to `high` on pixels from `start` to `end`.
struct Axis {
    low: f64,
    high: f64,
    start: f64,
    end: f64,
    step: f64,
}

impl Axis {
    /// Covers the values, rounded out to whole steps.
    fn over(values: impl Iterator<Item = f64>, start: f64, end: f64) -> Self {
        let (mut low, mut high) =
            values.filter(|v| v.is_finite()).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        if low == high {
            let room = if low == 0.0 { 1.0 } else { 0.5 * low.abs() };
            (low, high) = (low - room, high + room);
        }
        let rough = (high - low) / 6.0;
        let power = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|k| k * power).find(|s| *s >= rough).unwrap_or(power);
        Self { low: (low / step).floor() * step, high: (high / step).ceil() * step, start, end, step }
    }

    fn place(&self, value: f64) -> f64 {
        self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)
    }

    fn ticks(&self) -> impl Iterator<Item = f64> + '_ {
        let count = ((self.high - self.low) / self.step).round() as usize;
        (0..=count).map(|k| self.low + self.step * k as f64)
    }

    fn label(&self, value: f64) -> String {
        let decimals = (-self.step.log10().floor()).clamp(0.0, 12.0) as usize;
        let largest = self.low.abs().max(self.high.abs());
        if !(1e-3..1e6).contains(&largest) {
            return format!("{value:.1e}").to_uppercase();
        }
        let text = format!("{value:.decimals$}");
        if text.trim_start_matches('-').chars().all(|c| c == '0' || c == '.') { "0".into() } else { text }
    }
}

impl Chart {
    /// The drawing.
    pub fn picture(&self) -> Picture {
        let all = || self.series.iter().flat_map(|series| &series.points);
        let x = Axis::over(all().map(|p| p[0]), MARGIN[0], WIDTH - MARGIN[1]);
        let y = Axis::over(all().map(|p| p[1]), HEIGHT - MARGIN[3], MARGIN[2]);
        let mut shapes = frame(&x, &y);
        shapes.extend(self.labels());
        for (index, series) in self.series.iter().enumerate() {
            shapes.extend(curve(series, &x, &y, self.colour(index)));
        }
        shapes.extend(self.legend());
        Picture { title: self.title.clone(), width_px: WIDTH as u32, height_px: HEIGHT as u32, shapes }
    }

    fn labels(&self) -> Vec<Shape> {
        let middle = 0.5 * (MARGIN[2] + HEIGHT - MARGIN[3]);
        let centre = 0.5 * (MARGIN[0] + WIDTH - MARGIN[1]);
        let mut lines = Lettering::new(&self.title, 13.0).centred_at([centre, 26.0]);
        lines.extend(Lettering::new(&self.x_label, 10.0).centred_at([centre, HEIGHT - 22.0]));
        lines.extend(Lettering::new(&self.y_label, 10.0).turned_at([22.0, middle], true));
        vec![text(lines)]
    }

    /// Place of a series in the legend, and so of its colour: that of the first of its name.
    fn first_of_name(&self, index: usize) -> usize {
        let name = &self.series[index].name;
        let first = self.series.iter().position(|series| !name.is_empty() && series.name == *name);
        first.unwrap_or(index)
    }

    fn colour(&self, index: usize) -> Colour {
        PALETTE[self.first_of_name(index) % PALETTE.len()]
    }

    /// Names in the colours of their curves, in the upper left corner.
    fn legend(&self) -> Vec<Shape> {
        let mut shapes = Vec::new();
        let is_entry =
            |(index, series): &(usize, &Series)| !series.name.is_empty() && self.first_of_name(*index) == *index;
        let named = self.series.iter().enumerate().filter(is_entry);
        for (row, (index, series)) in named.enumerate() {
            let colour = self.colour(index);
            let (left, level) = (MARGIN[0] + 14.0, MARGIN[2] + 16.0 + 20.0 * row as f64);
            let lettering = Lettering::new(&series.name, 9.0);
            let centre = left + 34.0 + 0.5 * lettering.width;
            shapes.push(line("legend", vec![Polyline::open(vec![[left, level], [left + 24.0, level]])], colour, 2.5));
            shapes.push(text(lettering.centred_at([centre, level])));
        }
        shapes
    }
}

fn frame(x: &Axis, y: &Axis) -> Vec<Shape> {
    let mut grid = Vec::new();
    let mut letters = Vec::new();
    for tick in x.ticks() {
        let at = x.place(tick);
        grid.push(Polyline::open(vec![[at, y.start], [at, y.end]]));
        letters.extend(Lettering::new(&x.label(tick), 9.0).centred_at([at, y.start + 18.0]));
    }
    for tick in y.ticks() {
        let at = y.place(tick);
        grid.push(Polyline::open(vec![[x.start, at], [x.end, at]]));
        let lettering = Lettering::new(&y.label(tick), 9.0);
        let centre = x.start - 10.0 - 0.5 * lettering.width;
        letters.extend(lettering.centred_at([centre, at]));
    }
    let corners = vec![[x.start, y.start], [x.end, y.start], [x.end, y.end], [x.start, y.end]];
    vec![line("grid", grid, GRID, 1.0), line("frame", vec![Polyline::closed(corners)], INK, 1.2), text(letters)]
}

fn curve(series: &Series, x: &Axis, y: &Axis, colour: Colour) -> Vec<Shape> {
    let is_finite = |p: &[f64; 2]| p.iter().all(|v| v.is_finite());
    let place = |p: &[f64; 2]| -> Point { [x.place(p[0]), y.place(p[1])] };
    let points: Vec<Point> = series.points.iter().filter(|p| is_finite(p)).map(place).collect();
    let mut shapes = Vec::new();
    if series.mark != Mark::Points {
        let pieces = series.points.split(|p| !is_finite(p)).filter(|piece| piece.len() > 1);
        let lines: Vec<Polyline> =
            pieces.map(|piece| Polyline::open(piece.iter().map(place).collect::<Vec<_>>())).collect();
        shapes.extend((!lines.is_empty()).then(|| line("curve", lines, colour, 2.0)));
    }
    if series.mark != Mark::Line {
        let diamond =
            |[x, y]: &Point| Polyline::closed(vec![[x - 4.0, *y], [*x, y - 4.0], [x + 4.0, *y], [*x, y + 4.0]]);
        let lines = points.iter().map(diamond).collect();
        shapes.push(Shape { class: "points", lines, fill: Some(colour), stroke: None });
    }
    shapes
}

fn line(class: &'static str, lines: Vec<Polyline>, colour: Colour, width: f64) -> Shape {
    Shape { class, lines, fill: None, stroke: Some(Stroke { colour, width }) }
}

fn text(lines: Vec<Polyline>) -> Shape {
    line("text", lines, INK, 1.2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_round_out_and_place_their_ends() {
        let axis = Axis::over([0.13, 0.97, f64::NAN].into_iter(), 100.0, 500.0);
        assert!((axis.low - 0.0).abs() < 1e-12 && (axis.high - 1.0).abs() < 1e-12, "{} {}", axis.low, axis.high);
        assert_eq!((axis.place(axis.low), axis.place(axis.high)), (100.0, 500.0));
        assert_eq!(
            axis.ticks().map(|tick| axis.label(tick)).collect::<Vec<_>>(),
            ["0", "0.2", "0.4", "0.6", "0.8", "1.0"]
        );
    }

    #[test]
    fn empty_and_constant_series_draw() {
        let flat = Series { name: "flat".into(), points: vec![[1.0, 2.0]], mark: Mark::LinePoints };
        let chart = Chart { title: "t".into(), x_label: "x".into(), y_label: "y".into(), series: vec![flat] };
        assert!(chart.picture().shapes.iter().any(|shape| shape.class == "points"));
        let empty = Chart { series: Vec::new(), ..chart };
        assert!(!empty.picture().shapes.is_empty());
    }
}
