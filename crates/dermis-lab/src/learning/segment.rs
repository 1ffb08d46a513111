//! Labels recorded frames offline; the work behind `dermis segment`. With a model, the network's probabilities
//! decide. Frames unlike the training data, and all frames if there is no model, are labelled by thresholds on their
//! image.

use dermis_live::imager::Imager;
use dermis_live::imager::Refiner;
use std::path::PathBuf;

use dermis_device::instruments::npy;
use dermis_device::{FileSpec, FrameTable, ReadOptions};
use dermis_learn::Model;
use dermis_tomo::mesh::{INSIDE_COVERAGE, PixelGrid, PixelMap};

use crate::Error;
use dermis_live::channels::ChannelReader;
use dermis_live::network::Classifier;
use dermis_live::network::UNLIKE;
use dermis_live::network::{MaskRule, PRESENCE, enlarge, masks_of_image};
use dermis_live::network::{built_in, suits};
use dermis_live::prepare::Prepared;
use dermis_live::reference::Reference;
use dermis_skin::Skin;

/// Input and output of a segmentation.
#[derive(Clone, Debug)]
pub struct SegmentRequest {
    /// The skin.
    pub skin: Skin,
    /// Frames of the untouched skin, to be averaged; missing channels are NaN.
    pub reference: FileSpec,
    /// Frames to label; missing channels are NaN.
    pub frames: FileSpec,
    /// How to read both files.
    pub read: ReadOptions,
    /// The network to use.
    pub network: NetworkChoice,
    /// Pixels along the longer side of the label images.
    pub size: usize,
    /// Output file of the labels: NPY, u8, rows x columns (frames x rows x columns for several frames), row 0 at the
    /// top.
    pub labels: Option<PathBuf>,
    /// Output file of the probabilities: NPY, f32, frames x classes x rows x columns; needs a network.
    pub probabilities: Option<PathBuf>,
}

/// Selects the network that labels frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NetworkChoice {
    /// The network shipped with the skin, if there is one and nothing that affects images was changed; else none.
    Shipped,
    /// A model card made by `dermis train`.
    File(PathBuf),
    /// No network, only thresholds.
    None,
}

impl NetworkChoice {
    fn open(&self, skin: &Skin) -> Result<Option<Model>, Error> {
        Ok(match self {
            Self::Shipped => built_in(&skin.name)?.filter(|model| suits(model, skin)),
            Self::File(path) => Some(Model::load(path)?),
            Self::None => None,
        })
    }
}

/// The method used for a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// The network. The novelty score, if the model has one, was at most 1.
    Network {
        /// The score.
        novelty: Option<f32>,
    },
    /// Thresholds, because the novelty score exceeded [`UNLIKE`].
    UnlikeTraining {
        /// The score.
        novelty: f32,
    },
    /// Thresholds, because there is no model.
    Thresholds,
}

/// One labelled frame.
#[derive(Clone, Debug)]
pub struct Segmented {
    /// Class of each pixel, row 0 at the top, 0 outside the skin.
    pub labels: Vec<u8>,
    /// Classes x pixels; only for frames labelled by a network, and only if probabilities are kept.
    pub probabilities: Option<Vec<f32>>,
    /// The method used.
    pub method: Method,
}

/// Maximum number of pixels per side; a larger number is a typing error.
const MOST_PIXELS: usize = 4096;

