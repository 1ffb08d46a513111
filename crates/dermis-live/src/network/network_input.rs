//! Input images of a network: those made from the frame alone, and those from a first network.

use dermis_learn::Model;

use super::contact_image::FittedTouches;
use super::first_network::{FirstNetwork, Look};
use super::input_image::InputImage;
use super::plain_images::PlainImages;
use crate::Error;
use crate::prepare::Prepared;
use crate::reference::Reference;

/// Makes a network's input images from difference frames.
#[derive(Debug)]
pub struct FirstStep {
    plain: PlainImages,
    /// A first network, if its results are among the images.
    first: Option<Box<FirstLook>>,
}

/// A first network, and the indices of the images that show its results.
#[derive(Debug)]
struct FirstLook {
    network: FirstNetwork,
    places: Vec<(usize, Look)>,
}

impl FirstStep {
    /// Prepares the operators. They do not depend on measurements unless the skin's weights or hyperparameter do.
    ///
    /// # Errors
    /// Images that the skin does not have, or that require a first network; as [`crate::imager::Imager::new`].
    pub fn new(prepared: &Prepared, reference: &Reference, images: &[InputImage]) -> Result<Self, Error> {
        Self::with_first(prepared, reference, images, None)
    }

    /// As [`FirstStep::new`], with a first network for images of its results.
    ///
    /// # Errors
    /// As [`FirstStep::new`]; a first network that does not match the skin.
    pub fn with_first(
        prepared: &Prepared,
        reference: &Reference,
        images: &[InputImage],
        first: Option<&Model>,
    ) -> Result<Self, Error> {
        let first = first.filter(|_| images.iter().any(|image| image.is_of_first()));
        let first = first.map(|model| FirstNetwork::new(prepared, reference, model)).transpose()?;
        let first = first.map(|network| {
            let look = |(place, image): (usize, &InputImage)| network.look(*image).map(|look| (place, look));
            let places = images.iter().enumerate().filter_map(look).collect();
            Box::new(FirstLook { network, places })
        });
        let others: Vec<usize> = first.iter().flat_map(|first| first.places.iter().map(|(place, _)| *place)).collect();
        Ok(Self { plain: PlainImages::new(prepared, reference, images, &others, false)?, first })
    }

    /// As [`FirstStep::new`], for frames that already carry their fits ([`FirstStep::images_of_fitted`]).
    ///
    /// # Errors
    /// As [`FirstStep::new`].
    pub fn beside_fits(prepared: &Prepared, reference: &Reference, images: &[InputImage]) -> Result<Self, Error> {
        Ok(Self { plain: PlainImages::new(prepared, reference, images, &[], true)?, first: None })
    }

    /// Number of input images.
    pub fn images(&self) -> usize {
        self.plain.images()
    }

    /// Images of one frame of difference data (model volts, `NaN` where missing), into images x rows x columns; 0
    /// outside the skin. Allocates only if the set of missing channels changes, or for a first network.
    ///
    /// # Errors
    /// A slice of the wrong length; as [`crate::imager::Imager::image`].
    pub fn images_of(&mut self, difference: &[f64], out: &mut [f32]) -> Result<(), Error> {
        self.plain.images_of(difference, out)?;
        if self.first.is_some() {
            self.look(&[difference.to_vec()], out)?;
        }
        Ok(())
    }

    /// As [`FirstStep::images_of`] for a frame with its fit. Refined images, for which live frames have no time, are
    /// left unchanged.
    ///
    /// # Errors
    /// As [`FirstStep::images_of`].
    pub fn images_of_fitted(
        &mut self,
        difference: &[f64],
        fitted: &FittedTouches,
        out: &mut [f32],
    ) -> Result<(), Error> {
        self.plain.images_of_fitted(difference, fitted, out)
    }

    /// As [`FirstStep::images_of`] for many frames, one after another in `out`, refined on all threads.
    ///
    /// # Errors
    /// As [`FirstStep::images_of`].
    pub fn images_of_all(&mut self, differences: &[Vec<f64>], out: &mut Vec<f32>) -> Result<(), Error> {
        out.clear();
        out.resize(differences.len() * self.plain.values(), 0.0);
        self.plain.images_of_all(differences, out)?;
        self.look(differences, out)
    }

    /// Writes a first network's results on frames into their places.
    fn look(&mut self, differences: &[Vec<f64>], out: &mut [f32]) -> Result<(), Error> {
        let images = self.images();
        let Some(FirstLook { network, places }) = self.first.as_deref_mut() else { return Ok(()) };
        network.show(differences, places, images, out)
    }
}
