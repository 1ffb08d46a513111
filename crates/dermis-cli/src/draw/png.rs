//! Pictures as PNG, rasterised with anti-aliasing. Text is drawn as outlines of the bundled font, so every machine
//! gives the same result.

use anyhow::Context;
use tiny_skia::{Color, FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Stroke, Transform};
use ttf_parser::OutlineBuilder;

use super::picture::{Colour, Item, Picture, Shape, Text, WHITE};
use super::text;

/// The picture as the content of a PNG file, `scale` times as many pixels in each direction.
pub fn png(picture: &Picture, scale: u32) -> anyhow::Result<Vec<u8>> {
    let (width, height) = (scale * picture.width_px, scale * picture.height_px);
    let mut pixels = Pixmap::new(width, height).with_context(|| format!("no memory for {width} x {height} pixels"))?;
    pixels.fill(Color::WHITE);
    let whole = Transform::from_scale(scale as f32, scale as f32);
    for item in &picture.items {
        match item {
            Item::Shape(shape) => draw_shape(&mut pixels, shape, whole),
            Item::Text(words) => draw_text(&mut pixels, words, whole),
        }
    }
    pixels.encode_png().context("PNG encoding")
}

fn draw_shape(pixels: &mut Pixmap, shape: &Shape, place: Transform) {
    // A shape without lines has no path.
    let Some(path) = path_of(shape) else { return };
    if let Some(colour) = shape.fill {
        let ink = Paint { anti_alias: !shape.crisp, ..paint(colour) };
        pixels.fill_path(&path, &ink, FillRule::Winding, place, None);
    }
    if let Some(line) = shape.stroke {
        pixels.stroke_path(&path, &paint(line.colour), &round(line.width), place, None);
    }
}

fn path_of(shape: &Shape) -> Option<Path> {
    let mut builder = PathBuilder::new();
    for line in &shape.lines {
        for (index, [x, y]) in line.points.iter().enumerate() {
            let (x, y) = (*x as f32, *y as f32);
            if index == 0 { builder.move_to(x, y) } else { builder.line_to(x, y) }
        }
        if line.closed {
            builder.close();
        }
    }
    builder.finish()
}

fn draw_text(pixels: &mut Pixmap, words: &Text, place: Transform) {
    let unit = words.size / f64::from(text::face().units_per_em());
    let mut outline = Outline { builder: PathBuilder::new(), unit: unit as f32, pen: 0.0 };
    for glyph in words.words.chars().map(text::glyph) {
        text::face().outline_glyph(glyph, &mut outline);
        outline.pen += (words.size * text::advance(glyph)) as f32;
    }
    // Blanks have no outline.
    let Some(path) = outline.builder.finish() else { return };
    let [x, y] = words.origin().map(|v| v as f32);
    let turn = if words.upward { Transform::from_rotate(-90.0) } else { Transform::identity() };
    let place = turn.post_translate(x, y).post_concat(place);
    if words.halo > 0.0 {
        pixels.stroke_path(&path, &paint(WHITE), &round(2.0 * words.halo), place, None);
    }
    pixels.fill_path(&path, &paint(words.colour), FillRule::Winding, place, None);
}

/// Sets glyphs side by side on one base line, y down.
struct Outline {
    builder: PathBuilder,
    /// Pixels per font unit.
    unit: f32,
    /// Left edge of the current glyph, pixels.
    pen: f32,
}

impl Outline {
    fn at(&self, x: f32, y: f32) -> (f32, f32) {
        (self.pen + self.unit * x, -self.unit * y)
    }
}

impl OutlineBuilder for Outline {
    fn move_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.at(x, y);
        self.builder.move_to(x, y);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.at(x, y);
        self.builder.line_to(x, y);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        let ((x1, y1), (x, y)) = (self.at(x1, y1), self.at(x, y));
        self.builder.quad_to(x1, y1, x, y);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        let ((x1, y1), (x2, y2), (x, y)) = (self.at(x1, y1), self.at(x2, y2), self.at(x, y));
        self.builder.cubic_to(x1, y1, x2, y2, x, y);
    }

    fn close(&mut self) {
        self.builder.close();
    }
}

fn round(width: f64) -> Stroke {
    let (line_cap, line_join) = (LineCap::Round, LineJoin::Round);
    Stroke { width: width as f32, line_cap, line_join, ..Stroke::default() }
}

