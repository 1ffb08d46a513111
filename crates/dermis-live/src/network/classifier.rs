//! The second step in live use: difference data in, the class of every pixel out, with probabilities and a novelty
//! score. For a frame too different from the training set, it falls back to thresholds on the first-step image.
//! Allocates nothing per frame while the set of missing channels stays the same.

use dermis_learn::metrics::most_likely;
use dermis_learn::scene::{BACKGROUND, LOWERED, RAISED};
use dermis_learn::{Model, Network, Novelty};
use dermis_skin::{Backend, Electronics, Skin};
use rayon::prelude::*;

use super::classes::{CLASSES, Classes, UNLIKE};
use super::contact_image::FittedTouches;
use super::input_image::{InputImage, inputs_of, rescale};
use super::masks::{MaskRule, label_image};
use super::network_input::FirstStep;
use super::plain_images::BATCH;
use crate::Error;
use crate::prepare::Prepared;
use crate::reference::Reference;

/// Results for one frame of a batch: probabilities, and novelty if the model has a score.
pub type Seen = (Vec<f32>, Option<f32>);

/// A network with the images it needs, for one skin.
#[derive(Debug)]
pub struct Classifier {
    first_step: FirstStep,
    network: Network,
    novelty: Option<Novelty>,
    scale: Vec<f32>,
    temperature: f32,
    /// Indices among the inputs of a first network's probabilities: lowered, raised.
    first: Option<[usize; 2]>,
    /// Index among the inputs of the image for the fallback thresholds, and the sign that makes it one of
    /// conductivity.
    step: usize,
    polarity: f32,
    rule: MaskRule,
    outside: Vec<u32>,
    input: Vec<f32>,
    probabilities: Vec<f32>,
}

impl Classifier {
    /// As [`Classifier::new`], for frames that already carry their fits ([`Classifier::classify_fitted`]).
    ///
    /// # Errors
    /// As [`Classifier::new`].
    pub fn beside_fits(prepared: &Prepared, model: &Model) -> Result<Self, Error> {
        refuse_refined(model)?;
        let reference = Reference::of(prepared, std::slice::from_ref(&prepared.voltages))?;
        Self::of(prepared, model, |inputs| FirstStep::beside_fits(prepared, &reference, inputs))
    }

    /// For frames of any reference: the operators are those of a skin's own model. Quantities that the skin file
    /// takes from a measured baseline (weights by noise) are taken from the model here; use
    /// [`Classifier::with_reference`] for those.
    ///
    /// # Errors
    /// As [`Classifier::with_reference`], and a network that needs refined images, for which live frames have no
    /// time.
    pub fn new(prepared: &Prepared, model: &Model) -> Result<Self, Error> {
        refuse_refined(model)?;
        let reference = Reference::of(prepared, std::slice::from_ref(&prepared.voltages))?;
        Self::with_reference(prepared, &reference, model)
    }

    /// With operators for one reference.
    ///
    /// # Errors
    /// A model of another skin, or with inputs, classes or image size that do not match it.
    pub fn with_reference(prepared: &Prepared, reference: &Reference, model: &Model) -> Result<Self, Error> {
        let first = model.first()?;
        Self::of(prepared, model, |inputs| FirstStep::with_first(prepared, reference, inputs, first.as_ref()))
    }

    fn of(
        prepared: &Prepared,
        model: &Model,
        first_step: impl FnOnce(&[InputImage]) -> Result<FirstStep, Error>,
    ) -> Result<Self, Error> {
        model.check_skin(&prepared.skin.name, &imaging_sha256(&prepared.skin))?;
        let card = &model.card;
        let refuse = |expected: String, got: String| Error::Frames { what: "model".into(), expected, got };
        let inputs = inputs_of(model)?;
        let Some(step) = inputs.iter().position(|input| matches!(input, InputImage::Step(_))) else {
            return Err(refuse("an image among the inputs".into(), card.inputs.join(", ")));
        };
        let place = |class| inputs.iter().position(|input| *input == InputImage::First(class));
        let first = place(LOWERED).zip(place(RAISED)).map(<[usize; 2]>::from);
        if card.classes != CLASSES {
            return Err(refuse(format!("classes {}", CLASSES.join(", ")), card.classes.join(", ")));
        }
        let grid = prepared.map.grid();
        if (card.rows, card.columns) != (grid.rows, grid.columns) {
            let expected = format!("images of {} x {}", grid.rows, grid.columns);
            return Err(refuse(expected, format!("{} x {}", card.rows, card.columns)));
        }
        let inside = prepared.map.inside_mask();
        Ok(Self {
            first_step: first_step(&inputs)?,
            network: model.network()?,
            novelty: model.novelty(),
            scale: card.input_scale.clone(),
            temperature: card.temperature,
            first,
            step,
            polarity: prepared.skin.imaging.polarity.sign() as f32,
            rule: MaskRule::linear(prepared.skin.touch.smallest_amplitude),
            outside: (0..grid.len() as u32).filter(|&pixel| !inside[pixel as usize]).collect(),
            input: vec![0.0; inputs.len() * grid.len()],
            probabilities: vec![0.0; card.classes.len() * grid.len()],
        })
    }

