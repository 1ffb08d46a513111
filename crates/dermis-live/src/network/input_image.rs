//! The input images of a network, by name.

use std::fmt;
use std::str::FromStr;

use dermis_learn::Model;
use dermis_learn::scene::{LOWERED, RAISED};

use crate::Error;

/// One input image of a network, written `image`, `image*0.3` (lambda times 0.3), `refined`, `contacts`, `left`,
/// `coverage`, `first-lowered`, `first-raised` or `about-first`.
///
/// ```
/// use dermis_live::network::InputImage;
///
/// assert_eq!("image*0.3".parse(), Ok(InputImage::Step(0.3)));
/// assert_eq!(InputImage::Step(1.0).to_string(), "image");
/// assert!("image*-1".parse::<InputImage>().is_err());
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InputImage {
    /// The linear image at the skin's lambda times this.
    Step(f64),
    /// The Gauss-Newton image requested by the skin file (`imaging.refinement`): log conductivity. It takes some
    /// tenths of a second, so a network that uses it labels recordings, not live frames.
    Refined,
    /// The touches fitted by the forward model, as discs: the share of each pixel that they cover.
    Contacts,
    /// For a sandwich, the linear image of the residual after fitting these touches: cuts, and anything that is not a
    /// touch.
    Left,
    /// Sensitivity of the available channels relative to that of all: 1 if nothing is lost, 0 if nothing is left.
    Coverage,
    /// A first network's probability of a class: [`LOWERED`] or [`RAISED`].
    First(u8),
    /// The Gauss-Newton image linearised about a first network's result: log conductivity.
    AboutFirst,
}

impl InputImage {
    /// True if it requires a first network.
    pub fn is_of_first(self) -> bool {
        matches!(self, Self::First(_) | Self::AboutFirst)
    }

    /// True if it takes too long for live frames.
    pub fn takes_long(self) -> bool {
        self == Self::Refined || self.is_of_first()
    }
}

impl fmt::Display for InputImage {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            InputImage::Step(1.0) => out.write_str("image"),
            InputImage::Step(factor) => write!(out, "image*{factor}"),
            InputImage::Refined => out.write_str("refined"),
            InputImage::Contacts => out.write_str("contacts"),
            InputImage::Left => out.write_str("left"),
            InputImage::Coverage => out.write_str("coverage"),
            InputImage::First(class) => out.write_str(if *class == LOWERED { "first-lowered" } else { "first-raised" }),
            InputImage::AboutFirst => out.write_str("about-first"),
        }
    }
}

impl FromStr for InputImage {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let factor = match text.split_once('*') {
            _ if text == "coverage" => return Ok(InputImage::Coverage),
            _ if text == "refined" => return Ok(InputImage::Refined),
            _ if text == "contacts" => return Ok(InputImage::Contacts),
            _ if text == "left" => return Ok(InputImage::Left),
            _ if text == "first-lowered" => return Ok(InputImage::First(LOWERED)),
            _ if text == "first-raised" => return Ok(InputImage::First(RAISED)),
            _ if text == "about-first" => return Ok(InputImage::AboutFirst),
            None if text == "image" => Some(1.0),
            Some(("image", factor)) => factor.parse().ok().filter(|f: &f64| *f > 0.0 && f.is_finite()),
            _ => None,
        };
        let known = "image, image*FACTOR with a positive factor on lambda, refined, contacts, left, coverage, \
                     first-lowered, first-raised, or about-first";
        let refused = || format!("{text:?}: expected {known}");
        factor.map(InputImage::Step).ok_or_else(refused)
    }
}

/// The images that a model is shown.
///
/// # Errors
/// Names that are not known.
pub(super) fn inputs_of(model: &Model) -> Result<Vec<InputImage>, Error> {
    let refuse = |got: String| Error::Frames { what: "model".into(), expected: "inputs that are known".into(), got };
    model.card.inputs.iter().map(|name| name.parse().map_err(refuse)).collect()
}

/// Images times the factors that the network was trained with.
pub(super) fn rescale(input: &mut [f32], scale: &[f32]) {
    let pixels = input.len() / scale.len();
    for (image, factor) in input.chunks_exact_mut(pixels).zip(scale) {
        image.iter_mut().for_each(|value| *value *= factor);
    }
}
