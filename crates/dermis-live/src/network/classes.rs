//! Classes of the pixels of one frame.

use dermis_learn::scene::BACKGROUND;

/// Names of the classes, in the order of the labels.
pub const CLASSES: [&str; 3] = ["background", "lowered", "raised"];
/// Novelty score above which the network does not label a frame: 1.5 times as far from the training set as all but a
/// thousandth of the held-out frames. Those are simulated; measured frames are slightly further out.
pub const UNLIKE: f32 = 1.5;

/// Classes of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Classes {
    /// Rows of the images, row 0 at the top.
    pub rows: usize,
    /// Columns of the images.
    pub columns: usize,
    /// Probability of each class in each pixel, classes (in the order of [`CLASSES`]) x rows x columns. Background
    /// outside the skin. If the frame falls back to thresholds, which give no probabilities: 1 for the label, 0 for
    /// the others.
    pub probabilities: Vec<f32>,
    /// The most likely class of each pixel, rows x columns; background outside the skin.
    pub labels: Vec<u8>,
    /// Distance of the frame from the training set; above [`UNLIKE`] the frame is too different. `None` if the model
    /// has no score.
    pub novelty: Option<f32>,
    /// True if the frame is too different from the training set. The labels then come from thresholds on its
    /// first-step image.
    pub falls_back: bool,
}

impl Classes {
    /// Background everywhere, for images of this size.
    pub fn new(rows: usize, columns: usize) -> Self {
        let pixels = rows * columns;
        let mut probabilities = vec![0.0; CLASSES.len() * pixels];
        probabilities[..pixels].fill(1.0);
        let labels = vec![BACKGROUND; pixels];
        Self { rows, columns, probabilities, labels, novelty: None, falls_back: false }
    }

    /// Probabilities of one class, rows x columns; `None` for an invalid label.
    pub fn of_class(&self, class: u8) -> Option<&[f32]> {
        self.probabilities.chunks_exact(self.labels.len().max(1)).nth(usize::from(class))
    }
}
