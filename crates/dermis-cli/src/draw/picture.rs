//! The elements of a picture: areas, lines and texts. Every output format draws the same list.

use super::text;

/// A point in pixels: x to the right, y down, origin at the top left corner.
pub type PixelPoint = [f64; 2];

/// Red, green, blue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Colour(pub u8, pub u8, pub u8);

/// Colour of texts and axes.
pub const INK: Colour = Colour(31, 36, 45);
/// Colour of the background.
pub const WHITE: Colour = Colour(255, 255, 255);

/// Style of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke {
    /// Colour.
    pub colour: Colour,
    /// Width, pixels.
    pub width: f64,
}

/// A sequence of straight lines.
#[derive(Clone, Debug, PartialEq)]
pub struct Polyline {
    /// Corners.
    pub points: Vec<PixelPoint>,
    /// True if the last point is joined to the first.
    pub closed: bool,
}

impl Polyline {
    /// A line that ends at its last point.
    pub fn open(points: impl Into<Vec<PixelPoint>>) -> Self {
        Self { points: points.into(), closed: false }
    }

    /// The outline of an area.
    pub fn closed(points: impl Into<Vec<PixelPoint>>) -> Self {
        Self { points: points.into(), closed: true }
    }

    /// The outline of an upright rectangle.
    pub fn rectangle([left, top]: PixelPoint, [right, bottom]: PixelPoint) -> Self {
        Self::closed([[left, top], [right, top], [right, bottom], [left, bottom]])
    }

    /// The outline of a disc, with 24 corners.
    pub fn disc(centre: PixelPoint, radius: f64) -> Self {
        let corner = |k: i32| {
            let (sine, cosine) = (f64::from(k) / 24.0 * std::f64::consts::TAU).sin_cos();
            [centre[0] + radius * cosine, centre[1] + radius * sine]
        };
        Self::closed((0..24).map(corner).collect::<Vec<_>>())
    }
}

/// Polylines of one style drawn together: filled first, then stroked with round ends and joins.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    /// Group that the shape belongs to.
    pub class: &'static str,
    /// The polylines.
    pub lines: Vec<Polyline>,
    /// Fill colour of the areas.
    pub fill: Option<Colour>,
    /// Style of the lines.
    pub stroke: Option<Stroke>,
    /// If true, edges are not smoothed, so that adjacent areas have no seam.
    pub crisp: bool,
}

impl Shape {
    /// Lines of one colour and width.
    pub fn stroked(class: &'static str, lines: Vec<Polyline>, colour: Colour, width: f64) -> Self {
        Self { class, lines, fill: None, stroke: Some(Stroke { colour, width }), crisp: false }
    }

    /// Areas of one colour.
    pub fn filled(class: &'static str, lines: Vec<Polyline>, colour: Colour) -> Self {
        Self { class, lines, fill: Some(colour), stroke: None, crisp: false }
    }
}

/// The part of a text that lies on its point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// The start.
    Start,
    /// The middle.
    Middle,
    /// The end.
    End,
}

/// One line of text.
#[derive(Clone, Debug, PartialEq)]
pub struct Text {
    /// Group that the text belongs to.
    pub class: &'static str,
    /// The text.
    pub words: String,
    /// Position of the anchor, half-way up the capitals.
    pub at: PixelPoint,
    /// Font size, pixels.
    pub size: f64,
    /// The part of the text that lies on the position.
    pub anchor: Anchor,
    /// True if the text reads upward.
    pub upward: bool,
    /// Its colour.
    pub colour: Colour,
    /// Width of the white rim that keeps text legible over lines, pixels; 0 for none.
    pub halo: f64,
}

impl Text {
    /// A text in ink, centred on a point.
    pub fn new(words: impl Into<String>, size: f64, at: PixelPoint) -> Self {
        let (class, words) = ("text", words.into());
        let (anchor, upward, colour, halo) = (Anchor::Middle, false, INK, 0.0);
        Self { class, words, at, size, anchor, upward, colour, halo }
    }

    /// Width, pixels.
    pub fn width(&self) -> f64 {
        text::width(&self.words, self.size)
    }

    /// Start of the base line, pixels.
    pub fn origin(&self) -> PixelPoint {
        let back = match self.anchor {
            Anchor::Start => 0.0,
            Anchor::Middle => 0.5 * self.width(),
            Anchor::End => self.width(),
        };
        let down = 0.5 * text::CAPITAL * self.size;
        match self.upward {
            true => [self.at[0] + down, self.at[1] + back],
            false => [self.at[0] - back, self.at[1] + down],
        }
    }
}

/// An element of a picture.
#[derive(Clone, Debug, PartialEq)]
pub enum Item {
    /// Lines and areas.
    Shape(Shape),
    /// A text.
    Text(Text),
}

impl From<Shape> for Item {
    fn from(shape: Shape) -> Self {
        Self::Shape(shape)
    }
}

impl From<Text> for Item {
    fn from(text: Text) -> Self {
        Self::Text(text)
    }
}

/// A picture on a white background.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Title.
    pub title: String,
    /// Width, pixels.
    pub width_px: u32,
    /// Height, pixels.
    pub height_px: u32,
    /// Elements, from bottom to top.
    pub items: Vec<Item>,
}

#[cfg(test)]
impl Picture {
    /// Lines and areas.
    pub fn shapes(&self) -> impl Iterator<Item = &Shape> {
        self.items.iter().filter_map(|item| match item {
            Item::Shape(shape) => Some(shape),
            Item::Text(_) => None,
        })
    }

    /// Texts.
    pub fn texts(&self) -> impl Iterator<Item = &Text> {
        self.items.iter().filter_map(|item| match item {
            Item::Text(text) => Some(text),
            Item::Shape(_) => None,
        })
    }
}