    /// Rows and columns of the images.
    pub fn image_size(&self) -> (usize, usize) {
        self.network.image_size()
    }

    /// Classifies one frame of difference data (model volts, `NaN` where missing), as from `Reference::difference`.
    /// `out` is resized to the images if necessary.
    ///
    /// # Errors
    /// A frame of the wrong length or without any channel.
    pub fn classify(&mut self, difference: &[f64], out: &mut Classes) -> Result<(), Error> {
        self.first_step.images_of(difference, &mut self.input)?;
        self.classify_input(out)
    }

    /// As [`Classifier::classify`], for a frame with its fit.
    ///
    /// # Errors
    /// As [`Classifier::classify`].
    pub fn classify_fitted(
        &mut self,
        difference: &[f64],
        fitted: &FittedTouches,
        out: &mut Classes,
    ) -> Result<(), Error> {
        self.first_step.images_of_fitted(difference, fitted, &mut self.input)?;
        self.classify_input(out)
    }

    fn classify_input(&mut self, out: &mut Classes) -> Result<(), Error> {
        let (rows, columns) = self.image_size();
        if (out.rows, out.columns) != (rows, columns) || out.probabilities.len() != self.probabilities.len() {
            *out = Classes::new(rows, columns);
        }
        out.novelty = self.run()?;
        out.falls_back = out.novelty.is_some_and(|novelty| novelty > UNLIKE);
        let pixels = rows * columns;
        if out.falls_back {
            let image = &self.input[self.step * pixels..(self.step + 1) * pixels];
            // The image was multiplied by the network's scale; the thresholds are for the image itself.
            label_image(image, self.polarity / self.scale[self.step], &self.rule, &mut out.labels);
            for (class, probabilities) in out.probabilities.chunks_exact_mut(pixels).enumerate() {
                for (probability, label) in probabilities.iter_mut().zip(&out.labels) {
                    *probability = f32::from(u8::from(usize::from(*label) == class));
                }
            }
        } else {
            out.probabilities.copy_from_slice(&self.probabilities);
            for &pixel in &self.outside {
                for (class, probabilities) in out.probabilities.chunks_exact_mut(pixels).enumerate() {
                    probabilities[pixel as usize] = f32::from(u8::from(class == usize::from(BACKGROUND)));
                }
            }
            most_likely(&out.probabilities, CLASSES.len(), &mut out.labels);
        }
        Ok(())
    }

    /// Runs the network and leaves its probabilities, including those outside the skin, in `self.probabilities`.
    /// Returns the novelty score.
    fn run(&mut self) -> Result<Option<f32>, Error> {
        rescale(&mut self.input, &self.scale);
        self.network.probabilities(&self.input, self.temperature, &mut self.probabilities)?;
        agree(self.first, &self.scale, &self.input, &mut self.probabilities);
        Ok(self.novelty.as_ref().map(|novelty| novelty.score(self.network.features())))
    }

