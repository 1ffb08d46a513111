//! What a network is shown of a frame: first-step images at one or more hyperparameters, the refined image where the
//! skin file asks for one, and how well the channels that are left see each place. The coverage image is what makes one
//! network serve all sets of lost electrodes.

use std::fmt;
use std::str::FromStr;

use dermis_learn::Model;
use dermis_learn::scene::{LOWERED, RAISED};
use dermis_tomo::mesh::PixelGrid;

use super::contact_image::{ContactFitter, FittedTouches, draw_discs};
use super::first_network::{FirstNetwork, Look};
use crate::Error;
use crate::imager::{Imager, Refiner};
use crate::prepare::Prepared;
use crate::reference::Reference;

/// Model error that weights are made of, as in the skins' default: a floor and a share of the channel's voltage.
const FLOOR: f64 = 0.02;
const SHARE: f64 = 0.1;

/// One image that a network is shown, written `image`, `image*0.3` (lambda times 0.3), `refined`, `contacts`, `left`,
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
    /// The Gauss-Newton image that the skin file asks for (`imaging.refinement`): log conductivity. It takes some
    /// tenths of a second, so that a network that is shown it labels recordings, not live frames.
    Refined,
    /// The touches that the forward model fits (`touch.refine`), as discs: the share of each pixel that they cover.
    Contacts,
    /// The linear image of what these touches leave of the frame, of a sandwich: cuts, and what is no touch.
    Left,
    /// Sensitivity of the channels that are there relative to that of all: 1 where nothing is lost, 0 where nothing is
    /// left.
    Coverage,
    /// The probability that a first network gives a class: [`LOWERED`] or [`RAISED`].
    First(u8),
    /// The Gauss-Newton image about what a first network makes of the frame: log conductivity.
    AboutFirst,
}

impl InputImage {
    /// Whether only a first network can give it.
    pub fn is_of_first(self) -> bool {
        matches!(self, Self::First(_) | Self::AboutFirst)
    }

    /// Whether live frames have no time for it.
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

/// Makes a network's input images of difference frames.
#[derive(Debug)]
pub struct FirstStep {
    sources: Vec<Source>,
    /// Fits the touches of frames, where these or what they leave are shown and frames do not bring them along.
    fitter: Option<Box<ContactFitter>>,
    fitted: FittedTouches,
    /// Looks first, where what it sees is shown.
    first: Option<Box<FirstNetwork>>,
    grid: PixelGrid,
    pixels: usize,
    /// `W_m J_mp^2`, channels x inside pixels, and its sums over channels.
    sensitivity: Vec<f32>,
    whole: Vec<f32>,
    inside: Vec<u32>,
    absent: Vec<bool>,
    coverage: Vec<f32>,
}

#[derive(Debug)]
enum Source {
    /// The linear image at so many times lambda.
    Imager(f64, Box<Imager>),
    Refiner(Box<Refiner>),
    Contacts,
    Left,
    Coverage,
    First(Look),
}

/// Frames of a batch that are worked on at a time: bounds memory.
pub const BATCH: usize = 64;

impl FirstStep {
    /// Prepares the operators. They do not depend on measurements unless the skin's weights or hyperparameter do.
    ///
    /// # Errors
    /// As [`Imager::new`]; images that the skin has not.
    pub fn new(prepared: &Prepared, reference: &Reference, images: &[InputImage]) -> Result<Self, Error> {
        Self::with_first(prepared, reference, images, None)
    }

    /// As [`FirstStep::new`], with a network that looks first, for images of what it sees.
    ///
    /// # Errors
    /// As [`FirstStep::new`]; a first network that does not fit the skin.
    pub fn with_first(
        prepared: &Prepared,
        reference: &Reference,
        images: &[InputImage],
        first: Option<&Model>,
    ) -> Result<Self, Error> {
        let first = first.filter(|_| images.iter().any(|image| image.is_of_first()));
        let first = first.map(|model| FirstNetwork::new(prepared, reference, model)).transpose()?;
        let mut first_step = Self::of(prepared, reference, images, first)?;
        if first_step.shows_fits() {
            first_step.fitter = Some(Box::new(ContactFitter::new(prepared)?));
        }
        Ok(first_step)
    }

    /// As [`FirstStep::new`], for frames that bring along what was fitted to them
    /// ([`FirstStep::images_of_fitted`]).
    ///
    /// # Errors
    /// As [`FirstStep::new`].
    pub fn beside_fits(prepared: &Prepared, reference: &Reference, images: &[InputImage]) -> Result<Self, Error> {
        Self::of(prepared, reference, images, None)
    }

