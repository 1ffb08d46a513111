//! Pictures as PNG, rasterised with anti-aliasing.

use anyhow::Context;
use tiny_skia::{Color, FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Stroke, Transform};

use super::picture::{Colour, Picture, Shape};

/// The picture as the content of a PNG file.
pub fn png(picture: &Picture) -> anyhow::Result<Vec<u8>> {
    let (width, height) = (picture.width_px, picture.height_px);
    let mut pixels = Pixmap::new(width, height).with_context(|| format!("no memory for {width} x {height} pixels"))?;
    pixels.fill(Color::WHITE);
    for shape in &picture.shapes {
        // A shape without lines has no path.
        if let Some(path) = path_of(shape) {
            draw(&mut pixels, &path, shape);
        }
    }
    pixels.encode_png().context("PNG encoding")
}

fn draw(pixels: &mut Pixmap, path: &Path, shape: &Shape) {
    if let Some(colour) = shape.fill {
        pixels.fill_path(path, &paint(colour), FillRule::Winding, Transform::identity(), None);
    }
    if let Some(line) = shape.stroke {
        let (line_cap, line_join) = (LineCap::Round, LineJoin::Round);
        let stroke = Stroke { width: line.width as f32, line_cap, line_join, ..Stroke::default() };
        pixels.stroke_path(path, &paint(line.colour), &stroke, Transform::identity(), None);
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

fn paint(Colour(red, green, blue): Colour) -> Paint<'static> {
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    paint.set_color_rgba8(red, green, blue, 255);
    paint
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::picture::Polyline;

    #[test]
    fn a_filled_square_covers_its_pixels_and_no_others() {
        let corners = [[2.0, 2.0], [6.0, 2.0], [6.0, 6.0], [2.0, 6.0]];
        let lines = vec![Polyline::closed(corners)];
        let square = Shape { class: "electrodes", lines, fill: Some(Colour(200, 100, 50)), stroke: None };
        let picture = Picture { title: String::new(), width_px: 10, height_px: 8, shapes: vec![square] };
        let pixels = Pixmap::decode_png(&png(&picture).unwrap()).unwrap();
        assert_eq!((pixels.width(), pixels.height()), (10, 8));
        let at = |x, y| pixels.pixel(x, y).map(|p| (p.red(), p.green(), p.blue()));
        assert_eq!(at(4, 4), Some((200, 100, 50)));
        assert_eq!(at(7, 4), Some((255, 255, 255)));
        assert_eq!(at(4, 1), Some((255, 255, 255)));
    }
}
