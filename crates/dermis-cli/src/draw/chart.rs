//! Charts of lines and points with axes.

use super::axis::{Axis, power_of_ten};
use super::colours::CURVES;
use super::marker::{Marker, dashed};
use super::picture::{Anchor, Colour, INK, Item, Picture, PixelPoint, Polyline, Shape, Stroke, Text, WHITE};
use super::text::width;

const GRID: Colour = Colour(226, 229, 233);
const WIDTH: f64 = 600.0;
/// Height of the frame around the curves.
const FRAME: f64 = 320.0;
const TITLE_SIZE: f64 = 17.0;
const LABEL_SIZE: f64 = 15.0;
const TICK_SIZE: f64 = 14.0;
/// Margins left, right and below the frame.
const MARGIN: [f64; 3] = [84.0, 22.0, 64.0];
const LEGEND_LINE: f64 = 22.0;
/// Prefix of the names of series printed in a paper.
const PAPER: &str = "paper: ";
/// Distance from a legend's symbol to its text, and from there to the next symbol.
const LEGEND_GAP: [f64; 2] = [34.0, 24.0];

/// Style of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// A line through the points.
    Line,
    /// Separate points.
    Points,
    /// A line with its points.
    LinePoints,
    /// All points drawn faintly, with the mean of those at the same x and a bar of one standard deviation to both
    /// sides.
    Repeats,
    /// Hollow squares for points printed in a paper, in the colour of the series whose name follows `paper: `, else
    /// in ink.
    PaperPoints,
    /// A dashed line in ink for a line printed in a paper.
    PaperLine,
}

/// One curve.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Name in the legend; no entry if empty. Series with the same name share a colour and an entry.
    pub name: String,
    /// (x, y); points that are not finite are left out and break a line.
    pub points: Vec<[f64; 2]>,
    /// Style.
    pub mark: Mark,
}

/// A chart; its axes cover all series.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    /// Title above the frame.
    pub title: String,
    /// Label below the x axis, with unit.
    pub x_label: String,
    /// Label next to the y axis, with unit.
    pub y_label: String,
    /// The curves.
    pub series: Vec<Series>,
}

/// Summary of the points at each x: x, mean, standard deviation (NaN for a single point).
fn repeats(points: &[[f64; 2]]) -> Vec<[f64; 3]> {
    let mut sorted: Vec<[f64; 2]> = points.iter().copied().filter(|p| p.iter().all(|v| v.is_finite())).collect();
    sorted.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let groups = sorted.chunk_by(|a, b| a[0] == b[0]);
    groups
        .map(|group| {
            let count = group.len() as f64;
            let mean = group.iter().map(|p| p[1]).sum::<f64>() / count;
            let square = group.iter().map(|p| (p[1] - mean).powi(2)).sum::<f64>();
            [group[0][0], mean, (square / (count - 1.0)).sqrt()]
        })
        .collect()
}

/// An entry in the legend: the series, and the position of its symbol.
struct Entry {
    index: usize,
    at: PixelPoint,
}

impl Chart {
    /// The drawing.
    pub fn picture(&self) -> Picture {
        let (entries, lines) = self.legend_entries();
        let legend_top = if self.title.is_empty() { 12.0 } else { 46.0 };
        let all = || self.series.iter().flat_map(|series| &series.points);
        let spread = self.series.iter().filter(|series| series.mark == Mark::Repeats).flat_map(|s| repeats(&s.points));
        let ends = spread.filter(|p| p[2].is_finite()).flat_map(|p| [p[1] - p[2], p[1] + p[2]]);
        // Leave room above bounds, which the frame's line would hide.
        let bounds = self.series.iter().filter(|series| series.mark == Mark::PaperLine);
        let beyond = bounds.flat_map(|series| &series.points).map(|p| 1.05 * p[1]);
        let x = Axis::over(all().map(|p| p[0]), [MARGIN[0], WIDTH - MARGIN[1]], 6);
        let mut y = Axis::over(all().map(|p| p[1]).chain(ends).chain(beyond), [FRAME, 0.0], 6);
        let power_line = if y.power() == 0 { 0.0 } else { 18.0 };
        let top = legend_top + LEGEND_LINE * lines as f64 + 10.0 + power_line;
        (y.start, y.end) = (top + FRAME, top);
        let mut items = frame(&x, &y);
        items.extend(self.labels(&x, &y));
        for (index, series) in self.series.iter().enumerate() {
            items.extend(self.curve(series, index, &x, &y));
        }
        items.extend(self.legend(&entries, legend_top));
        let height_px = (top + FRAME + MARGIN[2]).ceil() as u32;
        Picture { title: self.title.clone(), width_px: WIDTH as u32, height_px, items }
    }

