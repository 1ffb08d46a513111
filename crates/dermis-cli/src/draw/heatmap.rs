//! Images in false colours, several side by side on one scale, with marks where something truly was.

use super::picture::{Colour, Picture, Polyline, Shape, Stroke};
use super::text::Lettering;

const INK: Colour = Colour(40, 44, 52);
/// Height of a panel's image, and what surrounds it.
const SIZE: f64 = 280.0;
const GAP: f64 = 18.0;
const TOP: f64 = 58.0;
const BOTTOM: f64 = 34.0;
/// Panels in a row.
const PER_ROW: usize = 4;
/// Steps of the colour scale.
const LEVELS: usize = 64;

/// One image.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// Below it.
    pub name: String,
    /// Pixels in a row.
    pub columns: usize,
    /// Row-major, row 0 at the top, NaN outside.
    pub values: Vec<f32>,
    /// FrameAnomalies, as shares of the image's width and height from the top left corner.
    pub marks: Vec<[f64; 2]>,
    /// Radius of the upright cylinder on which the image lies, as a share of its width; none where it is flat.
    pub bend: Option<f64>,
}

/// Turn and tilt from which an image on a cylinder is seen, radians.
const TURN: f64 = -0.35;
const TILT: f64 = 0.4;

/// Panels on one colour scale, blue below zero, red above.
#[derive(Clone, Debug, PartialEq)]
pub struct Heatmap {
    /// Above all.
    pub title: String,
    /// The images.
    pub panels: Vec<Panel>,
    /// Each panel on a scale of its own.
    pub own_scales: bool,
}

impl Heatmap {
    /// The drawing.
    pub fn picture(&self) -> Picture {
        let columns = self.panels.len().clamp(1, PER_ROW);
        let rows = self.panels.len().div_ceil(PER_ROW).max(1);
        let width = columns as f64 * (SIZE + GAP) + GAP;
        let height = TOP + rows as f64 * (SIZE + BOTTOM + GAP);
        let largest =
            |panel: &Panel| panel.values.iter().filter(|v| v.is_finite()).fold(0.0_f32, |m, v| m.max(v.abs()));
        let common = self.panels.iter().map(largest).fold(0.0, f32::max);
        let mut letters = Lettering::new(&self.title, 13.0).centred_at([0.5 * width, 26.0]);
        let mut shapes = Vec::new();
        for (index, panel) in self.panels.iter().enumerate() {
            let left = GAP + (index % PER_ROW) as f64 * (SIZE + GAP);
            let top = TOP + (index / PER_ROW) as f64 * (SIZE + BOTTOM + GAP);
            let scale = if self.own_scales { largest(panel) } else { common };
            shapes.extend(panel.shapes(left, top, scale.max(f32::MIN_POSITIVE)));
            letters.extend(Lettering::new(&panel.name, 9.0).centred_at([left + 0.5 * SIZE, top + SIZE + 18.0]));
        }
        let stroke = Some(Stroke { colour: INK, width: 1.2 });
        shapes.push(Shape { class: "text", lines: letters, fill: None, stroke });
        Picture { title: self.title.clone(), width_px: width as u32, height_px: height as u32, shapes }
    }
}