fn paint(Colour(red, green, blue): Colour) -> Paint<'static> {
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    paint.set_color_rgba8(red, green, blue, 255);
    paint
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::picture::{Anchor, Polyline};

    fn pixels(item: Item, scale: u32) -> Pixmap {
        let picture = Picture { title: String::new(), width_px: 20, height_px: 10, items: vec![item] };
        Pixmap::decode_png(&png(&picture, scale).unwrap()).unwrap()
    }

    #[test]
    fn a_filled_square_covers_exactly_its_pixels() {
        let square = || {
            let lines = vec![Polyline::rectangle([2.0, 2.0], [6.0, 6.0])];
            Shape::filled("electrodes", lines, Colour(200, 100, 50)).into()
        };
        let small = pixels(square(), 1);
        assert_eq!((small.width(), small.height()), (20, 10));
        let at = |pixels: &Pixmap, x, y| pixels.pixel(x, y).map(|p| (p.red(), p.green(), p.blue()));
        assert_eq!(at(&small, 4, 4), Some((200, 100, 50)));
        assert_eq!(at(&small, 7, 4), Some((255, 255, 255)));
        assert_eq!(at(&small, 4, 1), Some((255, 255, 255)));
        let large = pixels(square(), 2);
        assert_eq!((large.width(), large.height()), (40, 20));
        assert_eq!(at(&large, 11, 11), Some((200, 100, 50)));
        assert_eq!(at(&large, 13, 11), Some((255, 255, 255)));
    }

    #[test]
    fn crisp_areas_side_by_side_have_no_seam() {
        // The edge lies in the middle of the fifth column of pixels.
        let half = |from, to| Polyline::rectangle([from, 0.0], [to, 10.0]);
        let area = |crisp| Shape { crisp, ..Shape::filled("pixels", vec![half(0.0, 4.5)], Colour(0, 0, 0)) };
        let red = |crisp| pixels(area(crisp).into(), 1).pixel(4, 5).map(|pixel| pixel.red());
        assert!(matches!(red(true), Some(0 | 255)) && matches!(red(false), Some(100..155)), "{:?}", red(false));
    }

    /// First and last column and row with ink, pixels.
    fn inked(text: Text) -> [f64; 4] {
        let pixels = pixels(text.into(), 8);
        let width = pixels.width() as usize;
        let dark = || pixels.pixels().iter().enumerate().filter(|(_, p)| p.red() < 128).map(|(k, _)| k);
        let side = |values: &dyn Fn(usize) -> usize, most: bool| {
            let value = if most { dark().map(values).max().unwrap() + 1 } else { dark().map(values).min().unwrap() };
            value as f64 / 8.0
        };
        let (column, row) = (|k: usize| k % width, |k: usize| k / width);
        [side(&column, false), side(&column, true), side(&row, false), side(&row, true)]
    }

    #[test]
    fn text_is_at_its_place() {
        // An H at 8 px is 5.83 px high and has side bearings of 0.79 px in its advance of 6.02 px.
        let [left, right, top, bottom] = inked(Text::new("H", 8.0, [10.0, 5.0]));
        assert!((0.5 * (left + right) - 10.0).abs() < 0.2 && (0.5 * (top + bottom) - 5.0).abs() < 0.2);
        assert!((bottom - top - 5.83).abs() < 0.3, "{top} to {bottom}");
        let start = inked(Text { anchor: Anchor::Start, ..Text::new("H", 8.0, [10.0, 5.0]) });
        assert!((start[0] - 10.79).abs() < 0.2, "{start:?}");
        let end = inked(Text { anchor: Anchor::End, ..Text::new("H", 8.0, [10.0, 5.0]) });
        assert!((end[1] - 9.21).abs() < 0.2, "{end:?}");
        // Read upward, its height runs horizontally.
        let [left, right, top, bottom] = inked(Text { upward: true, ..Text::new("H", 8.0, [10.0, 5.0]) });
        assert!((right - left - 5.83).abs() < 0.3 && (0.5 * (left + right) - 10.0).abs() < 0.2, "{left} to {right}");
        assert!((0.5 * (top + bottom) - 5.0).abs() < 0.2, "{top} to {bottom}");
    }
}
