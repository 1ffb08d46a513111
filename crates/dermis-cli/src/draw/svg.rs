//! Pictures as SVG 1.1: paths only, two decimals of a pixel.

use std::fmt::Write;

use super::picture::{Colour, Picture, Polyline, Shape};

/// The picture as an SVG document.
pub fn svg(picture: &Picture) -> String {
    let (width, height) = (picture.width_px, picture.height_px);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\">\n\
         <title>{}</title>\n<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n",
        escaped(&picture.title)
    );
    for shape in &picture.shapes {
        push_shape(&mut text, shape);
    }
    text.push_str("</svg>\n");
    text
}

fn push_shape(text: &mut String, shape: &Shape) {
    let fill = shape.fill.map_or("none".to_string(), hex);
    // Writing to a String cannot fail.
    let _ = write!(text, "<path class=\"{}\" fill=\"{fill}\"", shape.class);
    if let Some(stroke) = shape.stroke {
        let (colour, width) = (hex(stroke.colour), number(stroke.width));
        let _ = write!(
            text,
            " stroke=\"{colour}\" stroke-width=\"{width}\" stroke-linecap=\"round\" stroke-linejoin=\"round\""
        );
    }
    text.push_str(" d=\"");
    for line in &shape.lines {
        push_line(text, line);
    }
    text.push_str("\"/>\n");
}

fn push_line(text: &mut String, line: &Polyline) {
    for (index, [x, y]) in line.points.iter().enumerate() {
        let command = if index == 0 { 'M' } else { 'L' };
        let _ = write!(text, "{command}{} {}", number(*x), number(*y));
    }
    if line.closed {
        text.push('Z');
    }
}

fn number(value: f64) -> String {
    let text = format!("{value:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}

fn hex(Colour(red, green, blue): Colour) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

fn escaped(text: &str) -> String {
    let allowed = text.chars().filter(|c| !c.is_control());
    allowed.fold(String::new(), |mut out, c| {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            c => out.push(c),
        }
        out
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::picture::Stroke;

    #[test]
    fn a_picture_is_paths_and_an_escaped_title() {
        let triangle = Shape {
            class: "electrodes",
            lines: vec![Polyline::closed([[0.0, 1.0], [2.5, 3.125], [10.0, 0.0]])],
            fill: Some(Colour(255, 0, 16)),
            stroke: Some(Stroke { colour: Colour(0, 0, 0), width: 1.5 }),
        };
        let picture = Picture { title: "a < b & c".into(), width_px: 20, height_px: 10, shapes: vec![triangle] };
        let text = svg(&picture);
        assert!(text.contains("<title>a &lt; b &amp; c</title>"), "{text}");
        assert!(text.contains("viewBox=\"0 0 20 10\"") && text.contains("fill=\"#ff0010\""), "{text}");
        assert!(text.contains("stroke-width=\"1.5\"") && text.contains("d=\"M0 1L2.5 3.12L10 0Z\""), "{text}");
    }
}