    fn of(
        prepared: &Prepared,
        reference: &Reference,
        images: &[InputImage],
        first: Option<FirstNetwork>,
    ) -> Result<Self, Error> {
        let fits = [InputImage::Contacts, InputImage::Left];
        if let Some(image) = images.iter().find(|image| fits.contains(image) && !prepared.skin.refines_touches()) {
            let (expected, got) = ("touch.refine in the skin file".into(), prepared.skin.name.clone());
            return Err(Error::Frames { what: format!("input image \"{image}\""), expected, got });
        }
        if images.contains(&InputImage::Left) && !images.contains(&InputImage::Step(1.0)) {
            let (expected, got) = ("image among the inputs too".into(), "none".into());
            return Err(Error::Frames { what: "input image \"left\"".into(), expected, got });
        }
        let mut sources = Vec::with_capacity(images.len());
        for image in images {
            if let Some(look) = first.as_ref().and_then(|first| first.look(*image)) {
                sources.push(Source::First(look));
                continue;
            }
            sources.push(match image {
                InputImage::First(_) | InputImage::AboutFirst => {
                    let (expected, got) = ("a first network".into(), "none".into());
                    return Err(Error::Frames { what: format!("input image \"{image}\""), expected, got });
                }
                InputImage::Coverage => Source::Coverage,
                InputImage::Refined => Source::Refiner(Box::new(refiner(prepared, reference)?)),
                InputImage::Contacts => Source::Contacts,
                InputImage::Left => Source::Left,
                InputImage::Step(factor) => {
                    let mut imager = Imager::new(prepared, reference, &[])?;
                    if *factor != 1.0 {
                        imager.set_hyperparameter(factor * imager.hyperparameter(), &reference.noise)?;
                    }
                    Source::Imager(*factor, Box::new(imager))
                }
            });
        }
        let covered = sources.iter().any(|source| matches!(source, Source::Coverage));
        let sensitivity = if covered { sensitivity(prepared) } else { Vec::new() };
        let inside = prepared.map.inside_pixels().to_vec();
        let mut whole = vec![0.0; inside.len()];
        for row in sensitivity.chunks_exact(inside.len().max(1)) {
            whole.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
        }
        let grid = *prepared.map.grid();
        let pixels = grid.len();
        let absent = vec![false; prepared.channels()];
        let mut coverage = vec![0.0; pixels];
        inside.iter().for_each(|&pixel| coverage[pixel as usize] = 1.0);
        let (fitter, fitted) = (None, FittedTouches::default());
        let first = first.map(Box::new);
        Ok(Self { sources, fitter, fitted, first, grid, pixels, sensitivity, whole, inside, absent, coverage })
    }

    fn shows_fits(&self) -> bool {
        self.sources.iter().any(|source| matches!(source, Source::Contacts | Source::Left))
    }

    /// Number of input images.
    pub fn images(&self) -> usize {
        self.sources.len()
    }

    /// Images of one frame of difference data (model volts, `NaN` where missing), into images x rows x columns; 0
    /// outside the skin. Allocates only when the set of missing channels changes.
    ///
    /// # Errors
    /// As [`Imager::image`].
    pub fn images_of(&mut self, difference: &[f64], out: &mut [f32]) -> Result<(), Error> {
        self.check_length(out)?;
        if self.sources.iter().any(|source| matches!(source, Source::Refiner(_) | Source::First(_))) {
            self.refine(&[difference.to_vec()], out)?;
        }
        self.image(difference, out)
    }

    /// As [`FirstStep::images_of`] of a frame to which this has been fitted; refined images, for which live frames have no
    /// time, are left as they are.
    ///
    /// # Errors
    /// As [`FirstStep::images_of`].
    pub fn images_of_fitted(
        &mut self,
        difference: &[f64],
        fitted: &FittedTouches,
        out: &mut [f32],
    ) -> Result<(), Error> {
        self.check_length(out)?;
        self.draw(difference, fitted, out)
    }

    fn check_length(&self, out: &[f32]) -> Result<(), Error> {
        if out.len() != self.images() * self.pixels {
            let (expected, got) = (format!("{} values", self.images() * self.pixels), out.len().to_string());
            return Err(Error::Frames { what: "input images".into(), expected, got });
        }
        Ok(())
    }

    /// As [`FirstStep::images_of`] for many frames, one after the other in `out`, refined on all threads.
    ///
    /// # Errors
    /// As [`FirstStep::images_of`].
    pub fn images_of_all(&mut self, differences: &[Vec<f64>], out: &mut Vec<f32>) -> Result<(), Error> {
        let values = self.images() * self.pixels;
        out.clear();
        out.resize(differences.len() * values, 0.0);
        self.refine(differences, out)?;
        for (difference, frame) in differences.iter().zip(out.chunks_exact_mut(values)) {
            self.image(difference, frame)?;
        }
        Ok(())
    }