impl Panel {
    /// Pixels of one colour together, runs of a row as one rectangle.
    fn shapes(&self, left: f64, top: f64, scale: f32) -> Vec<Shape> {
        let columns = self.columns.max(1);
        let rows = (self.values.len() / columns).max(1);
        let pixel = SIZE / columns.max(rows) as f64;
        let mut runs: Vec<Vec<Polyline>> = vec![Vec::new(); 2 * LEVELS + 1];
        let level = |value: f32| {
            value.is_finite().then(|| ((value / scale).clamp(-1.0, 1.0) * LEVELS as f32).round() as i64 + LEVELS as i64)
        };
        for (row, values) in self.values.chunks(columns).enumerate() {
            let mut start = 0;
            while start < values.len() {
                let here = level(values[start]);
                let end = (start + 1..values.len()).find(|&k| level(values[k]) != here).unwrap_or(values.len());
                // On a cylinder a run is no rectangle.
                let end = if self.bend.is_some() { start + 1 } else { end };
                if let Some(here) = here {
                    // A little over the edge, so that no seams show.
                    let (x0, x1) = (left + start as f64 * pixel, left + end as f64 * pixel + 0.4);
                    let (y0, y1) = (top + row as f64 * pixel, top + (row + 1) as f64 * pixel + 0.4);
                    runs[here as usize].push(Polyline::closed(vec![[x0, y0], [x1, y0], [x1, y1], [x0, y1]]));
                }
                start = end;
            }
        }
        let filled = runs.into_iter().enumerate().filter(|(_, lines)| !lines.is_empty());
        let (width, height) = (pixel * columns as f64, pixel * rows as f64);
        let lay = |mut line: Polyline| {
            if let Some(bend) = self.bend {
                let middle = [left + 0.5 * width, top + 0.5 * height];
                line.points.iter_mut().for_each(|point| *point = bent(*point, middle, width, bend));
            }
            line
        };
        let mut shapes: Vec<Shape> = filled
            .map(|(level, lines)| {
                let lines = lines.into_iter().map(lay).collect();
                let fill = Some(colour(level as f64 / LEVELS as f64 - 1.0));
                Shape { class: "pixels", lines, fill, stroke: None }
            })
            .collect();
        let cross = |[x, y]: &[f64; 2]| {
            let (x, y) = (left + x * width, top + y * height);
            [Polyline::open(vec![[x - 6.0, y], [x + 6.0, y]]), Polyline::open(vec![[x, y - 6.0], [x, y + 6.0]])]
        };
        let lines: Vec<Polyline> = self.marks.iter().flat_map(cross).map(lay).collect();
        let stroke = Some(Stroke { colour: INK, width: 1.6 });
        shapes.push(Shape { class: "truth", lines, fill: None, stroke });
        shapes
    }
}

/// Where a point of an image that is laid on an upright cylinder of radius `bend` times its width is seen. Angles of up
/// to a right one from the view are assumed, so that nothing hides anything.
fn bent([x, y]: [f64; 2], [across, down]: [f64; 2], width: f64, bend: f64) -> [f64; 2] {
    let radius = bend * width;
    let (half, angle) = (0.5 / bend, (x - across) / radius);
    // The picture keeps to the middle of its panel, and its depth to the middle of what it spans.
    let centre = 0.5 * ((TURN + half).sin() + (TURN - half).sin());
    let depth = (TURN + angle).cos() - 0.5 * (1.0 + (TURN - half).cos());
    let scale = 0.85;
    let right = scale * radius * ((TURN + angle).sin() - centre);
    [across + right, down + scale * ((y - down) * TILT.cos() + radius * depth * TILT.sin())]
}

/// White at 0, through orange to dark red at 1, through light to dark blue at -1.
fn colour(value: f64) -> Colour {
    let stops: [[f64; 3]; 4] = if value >= 0.0 {
        [[247.0, 247.0, 247.0], [253.0, 187.0, 132.0], [227.0, 74.0, 51.0], [127.0, 0.0, 0.0]]
    } else {
        [[247.0, 247.0, 247.0], [146.0, 197.0, 222.0], [33.0, 102.0, 172.0], [5.0, 48.0, 97.0]]
    };
    let place = value.abs().min(1.0) * 3.0;
    let below = (place.floor() as usize).min(2);
    let mix = |k: usize| {
        let share = place - below as f64;
        (stops[below][k] * (1.0 - share) + stops[below + 1][k] * share).round() as u8
    };
    Colour(mix(0), mix(1), mix(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_of_one_colour_in_a_row_are_one_rectangle() {
        let values = vec![1.0, 1.0, f32::NAN, 0.0, -1.0, -1.0];
        let panel = Panel { name: "a".into(), columns: 3, values, marks: vec![[0.5, 0.5]], bend: None };
        let picture = Heatmap { title: "t".into(), panels: vec![panel], own_scales: false }.picture();
        let pixels: Vec<usize> =
            picture.shapes.iter().filter(|shape| shape.class == "pixels").map(|shape| shape.lines.len()).collect();
        assert_eq!(pixels, [1, 1, 1]);
    }

    #[test]
    fn colours_run_from_blue_to_red() {
        assert_eq!(colour(0.0), Colour(247, 247, 247));
        assert_eq!(colour(1.0), Colour(127, 0, 0));
        assert_eq!(colour(-1.0), Colour(5, 48, 97));
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
