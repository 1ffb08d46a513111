//! Experiments and what they give: tables and figures, without a look.

use crate::Error;

/// How a figure of a table came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A parameter was chosen so that this agrees; no evidence of anything.
    Fitted,
    /// Follows from the physics of the twin.
    Predicted,
    /// Follows from how images and touches are made of the readings.
    Algorithm,
}

impl Kind {
    /// For tables.
    pub fn word(self) -> &'static str {
        match self {
            Self::Fitted => "fitted",
            Self::Predicted => "predicted",
            Self::Algorithm => "algorithm",
        }
    }
}

/// One line of a table: a figure of the paper and the same here.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// What.
    pub quantity: String,
    /// Its unit, empty for numbers and counts.
    pub unit: &'static str,
    /// What the paper gives, if it gives a number.
    pub paper: Option<f64>,
    /// What the twin and dermis give.
    pub here: f64,
    /// How it came about.
    pub kind: Kind,
}

/// How a curve is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// Points that are joined.
    Line,
    /// Points by themselves.
    Points,
    /// Repeats: several points of one x, to be shown as their mean and standard deviation.
    Repeats,
    /// Points that the paper prints.
    PaperPoints,
    /// A line that the paper prints, or a bound that it gives.
    PaperLine,
}

/// A curve of a figure.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Its name in the legend; curves of one name have one colour and one entry.
    pub name: String,
    /// (x, y); a line breaks at a point that is not finite.
    pub points: Vec<[f64; 2]>,
    /// How they are drawn.
    pub look: Look,
}

/// An image of a figure.
#[derive(Clone, Debug, PartialEq)]
pub struct ImagePanel {
    /// What it shows.
    pub name: String,
    /// What the values are, with their unit; panels of one quantity share a scale.
    pub quantity: &'static str,
    /// Row-major, row 0 at the top, NaN outside.
    pub values: Vec<f32>,
    /// Where something truly pressed, as shares of width and height from the top left corner.
    pub marks: Vec<[f64; 2]>,
    /// Radius of the upright cylinder that the skin lies on, as a share of the image's width; none where it is flat.
    pub bend: Option<f64>,
    /// Width of the image, millimetres; none where its width is no length.
    pub width_mm: Option<f64>,
}

/// A figure, without a look.
#[derive(Clone, Debug, PartialEq)]
pub enum Figure {
    /// Curves over one axis.
    Curves {
        /// Name of its file.
        name: &'static str,
        /// Above it.
        title: String,
        /// What is shown and how it came about, for a reader of the figure alone.
        caption: String,
        /// With its unit.
        x_label: &'static str,
        /// With its unit.
        y_label: &'static str,
        /// The curves.
        curves: Vec<Curve>,
    },
    /// Images of one grid.
    Images {
        /// Name of its file.
        name: &'static str,
        /// Above them.
        title: String,
        /// What is shown and how it came about, for a reader of the figure alone.
        caption: String,
        /// Pixels in a row.
        columns: usize,
        /// The images.
        panels: Vec<ImagePanel>,
    },
}

/// What an experiment gives.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// As in `I2`.
    pub id: &'static str,
    /// One line.
    pub title: &'static str,
    /// Its table.
    pub rows: Vec<Row>,
    /// Its figures.
    pub figures: Vec<Figure>,
    /// What was fitted, assumed, or needs saying.
    pub notes: Vec<String>,
}

/// Something that is replayed.
#[derive(Clone, Copy)]
pub struct Experiment {
    /// As in `I2`.
    pub id: &'static str,
    /// One line.
    pub title: &'static str,
    pub(crate) run: fn() -> Result<Report, Error>,
}

impl std::fmt::Debug for Experiment {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Experiment").field("id", &self.id).finish_non_exhaustive()
    }
}

impl Experiment {
    /// Replays it.
    ///
    /// # Errors
    /// A twin that cannot be made or solved.
    pub fn run(&self) -> Result<Report, Error> {
        (self.run)()
    }
}
