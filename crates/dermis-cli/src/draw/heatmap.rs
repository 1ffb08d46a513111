//! Images in false colours, several side by side with one colour bar, scale bars, and crosses at true positions.

use super::axis::{nice_at_most, tick_label};
use super::colour_bar::ColourBar;
use super::colours::Scale;
use super::picture::{Anchor, Colour, INK, Item, Picture, PixelPoint, Polyline, Shape, Text, WHITE};
use super::text::width;

/// Height of a panel's image, and the space around it.
const SIZE: f64 = 170.0;
const GAP: f64 = 14.0;
const TITLE: f64 = 44.0;
/// Space between two groups of panels.
const GROUP_GAP: f64 = 12.0;
const NAME_SIZE: f64 = 12.5;
const NAME_LINE: f64 = 16.0;
const TITLE_SIZE: f64 = 17.0;
/// Panels per row.
const PER_ROW: usize = 4;
/// Minimum width of a picture, to leave room for its title.
const LEAST_WIDTH: f64 = 420.0;
/// Maximum width of groups placed side by side.
const MOST_WIDTH: f64 = 860.0;
/// Steps of the colour scale.
const LEVELS: usize = 64;
const RIM: Colour = Colour(120, 126, 135);

/// One image.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// Name below the image.
    pub name: String,
    /// Quantity with its unit; panels of the same quantity share a scale and its bar.
    pub quantity: String,
    /// Pixels per row.
    pub columns: usize,
    /// Row-major, row 0 at the top, NaN outside.
    pub values: Vec<f32>,
    /// True positions, as shares of the image's width and height from the top left corner.
    pub marks: Vec<[f64; 2]>,
    /// Radius of the upright cylinder that the image lies on, as a share of its width; `None` if it is flat.
    pub bend: Option<f64>,
    /// Width of the image, millimetres, for the scale bar; `None` if it is not a length.
    pub width_mm: Option<f64>,
}

/// Turn and tilt of the view onto an image on a cylinder, radians.
const TURN: f64 = -0.35;
const TILT: f64 = 0.4;

/// Panels with the colour bars of their quantities.
#[derive(Clone, Debug, PartialEq)]
pub struct Heatmap {
    /// Title above everything.
    pub title: String,
    /// The images.
    pub panels: Vec<Panel>,
}

impl Heatmap {
    /// The drawing, with the groups of each quantity side by side if there is room, else stacked.
    pub fn picture(&self) -> Picture {
        let first = if self.title.is_empty() { GAP } else { TITLE };
        let (mut left, mut top, mut bottom, mut right) = (GAP, first, first, LEAST_WIDTH);
        let mut items = Vec::new();
        for panels in self.groups() {
            let group = Group::of(panels);
            if left > GAP && left + group.width() > MOST_WIDTH {
                (left, top) = (GAP, bottom + GROUP_GAP);
            }
            items.extend(group.items([left, top]));
            left += group.width();
            (right, bottom) = (right.max(left), bottom.max(top + group.height()));
        }
        items.push(Text::new(&self.title, TITLE_SIZE, [0.5 * right, 24.0]).into());
        Picture { title: self.title.clone(), width_px: right.ceil() as u32, height_px: bottom.ceil() as u32, items }
    }

    /// Panels grouped by quantity, in order of first appearance.
    fn groups(&self) -> Vec<Vec<&Panel>> {
        let mut groups: Vec<Vec<&Panel>> = Vec::new();
        for panel in &self.panels {
            match groups.iter_mut().find(|group| group[0].quantity == panel.quantity) {
                Some(group) => group.push(panel),
                None => groups.push(vec![panel]),
            }
        }
        groups
    }
}

/// Panels of one quantity, their names split into lines, and their scale.
struct Group<'a> {
    panels: Vec<&'a Panel>,
    names: Vec<Vec<String>>,
    scale: Scale,
}