    fn labels(&self, x: &Axis, y: &Axis) -> Vec<Item> {
        let centre = |axis: &Axis| 0.5 * (axis.start + axis.end);
        let mut texts = vec![
            Text::new(&self.title, TITLE_SIZE, [0.5 * WIDTH, 24.0]),
            Text::new(&self.x_label, LABEL_SIZE, [centre(x), y.start + 48.0]),
            Text { upward: true, ..Text::new(&self.y_label, LABEL_SIZE, [18.0, centre(y)]) },
        ];
        let power = |axis: &Axis, at: PixelPoint, anchor: Anchor| {
            let words = format!("× {}", power_of_ten(axis.power()));
            (axis.power() != 0).then(|| Text { anchor, ..Text::new(words, TICK_SIZE, at) })
        };
        texts.extend(power(y, [y_edge(x), y.end - 14.0], Anchor::Start));
        texts.extend(power(x, [x.end, y.start + 48.0], Anchor::End));
        texts.into_iter().map(Item::Text).collect()
    }

    /// Index of the first series with the same name, which determines legend entry and colour.
    fn first_of_name(&self, index: usize) -> usize {
        let name = &self.series[index].name;
        let first = self.series.iter().position(|series| !name.is_empty() && series.name == *name);
        first.unwrap_or(index)
    }

    /// Number of distinct names before a series, not counting the paper's, which are drawn in ink.
    fn number(&self, index: usize) -> usize {
        let own = |k: &usize| !self.series[*k].mark.is_paper() && self.first_of_name(*k) == *k;
        (0..self.first_of_name(index)).filter(own).count()
    }

    fn colour(&self, index: usize) -> Colour {
        let series = &self.series[index];
        if !series.mark.is_paper() {
            return CURVES[self.number(index) % CURVES.len()];
        }
        let own = series.name.strip_prefix(PAPER).and_then(|name| self.series.iter().position(|s| s.name == name));
        own.map_or(INK, |own| self.colour(own))
    }

    fn curve(&self, series: &Series, index: usize, x: &Axis, y: &Axis) -> Vec<Item> {
        let colour = self.colour(index);
        let marker = if series.mark.is_paper() { Marker::HollowSquare } else { Marker::of(self.number(index)) };
        let is_finite = |p: &[f64; 2]| p.iter().all(|v| v.is_finite());
        let place = |p: &[f64; 2]| -> PixelPoint { [x.place(p[0]), y.place(p[1])] };
        let points: Vec<PixelPoint> = series.points.iter().filter(|p| is_finite(p)).map(place).collect();
        let mut items: Vec<Item> = Vec::new();
        if series.mark.is_line() {
            let pieces = series.points.split(|p| !is_finite(p)).filter(|piece| piece.len() > 1);
            let lines = pieces.map(|piece| Polyline::open(piece.iter().map(place).collect::<Vec<_>>()));
            let lines: Vec<Polyline> = match series.mark {
                Mark::PaperLine => lines.flat_map(|line| dashed(&line.points)).collect(),
                _ => lines.collect(),
            };
            items.extend((!lines.is_empty()).then(|| Shape::stroked("curve", lines, colour, 2.0).into()));
        }
        match series.mark {
            Mark::Line | Mark::PaperLine => {}
            Mark::Repeats => items.extend(spread(series, place, colour, marker)),
            Mark::Points | Mark::LinePoints | Mark::PaperPoints => {
                items.extend(marker.shape("points", &points, colour).map(Item::Shape));
            }
        }
        items
    }