/// Labels all frames and writes the requested files. `progress` gets the number of steps done and the total.
///
/// # Errors
/// Files cannot be read or don't fit the skin, the model is damaged or belongs to another skin, or an output cannot
/// be written.
pub fn segment(request: &SegmentRequest, progress: impl FnMut(usize, usize)) -> Result<Vec<Segmented>, Error> {
    let refuse = |what: &str, expected: &str, got: String| {
        Err(Error::Live(dermis_live::Error::Frames { what: what.into(), expected: expected.into(), got }))
    };
    if !(8..=MOST_PIXELS).contains(&request.size) {
        return refuse("size of the labels", "8 to 4096 pixels", request.size.to_string());
    }
    let model = request.network.open(&request.skin)?;
    if request.probabilities.is_some() && model.is_none() {
        return refuse("probabilities", "a network, which gives them", "none for this skin".into());
    }
    let read = |file| dermis_record::read_frames_of(&request.skin, file, request.read.clone());
    let (references, frames) = (read(&request.reference)?, read(&request.frames)?);
    let prepared = Prepared::new(request.skin.clone())?;
    let reads = prepared.skin.backend.reads;
    let reader = |table: &FrameTable| {
        ChannelReader::new(table.layout(), &prepared.protocol, reads, &table.source().display().to_string())
    };
    let mut reference_reader = reader(&references)?;
    let references = reference_reader.read_table(&references)?;
    let mut frame_reader = reader(&frames)?;
    frame_reader.share_phase_of(&reference_reader);
    let frames = frame_reader.read_table(&frames)?;
    let reference = Reference::of(&prepared, &references)?;
    let differences: Vec<Vec<f64>> = frames.iter().map(|frame| reference.difference(frame, None)).collect();
    let mut segmenter = Segmenter::new(&prepared, &reference, model.as_ref(), request.size)?;
    if request.probabilities.is_some() {
        segmenter.keep_probabilities();
    }
    let segmented = segmenter.label(&differences, progress)?;
    write(request, segmenter.label_size(), &segmented)?;
    Ok(segmented)
}

fn write(request: &SegmentRequest, [rows, columns]: [usize; 2], frames: &[Segmented]) -> Result<(), Error> {
    if let Some(path) = &request.labels {
        let labels: Vec<u8> = frames.iter().flat_map(|frame| frame.labels.iter().copied()).collect();
        let shape: &[usize] = if frames.len() == 1 { &[rows, columns] } else { &[frames.len(), rows, columns] };
        npy::write_u8(path, shape, &labels)?;
    }
    if let Some(path) = &request.probabilities {
        let classes = dermis_live::network::CLASSES.len();
        let absent = || vec![f32::NAN; classes * rows * columns];
        let values: Vec<f32> =
            frames.iter().flat_map(|frame| frame.probabilities.clone().unwrap_or_else(absent)).collect();
        npy::write_f32(path, &[frames.len(), classes, rows, columns], &values)?;
    }
    Ok(())
}

/// Labels difference frames of one skin, taken against one reference.
pub struct Segmenter<'a> {
    prepared: &'a Prepared,
    reference: &'a Reference,
    network: Option<Classifier>,
    label_size: [usize; 2],
    outside: Vec<bool>,
    keeps_probabilities: bool,
}

impl<'a> Segmenter<'a> {
    /// Prepares the operators and the network.
    ///
    /// # Errors
    /// The model belongs to another skin or needs unknown inputs.
    pub fn new(
        prepared: &'a Prepared,
        reference: &'a Reference,
        model: Option<&Model>,
        size: usize,
    ) -> Result<Self, Error> {
        let network = model.map(|model| Classifier::with_reference(prepared, reference, model)).transpose()?;
        let (low, high) = prepared.body.outline.bounds_m();
        let named = |source| Error::Live(dermis_live::Error::Mesh { skin: prepared.skin.name.clone(), source });
        let grid = PixelGrid::covering(low, high, size).map_err(named)?;
        let label_size = [grid.rows, grid.columns];
        let map = PixelMap::new(grid, &prepared.body.mesh.mesh).map_err(named)?;
        let outside = map.coverage().iter().map(|share| *share < INSIDE_COVERAGE).collect();
        Ok(Self { prepared, reference, network, label_size, outside, keeps_probabilities: false })
    }

    /// Keeps the probabilities of labelled frames (classes x pixels of the labels). They take much more memory than
    /// the labels.
    pub fn keep_probabilities(&mut self) {
        self.keeps_probabilities = true;
    }

    /// Rows and columns of the labels.
    pub fn label_size(&self) -> [usize; 2] {
        self.label_size
    }

