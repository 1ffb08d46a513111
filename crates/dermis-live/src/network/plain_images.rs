//! Input images made from a frame alone: first-step images at one or more hyperparameters, the refined image if the
//! skin file requests it, and the sensitivity of the remaining channels at each position. This coverage image lets
//! one network handle all sets of lost electrodes.

use dermis_tomo::mesh::PixelGrid;

use super::contact_image::{ContactFitter, FittedTouches, draw_discs};
use super::input_image::InputImage;
use crate::Error;
use crate::imager::{Imager, Refiner};
use crate::prepare::Prepared;
use crate::reference::Reference;

/// Model error used for weights, as in the skins' default: a floor and a share of the channel's voltage.
const FLOOR: f64 = 0.02;
const SHARE: f64 = 0.1;

/// Makes all images of difference frames except those of a first network.
#[derive(Debug)]
pub(super) struct PlainImages {
    sources: Vec<Source>,
    /// Fits the touches of frames, if these or the residual are shown and frames do not carry their fits.
    fitter: Option<Box<ContactFitter>>,
    fitted: FittedTouches,
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
    /// The linear image at this multiple of lambda.
    Imager(f64, Box<Imager>),
    Refiner(Box<Refiner>),
    Contacts,
    Left,
    Coverage,
    /// An image made elsewhere.
    Other,
}

/// Number of frames processed at a time in a batch, to limit memory.
pub const BATCH: usize = 64;

impl PlainImages {
    /// Prepares the operators. They do not depend on measurements unless the skin's weights or hyperparameter do.
    /// Touches are fitted here if frames do not carry their fits. The images at indices `others` are left unchanged.
    ///
    /// # Errors
    /// As [`Imager::new`]; images that the skin does not have.
    pub(super) fn new(
        prepared: &Prepared,
        reference: &Reference,
        images: &[InputImage],
        others: &[usize],
        bring_fits: bool,
    ) -> Result<Self, Error> {
        let mut plain = Self::of(prepared, reference, images, others)?;
        if !bring_fits && plain.shows_fits() {
            plain.fitter = Some(Box::new(ContactFitter::new(prepared)?));
        }
        Ok(plain)
    }

    fn of(prepared: &Prepared, reference: &Reference, images: &[InputImage], others: &[usize]) -> Result<Self, Error> {
        let fits = [InputImage::Contacts, InputImage::Left];
        if let Some(image) = images.iter().find(|image| fits.contains(image) && !prepared.skin.fits_touches()) {
            let (expected, got) =
                ("a skin without backend.circuit, whose touches the model fits".into(), prepared.skin.name.clone());
            return Err(Error::Frames { what: format!("input image \"{image}\""), expected, got });
        }
        if images.contains(&InputImage::Left) && !images.contains(&InputImage::Step(1.0)) {
            let (expected, got) = ("image among the inputs too".into(), "none".into());
            return Err(Error::Frames { what: "input image \"left\"".into(), expected, got });
        }
        let mut sources = Vec::with_capacity(images.len());
        for (place, image) in images.iter().enumerate() {
            if others.contains(&place) {
                sources.push(Source::Other);
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
        Ok(Self { sources, fitter, fitted, grid, pixels, sensitivity, whole, inside, absent, coverage })
    }

    fn shows_fits(&self) -> bool {
        self.sources.iter().any(|source| matches!(source, Source::Contacts | Source::Left))
    }

    /// Number of images.
    pub(super) fn images(&self) -> usize {
        self.sources.len()
    }

    /// Number of values in the images of one frame.
    pub(super) fn values(&self) -> usize {
        self.images() * self.pixels
    }

    /// Images of one frame of difference data (model volts, `NaN` where missing), into images x rows x columns; 0
    /// outside the skin. Allocates only if the set of missing channels changes.
    ///
    /// # Errors
    /// As [`Imager::image`].
    pub(super) fn images_of(&mut self, difference: &[f64], out: &mut [f32]) -> Result<(), Error> {
        self.check_length(out)?;
        if self.sources.iter().any(|source| matches!(source, Source::Refiner(_))) {
            self.refine(&[difference.to_vec()], out)?;
        }
        self.image(difference, out)
    }

    /// As [`PlainImages::images_of`] for a frame with its fit; refined images are left unchanged.
    ///
    /// # Errors
    /// As [`PlainImages::images_of`].
    pub(super) fn images_of_fitted(
        &mut self,
        difference: &[f64],
        fitted: &FittedTouches,
        out: &mut [f32],
    ) -> Result<(), Error> {
        self.check_length(out)?;
        self.draw(difference, fitted, out)
    }

    /// As [`PlainImages::images_of`] for many frames, one after another, refined on all threads.
    ///
    /// # Errors
    /// As [`PlainImages::images_of`].
    pub(super) fn images_of_all(&mut self, differences: &[Vec<f64>], out: &mut [f32]) -> Result<(), Error> {
        self.refine(differences, out)?;
        for (difference, frame) in differences.iter().zip(out.chunks_exact_mut(self.values())) {
            self.image(difference, frame)?;
        }
        Ok(())
    }

    fn check_length(&self, out: &[f32]) -> Result<(), Error> {
        if out.len() != self.values() {
            let (expected, got) = (format!("{} values", self.values()), out.len().to_string());
            return Err(Error::Frames { what: "input images".into(), expected, got });
        }
        Ok(())
    }

    /// Writes the refined images of frames into their places.
    fn refine(&mut self, differences: &[Vec<f64>], out: &mut [f32]) -> Result<(), Error> {
        let values = self.values();
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

    /// Makes the other images of a frame, and clears all outside the skin.
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
                Source::Left | Source::Refiner(_) | Source::Other => {}
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

/// A refiner with the skin file's settings, at the live image's lambda.
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