impl<'a> Group<'a> {
    fn of(panels: Vec<&'a Panel>) -> Self {
        let scale = Scale::of(panels.iter().flat_map(|panel| &panel.values));
        let names = panels.iter().map(|panel| wrapped(&panel.name, SIZE + 4.0)).collect();
        Self { panels, names, scale }
    }

    fn per_row(&self) -> usize {
        self.panels.len().clamp(1, PER_ROW)
    }

    /// Distance from one row of panels to the next.
    fn row(&self) -> f64 {
        let name_lines = self.names.iter().map(Vec::len).max().unwrap_or(1) as f64;
        SIZE + NAME_LINE * name_lines + GAP
    }

    fn width(&self) -> f64 {
        self.per_row() as f64 * (SIZE + GAP) + ColourBar::WIDTH
    }

    fn height(&self) -> f64 {
        self.panels.len().div_ceil(self.per_row()) as f64 * self.row()
    }

    fn items(&self, [left, top]: PixelPoint) -> Vec<Item> {
        let mut items = Vec::new();
        for (index, (panel, name)) in self.panels.iter().zip(&self.names).enumerate() {
            let (column, row) = ((index % self.per_row()) as f64, (index / self.per_row()) as f64);
            let corner = [left + column * (SIZE + GAP), top + row * self.row()];
            items.extend(panel.items(corner, self.scale, index == 0));
            for (line, words) in name.iter().enumerate() {
                let at = [corner[0] + 0.5 * SIZE, corner[1] + SIZE + 12.0 + NAME_LINE * line as f64];
                items.push(Text::new(words, NAME_SIZE, at).into());
            }
        }
        let bar = ColourBar { scale: self.scale, quantity: &self.panels[0].quantity };
        let span = self.height() - self.row() + SIZE;
        items.extend(bar.items([left + self.per_row() as f64 * (SIZE + GAP), top], span));
        items
    }
}

/// Text split into lines no wider than `room` pixels, at the size of names.
fn wrapped(words: &str, room: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in words.split_whitespace() {
        match lines.last_mut().filter(|line| width(&format!("{line} {word}"), NAME_SIZE) <= room) {
            Some(line) => {
                line.push(' ');
                line.push_str(word);
            }
            None => lines.push(word.into()),
        }
    }
    lines
}

impl Panel {
    fn items(&self, [left, top]: PixelPoint, scale: Scale, is_first: bool) -> Vec<Item> {
        let columns = self.columns.max(1);
        let rows = (self.values.len() / columns).max(1);
        let pixel = SIZE / columns.max(rows) as f64;
        let (width, height) = (pixel * columns as f64, pixel * rows as f64);
        let lay = |mut line: Polyline| {
            if let Some(bend) = self.bend {
                let middle = [left + 0.5 * width, top + 0.5 * height];
                line.points.iter_mut().for_each(|point| *point = bent(*point, middle, width, bend));
            }
            line
        };
        let place = |[x, y]: [f64; 2]| [left + pixel * x, top + pixel * y];
        let mut items: Vec<Item> = Vec::new();
        for (level, runs) in self.runs(scale).into_iter().enumerate().filter(|(_, runs)| !runs.is_empty()) {
            let rectangle = |[from, to]: [[f64; 2]; 2]| {
                let ([x0, y0], [x1, y1]) = (place(from), place(to));
                // Slightly larger, so that no seams show.
                lay(Polyline::rectangle([x0, y0], [x1 + 0.3, y1 + 0.3]))
            };
            let colour = scale.map.colour(level as f64 / LEVELS as f64);
            let area = Shape::filled("pixels", runs.into_iter().map(rectangle).collect(), colour);
            items.push(Shape { crisp: self.bend.is_none(), ..area }.into());
        }
        let rim = self.rim(rows).into_iter().map(|[from, to]| lay(Polyline::open([place(from), place(to)]))).collect();
        items.push(Shape::stroked("rim", rim, RIM, 0.8).into());
        let cross = |[x, y]: &[f64; 2]| {
            let (x, y) = (left + x * width, top + y * height);
            [Polyline::open(vec![[x - 5.0, y], [x + 5.0, y]]), Polyline::open(vec![[x, y - 5.0], [x, y + 5.0]])]
        };
        let crosses: Vec<Polyline> = self.marks.iter().flat_map(cross).map(lay).collect();
        items.push(Shape::stroked("halo", crosses.clone(), WHITE, 3.4).into());
        items.push(Shape::stroked("truth", crosses, INK, 1.5).into());
        if let Some(width_mm) = self.width_mm.filter(|_| is_first && self.bend.is_none()) {
            items.extend(scale_bar([left, top + height], width / width_mm, width_mm));
        }
        items
    }