    /// The refined images of frames, and what a first network sees in them, into their places.
    fn refine(&mut self, differences: &[Vec<f64>], out: &mut [f32]) -> Result<(), Error> {
        let values = self.images() * self.pixels;
        if let Some(first) = &mut self.first {
            let look = |(place, source): (usize, &Source)| match source {
                Source::First(look) => Some((place, *look)),
                _ => None,
            };
            let places: Vec<(usize, Look)> = self.sources.iter().enumerate().filter_map(look).collect();
            first.show(differences, &places, self.sources.len(), out)?;
        }
        for (place, source) in self.sources.iter_mut().enumerate() {
            if let Source::Refiner(refiner) = source {
                let refined = refiner.images(differences, || ())?;
                for (image, frame) in refined.iter().zip(out.chunks_exact_mut(values)) {
                    frame[place * self.pixels..][..self.pixels].copy_from_slice(image);
                }
            }
        }
        Ok(())
    }

    /// The other images of a frame, and all cleared outside the skin.
    fn image(&mut self, difference: &[f64], frame: &mut [f32]) -> Result<(), Error> {
        let mut fitted = std::mem::take(&mut self.fitted);
        let is_fitted = self.fitter.as_mut().map_or(Ok(()), |fitter| fitter.fit(difference, &mut fitted));
        let drawn = is_fitted.and_then(|()| self.draw(difference, &fitted, frame));
        self.fitted = fitted;
        drawn
    }

    fn draw(&mut self, difference: &[f64], fitted: &FittedTouches, frame: &mut [f32]) -> Result<(), Error> {
        self.update_coverage(difference);
        if let Some(left) = self.sources.iter().position(|source| matches!(source, Source::Left)) {
            let imager = self.sources.iter_mut().find_map(|source| match source {
                Source::Imager(1.0, imager) => Some(imager),
                _ => None,
            });
            let image = &mut frame[left * self.pixels..(left + 1) * self.pixels];
            imager.map_or(Ok(()), |imager| imager.image(&fitted.left, image))?;
        }
        for (source, image) in self.sources.iter_mut().zip(frame.chunks_exact_mut(self.pixels)) {
            match source {
                Source::Coverage => image.copy_from_slice(&self.coverage),
                Source::Imager(_, imager) => imager.image(difference, image)?,
                Source::Contacts => draw_discs(&self.grid, &self.inside, &fitted.discs, image),
                Source::Left | Source::Refiner(_) | Source::First(_) => {}
            }
            image.iter_mut().filter(|value| !value.is_finite()).for_each(|value| *value = 0.0);
        }
        Ok(())
    }

    fn update_coverage(&mut self, difference: &[f64]) {
        let same = difference.iter().zip(&self.absent).all(|(value, absent)| value.is_finite() != *absent);
        if same || self.sensitivity.is_empty() {
            return;
        }
        self.absent.iter_mut().zip(difference).for_each(|(absent, value)| *absent = !value.is_finite());
        let mut left = vec![0.0_f32; self.inside.len()];
        for (row, absent) in self.sensitivity.chunks_exact(self.inside.len()).zip(&self.absent) {
            if !absent {
                left.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
            }
        }
        for ((&pixel, left), whole) in self.inside.iter().zip(&left).zip(&self.whole) {
            self.coverage[pixel as usize] = (left / whole.max(f32::MIN_POSITIVE)).sqrt().min(1.0);
        }
    }
}

/// As the skin file says, at the live image's lambda.
pub(super) fn refiner(prepared: &Prepared, reference: &Reference) -> Result<Refiner, Error> {
    let Some(refinement) = &prepared.skin.imaging.refinement else {
        let (expected, got) = ("imaging.refinement in the skin file".into(), prepared.skin.name.clone());
        return Err(Error::Frames { what: "input image \"refined\"".into(), expected, got });
    };
    let lambda = Imager::new(prepared, reference, &[])?.hyperparameter();
    Refiner::new(prepared, refinement, reference, lambda)
}

fn sensitivity(prepared: &Prepared) -> Vec<f32> {
    let largest = prepared.voltages.iter().map(|v| v.abs()).fold(0.0, f64::max);
    let mut values = Vec::with_capacity(prepared.jacobian.values.len());
    for (channel, voltage) in prepared.voltages.iter().enumerate() {
        let weight = 1.0 / ((FLOOR * largest).powi(2) + (SHARE * voltage).powi(2));
        values.extend(prepared.jacobian.row(channel).iter().map(|j| (weight * j * j) as f32));
    }
    values
}
