//! Ratios to a norm, one per line, on a logarithmic axis.

use super::axis::tick_label;
use super::colours::CURVES;
use super::marker::{Marker, dashed};
use super::picture::{Anchor, Colour, INK, Item, Picture, Polyline, Shape, Text};
use super::text::width;

const WIDTH: f64 = 760.0;
const TITLE_SIZE: f64 = 17.0;
const SIZE: f64 = 13.0;
const LABEL_SIZE: f64 = 15.0;
const LINE: f64 = 16.0;
/// Space above and below the text of a row.
const ROOM: f64 = 9.0;
/// Left and right end of the axis.
const AXIS: [f64; 2] = [330.0, 620.0];
const GRID: Colour = Colour(226, 229, 233);
/// Largest ratio drawn; beyond it the symbol stays at the end.
const FARTHEST: f64 = 100.0;

/// One line.
#[derive(Clone, Debug, PartialEq)]
pub struct Dot {
    /// Name, at the left.
    pub name: String,
    /// Numbers, at the right.
    pub numbers: String,
    /// Ratio to the norm; positive.
    pub ratio: f64,
    /// Index of its kind.
    pub kind: usize,
}

/// Dots on both sides of a norm.
#[derive(Clone, Debug, PartialEq)]
pub struct DotPlot {
    /// Title above the plot.
    pub title: String,
    /// Label below the axis.
    pub label: String,
    /// Names of the kinds, for the legend.
    pub kinds: Vec<String>,
    /// The lines.
    pub dots: Vec<Dot>,
}

impl DotPlot {
    /// The drawing.
    pub fn picture(&self) -> Picture {
        let reach = self.reach();
        let place = |ratio: f64| {
            let share = 0.5 + 0.5 * ratio.clamp(1.0 / reach, reach).ln() / reach.ln();
            AXIS[0] + share * (AXIS[1] - AXIS[0])
        };
        let top = 84.0;
        let names: Vec<Vec<String>> = self.dots.iter().map(|dot| lines_of(&dot.name)).collect();
        let height = |lines: &Vec<String>| LINE * lines.len() as f64 + ROOM;
        let bottom = top + names.iter().map(height).sum::<f64>() + 6.0;
        let upright = |ratio: f64| Polyline::open([[place(ratio), top], [place(ratio), bottom]]);
        let ticks: Vec<f64> = TICKS.into_iter().filter(|tick| (1.0 / reach..=reach).contains(tick)).collect();
        let mut items: Vec<Item> = vec![
            Text::new(&self.title, TITLE_SIZE, [0.5 * WIDTH, 24.0]).into(),
            Shape::stroked("grid", ticks.iter().map(|tick| upright(*tick)).collect(), GRID, 1.0).into(),
            Shape::stroked("norm", dashed(&upright(1.0).points), INK, 1.6).into(),
            Shape::stroked("axis", vec![Polyline::open([[AXIS[0], bottom], [AXIS[1], bottom]])], INK, 1.2).into(),
            Text::new(&self.label, LABEL_SIZE, [0.5 * (AXIS[0] + AXIS[1]), bottom + 44.0]).into(),
        ];
        let tick_text = |tick: &f64| Text::new(tick_label(*tick, *tick), SIZE, [place(*tick), bottom + 17.0]).into();
        // If the axis spans more than two decades, there is only room for the labels of powers of ten.
        let is_labelled = |tick: &&f64| reach <= 10.0 || tick.log10().fract().abs() < 1e-9;
        items.extend(ticks.iter().filter(is_labelled).map(tick_text));
        items.extend(self.legend());
        let mut level = top + 3.0;
        for (dot, lines) in self.dots.iter().zip(&names) {
            let middle = level + 0.5 * height(lines);
            for (index, words) in lines.iter().enumerate() {
                let y = middle + LINE * (index as f64 - 0.5 * (lines.len() - 1) as f64);
                items.push(Text { anchor: Anchor::End, ..Text::new(words, SIZE, [AXIS[0] - 16.0, y]) }.into());
            }
            let at = [AXIS[1] + 14.0, middle];
            items.push(Text { anchor: Anchor::Start, ..Text::new(&dot.numbers, SIZE, at) }.into());
            let stem = vec![Polyline::open([[place(1.0), middle], [place(dot.ratio), middle]])];
            let colour = CURVES[dot.kind % CURVES.len()];
            items.push(Shape::stroked("stem", stem, colour, 1.4).into());
            let marker = Marker::of(dot.kind).shape("points", &[[place(dot.ratio), middle]], colour);
            items.extend(marker.map(Item::Shape));
            level += height(lines);
        }
        let height_px = (bottom + 62.0).ceil() as u32;
        Picture { title: self.title.clone(), width_px: WIDTH as u32, height_px, items }
    }

