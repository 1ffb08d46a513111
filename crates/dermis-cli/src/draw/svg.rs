//! Pictures as SVG: a path for each shape and a `text` element for each text.

use std::fmt::Write as _;

use super::picture::{Anchor, Colour, Item, Picture, Polyline, Shape, Text};
use super::text::{CAPITAL, FAMILIES};

/// The picture as an SVG document.
pub fn svg(picture: &Picture) -> String {
    let (width, height) = (picture.width_px, picture.height_px);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} \
         {height}\" role=\"img\" font-family=\"{FAMILIES}\">\n\
         <title>{}</title>\n<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n",
        escaped(&picture.title)
    );
    for item in &picture.items {
        match item {
            Item::Shape(shape) => push_shape(&mut text, shape),
            Item::Text(words) => push_text(&mut text, words),
        }
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
    if shape.crisp {
        text.push_str(" shape-rendering=\"crispEdges\"");
    }
    text.push_str(" d=\"");
    for line in &shape.lines {
        push_line(text, line);
    }
    text.push_str("\"/>\n");
}

fn push_line(text: &mut String, line: &Polyline) {
    let mut before: Option<[String; 2]> = None;
    for point in &line.points {
        let [x, y] = point.map(number);
        // Horizontal and vertical lines have shorter commands, which halves the size of images.
        let _ = match &before {
            None => write!(text, "M{x} {y}"),
            Some([_, level]) if *level == y => write!(text, "H{x}"),
            Some([place, _]) if *place == x => write!(text, "V{y}"),
            Some(_) => write!(text, "L{x} {y}"),
        };
        before = Some([x, y]);
    }
    if line.closed {
        text.push('Z');
    }
}

fn push_text(text: &mut String, words: &Text) {
    let down = 0.5 * CAPITAL * words.size;
    let (x, y) = (number(words.at[0]), number(words.at[1]));
    let _ = write!(text, "<text class=\"{}\" fill=\"{}\"", words.class, hex(words.colour));
    let _ = match words.upward {
        true => write!(text, " transform=\"translate({x} {y}) rotate(-90)\" y=\"{}\"", number(down)),
        false => write!(text, " x=\"{x}\" y=\"{}\"", number(words.at[1] + down)),
    };
    let _ = write!(text, " font-size=\"{}\"", number(words.size));
    match words.anchor {
        Anchor::Start => {}
        Anchor::Middle => text.push_str(" text-anchor=\"middle\""),
        Anchor::End => text.push_str(" text-anchor=\"end\""),
    }
    if words.halo > 0.0 {
        let width = number(2.0 * words.halo);
        let _ = write!(
            text,
            " paint-order=\"stroke\" stroke=\"#ffffff\" stroke-width=\"{width}\" stroke-linejoin=\"round\""
        );
    }
    let _ = writeln!(text, ">{}</text>", escaped(&words.words));
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

    fn picture(item: Item) -> Picture {
        Picture { title: "a < b & c".into(), width_px: 20, height_px: 10, items: vec![item] }
    }

    #[test]
    fn shapes_are_paths_and_titles_are_escaped() {
        let triangle = Shape {
            class: "electrodes",
            lines: vec![Polyline::closed([[0.0, 1.0], [2.5, 3.125], [10.0, 0.0]])],
            fill: Some(Colour(255, 0, 16)),
            stroke: Some(Stroke { colour: Colour(0, 0, 0), width: 1.5 }),
            crisp: true,
        };
        let text = svg(&picture(triangle.into()));
        assert!(text.contains("<title>a &lt; b &amp; c</title>"), "{text}");
        assert!(text.contains("viewBox=\"0 0 20 10\"") && text.contains("fill=\"#ff0010\""), "{text}");
        assert!(
            text.contains("crispEdges")
                && text.contains("stroke-width=\"1.5\"")
                && text.contains("d=\"M0 1L2.5 3.12L10 0Z\""),
            "{text}"
        );
    }

    #[test]
    fn upright_rectangles_are_short() {
        let lines = vec![Polyline::rectangle([1.0, 2.0], [3.5, 4.0])];
        let text = svg(&picture(Shape::filled("pixels", lines, Colour(0, 0, 0)).into()));
        assert!(text.contains("d=\"M1 2H3.5V4H1Z\""), "{text}");
    }

    #[test]
    fn texts_are_text_that_can_be_searched_and_copied() {
        let words = Text { halo: 1.5, ..Text::new("R & D < 5 µV", 10.0, [7.0, 20.0]) };
        let text = svg(&picture(words.clone().into()));
        assert!(text.contains(">R &amp; D &lt; 5 µV</text>"), "{text}");
        // Half the height of a capital below the middle.
        assert!(text.contains("x=\"7\" y=\"23.64\" font-size=\"10\" text-anchor=\"middle\""), "{text}");
        assert!(text.contains("stroke-width=\"3\""), "{text}");
        let upward = svg(&picture(Text { upward: true, anchor: Anchor::Start, ..words }.into()));
        assert!(upward.contains("transform=\"translate(7 20) rotate(-90)\""), "{upward}");
        assert!(!upward.contains("text-anchor"), "{upward}");
    }
}