    fn level(scale: Scale, value: f32) -> Option<usize> {
        value.is_finite().then(|| (scale.share(f64::from(value)) * LEVELS as f64).round() as usize)
    }

    /// For each colour level, runs of equal pixels in a row: their corners, in image pixels.
    fn runs(&self, scale: Scale) -> Vec<Vec<[[f64; 2]; 2]>> {
        let mut runs = vec![Vec::new(); LEVELS + 1];
        for (row, values) in self.values.chunks(self.columns.max(1)).enumerate() {
            let mut start = 0;
            while start < values.len() {
                let here = Self::level(scale, values[start]);
                let end =
                    (start + 1..values.len()).find(|&k| Self::level(scale, values[k]) != here).unwrap_or(values.len());
                // On a cylinder a run is not a rectangle, so keep single pixels.
                let end = if self.bend.is_some() { start + 1 } else { end };
                if let Some(here) = here {
                    runs[here].push([[start as f64, row as f64], [end as f64, row as f64 + 1.0]]);
                }
                start = end;
            }
        }
        runs
    }

    /// Outer sides of the skin's pixels, in image pixels.
    fn rim(&self, rows: usize) -> Vec<[[f64; 2]; 2]> {
        let columns = self.columns.max(1);
        let is_inside = |column: i64, row: i64| {
            (0..columns as i64).contains(&column)
                && (0..rows as i64).contains(&row)
                && self.values[row as usize * columns + column as usize].is_finite()
        };
        let mut sides = Vec::new();
        for (row, column) in (0..=rows as i64).flat_map(|r| (0..=columns as i64).map(move |c| (r, c))) {
            let (x, y) = (column as f64, row as f64);
            if is_inside(column, row) != is_inside(column, row - 1) {
                sides.push([[x, y], [x + 1.0, y]]);
            }
            if is_inside(column, row) != is_inside(column - 1, row) {
                sides.push([[x, y], [x, y + 1.0]]);
            }
        }
        sides
    }
}

/// A scale bar with a round length, in the lower left corner of an image.
fn scale_bar([left, bottom]: PixelPoint, pixels_per_mm: f64, width_mm: f64) -> Vec<Item> {
    let length_mm = nice_at_most(0.26 * width_mm);
    let (from, level) = (left + 7.0, bottom - 8.0);
    let to = from + length_mm * pixels_per_mm;
    let line = || vec![Polyline::open([[from, level], [to, level]])];
    let words = format!("{} mm", tick_label(length_mm, length_mm));
    let at = [from, level - 11.0];
    let text = Text { anchor: Anchor::Start, halo: 2.0, ..Text::new(words, 11.5, at) };
    vec![
        Shape::stroked("halo", line(), WHITE, 5.0).into(),
        Shape::stroked("scale-bar", line(), INK, 2.4).into(),
        text.into(),
    ]
}

