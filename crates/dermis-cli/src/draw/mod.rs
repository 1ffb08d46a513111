//! Pictures as lists of areas, lines and texts in pixels. SVG, PNG and PDF all draw the same list, with real text in
//! one bundled font.
//!
//! Charts, maps and text are laid out here rather than by a charting crate, because such crates don't draw images on
//! a skin's outline, bent images, or colour bars shared by several images. Of the crates that were tried, `kuva` 0.6
//! adds 2.4 MB to a command limited to 25, `resvg` with text adds 3.1 MB, and `plotters` 0.3 places everything at
//! whole pixels and puts its legends over curves. Rasterising the outlines of glyphs takes `tiny-skia` and
//! `ttf-parser`; the latter adds 0.07 MB.

mod axis;
mod body;
mod chart;
mod colour_bar;
mod colours;
mod dot_plot;
mod heatmap;
mod marker;
mod pdf;
mod picture;
mod png;
mod skin;
mod svg;
mod text;

pub use body::BodyDrawing;
pub use chart::{Chart, Mark, Series};
pub use dot_plot::{Dot, DotPlot};
pub use heatmap::{Heatmap, Panel};
pub use pdf::pdf;
pub use picture::Picture;
pub use png::png;
pub use skin::SkinDrawing;
pub use svg::svg;
pub use text::FILE as FONT_FILE;
