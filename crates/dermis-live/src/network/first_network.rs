//! Inputs of a second network that come from a first one: its probabilities, and the image of the data linearised
//! about them. A network normally sees images linearised about an empty skin. Linearised about its own guess, the
//! same data show where the guess is wrong.

use dermis_learn::{Model, Network};
use rayon::prelude::*;

use super::classes::CLASSES;
use super::input_image::{InputImage, inputs_of, rescale};
use super::plain_images::{PlainImages, refiner};
use crate::Error;
use crate::imager::GuessRefiner;
use crate::prepare::Prepared;
use crate::reference::Reference;

/// An image from a first network's evaluation of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Look {
    /// One of the first network's input images.
    Input(usize),
    /// Its probability of a class.
    Class(u8),
    /// The image linearised about its guess.
    About,
}

/// A first network with its input images, and the refinement of its guess.
#[derive(Debug)]
pub(super) struct FirstNetwork {
    inputs: Vec<InputImage>,
    plain: PlainImages,
    network: Network,
    scale: Vec<f32>,
    temperature: f32,
    about: GuessRefiner,
    inside: Vec<u32>,
    pixels: usize,
}

impl FirstNetwork {
    /// # Errors
    /// A model whose inputs do not match the skin; a skin without `imaging.refinement`.
    pub(super) fn new(prepared: &Prepared, reference: &Reference, model: &Model) -> Result<Self, Error> {
        let inputs = inputs_of(model)?;
        let plain = PlainImages::new(prepared, reference, &inputs, &[], false)?;
        let about = GuessRefiner::new(prepared, refiner(prepared, reference)?)?;
        Ok(Self {
            inputs,
            plain,
            network: model.network()?,
            scale: model.card.input_scale.clone(),
            temperature: model.card.temperature,
            about,
            inside: prepared.map.inside_pixels().to_vec(),
            pixels: prepared.map.grid().len(),
        })
    }

    /// Source of an image, if it comes from the first network or was computed for it at some expense.
    pub(super) fn look(&self, image: InputImage) -> Option<Look> {
        match image {
            InputImage::First(class) => Some(Look::Class(class)),
            InputImage::AboutFirst => Some(Look::About),
            InputImage::Refined => self.inputs.iter().position(|input| *input == image).map(Look::Input),
            _ => None,
        }
    }

    /// Writes images of frames into their places; each frame has `images` of them.
    ///
    /// # Errors
    /// As [`PlainImages::images_of_all`].
    pub(super) fn show(
        &mut self,
        differences: &[Vec<f64>],
        places: &[(usize, Look)],
        images: usize,
        out: &mut [f32],
    ) -> Result<(), Error> {
        let mut shown = vec![0.0; differences.len() * self.plain.values()];
        self.plain.images_of_all(differences, &mut shown)?;
        let values = self.inputs.len() * self.pixels;
        let probabilities: Vec<Vec<f32>> = shown
            .par_chunks_exact(values)
            .map_init(
                || self.network.clone(),
                |network, input| {
                    let mut scaled = input.to_vec();
                    rescale(&mut scaled, &self.scale);
                    let mut found = vec![0.0; CLASSES.len() * self.pixels];
                    network.probabilities(&scaled, self.temperature, &mut found)?;
                    Ok(found)
                },
            )
            .collect::<Result<_, Error>>()?;
        let is_about_shown = places.iter().any(|(_, look)| *look == Look::About);
        let about = if is_about_shown { self.about.images(differences, &probabilities)? } else { Vec::new() };
        for (frame, out) in out.chunks_exact_mut(images * self.pixels).enumerate() {
            for &(place, look) in places {
                let image = &mut out[place * self.pixels..][..self.pixels];
                match look {
                    Look::Input(input) => {
                        image.copy_from_slice(&shown[frame * values + input * self.pixels..][..self.pixels]);
                    }
                    Look::Class(class) => {
                        let of_class = &probabilities[frame][usize::from(class) * self.pixels..][..self.pixels];
                        image.fill(0.0);
                        self.inside.iter().for_each(|&pixel| image[pixel as usize] = of_class[pixel as usize]);
                    }
                    Look::About => image.copy_from_slice(&about[frame]),
                }
            }
        }
        Ok(())
    }
}