    /// The entries from left to right on as many lines as needed, and the number of lines.
    fn legend_entries(&self) -> (Vec<Entry>, usize) {
        let is_entry = |index: &usize| !self.series[*index].name.is_empty() && self.first_of_name(*index) == *index;
        let (mut entries, mut line, mut left) = (Vec::new(), 0, MARGIN[0]);
        for index in (0..self.series.len()).filter(is_entry) {
            let wide = LEGEND_GAP[0] + width(&self.series[index].name, TICK_SIZE);
            if left > MARGIN[0] && left + wide > WIDTH - MARGIN[1] {
                (line, left) = (line + 1, MARGIN[0]);
            }
            entries.push(Entry { index, at: [left, LEGEND_LINE * (line as f64 + 0.5)] });
            left += wide + LEGEND_GAP[1];
        }
        let lines = if entries.is_empty() { 0 } else { line + 1 };
        (entries, lines)
    }

    fn legend(&self, entries: &[Entry], top: f64) -> Vec<Item> {
        let mut items: Vec<Item> = Vec::new();
        for Entry { index, at } in entries {
            let (series, [left, level]) = (&self.series[*index], [at[0], top + at[1]]);
            let middle = [left + 13.0, level];
            let line = [[left, level], [left + 26.0, level]];
            let same = self.series.iter().filter(|other| other.name == series.name);
            let marks: Vec<Mark> = same.map(|other| other.mark).collect();
            if marks.iter().any(|mark| mark.is_line()) {
                let lines = if series.mark == Mark::PaperLine { dashed(&line) } else { vec![Polyline::open(line)] };
                items.push(Shape::stroked("legend", lines, self.colour(*index), 2.0).into());
            }
            if marks.iter().any(|mark| !matches!(mark, Mark::Line | Mark::PaperLine)) {
                let paper = series.mark.is_paper();
                let marker = if paper { Marker::HollowSquare } else { Marker::of(self.number(*index)) };
                items.extend(marker.shape("legend", &[middle], self.colour(*index)).map(Item::Shape));
            }
            let at = [left + LEGEND_GAP[0], level];
            items.push(Text { anchor: Anchor::Start, ..Text::new(&series.name, TICK_SIZE, at) }.into());
        }
        items
    }
}

impl Mark {
    fn is_paper(self) -> bool {
        matches!(self, Self::PaperPoints | Self::PaperLine)
    }

    fn is_line(self) -> bool {
        matches!(self, Self::Line | Self::LinePoints | Self::PaperLine)
    }
}

/// Left edge of the ticks' labels.
fn y_edge(x: &Axis) -> f64 {
    x.start - 40.0
}

/// Means with their bars, drawn before the points they summarise.
fn spread(series: &Series, place: impl Fn(&[f64; 2]) -> PixelPoint, colour: Colour, marker: Marker) -> Vec<Item> {
    let finite = series.points.iter().filter(|p| p.iter().all(|v| v.is_finite()));
    let dots: Vec<Polyline> = finite.map(|p| Polyline::disc(place(p), 1.8)).collect();
    let groups = repeats(&series.points);
    let mut bars = Vec::new();
    for [x, mean, deviation] in groups.iter().filter(|group| group[2] > 0.0) {
        let [low, high] = [mean - deviation, mean + deviation].map(|y| place(&[*x, y]));
        bars.push(Polyline::open([low, high]));
        bars.extend([low, high].map(|[x, y]| Polyline::open([[x - 4.0, y], [x + 4.0, y]])));
    }
    let means: Vec<PixelPoint> = groups.iter().map(|[x, mean, _]| place(&[*x, *mean])).collect();
    let mut items: Vec<Item> = vec![Shape::filled("repeats", dots, pale(colour)).into()];
    items.push(Shape::stroked("bars", bars, colour, 1.5).into());
    items.extend(marker.shape("points", &means, colour).map(Item::Shape));
    items
}

/// The colour half-way to white.
fn pale(Colour(red, green, blue): Colour) -> Colour {
    let [red, green, blue] = [red, green, blue].map(|value| ((u16::from(value) + 255) / 2) as u8);
    Colour(red, green, blue)
}