    /// Extent of the axis to both sides: at least a factor of two.
    fn reach(&self) -> f64 {
        let farthest = self.dots.iter().map(|dot| dot.ratio.max(1.0 / dot.ratio)).fold(2.0, f64::max);
        TICKS.into_iter().filter(|tick| *tick >= 2.0).find(|tick| *tick >= farthest).unwrap_or(FARTHEST)
    }

    fn legend(&self) -> Vec<Item> {
        let mut items: Vec<Item> = Vec::new();
        let used: Vec<usize> =
            (0..self.kinds.len()).filter(|kind| self.dots.iter().any(|dot| dot.kind == *kind)).collect();
        let wide = |kind: &usize| 20.0 + width(&self.kinds[*kind], SIZE) + 22.0;
        let mut left = 0.5 * (WIDTH - used.iter().map(wide).sum::<f64>());
        for kind in used {
            let marker = Marker::of(kind).shape("legend", &[[left + 6.0, 58.0]], CURVES[kind % CURVES.len()]);
            items.extend(marker.map(Item::Shape));
            let at = [left + 20.0, 58.0];
            items.push(Text { anchor: Anchor::Start, ..Text::new(&self.kinds[kind], SIZE, at) }.into());
            left += wide(&kind);
        }
        items
    }
}

/// Ticks of the axis.
const TICKS: [f64; 13] = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, FARTHEST];

/// A name split into lines that fit left of the axis.
fn lines_of(name: &str) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in name.split_whitespace() {
        match lines.last_mut().filter(|line| width(&format!("{line} {word}"), SIZE) <= AXIS[0] - 26.0) {
            Some(line) => {
                line.push(' ');
                line.push_str(word);
            }
            None => lines.push(word.into()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(ratios: &[f64]) -> DotPlot {
        let dot = |ratio: &f64| Dot { name: format!("at {ratio}"), numbers: "1, 2".into(), ratio: *ratio, kind: 0 };
        let dots = ratios.iter().map(dot).collect();
        DotPlot { title: "t".into(), label: "l".into(), kinds: vec!["a".into(), "b".into()], dots }
    }

    #[test]
    fn half_and_twice_are_equally_far_from_the_norm() {
        let picture = plot(&[0.5, 2.0, 1.0]).picture();
        let stems: Vec<f64> = picture
            .shapes()
            .filter(|shape| shape.class == "stem")
            .map(|shape| shape.lines[0].points[1][0] - shape.lines[0].points[0][0])
            .collect();
        assert!((stems[0] + stems[1]).abs() < 1e-9 && stems[0] < -100.0 && stems[2] == 0.0, "{stems:?}");
        // Only kinds that occur are in the legend.
        assert!(picture.texts().any(|text| text.words == "a") && picture.texts().all(|text| text.words != "b"));
    }

    #[test]
    fn the_axis_covers_the_dots_up_to_a_hundred() {
        assert_eq!([plot(&[1.1]).reach(), plot(&[0.3]).reach(), plot(&[1e-9]).reach()], [2.0, 5.0, 100.0]);
    }
}
