//! Experiments and their results: tables and figures, independent of how they are drawn.

use crate::Error;

/// Origin of a figure in a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A parameter was tuned to match it, so it proves nothing.
    Fitted,
    /// Follows from the twin's physics.
    Predicted,
    /// Follows from the algorithms that turn readings into images and touches.
    Algorithm,
}

impl Kind {
    /// The word used in tables.
    pub fn word(self) -> &'static str {
        match self {
            Self::Fitted => "fitted",
            Self::Predicted => "predicted",
            Self::Algorithm => "algorithm",
        }
    }
}

/// One line of a table: a figure from the paper and its counterpart here.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Name of the quantity.
    pub quantity: String,
    /// Unit; empty for ratios and counts.
    pub unit: &'static str,
    /// Value in the paper, if it gives one.
    pub paper: Option<f64>,
    /// Value from the twin and dermis.
    pub here: f64,
    /// Origin of the value here.
    pub kind: Kind,
}

/// Style of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// Connected points.
    Line,
    /// Separate points.
    Points,
    /// Repeats: several points per x, shown as their mean and standard deviation.
    Repeats,
    /// Points printed in the paper.
    PaperPoints,
    /// A line printed in the paper, or a bound stated there.
    PaperLine,
}

/// A curve in a figure.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Name in the legend; curves with the same name share a colour and an entry.
    pub name: String,
    /// (x, y); a line breaks at a point that is not finite.
    pub points: Vec<[f64; 2]>,
    /// Style.
    pub look: Look,
}

/// An image in a figure.
#[derive(Clone, Debug, PartialEq)]
pub struct ImagePanel {
    /// Title.
    pub name: String,
    /// Quantity with its unit; panels of the same quantity share a scale.
    pub quantity: &'static str,
    /// Row-major, row 0 at the top, NaN outside.
    pub values: Vec<f32>,
    /// True positions of the presses, as shares of width and height from the top left corner.
    pub marks: Vec<[f64; 2]>,
    /// Radius of the upright cylinder that the skin lies on, as a share of the image's width; `None` if it is flat.
    pub bend: Option<f64>,
    /// Width of the image, millimetres; `None` if the width is not a length.
    pub width_mm: Option<f64>,
}

/// A figure, independent of how it is drawn.
#[derive(Clone, Debug, PartialEq)]
pub enum Figure {
    /// Curves with common axes.
    Curves {
        /// File name.
        name: &'static str,
        /// Title above the curves.
        title: String,
        /// Caption: what is shown and how it was made, for readers who see only the figure.
        caption: String,
        /// Label with unit.
        x_label: &'static str,
        /// Label with unit.
        y_label: &'static str,
        /// The curves.
        curves: Vec<Curve>,
    },
    /// Images on a common grid.
    Images {
        /// File name.
        name: &'static str,
        /// Title above the images.
        title: String,
        /// Caption: what is shown and how it was made, for readers who see only the figure.
        caption: String,
        /// Pixels per row.
        columns: usize,
        /// The images.
        panels: Vec<ImagePanel>,
    },
}

/// Results of an experiment.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// Identifier, such as `I2`.
    pub id: &'static str,
    /// One-line title.
    pub title: &'static str,
    /// Table of results.
    pub rows: Vec<Row>,
    /// Figures.
    pub figures: Vec<Figure>,
    /// Notes on what was fitted or assumed, and other remarks.
    pub notes: Vec<String>,
}

/// An experiment that can be replayed.
#[derive(Clone, Copy)]
pub struct Experiment {
    /// Identifier, such as `I2`.
    pub id: &'static str,
    /// One-line title.
    pub title: &'static str,
    pub(crate) run: fn() -> Result<Report, Error>,
}

impl std::fmt::Debug for Experiment {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Experiment").field("id", &self.id).finish_non_exhaustive()
    }
}

impl Experiment {
    /// Replays the experiment.
    ///
    /// # Errors
    /// The twin cannot be built or solved.
    pub fn run(&self) -> Result<Report, Error> {
        (self.run)()
    }
}