/// Projects a point of an image on an upright cylinder of radius `bend` times its width. Assumes angles of at most 90
/// degrees from the view, so that nothing is hidden.
fn bent([x, y]: [f64; 2], [across, down]: [f64; 2], width: f64, bend: f64) -> [f64; 2] {
    let radius = bend * width;
    let (half, angle) = (0.5 / bend, (x - across) / radius);
    // Keep the picture centred in its panel, and its depth centred on the range it covers.
    let centre = 0.5 * ((TURN + half).sin() + (TURN - half).sin());
    let depth = (TURN + angle).cos() - 0.5 * (1.0 + (TURN - half).cos());
    let scale = 0.85;
    let right = scale * radius * ((TURN + angle).sin() - centre);
    [across + right, down + scale * ((y - down) * TILT.cos() + radius * depth * TILT.sin())]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::colours::Map;

    fn panel(quantity: &str, columns: usize, values: Vec<f32>) -> Panel {
        let (name, quantity) = ("a".into(), quantity.into());
        Panel { name, quantity, columns, values, marks: vec![[0.5, 0.5]], bend: None, width_mm: Some(100.0) }
    }

    fn picture(panels: Vec<Panel>) -> Picture {
        Heatmap { title: "t".into(), panels }.picture()
    }

    #[test]
    fn pixels_of_one_colour_in_a_row_are_one_rectangle_and_the_skin_has_a_rim() {
        let picture = picture(vec![panel("q", 3, vec![1.0, 1.0, f32::NAN, 0.0, -1.0, -1.0])]);
        let lines =
            |class: &str| picture.shapes().filter(|s| s.class == class).map(|s| s.lines.len()).collect::<Vec<_>>();
        assert_eq!(lines("pixels"), [1, 1, 1]);
        // The outline of 3 x 2 pixels without the upper right one has ten sides.
        assert_eq!(lines("rim"), [10]);
    }

    #[test]
    fn panels_of_one_quantity_share_a_scale_and_others_have_their_own() {
        let picture = picture(vec![panel("q", 1, vec![1.0]), panel("p", 1, vec![8.0]), panel("q", 1, vec![4.0])]);
        let pixels: Vec<Colour> = picture.shapes().filter(|s| s.class == "pixels").filter_map(|s| s.fill).collect();
        let [low, high, other] = [pixels[0], pixels[1], pixels[2]];
        assert_eq!((high, other), (Map::Rising.colour(1.0), Map::Rising.colour(1.0)));
        assert_eq!(low, Map::Rising.colour(0.25));
        // One bar for each of the two quantities.
        assert_eq!(picture.texts().filter(|text| text.words == "q" || text.words == "p").count(), 2);
    }

    #[test]
    fn scale_bars_are_to_scale() {
        let picture = picture(vec![panel("q", 10, vec![1.0; 100])]);
        let bar = picture.shapes().find(|shape| shape.class == "scale-bar").unwrap();
        let [from, to] = [bar.lines[0].points[0], bar.lines[0].points[1]];
        // A fifth of the 100 mm.
        assert!((to[0] - from[0] - 0.2 * SIZE).abs() < 1e-9, "{bar:?}");
        assert!(picture.texts().any(|text| text.words == "20 mm"));
    }

    #[test]
    fn long_names_are_wrapped() {
        let lines = wrapped("ring and touch, from the pressed ring", SIZE);
        assert_eq!(lines.len(), 2);
        assert_eq!(lines.join(" "), "ring and touch, from the pressed ring");
        assert!(lines.iter().all(|line| width(line, NAME_SIZE) <= SIZE), "{lines:?}");
    }

    #[test]
    fn an_image_on_a_cylinder_is_narrower_towards_its_sides_and_stays_in_its_panel() {
        // 150 mm on a radius of 95 mm, in a panel of 280 pixels.
        let (bend, middle) = (95.0 / 150.0, [140.0, 140.0]);
        let at = |x: f64, y: f64| bent([x, y], middle, 280.0, bend);
        let widths: Vec<f64> = [0.0, 130.0, 270.0].map(|x| at(x + 10.0, 140.0)[0] - at(x, 140.0)[0]).to_vec();
        assert!(widths[0] > 0.0 && widths[1] > widths[0] && widths[1] > widths[2], "{widths:?}");
        let corners = [[0.0, 0.0], [280.0, 0.0], [280.0, 280.0], [0.0, 280.0], [200.0, 280.0]].map(|[x, y]| at(x, y));
        assert!(corners.iter().flatten().all(|value| (-5.0..285.0).contains(value)), "{corners:?}");
    }
}