fn frame(x: &Axis, y: &Axis) -> Vec<Item> {
    let (mut grid, mut ticks, mut texts) = (Vec::new(), Vec::new(), Vec::new());
    for tick in x.ticks() {
        let at = x.place(tick);
        grid.push(Polyline::open([[at, y.start], [at, y.end]]));
        ticks.push(Polyline::open([[at, y.start], [at, y.start + 5.0]]));
        texts.push(Text::new(x.label(tick), TICK_SIZE, [at, y.start + 19.0]));
    }
    for tick in y.ticks() {
        let at = y.place(tick);
        grid.push(Polyline::open([[x.start, at], [x.end, at]]));
        ticks.push(Polyline::open([[x.start - 5.0, at], [x.start, at]]));
        let place = [x.start - 10.0, at];
        texts.push(Text { anchor: Anchor::End, ..Text::new(y.label(tick), TICK_SIZE, place) });
    }
    let corners = Polyline::rectangle([x.start, y.end], [x.end, y.start]);
    let edge = Some(Stroke { colour: INK, width: 1.2 });
    let ground = Shape { class: "frame", lines: vec![corners.clone()], fill: Some(WHITE), stroke: None, crisp: false };
    let rim = Shape { class: "frame", lines: vec![corners], fill: None, stroke: edge, crisp: false };
    let shapes = [ground, Shape::stroked("grid", grid, GRID, 1.0), rim, Shape::stroked("ticks", ticks, INK, 1.2)];
    shapes.into_iter().map(Item::Shape).chain(texts.into_iter().map(Item::Text)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(series: Vec<Series>) -> Chart {
        Chart { title: "t".into(), x_label: "x".into(), y_label: "y".into(), series }
    }

    fn series(name: &str, points: &[[f64; 2]], mark: Mark) -> Series {
        Series { name: name.into(), points: points.to_vec(), mark }
    }

    #[test]
    fn empty_and_constant_series_draw() {
        let flat = chart(vec![series("flat", &[[1.0, 2.0]], Mark::LinePoints)]).picture();
        assert!(flat.shapes().any(|shape| shape.class == "points"));
        assert!(!chart(Vec::new()).picture().items.is_empty());
    }

    #[test]
    fn repeats_are_their_mean_with_one_standard_deviation() {
        let points = [[2.0, 5.0], [1.0, 1.0], [1.0, 3.0], [1.0, f64::NAN], [1.0, 2.0]];
        let groups = repeats(&points);
        assert_eq!(groups[0], [1.0, 2.0, 1.0]);
        assert!(groups[1][1] == 5.0 && groups[1][2].is_nan(), "{groups:?}");
        let picture = chart(vec![series("a", &points, Mark::Repeats)]).picture();
        let lines = |class: &str| picture.shapes().filter(|s| s.class == class).map(|s| s.lines.len()).sum::<usize>();
        // One bar with two ends, since a single value has no deviation. Every value is a dot.
        assert_eq!((lines("bars"), lines("repeats"), lines("points")), (3, 4, 2));
    }

    #[test]
    fn published_values_are_in_ink_and_use_up_no_colour() {
        let both = chart(vec![
            series("paper", &[[0.0, 1.0]], Mark::PaperPoints),
            series("ours", &[[0.0, 1.0], [1.0, 2.0]], Mark::Line),
            series("bound", &[[0.0, 3.0], [1.0, 3.0]], Mark::PaperLine),
            series("more", &[[0.0, 0.0]], Mark::Points),
            series("paper: more", &[[0.0, 2.0]], Mark::PaperPoints),
        ]);
        assert_eq!([0, 1, 2, 3, 4].map(|k| both.colour(k)), [INK, CURVES[0], INK, CURVES[1], CURVES[1]]);
        let dashes = both.picture();
        let dashes = dashes.shapes().filter(|s| s.class == "curve" && s.stroke.is_some_and(|s| s.colour == INK));
        assert!(dashes.map(|shape| shape.lines.len()).sum::<usize>() > 10);
    }

    #[test]
    fn legends_are_above_the_frame_in_lines_that_fit() {
        let names =
            ["a rather long name of a curve", "another one that is as long", "a third of them", "a third of them"];
        let chart = chart(names.map(|name| series(name, &[[0.0, 0.0], [1.0, 1.0]], Mark::LinePoints)).to_vec());
        let (entries, lines) = chart.legend_entries();
        // The last two series share a name.
        assert_eq!((entries.len(), lines), (3, 2));
        let picture = chart.picture();
        let top = picture.shapes().find(|s| s.class == "frame").unwrap().lines[0].points[0][1];
        for name in names {
            let text = picture.texts().find(|text| text.words == name).unwrap();
            assert!(text.at[1] + 0.5 * TICK_SIZE < top && text.at[0] + text.width() < WIDTH, "{text:?}");
        }
    }
}
