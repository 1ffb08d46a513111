//! Classes of the pixels of one frame.

use dermis_learn::scene::BACKGROUND;

/// Names of the classes, in the order of the labels.
pub const CLASSES: [&str; 3] = ["background", "lowered", "raised"];
/// Novelty score above which a frame is not labelled by the network: half as far again from the training set as all but
/// a thousandth of the frames held out. Those are simulated, and measured ones are a little farther out.
pub const UNLIKE: f32 = 1.5;

/// Classes of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Classes {
    /// Rows of the images, row 0 at the top.
    pub rows: usize,
    /// Columns of the images.
    pub columns: usize,
    /// Probability of each class in each pixel, classes (in the order of [`CLASSES`]) x rows x columns. Background
    /// outside the skin. Where the frame falls back, 1 for the label and 0 for the others: thresholds give none.
    pub probabilities: Vec<f32>,
    /// The most likely class of each pixel, rows x columns; background outside the skin.
    pub labels: Vec<u8>,
    /// How far the frame is from the training set; above [`UNLIKE`] it is unlike it. `None` where the model has no
    /// score.
    pub novelty: Option<f32>,
    /// True where the frame is unlike the training set: the labels are those of thresholds on its first-step image.
    pub falls_back: bool,
}

impl Classes {
    /// Background everywhere, of images of this size.
    pub fn new(rows: usize, columns: usize) -> Self {
        let pixels = rows * columns;
        let mut probabilities = vec![0.0; CLASSES.len() * pixels];
        probabilities[..pixels].fill(1.0);
        let labels = vec![BACKGROUND; pixels];
        Self { rows, columns, probabilities, labels, novelty: None, falls_back: false }
    }

    /// Probabilities of one class, rows x columns; `None` for a label that is no class.
    pub fn of_class(&self, class: u8) -> Option<&[f32]> {
        self.probabilities.chunks_exact(self.labels.len().max(1)).nth(usize::from(class))
    }
}