    /// The network's probabilities (classes x rows x columns, including outside the skin) and novelty scores of many
    /// frames, on all threads. `done` is called after each batch with its number of frames.
    ///
    /// # Errors
    /// As [`Classifier::classify`].
    pub fn run_all(&mut self, differences: &[Vec<f64>], mut done: impl FnMut(usize)) -> Result<Vec<Seen>, Error> {
        let mut all = Vec::with_capacity(differences.len());
        let mut inputs = Vec::new();
        for batch in differences.chunks(BATCH) {
            self.first_step.images_of_all(batch, &mut inputs)?;
            let (values, count) = (self.input.len(), self.probabilities.len());
            let of_frame = |network: &mut Network, input: &mut [f32]| {
                rescale(input, &self.scale);
                let mut probabilities = vec![0.0; count];
                network.probabilities(input, self.temperature, &mut probabilities)?;
                agree(self.first, &self.scale, input, &mut probabilities);
                Ok((probabilities, self.novelty.as_ref().map(|novelty| novelty.score(network.features()))))
            };
            let frames = inputs.par_chunks_exact_mut(values);
            let found: Result<Vec<Seen>, Error> = frames.map_init(|| self.network.clone(), of_frame).collect();
            all.extend(found?);
            done(batch.len());
        }
        Ok(all)
    }
}

/// Lower bound on a network's probability.
const LEAST_PROBABILITY: f32 = 1e-6;

/// Replaces a second network's probabilities by their geometric mean with the first network's, if those are among the
/// inputs. For objects unlike its training set, the second network is overconfident.
fn agree(first: Option<[usize; 2]>, scale: &[f32], input: &[f32], probabilities: &mut [f32]) {
    let Some(places) = first else { return };
    let pixels = probabilities.len() / CLASSES.len();
    for pixel in 0..pixels {
        let [lowered, raised] = places.map(|place| input[place * pixels + pixel] / scale[place]);
        let of_first = [1.0 - lowered - raised, lowered, raised];
        let mean = [0, 1, 2].map(|class| {
            let of_second = probabilities[class * pixels + pixel].max(LEAST_PROBABILITY);
            (of_first[class].max(LEAST_PROBABILITY) * of_second).sqrt()
        });
        let sum: f32 = mean.iter().sum();
        for (class, value) in mean.into_iter().enumerate() {
            probabilities[class * pixels + pixel] = value / sum;
        }
    }
}

/// Rejects refined images and a first network's results as inputs, since live frames have no time for them.
fn refuse_refined(model: &Model) -> Result<(), Error> {
    if let Some(image) = inputs_of(model)?.iter().find(|image| image.takes_long()) {
        let (expected, got) = ("inputs that a live frame has time for".into(), image.to_string());
        return Err(Error::Frames { what: "model".into(), expected, got });
    }
    Ok(())
}

/// SHA-256 of everything that images depend on: modality, frontend, backend without its electronics, and imaging. A
/// network matches skins with the same fingerprint.
pub fn imaging_sha256(skin: &Skin) -> String {
    let backend = Backend { electronics: Electronics::default(), ..skin.backend.clone() };
    let parts = (skin.modality, &skin.frontend, &backend, &skin.imaging);
    dermis_learn::sha256(&serde_json::to_vec(&parts).unwrap_or_default())
}

/// True if a network was trained for this skin, and its input images can be made from the skin's frames.
pub fn suits(model: &Model, skin: &Skin) -> bool {
    let is_fitted =
        |name: &String| [InputImage::Contacts, InputImage::Left].iter().any(|image| *name == image.to_string());
    let is_trained_for = model.check_skin(&skin.name, &imaging_sha256(skin)).is_ok();
    is_trained_for && (skin.fits_touches() || !model.card.inputs.iter().any(is_fitted))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_networks_agree_halfway() {
        // One pixel, the images scaled by 2 and 4: the first says 0.8, 0.1, 0.1 and the second 0.2, 0.8, 0.0.
        let mut probabilities = [0.2, 0.8, 0.0];
        agree(Some([0, 1]), &[2.0, 4.0], &[0.2, 0.4], &mut probabilities);
        let (background, lowered) = (0.16_f32.sqrt(), 0.08_f32.sqrt());
        let raised = (0.1 * LEAST_PROBABILITY).sqrt();
        let sum = background + lowered + raised;
        for (found, expected) in probabilities.iter().zip([background, lowered, raised]) {
            assert!((found - expected / sum).abs() < 1e-6, "{probabilities:?}");
        }
        let before = probabilities;
        agree(None, &[], &[], &mut probabilities);
        assert_eq!(probabilities, before);
    }
}