    /// Labels difference frames (model volts, `NaN` where missing).
    ///
    /// # Errors
    /// A frame has the wrong length or no valid channel, or its forward problem cannot be solved.
    pub fn label(
        &mut self,
        differences: &[Vec<f64>],
        mut progress: impl FnMut(usize, usize),
    ) -> Result<Vec<Segmented>, Error> {
        let mut segmented: Vec<Option<Segmented>> = vec![None; differences.len()];
        let mut fallback = vec![Method::Thresholds; differences.len()];
        if let Some(network) = &mut self.network {
            let (size, mut done) = (network.image_size(), 0);
            let found = network.run_all(differences, |frames| {
                done += frames;
                progress(done, differences.len());
            })?;
            for (frame, (probabilities, novelty)) in found.into_iter().enumerate() {
                match novelty.filter(|novelty| *novelty > UNLIKE) {
                    Some(novelty) => fallback[frame] = Method::UnlikeTraining { novelty },
                    None => segmented[frame] = Some(self.labelled(&probabilities, size, novelty)),
                }
            }
        }
        let left: Vec<usize> = (0..differences.len()).filter(|&frame| segmented[frame].is_none()).collect();
        let rest: Vec<Vec<f64>> = left.iter().map(|&frame| differences[frame].clone()).collect();
        for (&frame, labels) in left.iter().zip(self.by_thresholds(&rest, &mut progress)?) {
            segmented[frame] = Some(Segmented { labels, probabilities: None, method: fallback[frame] });
        }
        Ok(segmented.into_iter().flatten().collect())
    }

    /// The network's probabilities scaled up to the label size, and the labels that follow from them.
    fn labelled(&self, small: &[f32], (rows, columns): (usize, usize), novelty: Option<f32>) -> Segmented {
        let classes = dermis_live::network::CLASSES.len();
        let pixels = self.label_size[0] * self.label_size[1];
        let mut probabilities = Vec::with_capacity(classes * pixels);
        for class in small.chunks_exact(rows * columns) {
            probabilities.extend(enlarge(class, [rows, columns], self.label_size, &[]));
        }
        let mut labels = vec![0; pixels];
        PRESENCE.label(&probabilities, &mut labels);
        self.clear_outside(&mut labels);
        let probabilities = self.keeps_probabilities.then_some(probabilities);
        Segmented { labels, probabilities, method: Method::Network { novelty } }
    }

    fn by_thresholds(
        &self,
        differences: &[Vec<f64>],
        progress: &mut impl FnMut(usize, usize),
    ) -> Result<Vec<Vec<u8>>, Error> {
        if differences.is_empty() {
            return Ok(Vec::new());
        }
        let prepared = self.prepared;
        let mut imager = Imager::new(prepared, self.reference, differences)?;
        let grid = prepared.map.grid();
        let (images, rule) = match &prepared.skin.imaging.refinement {
            Some(refinement) => {
                let (mut done, all) = (0, refinement.steps * differences.len());
                let mut refiner = Refiner::new(prepared, refinement, self.reference, imager.hyperparameter())?;
                let images = refiner.images(differences, || {
                    done += 1;
                    progress(done, all);
                })?;
                (images, MaskRule::LOG_CONDUCTIVITY)
            }
            None => {
                let mut images = Vec::with_capacity(differences.len());
                for difference in differences {
                    let mut image = vec![f32::NAN; grid.len()];
                    imager.image(difference, &mut image)?;
                    images.push(image);
                }
                (images, MaskRule::linear(prepared.skin.touch.smallest_amplitude))
            }
        };
        let polarity = prepared.skin.imaging.polarity.sign() as f32;
        let label = |mut image: Vec<f32>| {
            image.iter_mut().for_each(|value| *value *= polarity);
            let large = enlarge(&image, [grid.rows, grid.columns], self.label_size, &self.outside);
            masks_of_image(&large, &rule)
        };
        Ok(images.into_iter().map(label).collect())
    }

    fn clear_outside(&self, labels: &mut [u8]) {
        labels.iter_mut().zip(&self.outside).filter(|(_, outside)| **outside).for_each(|(label, _)| *label = 0);
    }
}
