//! What a picture is made of.

/// A point in pixels: x to the right, y down, origin at the top left corner.
pub type Point = [f64; 2];

/// Red, green, blue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Colour(pub u8, pub u8, pub u8);

/// A line's look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke {
    /// Its colour.
    pub colour: Colour,
    /// Its width, pixels.
    pub width: f64,
}

/// A run of straight lines.
#[derive(Clone, Debug, PartialEq)]
pub struct Polyline {
    /// Its corners.
    pub points: Vec<Point>,
    /// Whether the last joins the first.
    pub closed: bool,
}

impl Polyline {
    /// A line that ends where its points end.
    pub fn open(points: impl Into<Vec<Point>>) -> Self {
        Self { points: points.into(), closed: false }
    }

    /// The rim of an area.
    pub fn closed(points: impl Into<Vec<Point>>) -> Self {
        Self { points: points.into(), closed: true }
    }
}

/// Polylines of one look, drawn together: filled first, then stroked with round ends and joins.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    /// What it is, as the name of a group.
    pub class: &'static str,
    /// The lines.
    pub lines: Vec<Polyline>,
    /// Fill of the areas.
    pub fill: Option<Colour>,
    /// Look of the lines.
    pub stroke: Option<Stroke>,
}

/// A picture on a white ground.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// What it shows.
    pub title: String,
    /// Width.
    pub width_px: u32,
    /// Height.
    pub height_px: u32,
    /// Shapes, the first at the bottom.
    pub shapes: Vec<Shape>,
}
