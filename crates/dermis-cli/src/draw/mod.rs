//! Line drawings: a picture is a list of polylines in pixels, and each output format draws the same list. Text is drawn
//! as strokes, so that no format needs fonts.

mod chart;
mod heatmap;
mod picture;
mod png;
mod skin;
mod svg;
mod text;

pub use chart::{Chart, Mark, Series};
pub use heatmap::{Heatmap, Panel};
pub use picture::Picture;
pub use png::png;
pub use skin::SkinDrawing;
pub use svg::svg;
